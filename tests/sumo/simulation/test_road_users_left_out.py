"""Sources that say which road users there are, and a recording that begins later."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from deepmf_sumo import api
from deepmf_sumo.cli import main
from deepmf_sumo.scene.readers import npz

from tests.support import simulated_worlds, synthetic, tiny_network, untuned_networks


def run(folder, name, **changes):
    spec = tiny_network.spec(folder, name, **changes)
    return api.run(spec, folder / f"out-{name}").runs[0]


def test_a_network_has_the_named_road_users_alone(tiny):
    source = "{network: tiny.sumocfg, start_s: 2.0, av: {vehicle: av}, only: %s}"
    alone = run(tiny, "alone", source=source % "[]", duration_s="3.0")
    assert alone.rollout.tracks.ids == ("av",)
    assert alone.rollout.now == 10  # the history is there, without the leader
    both = run(tiny, "both", source=source % "[leader]", duration_s="3.0")
    plain = run(tiny, "plain", duration_s="3.0")
    assert both.rollout.tracks.ids == plain.rollout.tracks.ids
    np.testing.assert_array_equal(both.rollout.tracks.position_m, plain.rollout.tracks.position_m)
    freed = alone.rollout.tracks.position_m[0, -1, 0]
    assert freed > plain.rollout.tracks.position_m[0, -1, 0]  # nobody is in front of it


def test_persons_and_later_vehicles_are_left_out(tmp_path):
    config = untuned_networks._persons(tmp_path)
    found = api.attack(config, tmp_path / "out", moments=1, sets=["adversary=none"]).runs[0]
    source = found.source
    assert len(found.rollout.tracks.ids) > 2
    source["only"] = []
    spec = {"version": 1, "name": "alone", "source": source, "adversary": "none"}
    (tmp_path / "alone.yaml").write_text(yaml.safe_dump(spec))
    [alone] = api.run(tmp_path / "alone.yaml", tmp_path / "alone").runs
    assert alone.rollout.tracks.ids == (alone.rollout.av_id,)


@pytest.fixture
def recorded(tmp_path):
    scene = synthetic.scene()
    npz.write(scene, tmp_path / "scene.npz")

    def of(name, **source):
        spec = {
            "version": 1,
            "name": name,
            "source": {"recording": "scene.npz", **source},
            "adversary": "none",
            "duration_s": 2.0,
        }
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(spec))
        return tmp_path / f"{name}.yaml", tmp_path / name

    return scene, of


def test_a_recording_begins_later_with_the_named_road_users(recorded):
    scene, of = recorded
    [run] = api.run(*of("later", start_s=1.5, only=["south", "walker"])).runs
    assert run.status == "ok", run.result["error"]
    tracks = run.rollout.tracks
    assert set(tracks.ids) == {"av", "south", "walker"}
    assert run.rollout.now == 10
    row, theirs = tracks.row("av"), scene.tracks.row("av")
    np.testing.assert_allclose(
        tracks.position_m[row, :11], scene.tracks.position_m[theirs, 15:26], atol=1e-3
    )


def test_signals_seen_before_a_later_begin_are_known():
    scene = simulated_worlds.scene_of(
        simulated_worlds.crossing_road(),
        {"av": simulated_worlds.straight_motion(0, -60, np.pi / 2, 8.0)},
    )
    signals = simulated_worlds.red_light(scene.road, "south")
    seen = signals.seen.copy()
    seen[:, 5:] = False
    scene = replace(scene, signals=replace(signals, seen=seen))
    later = scene.later(20)
    assert later.now == scene.now
    assert later.tracks.steps == scene.tracks.steps - 20
    assert later.signals.at(10) == scene.signals.at(30)
    assert later.signals.at(10)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"start_s": 60.0}, "start_s': 60: the AV 'av' is not there"),
        ({"only": ["sought"]}, "'sought' is not in"),
    ],
)
def test_what_the_recording_does_not_have_is_named(recorded, capsys, source, said):
    _, of = recorded
    spec, out = of("wrong", **source)
    assert main.run(["run", str(spec), "--out", str(out), "--no-pictures"]) == 2
    assert said in " ".join(capsys.readouterr().out.split())


def test_specs_without_the_keys_are_as_they_were(recorded, tiny):
    from deepmf_sumo import spec

    _, of = recorded
    path, _ = of("plain")
    assert set(spec.load(path).resolved()["source"]) == {"recording", "scenes"}
    plain = spec.load(tiny_network.spec(tiny, "plain")).resolved()["source"]
    assert set(plain) == {"network", "start_s", "av", "sumo_options"}
