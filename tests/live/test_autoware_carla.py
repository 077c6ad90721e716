"""The backend of autoware-carla-scenario: in the package itself without CARLA, and on a double."""

import importlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import libsumo
import pytest

from deepmf_sumo.results.reader import Results

from tests.support import autoware_double
from tests.support.live_policies import Keep

pytestmark = pytest.mark.sumo

ROOT = Path(__file__).parents[2]
MODULE = "deepmf_sumo.live.autoware_carla"
OPTIONS = ("--no-step-log", "--no-warnings", "--collision.action", "none")
REASON = "not installed: pip install deepmf-sumo[autoware]"


@pytest.fixture
def found(tmp_path, monkeypatch):
    """Run a backend of the package, which finds ours by the entry points of ``pyproject.toml``."""
    if importlib.util.find_spec("autoware_carla_scenario") is None:
        pytest.skip(REASON)
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    installed = tmp_path / "site" / "deepmf_sumo_here-1.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: deepmf-sumo-here\nVersion: 1")
    lines = [
        line
        for group, members in points.items()
        for line in (f"[{group}]", *(f"{name} = {at}" for name, at in members.items()))
    ]
    (installed / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.setenv("PYTHONPATH", str(installed.parent), prepend=":")
    monkeypatch.delenv("DEEPMF_SUMO_RUNTIME", raising=False)

    def run(*arguments):
        command = [sys.executable, "-m", "tests.support.autoware_run", *map(str, arguments)]
        done = subprocess.run(
            command, check=False, cwd=ROOT, capture_output=True, text=True, timeout=240
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.slow
def test_the_package_runs_attacks_in_its_own_traffic(found, tmp_path):
    attacked = found("deepmf", "physics", tmp_path / "attacked")
    assert (attacked["failures"], attacked["said"]["backend"]) == (0, "deepmf")
    (row,) = attacked["said"]["attacks"]["fought"]
    assert (row["ended"], row["min_gap_m"]) == ("contact", 0.0)
    opponent = row["opponent"]
    # its car in CARLA touches the ego's when SUMO's vehicle does, and is nobody else's meanwhile
    (kept,) = Results.open(tmp_path / "attacked" / "deepmf").runs
    steps = kept.rollout.contacts[0].step - kept.rollout.now
    touching = [one["time_s"] for one in attacked["ticks"] if one["apart_m"][opponent] == 0.0]
    assert touching[0] == pytest.approx(row["begin_s"] + 0.1 * steps, abs=0.11)
    offered = {one["time_s"]: one["offered"] for one in attacked["ticks"]}
    assert offered[round(row["begin_s"] - 0.1, 2)] == ["ahead", "cutter"]
    assert offered[row["begin_s"]] == [one for one in ("ahead", "cutter") if one != opponent]
    # the same traffic without attacks
    plain = found("sumo", "teleport", tmp_path / "plain")
    assert min(one["apart_m"][opponent] for one in plain["ticks"]) > 5.0


@pytest.fixture
def backend(tiny, tmp_path, monkeypatch):
    """A run of the backend on the tiny network, on a double of the package."""
    for name, module in autoware_double.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, MODULE, None)  # put back what was there
    del sys.modules[MODULE]
    monkeypatch.setenv("DEEPMF_SUMO_RUNTIME", "torch")
    importlib.import_module(MODULE).register()
    policy = Keep()
    monkeypatch.setattr("deepmf_sumo.live.attacker.policy_of", lambda spec: policy)
    monkeypatch.setattr(f"{MODULE}.policy_of", lambda spec: policy)
    begun = []

    def begin(*, seen=("leader",), ego="av", step_s="0.05", **attacks):
        made = autoware_double.REGISTERED["deepmf"](
            {
                "config": tiny / "tiny.sumocfg", "net": tiny / "tiny.net.xml", "seen": seen,
                "ego": ego, "arguments": [*OPTIONS, "--step-length", step_s], "attacks": attacks,
            }
        )  # fmt: skip
        begun.append(made)
        made.prepare(SimpleNamespace(random_seed=3, output_dir=tmp_path))
        made.start(None)
        return made

    yield begin
    for one in begun:
        one.close()


def ticks(backend, number):
    for _ in range(number):
        backend.tick(None, 0.0)


def test_a_vehicle_attacks_whose_car_in_carla_then_is_where_sumo_has_it(backend, tmp_path):
    made = backend(duration_s=3.0, trigger=["time=2"])
    ticks(made, 18)
    assert made.controls == {"leader": "physics"}
    assert list(made.background_actors(None)) == ["sumo:leader"]
    ticks(made, 7)
    assert made.controls == {"leader": "teleport"}
    assert list(made.background_actors(None)) == []
    assert not made._to_mesoscopic("leader", 0.0)
    ticks(made, 40)
    assert made.controls == {"leader": "teleport"}  # its physics were never asked to stop
    assert made._to_mesoscopic("leader", 0.0)
    said = made.describe()
    assert (said["backend"], said["attacks"]["trigger"]) == ("deepmf", ["time=2"])
    (row,) = said["attacks"]["fought"]
    assert row["opponent"] == "leader"
    made.close()
    assert len(Results.open(tmp_path / "deepmf").runs) == 1


def test_runs_of_a_queue_have_folders_of_their_own(backend, tmp_path):
    for _ in range(2):
        backend().close()
    assert sorted(one.name for one in tmp_path.glob("deepmf*")) == ["deepmf", "deepmf-2"]


def test_nobody_attacks_who_is_not_in_carla(backend):
    made = backend(seen=())
    ticks(made, 60)
    assert made.describe()["attacks"]["fought"] == []
    assert made._driving() == set()


def test_attacks_that_fail_end_and_the_run_goes_on(backend, monkeypatch, caplog):
    made = backend(duration_s=3.0)
    ticks(made, 13)
    assert made._driving() == {"leader"}

    def broken(self, sighting):
        raise ValueError("too bad")

    monkeypatch.setattr("deepmf_sumo.live.engagement.Engagement.look", broken)
    ticks(made, 20)
    assert made.describe()["attacks"]["ended"] == "ValueError: too bad"
    assert "no attacks from now on: ValueError: too bad" in caplog.text
    assert made._driving() == set()
    assert libsumo.vehicle.getSpeedMode("leader") == libsumo.vehicle.getSpeedMode("av")


def test_an_ego_off_the_network_is_said(backend):
    made = backend(ego=None)
    ticks(made, 2)
    assert made.describe()["attacks"]["ended"] == "the ego is not on SUMO's network"


@pytest.mark.parametrize(
    ("attacks", "words"),
    [
        ({"triger": ["time=4"]}, "unknown key 'triger'. Did you mean 'trigger'?"),
        ({"duration_s": 1.0}, "duration is 1 s; it must be 3 s at least"),
        ({"trigger": ["tim=4"]}, "tim"),
        ({"sets": ["planner=idm"]}, "only profile, adversary, weights and seed can be set"),
    ],
)
def test_wrong_attacks_are_refused_before_the_run(backend, attacks, words):
    with pytest.raises(ValueError, match=f"traffic.options.attacks: .*{re.escape(words)}"):
        backend(**attacks)


def test_a_step_in_which_no_attack_fits_is_refused_before_the_run(backend):
    with pytest.raises(autoware_double.RefusedError, match=r"traffic.backend=deepmf: .*0\.04 s"):
        backend(step_s="0.04")
    assert not libsumo.isLoaded()


def test_beside_carlas_client_torch_is_not_loaded(backend, monkeypatch):
    monkeypatch.delenv("DEEPMF_SUMO_RUNTIME")
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    sys.modules[MODULE].register()
    assert os.environ["DEEPMF_SUMO_RUNTIME"] == "onnx"
    monkeypatch.setenv("DEEPMF_SUMO_RUNTIME", "torch")
    sys.modules[MODULE].register()
    assert os.environ["DEEPMF_SUMO_RUNTIME"] == "torch"
