"""A coverage document of openodd-py, ``openodd/run_coverage.json``: in which domain the AV drove.

It says what the attributes of an operational design domain (ODD; ASAM OpenODD 1.0, after ISO 34503)
were at each step of the attack, and when the AV was hit. ``openodd-coverage`` merges any number of
these documents, those of other programs too, into a report, and pools the runs of a network (its
*scenario*). Its failure rates are those of attacks, not of traffic: no run has a weight.

What a SUMO network does not know is missing: weather, light, kinds of roads. The radius of what is
near and the bounds of traffic density are those of autoware-carla-scenario 19.3, so that the same
word means the same in both. It needs the extra ``openodd``.
"""

import json
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from deepmf_sumo import __version__, files, plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene import Bools, Floats, RoadMap, Rollout, agent_ids
from deepmf_sumo.scene.geometry import frames, road
from deepmf_sumo.scene.geometry.ground import off_level
from deepmf_sumo.scene.geometry.road import Covering

FILE: Final = "openodd/"
DOCUMENT, ARCHIVE = "run_coverage.json", "run_odd.tar.gz"
_NEAR_M: Final = 50.0
_DENSITY: Final = ((0, "none"), (2, "low"), (5, "medium"), (np.inf, "high"))
"""Up to how many other vehicles near the AV the density is called so."""
_BESIDE_M: Final = 1.5 * 3.5
"""A vehicle ahead is in the AV's lane or in the next one."""
_SAME_WAY: Final = np.cos(np.pi / 4)
_KMH: Final = 3.6
_CREATED: Final = "1970-01-01T00:00:00+00:00"
"""The same run gives the same bytes."""


class Settings(plugins.Settings):
    """The domain.

    Attributes:
        odd: a binding file of openodd-py; empty: the ODD that comes with it.
    """

    odd: str = ""


def check() -> None:
    """Raise PluginError without the extra."""
    if find_spec("openodd") is None:
        raise PluginError(
            "exporter 'openodd' needs openodd-py, which is not installed; install it with"
            ' `pip install "deepmf-sumo[openodd]"`.'
        )


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``; time 0 is the begin of the attack.

    Raises OutputError, PluginError without the extra or for an ODD that cannot be read, and what
    `Exportable.around` raises.
    """
    check()
    import openodd

    rollout, backend = run.rollout, _backend()
    odd = _odd(settings.odd, backend)
    collector = openodd.CoverageCollector(
        [], odd=odd, backend=backend, generator={"deepmf-sumo": __version__}
    )
    steps = list(_steps(rollout, run.around.road))
    collector.start(steps[0], 0.0)
    for step in steps[1:]:
        collector.tick(step, step.elapsed_s)
    collector.end(steps[-1], steps[-1].elapsed_s)
    hit = next((one.step for one in rollout.contacts if one.kind.startswith("av_")), None)
    hit_s = None if hit is None else (hit - rollout.now) * rollout.dt_s
    collector.record_outcome(hit is None, failed_at=hit_s)
    document = collector.to_dict(Path(run.around.source.file).stem)
    document["odd"]["started_at"] = _CREATED
    with files.writing(path), files.whole_folder(path) as folder:
        (folder / DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", "utf-8")
        if (archive := odd.archive()) is not None:
            (folder / ARCHIVE).write_bytes(archive)


class _Step(NamedTuple):
    """A step of an attack; ``row`` is the AV's, ``there`` (A) all others on its level."""

    rollout: Rollout
    road: RoadMap
    row: int
    step: int
    there: Bools

    @property
    def elapsed_s(self) -> float:
        return (self.step - self.rollout.now) * self.rollout.dt_s

    @property
    def place_m(self) -> Floats:
        """(1, 2) the AV's."""
        place: Floats = self.rollout.tracks.position_m[self.row, self.step][None]
        return place

    @property
    def around_m(self) -> Floats:
        """(A, 2) where the others are, ahead and to the left of the AV."""
        tracks = self.rollout.tracks
        heading = float(tracks.heading_rad[self.row, self.step])
        return frames.to_local(tracks.position_m[:, self.step], self.place_m[0], heading)

    def near(self, *kinds: str) -> int:
        """Number of the others of some kinds near the AV; what bends is one, not its parts."""
        tracks = self.rollout.tracks
        near = self.there & np.isin(tracks.kinds, kinds)
        near &= np.hypot(*self.around_m.T) <= _NEAR_M
        return len(agent_ids.wholes(tracks.ids[row] for row in np.flatnonzero(near)))

    def under(self) -> Covering:
        """The lanes under the AV."""
        z_m = self.rollout.tracks.z_m[self.row, self.step]
        return road.covering(self.road, self.place_m, np.atleast_1d(z_m))


def _steps(rollout: Rollout, on: RoadMap) -> Iterator[_Step]:
    """From the begin of the attack to its end, while the AV is there."""
    tracks = rollout.tracks
    row = tracks.row(rollout.av_id)
    others = np.arange(tracks.agents) != row
    for step in range(rollout.now, tracks.steps):
        if tracks.valid[row, step]:
            here_m, z_m = tracks.position_m[:, step], tracks.z_m[:, step]
            off = off_level(on, here_m[row], float(z_m[row]), here_m, z_m)
            yield _Step(rollout, on, row, step, tracks.valid[:, step] & others & ~off)


def _speed_kph(at: _Step) -> float:
    return float(at.rollout.tracks.speed_mps[at.row, at.step]) * _KMH


def _limit_kph(at: _Step) -> float | None:
    tracks = at.rollout.tracks
    course, z_m = (np.atleast_1d(one[at.row, at.step]) for one in (tracks.heading_rad, tracks.z_m))
    found = float(road.limit_mps(at.road, at.place_m, course, z_m)[0]) * _KMH
    return None if np.isnan(found) else round(found, 3)


def _in_junction(at: _Step) -> bool | None:
    """On a lane inside a junction, and on no other; None beside all lanes."""
    lanes = road.lanes_for_cars(at.road).lanes
    inside = [lanes[row].interpolating for row in at.under().lane.tolist()]
    return all(inside) if inside else None


def _lane_count(at: _Step) -> int | None:
    """Lanes of the AV's direction; None in junctions and beside lanes."""
    if _in_junction(at) is not False:
        return None
    heading = float(at.rollout.tracks.heading_rad[at.row, at.step])
    under, lanes = at.under(), road.lanes_for_cars(at.road).lanes
    turns = np.cos(under.heading_rad - heading)
    counted = {lanes[row].id for row in under.lane[turns > _SAME_WAY].tolist()}
    waiting = [*counted]
    while waiting:
        lane = at.road.lanes[waiting.pop()]
        beside = {one.lane_id for one in (*lane.left, *lane.right)} & at.road.lanes.keys()
        new = {one for one in beside if at.road.lanes[one].kind != "bike"} - counted
        counted |= new
        waiting += new
    return len(counted) or None


def _density(at: _Step) -> str:
    near = at.near("vehicle", "cyclist", "other")
    return next(name for most, name in _DENSITY if near <= most)


def _pedestrian_nearby(at: _Step) -> bool:
    return at.near("pedestrian") > 0


def _ahead(at: _Step) -> tuple[float, float] | None:
    """Gap (m) and relative speed (km/h) of the nearest vehicle ahead that goes the same way."""
    tracks = at.rollout.tracks
    turned = np.cos(tracks.heading_rad[:, at.step] - tracks.heading_rad[at.row, at.step])
    x, y = at.around_m.T
    gap = x - (tracks.size_m[:, 0] + tracks.size_m[at.row, 0]) / 2
    rows = at.there & (x > 0) & (np.abs(y) < _BESIDE_M) & (turned > _SAME_WAY)
    rows &= np.isin(tracks.kinds, ("vehicle", "cyclist"))
    if not rows.any():
        return None
    row = int(np.where(rows, gap, np.inf).argmin())
    faster = float(tracks.speed_mps[row, at.step] - tracks.speed_mps[at.row, at.step])
    return max(float(gap[row]), 0.0), faster * _KMH


def _missing(_: _Step) -> None:
    """What no SUMO network and no track says."""


def _part(which: int) -> Callable[[_Step], float | None]:
    def read(at: _Step) -> float | None:
        found = _ahead(at)
        return None if found is None else found[which]

    return read


_PROBES: Final[dict[str, tuple[Callable[[_Step], Any], str]]] = {
    "in_junction": (_in_junction, ""),
    "speed_limit_kph": (_limit_kph, "km/h"),
    "lane_count": (_lane_count, ""),
    "ego_speed_kph": (_speed_kph, "km/h"),
    "traffic_density": (_density, ""),
    "pedestrian_nearby": (_pedestrian_nearby, ""),
    "lanelet_location": (_missing, ""),
    "lanelet_subtype": (_missing, ""),
    "illumination": (_missing, ""),
    "rain": (_missing, ""),
    "fog": (_missing, ""),
}
"""By the names of the ODD that openodd-py brings along."""
_MEASURES: Final[dict[str, tuple[Callable[[_Step], Any], str]]] = {
    "vehicle_ahead_gap_m": (_part(0), "m"),
    "vehicle_ahead_relative_speed_kph": (_part(1), "km/h"),
    "crossing_pedestrian_gap_m": (_missing, "m"),
    "crossing_pedestrian_speed_ms": (_missing, "m/s"),
}


def _backend() -> Any:
    """What measures the attributes; it imports nothing that a binding file names."""
    import openodd

    class Backend(openodd.Backend):  # type: ignore[misc]
        def position(self, context: _Step) -> tuple[float, float, float]:
            x, y = context.place_m[0].tolist()
            return x, y, float(context.rollout.tracks.z_m[context.row, context.step])

    return Backend(
        name="deepmf-sumo",
        probes=_PROBES,
        readers={"measure": _measure},
        allow_imports=False,
    )


def _measure(name: str) -> tuple[Callable[[_Step], Any], str]:
    if name not in _MEASURES:
        raise ValueError(f"{name!r} is not measured; it can be {', '.join(_MEASURES)}")
    return _MEASURES[name]


def _odd(file: str, backend: Any) -> Any:
    import openodd

    try:
        if file:
            return openodd.load_odd_binding(Path(file), backend=backend)
        return openodd.bundled_odd(backend=backend)
    except (OSError, ValueError) as error:
        raise PluginError(
            f"exporter 'openodd': {file or 'the ODD'} cannot be read: {error}"
        ) from None
