"""A SUMO network made from a scene, and how faithful it is."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class LanePiece:
    """Part of a scene's lane in SUMO: the SUMO lane, and where on the scene's lane it begins."""

    sumo_lane: str
    start_m: float
    length_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalLink:
    """A link of a SUMO traffic light."""

    light: str
    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ConversionReport:
    """What a conversion kept and lost.

    Attributes:
        lanes, connections: numbers in the scene.
        lost_lanes, lost_connections: what is not in the net, with the reason.
        error_mean_m, error_p99_m, error_max_m: distances of points of the scene's lanes to SUMO's
            and the reverse, taken together.
        seconds: wall time; 0 where the net was read back.
        bridged_connections: joins of lanes that do not touch, which got a way of their own, with
            the distance.
        lost_signals: lanes whose light is at no link, with the reason.
    """

    lanes: int
    connections: int
    lost_lanes: tuple[tuple[str, str], ...] = ()
    lost_connections: tuple[tuple[str, str, str], ...] = ()
    error_mean_m: float = 0.0
    error_p99_m: float = 0.0
    error_max_m: float = 0.0
    seconds: float = 0.0
    bridged_connections: tuple[tuple[str, str, str], ...] = ()
    lost_signals: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoNet:
    """A SUMO network and the way back to the scene.

    Attributes:
        file: the .net.xml.
        additional: polygons to draw (crosswalks), or None.
        pieces: scene lane id -> its pieces in driving order.
        lane_of: SUMO lane id -> scene lane ids on it, in driving order (extensions map to none).
        signals: scene lane id -> links whose light it sees.
        ghost_edge: SUMO edge along the AV's recorded path, joined to no other, where that path
            leaves the lanes; None where it does not.
    """

    file: Path
    additional: Path | None = None
    pieces: dict[str, tuple[LanePiece, ...]] = field(default_factory=dict)
    lane_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    signals: dict[str, tuple[SignalLink, ...]] = field(default_factory=dict)
    report: ConversionReport | None = None
    ghost_edge: str | None = None
