"""From what a file says to a Scene that the rest of the package can rely on."""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import (
    DT_S,
    Bools,
    Floats,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    frozen,
)
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers.checks import ids, motion, road
from deepmf_sumo.readers.checks.motion import RecordingTracks
from deepmf_sumo.texts import shown

MOST_STATES: Final = 1_000_000
"""Agents times steps; the largest scenes have 80 000."""
LONGEST_REPAIR: Final = 2000
"""Letters of the sentence about one repair; it may name many ids."""


@dataclass(kw_only=True)
class Recording:
    """A scene as its file tells it, before the checks.

    Attributes:
        now: the current step that the scene will have.
        timestamps_s: (T), or empty where the file has none: then 0, 0.1, 0.2, ...
        signals: over T steps, or over 0 where the file has none.
        av_id: None where the file does not name the AV.
        repairs: what the reader itself mended or had to infer, a sentence each.
    """

    name: str
    source: Source
    now: int
    timestamps_s: Floats
    tracks: RecordingTracks
    road: RoadMap
    signals: Signals
    av_id: str | None
    interest: tuple[str, ...] = ()
    to_predict: tuple[str, ...] = ()
    repairs: list[str] = field(default_factory=list)


def checked(recording: Recording) -> Scene:
    """The scene, mended where that is possible; `Scene.repairs` says what was mended.

    Raises ReaderError, naming file, record and reason, where it is not possible.
    """
    try:
        with np.errstate(all="ignore"):  # damaged numbers are looked for, not computed with
            return _checked(recording)
    except ReaderError as error:
        raise ReaderError(f"{_where(recording.source)}: {error}.") from None


def confirmed(scene: Scene) -> Scene:
    """A scene that was checked before, as it is. Raises ReaderError, with the reason alone."""
    with np.errstate(all="ignore"):
        ids.refuse(scene.name, scene.tracks.ids, scene.signals.lane_ids, scene.road)
        _refuse_size(scene.tracks.agents, scene.tracks.steps)
        _refuse_steps(scene.tracks.steps, scene.now)
        _refuse_twice(scene.tracks.ids)
        motion.refuse_values(scene.tracks)
        _refuse_av(scene.av_id, scene.tracks.valid[scene.tracks.row(scene.av_id)], scene.now)
        _refuse_unknown(scene)
        road.refuse(scene.road)
        road.refuse_links(scene.road)
    return scene


def _where(source: Source) -> str:
    return f"{source.file} record {source.record}"


def _checked(recording: Recording) -> Scene:
    raw, repairs = recording.tracks, list(recording.repairs)
    steps = raw.valid.shape[1]
    ids.refuse(recording.name, raw.ids, recording.signals.lane_ids, recording.road)
    _refuse_size(len(raw.ids), steps)
    _refuse_steps(steps, recording.now)
    _refuse_twice(raw.ids)
    av_id = _named_av(recording)
    timestamps = _timestamps(recording.timestamps_s, steps, repairs)
    motion.drop_impossible_states(raw, repairs)
    _refuse_av(av_id, raw.valid[raw.ids.index(av_id)], recording.now, repairs)
    motion.cut_jumps(raw, timestamps, recording.now, av_id, repairs)
    mended = road.mended(recording.road, repairs)
    tracks = motion.finished(raw, recording.now, av_id, repairs)
    return Scene(
        name=recording.name,
        source=recording.source,
        dt_s=DT_S,
        now=recording.now,
        timestamps_s=timestamps,
        tracks=tracks,
        road=mended,
        signals=_signals(recording.signals, mended.lanes, steps, repairs),
        av_id=av_id,
        interest=_known(recording.interest, tracks.ids, "objects of interest", repairs),
        to_predict=_known(recording.to_predict, tracks.ids, "tracks to predict", repairs),
        repairs=tuple(map(_readable, repairs)),
    )


def _readable(repair: str) -> str:
    cut = repair if len(repair) <= LONGEST_REPAIR else f"{repair[:LONGEST_REPAIR]} ..."
    return shown(cut)


def _refuse_size(agents: int, steps: int) -> None:
    if agents * steps > MOST_STATES:
        raise ReaderError(
            f"has {agents} agents over {steps} steps, more than {MOST_STATES} states in all"
        )


def _refuse_twice(agents: Sequence[str]) -> None:
    twice = next((agent for agent, count in Counter(agents).items() if count > 1), None)
    if twice is not None:
        raise ReaderError(f"two tracks have the id {twice}")


def _refuse_unknown(scene: Scene) -> None:
    """Raises ReaderError where the scene speaks of agents that it lacks, or of other times."""
    missing = next(
        (a for a in (*scene.interest, *scene.to_predict) if a not in scene.tracks.ids), ""
    )
    if missing:
        raise ReaderError(f"'interest' or 'to_predict' names {missing}, which is not there")
    if abs(scene.dt_s - DT_S) > 1e-9:
        raise ReaderError(f"'dt_s' is {scene.dt_s:g}; only {DT_S} s can be used")
    times = scene.timestamps_s
    if not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise ReaderError("'timestamps_s' is not finite or runs backwards")
    strange = scene.signals.state[scene.signals.state > max(SignalState)]
    if len(strange):
        raise ReaderError(f"'signals_state' has the unknown state {strange[0]}")
    if not np.isfinite(scene.signals.stop_m).all():
        raise ReaderError("'signals_stop_m' is not finite")


def _refuse_steps(steps: int, now: int) -> None:
    if steps < now + 2:
        raise ReaderError(
            f"has {steps} steps, but the current one is {now}, so that no future was recorded; "
            "take a file of the training or validation split"
        )


def _named_av(recording: Recording) -> str:
    av_id = recording.av_id
    if av_id is None:
        raise ReaderError(
            "the AV is not named, and no object has the size of the recording vehicle"
        )
    if av_id not in recording.tracks.ids:
        raise ReaderError(f"the AV is '{av_id}', but there is no such track")
    return av_id


def _refuse_av(av_id: str, valid: Bools, now: int, repairs: Sequence[str] = ()) -> None:
    """Raises ReaderError; what was left out of the AV's track before is the likely cause."""
    if not valid[now]:
        causes = [line.rstrip(".") for line in repairs if line.startswith(f"Agent {av_id}:")]
        why = f" ({'; '.join(causes)})" if causes else ""
        raise ReaderError(f"the AV ({av_id}) has no valid state at the current step {now}{why}")


def _timestamps(recorded: Floats, steps: int, repairs: list[str]) -> Floats:
    """As recorded, or on the grid of 0.1 s where they cannot be right."""
    grid = frozen(np.arange(steps) * DT_S)
    if not len(recorded):
        return grid
    if len(recorded) != steps:
        raise ReaderError(f"has {len(recorded)} timestamps, but {steps} steps")
    if not np.isfinite(recorded).all() or (np.diff(recorded) < 0).any():
        repairs.append("The timestamps are not finite or run backwards; 0.1 s a step was taken.")
        return grid
    spacing = float(np.median(np.diff(recorded)))
    if abs(spacing - DT_S) > DT_S / 4:
        raise ReaderError(f"was recorded every {spacing:.3g} s; only {DT_S} s can be used")
    return recorded


def _signals(signals: Signals, lanes: Collection[str], steps: int, repairs: list[str]) -> Signals:
    """Over all steps of the scene: never seen where the file says nothing."""
    kept_rows = np.array([lane in lanes for lane in signals.lane_ids], bool)
    if not kept_rows.all():
        lost = [lane for lane in signals.lane_ids if lane not in lanes]
        repairs.append(f"Signals of lanes not in the record were left out: {', '.join(lost)}.")
        signals = Signals(
            lane_ids=tuple(lane for lane in signals.lane_ids if lane in lanes),
            state=signals.state[kept_rows],
            seen=signals.seen[kept_rows],
            stop_m=signals.stop_m[kept_rows],
            stop_z_m=signals.stop_z_m[kept_rows],
        )
    there = signals.state.shape[1]
    if there > steps:
        repairs.append(f"Signals of {there - steps} steps after the last track state were dropped.")
    state = np.zeros((len(signals.lane_ids), steps), "uint8")
    seen = np.zeros(state.shape, bool)
    kept = min(there, steps)
    state[:, :kept], seen[:, :kept] = signals.state[:, :kept], signals.seen[:, :kept]
    unknown = seen & (state > 8)
    if unknown.any():
        repairs.append(f"{int(unknown.sum())} signal states above 8 were taken as unknown.")
    state[~seen | unknown] = 0
    return replace(signals, state=state, seen=seen)


def _known(
    wanted: tuple[str, ...], ids: tuple[str, ...], what: str, repairs: list[str]
) -> tuple[str, ...]:
    missing = [agent for agent in wanted if agent not in ids]
    if missing:
        repairs.append(f"The {what} {', '.join(missing)} are no tracks and were dropped.")
    return tuple(agent for agent in wanted if agent in ids)


__all__ = ["Recording", "RecordingTracks", "checked", "confirmed"]
