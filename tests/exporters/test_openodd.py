"""Coverage documents, read back by openodd-py: where the AV drove, and where it failed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene import Lane, Neighbour, RoadMap

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

openodd = pytest.importorskip("openodd", reason="pip install deepmf-sumo[openodd]")
STEPS = 41


def lane(name, y, **more):
    ends = np.array([[-100.0, y], [400.0, y]])
    return Lane(id=name, kind="street", centre_m=ends, z_m=np.zeros(2), width_m=3.5, **more)


def beside(name):
    return (Neighbour(lane_id=name, self_start=0, self_end=1, other_start=0, other_end=1),)


TWO_LANES = RoadMap(
    lanes={
        "right": lane("right", 0.0, speed_limit_mps=50 / 3.6, left=beside("left")),
        "left": lane("left", 3.5, speed_limit_mps=50 / 3.6, right=beside("right")),
        "oncoming": replace(
            lane("oncoming", 7.0), centre_m=np.array([[400.0, 7.0], [-100.0, 7.0]])
        ),
        "bike": replace(lane("bike", -3.0), kind="bike"),
    }
)


def written(
    tmp_path, paths, road=TWO_LANES, kinds=None, contacts=(), name="run", av_z_m=0.0, **settings
):
    """The document of a run in which the AV drives to the east with 36 km/h; all others at 0 m."""
    rollout = rollout_of(
        {"av": straight(0, 0, 10, steps=STEPS), **paths}, contacts, opponent_id=None
    )
    if kinds:
        rollout = replace(rollout, tracks=replace(rollout.tracks, kinds=("vehicle", *kinds)))
    z_m = rollout.tracks.z_m.copy()
    z_m[rollout.tracks.row("av")] = av_z_m
    rollout = replace(rollout, tracks=replace(rollout.tracks, z_m=z_m))
    case = replace(case_of(), road=road)
    run = replace(Exportable.of(rollout, case), name=name)
    exporter = plugins.load("exporters", "openodd")
    folder = tmp_path / name / "openodd"
    folder.parent.mkdir()
    exporter.write(run, folder, exporter.Settings(**settings))
    return json.loads((folder / "run_coverage.json").read_text())


def seconds(document, attribute):
    """Seconds in each bucket of an attribute in which there were any."""
    (item,) = (one for one in document["items"] if one["name"] == f"odd.{attribute}")
    return {bucket: pytest.approx(one, abs=1e-6) for bucket, one in item["seconds"].items() if one}


def test_the_attributes_are_those_of_the_drive(tmp_path):
    paths = {
        "ahead": straight(48, 0, 5, steps=STEPS),
        "oncoming": straight(60, 7, -5, steps=STEPS),
        "walker": straight(55, -8, 0, steps=STEPS),
    }
    found = written(tmp_path, paths, kinds=("vehicle", "vehicle", "pedestrian"))
    assert seconds(found, "scenery.junction") == {"false": 3.0}
    assert seconds(found, "scenery.lane_count") == {"2": 3.0}  # neither the bike's nor oncoming
    assert seconds(found, "scenery.speed_limit") == {"[50, 60)": 3.0}
    assert seconds(found, "dynamic.ego_speed") == {"[35, 45)": 3.0}
    assert seconds(found, "dynamic.vehicle_ahead_relative_speed") == {"[-30, -15)": 3.0}
    # Between boxes of 4.8 m: 43.2 - 5 t, which is less than 30 m after 2.64 s.
    assert seconds(found, "dynamic.vehicle_ahead_gap") == {"[30, 50)": 2.6, "[20, 30)": 0.4}
    # 55 m ahead and 8 m to the side: within 50 m once the AV has driven 5.64 m.
    assert seconds(found, "dynamic.pedestrian_nearby") == {"false": 0.5, "true": 2.5}
    assert seconds(found, "dynamic.traffic_density")["low"] == 3.0


@pytest.mark.parametrize(
    ("vehicles", "density"), [(0, "none"), (2, "low"), (3, "medium"), (6, "high")]
)
def test_density_is_called_as_in_autoware_carla_scenario(tmp_path, vehicles, density):
    paths = {f"v{n}": straight(10 + 6 * n, 3.5, 10, steps=STEPS) for n in range(vehicles)}
    assert seconds(written(tmp_path, paths), "dynamic.traffic_density") == {density: 3.0}


@pytest.mark.parametrize("level", ["on the bridge", "on the road"])
def test_traffic_below_a_bridge_is_not_around_the_av_on_it(tmp_path, level):
    deck = replace(lane("deck", 0.0, speed_limit_mps=90 / 3.6), z_m=np.full(2, 8.0))
    road = replace(TWO_LANES, lanes={**TWO_LANES.lanes, "deck": deck})
    paths = {
        "ahead": straight(48, 0, 5, steps=STEPS),
        "walker": straight(40, -8, 0, steps=STEPS),
    }
    above = level == "on the bridge"
    kinds, av_z_m = ("vehicle", "pedestrian"), 8.0 * above
    found = written(tmp_path, paths, road, kinds=kinds, av_z_m=av_z_m)
    assert seconds(found, "scenery.speed_limit") == {"[80, 100)" if above else "[50, 60)": 3.0}
    assert bool(seconds(found, "dynamic.vehicle_ahead_gap")) is not above
    assert seconds(found, "dynamic.pedestrian_nearby") == {"false" if above else "true": 3.0}
    density = "none" if above else "low"
    assert seconds(found, "dynamic.traffic_density") == {density: 3.0}


def test_inside_a_junction_lanes_are_not_counted_and_what_is_not_known_is_missing(tmp_path):
    road = RoadMap(lanes={"over": lane("over", 0.0, interpolating=True)})
    found = written(tmp_path, {}, road)
    assert seconds(found, "scenery.junction") == {"true": 3.0}
    missing = ("scenery.lane_count", "scenery.speed_limit", "environment.rain", "scenery.location",
               "dynamic.vehicle_ahead_gap", "environment.illumination")  # fmt: skip
    assert not any(seconds(found, one) for one in missing)


def test_openodd_merges_the_documents_and_says_where_runs_failed(tmp_path):
    written(tmp_path, {}, name="fine")
    hit = contact_of(step=30)
    found = written(tmp_path, {"b": straight(30, 0, 3, steps=STEPS)}, contacts=[hit], name="hit")
    assert found["outcome"]["passed"] is False
    assert found["outcome"]["failed_at"] == pytest.approx(2.0)
    report = openodd.load_and_merge([tmp_path])
    assert report.runs == 2
    speeds = next(one for one in report.entries if one.name == "odd.dynamic.ego_speed")
    assert speeds.runs["[35, 45)"] == 2
    (pooled,) = report.cell_flakiness  # both are of one network
    assert (pooled.runs, pooled.runs_failed, pooled.failures_located) == (2, 1, 1)


def test_an_odd_of_one_s_own_is_judged_and_one_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "odd.yaml").write_text(
        "TAXONOMY:\n  speed: float velocity\n"
        "ODD:\n  slow:\n    INCLUDE_AND:\n      speed: < 30 km/h\n"
    )
    binding = tmp_path / "slow.yaml"
    binding.write_text(
        "openodd: [odd.yaml]\nprobes:\n  speed: {probe: ego_speed_kph, buckets: [0, 30, 60]}\n"
    )
    found = written(tmp_path, {}, odd=str(binding))
    assert seconds(found, "speed") == {"[30, 60]": 3.0}
    assert found["odd"]["ticks"] == {"inside": 0, "assumed": 0, "outside": 30}
    for text in ("probes: {speed: {probe: os:system}}", "probes: {a: {measure: nothing}}", ": ["):
        binding.write_text(f"openodd: [odd.yaml]\n{text}\n")
        with pytest.raises(PluginError, match=r"slow\.yaml cannot be read: "):
            written(tmp_path, {}, name=f"{len(text)}", odd=str(binding))


def test_without_openodd_it_says_what_to_install(monkeypatch):
    exporter = plugins.load("exporters", "openodd")
    monkeypatch.setattr(exporter, "find_spec", lambda _: None)
    with pytest.raises(PluginError, match=r"pip install \"deepmf-sumo\[openodd\]\""):
        exporter.check()
