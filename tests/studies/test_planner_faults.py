"""The careful planner does what is right in small situations; each copy fails in its own."""

import dataclasses
import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_situations import (
    BEND,
    CAR,
    PERSON,
    TRUCK,
    YELLOW,
    Situation,
    braking,
    cutting_in,
    drive,
    road,
    steady,
    still,
)

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from studies.planner_faults import measure
from studies.planner_faults.faults import FAULTS, Faulty, Settings
from studies.planner_faults.halves import FROZEN, frozen_text, halves

from tests.support import gate_doubles

ROOT = Path(__file__).resolve().parents[2]
NORTH, SOUTH = np.pi / 2, -np.pi / 2


def one(motion, size=CAR, **more):
    return Situation(others={"other": (motion, size)}, **more)


SITUATIONS = {
    "crossing from the left": one(steady(45, 40, SOUTH, 12), seconds=5),
    "crossing from the right": one(steady(45, -40, NORTH, 12), seconds=5),
    "fast crossing": one(steady(45, 70, SOUTH, 20), seconds=5),
    "crossing late": one(steady(45, 47, SOUTH, 12), seconds=5),
    "crossing behind a truck": Situation(
        others={"truck": (still(20, 5), TRUCK), "other": (steady(36, 22, SOUTH, 8), CAR)},
        speed_mps=12,
        seconds=5,
    ),
    "turning across": one(steady(75, 12, np.radians(200), 10), seconds=5),
    "leader brakes": one(braking(24, 13, 1.0, 8.0)),
    "slow leader": one(steady(25, 0, 0, 5), speed_mps=16, seconds=5),
    "near leader": one(steady(19, 0, 0, 10), speed_mps=12, seconds=5),
    "standing car": one(still(60, 0)),
    "standing car, fast": one(still(60, 0), speed_mps=20, seconds=5),
    "standing truck": one(still(60, 0), TRUCK),
    "standing in the bend": one(still(52, 10, np.pi / 4), path_m=BEND, speed_mps=12),
    "reaching in": one(still(50, 1.4)),
    "reaching in a little": one(still(50, 1.97)),
    "cut-in": one(cutting_in(13, 7, 0.5), seconds=5),
    "merging": one(steady(20, 20, np.radians(-30), 12), seconds=5),
    "pedestrian": one(steady(30, -3.5, NORTH, 1.5), PERSON, seconds=5),
    "free road": Situation(speed_mps=14.5),
    "yellow": Situation(signals=YELLOW, speed_mps=10, seconds=1),
}
HARMLESS = one(steady(40, 3.2, 0.0, 10), speed_mps=10, seconds=2, seed=2)


@functools.cache
def driven(fault, name):
    situation = HARMLESS if name == "harmless" else SITUATIONS[name]
    return drive(Faulty(Settings(fault=fault)), situation, road())


def hits(good, bad):
    return bad.hit


def closer(good, bad):
    """Past the other with a metre less, and with less than three quarters of the gap."""
    return bad.nearest_m < min(good.nearest_m - 1.0, 0.75 * good.nearest_m)


def later(good, bad):
    return bad.first_braking_s >= good.first_braking_s + 1.0


def follows_closer(good, bad):
    return bad.nearest_m < good.nearest_m - 1.0


def brakes(good, bad):
    return good.hardest < 1.0 and bad.hardest > 4.0


def speeds(good, bad):
    return max(good.speeds) < 15.1 and max(bad.speeds) > 17.0


def overrules_sumo(good, bad):
    return {c.kind for c in good.commands} == {"sumo"} and bad.commands[0].kind == "speed"


WRONG = {
    "late_05": ("cut-in", hits),
    "late_10": ("cut-in", hits),
    "weak_brakes": ("leader brakes", hits),
    "no_standing": ("standing car", hits),
    "blind_left": ("crossing from the left", hits),
    "blind_right": ("crossing from the right", hits),
    "near_sighted": ("standing car, fast", hits),
    "blind_front_corner": ("cut-in", hits),
    "crossing_stops": ("crossing from the left", hits),
    "oncoming_slow": ("turning across", hits),
    "late_cut_in": ("cut-in", hits),
    "speed_minus_30": ("crossing late", later),
    "speed_plus_30": ("slow leader", follows_closer),
    "forgets_hidden": ("crossing behind a truck", hits),
    "narrow": ("reaching in a little", hits),
    "bold_gaps": ("fast crossing", hits),
    "latency_03": ("cut-in", hits),
    "freezes": ("cut-in", hits),
    "speeding": ("free road", speeds),
    "no_trucks": ("standing truck", hits),
    "ignores_yellow": ("yellow", overrules_sumo),
    "tailgates": ("near leader", closer),
    "phantom": ("free road", brakes),
    "no_partly": ("reaching in", hits),
    "lost_in_curves": ("standing in the bend", hits),
    "no_small": ("pedestrian", hits),
    "wide_wandering": ("merging", closer),
}


@pytest.mark.parametrize("name", SITUATIONS)
def test_the_careful_planner_hits_nobody(name):
    assert not driven("none", name).hit


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_shows_in_its_situation_and_nowhere_without_reason(fault):
    name, wrong = WRONG[fault]
    assert wrong(driven("none", name), driven(fault, name))
    assert driven(fault, "harmless").commands == driven("none", "harmless").commands


def test_a_second_episode_of_a_planner_is_the_same():
    planner = Faulty(Settings(fault="freezes"))
    first, second = (drive(planner, SITUATIONS["cut-in"], road()) for _ in range(2))
    assert first.commands == second.commands


def test_a_vehicle_that_can_still_stop_is_trusted():
    waits = one(steady(45, 60, SOUTH, 12), seconds=1)
    assert drive(Faulty(Settings()), waits, road()).hardest < 1.0


def test_it_does_not_stand_still_beside_waiting_vehicles():
    waiting = Situation(others={"a": (still(40, 4.5, SOUTH), CAR), "b": (still(60, 3.2), CAR)})
    assert drive(Faulty(Settings()), waiting, road()).speeds[-1] > 14.0


def test_faults_are_selected_by_name():
    plugin = "studies.planner_faults.faults:Faulty"
    assert plugins.settings("planners", plugin, {"fault": "late_05"}).fault == "late_05"
    with pytest.raises(PluginError, match="no fault 'late_5'"):
        plugins.settings("planners", plugin, {"fault": "late_5"})


def test_there_are_enough_faults_and_each_changes_one_thing():
    assert len(FAULTS) >= 24
    for fault in FAULTS.values():
        assert bool(fault.settings) + bool(fault.seen) + bool(fault.commanded) == 1
    assert len({fault.about for fault in FAULTS.values()}) == len(FAULTS)


def test_the_halves_are_frozen():
    """The list must not change once a search has been built on the open half."""
    assert FROZEN.read_text("utf-8") == frozen_text()
    drawn = list(halves(FAULTS).values())
    assert abs(drawn.count("open") - drawn.count("held out")) <= 1
    assert halves(reversed(FAULTS)) == halves(FAULTS)


@pytest.mark.sumo
def test_the_command_lists_all_faults_with_their_halves():
    done = subprocess.run(
        [sys.executable, "-m", "studies.planner_faults", "list"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name, half in halves(FAULTS).items():
        assert any(line.split()[0] == name and half in line for line in done.stdout.splitlines())


def test_a_measured_spec_keeps_the_opponent_and_takes_method_budget_and_fault():
    asked = measure.Asked(
        method="{name: deepmf, version: S2}", budget=4, moments=None, jobs=1, seeds=(1,),
        other_seeds=((2,),),
        faults=("narrow",), specs=(), thresholds=None, out=Path("unused"),
    )  # fmt: skip
    file = ROOT / "scenarios" / "cut_in.yaml"
    spec = measure.spec_of(file, asked, {"fault": "narrow"})
    assert (spec.planner.name, spec.planner.settings) == (measure.FAULTY, {"fault": "narrow"})
    assert spec.adversary.settings == {
        "constraints": [],
        "opponent": "cutter",
        "period_s": 2.0,
        "rule": "likeliest",
    }
    assert spec.budget.simulations == 4
    other = measure.spec_of(file, dataclasses.replace(asked, method="bga"), {"fault": "none"})
    assert other.adversary.name == "bga"


def test_a_copy_is_attacked_at_the_moments_of_the_baseline(tmp_path):
    asked = measure.Asked(
        method="deepmf", budget=None, moments=3, jobs=1, seeds=(1,), other_seeds=((2,),),
        faults=("narrow",), specs=(), thresholds=None, out=tmp_path,
    )  # fmt: skip
    (file, *others) = sorted(measure.SUITE.glob("*.yaml"))
    assert len(others) == 6
    assert measure.spec_of(file, asked, {"fault": "none"}).source.moments.count == 3
    again = measure.spec_of(file, asked, {"fault": "narrow"}, like=tmp_path).source.moments
    assert (again.of, again.count) == (tmp_path.resolve(), None)


def test_what_the_gate_says_of_a_copy_is_told_by_kind(tmp_path):
    runs = [gate_doubles.result("a", spec=f"spec {number}") for number in range(20)]
    old = gate_doubles.write_folder(tmp_path / "careful", runs)
    runs[3]["plain"] = {"av_over_limit": {"value": 2.5}}
    new = gate_doubles.write_folder(tmp_path / "speeding", runs)
    judged = functools.partial(measure.gate.check, thresholds=measure.gate.load(None), baseline=old)
    told = ("over the speed limit (av_over_limit_mps)",)
    assert measure.reported(judged(new)) == told
    assert measure.reported(judged(old)) == ()


def test_the_table_counts_reports_of_each_half_and_false_alarms():
    nothing = measure.Found(48, 48, 0, 0)
    told = nothing._replace(by=("red run (av_red_run_rate)",))
    lines = [
        measure.Line("careful", nothing),
        measure.Line("careful seed 101 against careful", told),
        measure.Line("careful seed 102 against careful", nothing),
        measure.Line("alike seed 2 against alike seed 1", nothing),
        measure.Line("narrow", nothing, told, measure.First("It turned.", own=True)),
        measure.Line("tailgates", told),
        measure.Line("speeding", nothing, nothing),
    ]
    text = measure.table(lines)
    assert "open: 1 of 2 reported with the first seeds, 2 with all; of 1 the first cause" in text
    assert "held out: 0 of 1 reported with the first seeds, 0 with all; of 0 " in text
    assert text.endswith(
        "careful with itself: 1 of 2 reported\nequally good planners: 0 of 1 reported"
    )
