"""Raw scenes: what a reader returns, what helps to make them, and what makes scenes of them.

A reader returns what its file states as a `RawScene`; `repair.repair` checks it and makes the
`Scene`. All readers make use of the same checks, so none needs any of its own.

- `road`: `RoadBuilder` and `SignalsBuilder`, feature by feature; ids and kinds.
- `lane_links`: successors and neighbours of lanes, from the geometry.
- `one_file`: what readers of formats with one scene in a file share.
- `repair`, `motion`: the checks, and the limits of what a scene may have.
"""

from dataclasses import dataclass, field

from deepmf_sumo.scene import AgentKind, Bools, Floats, RoadMap, Signals, Source


@dataclass(kw_only=True)
class RawTracks:
    """Motion as the file states it; the shapes are those of `Tracks`, except for the sizes.

    Attributes:
        size_m: (A, T, 3) length, width, height at each step; 0 is unknown.
        position_m: (A, T, 3) middle of the box; a height of 0 is unknown.
    """

    ids: list[str]
    kinds: list[AgentKind]
    size_m: Floats
    position_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    valid: Bools


@dataclass(kw_only=True)
class RawScene:
    """A scene as its file states it, before the checks.

    Attributes:
        now: the scene's current step.
        timestamps_s: (T), or empty if the file has none: then 0, 0.1, 0.2, ...
        signals: over T steps, or over 0 if the file has none.
        av_id: None if the file does not name the AV.
        repairs: one sentence for each repair or inference of the reader.
    """

    name: str
    source: Source
    now: int
    timestamps_s: Floats
    tracks: RawTracks
    road: RoadMap
    signals: Signals
    av_id: str | None
    interest: tuple[str, ...] = ()
    to_predict: tuple[str, ...] = ()
    repairs: list[str] = field(default_factory=list)


__all__ = ["RawScene", "RawTracks"]
