"""Defects planted in the core, one at a time: ``python -m tests.mutations [NAME...]``.

Each changes one place of the package in a copy of the tree and runs the tests of that place, of
which one has to fail. What survives shows what tests do not see. The defects were chosen before
the tests were cut, see ``studies/notebook/mutations.md``.
"""

import argparse
import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "deepmf_sumo"
COPIED = (PACKAGE, "tests", "sumo_nets", "scenarios", "suite", "studies", "pyproject.toml")
LOADED = ("scipy.optimize", "scipy.stats", "pandas", "shapely", "pydantic", "yaml", "torch")
"""Loaded once: each defect is tried in a copy of this process."""


class Mutation(NamedTuple):
    """One defect.

    Attributes:
        name: of the defect, in a word or two.
        file: in the package.
        old, new: text that is there once, and what takes its place.
        tests: files of ``tests/`` that see it.
    """

    name: str
    file: str
    old: str
    new: str
    tests: str


MUTATIONS = (
    Mutation(
        "the likelihood weighs nothing", "deepmf/scoring.py",
        "return weighted * mass", "return mass",
        "deepmf/test_selection.py deepmf/test_deepmf.py",
    ),
    Mutation(
        "equal values go to the likelier before the earlier", "deepmf/scoring.py",
        "(equal, -probability[equal], first_step[equal])",
        "(equal, first_step[equal], -probability[equal])",
        "deepmf/test_selection.py",
    ),
    Mutation(
        "severity is not a mean", "deepmf/scoring.py",
        "(colliding * severity).sum(axis=1) / np.maximum(mass, _EQUAL)",
        "(colliding * severity).sum(axis=1)",
        "deepmf/test_selection.py deepmf/test_steering.py",
    ),
    Mutation(
        "far corners do not collide", "deepmf/candidates.py",
        "(np.hypot(*opponent_size_m) + np.hypot(*av_size_m)) / 2",
        "(opponent_size_m[0] + av_size_m[0]) / 2",
        "deepmf/test_collision.py deepmf/test_candidates.py",
    ),
    Mutation(
        "the wrong side before the plan is forgotten", "deepmf/candidates.py",
        "before.sum() + more > _MOMENT_STEPS", "more > _MOMENT_STEPS",
        "deepmf/test_with_traffic.py",
    ),
    Mutation(
        "any direction from behind is a rear end", "deepmf/candidates.py",
        "behind & (np.abs(at.turn_rad) < np.pi / 4)", "behind",
        "deepmf/test_no_rear_end.py",
    ),
    Mutation(
        "the lighter one changes the other's speed more", "scene/geometry/impact.py",
        "relative_mps * other_m2", "relative_mps * area_m2",
        "deepmf/test_steering.py sumo/simulation/test_contacts.py",
    ),
    Mutation(
        "no limit to braking", "deepmf/tracking.py",
        "np.minimum(np.minimum(wanted, allowed), self._accel), -self._brake)",
        "np.minimum(np.minimum(wanted, allowed), self._accel), -2 * self._brake)",
        "deepmf/test_tracking.py",
    ),
    Mutation(
        "no limit to lateral acceleration", "deepmf/tracking.py",
        "np.minimum(self._curvature, self._lateral / np.maximum(fastest**2, 1e-6))",
        "np.full(len(wanted), self._curvature)",
        "deepmf/test_tracking.py",
    ),
    Mutation(
        "forbidden candidates that collide are chosen", "deepmf/scoring.py",
        "bars = pairs.collides.any(axis=1) & ~mask.allowed",
        "bars = np.zeros(len(mask.allowed), bool)",
        "deepmf/test_selection.py deepmf/test_steering.py deepmf/test_new_constraint.py",
    ),
    Mutation(
        "a sector counts though most contacts are elsewhere", "deepmf/scoring.py",
        "2 * (pairs.reaction_probability * there).sum(axis=1) > pairs.mass",
        "4 * (pairs.reaction_probability * there).sum(axis=1) > pairs.mass",
        "deepmf/test_selection.py deepmf/test_steering.py",
    ),
    Mutation(
        "a stop sign needs no stop", "deepmf/traffic_rules.py",
        "return crossed & ~stands", "return crossed & False",
        "deepmf/test_lawful.py",
    ),
    Mutation(
        "people never among the tried", "deepmf/opponent.py",
        "return [*found[:-1], ranked[missing]]", "return found",
        "deepmf/test_attackers.py deepmf/test_people_rules.py",
    ),
    Mutation(
        "a side that stands strikes", "judge/impact.py",
        "self.face if self.front is None and self.their_mps > self.own_mps else None",
        "self.face if self.front is None else None",
        "judge/test_hits_by_people.py",
    ),
    Mutation(
        "early braking is late", "judge/hits.py",
        "late = len(slower) > 0 and slower[0] * dt_s > _LATE_S",
        "late = len(slower) > 0",
        "judge/test_hits.py judge/test_causes.py",
    ),
    Mutation(
        "green gives way to green", "judge/hits.py",
        "if mine & GOES and theirs and theirs <= stops:", "if mine & GOES:",
        "judge/test_hits.py judge/test_ladder.py",
    ),
    Mutation(
        "a moment against the traffic is contrived", "judge/ladder.py",
        "against_traffic(episode, driving).sum() > most",
        "against_traffic(episode, driving).sum() > 0",
        "judge/test_ladder.py",
    ),
    Mutation(
        "right on red is an error", "judge/ladder.py",
        "if meeting.road is None or may_turn_on_red(episode.case, meeting.turn_rad(0)):",
        "if meeting.road is None:",
        "judge/test_ladder.py",
    ),
    Mutation(
        "the other side of the lane without an attack", "judge/avoidability/counterfactual.py",
        "middle + foot.left_m *", "middle - foot.left_m *",
        "judge/avoidability/test_counterfactual.py",
    ),
    Mutation(
        "another world counts as the unattacked one", "judge/avoidability/counterfactual.py",
        "return bool(there and np.hypot(*away) < _SAME_M)", "return bool(there)",
        "judge/avoidability/test_counterfactual.py",
    ),
    Mutation(
        "the careful driver needs no time", "judge/avoidability/reference_drivers.py",
        "JERK_MPS3 * (middle_s - DELAY_S)", "JERK_MPS3 * middle_s",
        "judge/avoidability/test_reference_drivers.py",
    ),
    Mutation(
        "the fuzzy driver knows no jerk", "judge/avoidability/reference_drivers.py",
        "change = JERK_MPS3 * sight.dt_s", "change = 100 * JERK_MPS3 * sight.dt_s",
        "judge/avoidability/test_reference_drivers.py",
    ),
    Mutation(
        "a leader of RSS stops immediately", "judge/avoidability/reference_drivers.py",
        "ahead = own - leader_mps**2 / (2 * ResponsibilitySensitive.LEADER_MPS2)",
        "ahead = own",
        "judge/avoidability/test_reference_drivers.py",
    ),
    Mutation(
        "manoeuvres run over others", "judge/avoidability/grading.py",
        "free &= ~hit_by(*poses, others, approach.av_size_m, straight)", "pass",
        "judge/avoidability/test_manoeuvres.py judge/avoidability/test_grading.py "
        "judge/metrics/test_avoidance_metrics.py",
    ),
    Mutation(
        "a standing opponent keeps closing in", "judge/metrics/conflict.py",
        "braking = np.where(moving * _TIMES_S <= speed, moving, standing)", "braking = moving",
        "judge/metrics/test_conflict_metrics.py",
    ),
    Mutation(
        "bridges share places with roads", "judge/metrics/conflict.py",
        "shared &= ~clear(tracks.z_m[av, mine, None], tracks.z_m[row, theirs])", "pass",
        "sumo/simulation/test_two_levels.py",
    ),
    Mutation(
        "cut-ins are rear-ends", "judge/conflict_types.py",
        "in_line = not from_beside and boxes.end_to_end", "in_line = boxes.end_to_end",
        "judge/metrics/test_accident_metrics.py judge/test_hits.py judge/test_ladder.py",
    ),
    Mutation(
        "overlaps at hand-overs are contacts", "sumo/simulation/contacts.py",
        'return None if owners[0] == owners[1] else "overlap_at_hand_over"', "return None",
        "sumo/simulation/test_hand_over.py",
    ),
    Mutation(
        "the slower one strikes", "sumo/simulation/contacts.py",
        "mine if approach[0] >= approach[1] else theirs",
        "mine if approach[0] < approach[1] else theirs",
        "sumo/simulation/test_contacts.py",
    ),
    Mutation(
        "the log takes what is beside it", "sumo/simulation/ownership.py",
        "        and abs(aside) <= _ASIDE_M\n", "",
        "sumo/simulation/test_hand_over.py sumo/simulation/test_recorded_episode.py",
    ),
    Mutation(
        "SUMO takes what is askew", "sumo/simulation/vehicle_control.py",
        "if abs(float(frames.difference(along, taken.pose.heading_rad))) > _ASKEW_RAD:",
        "if False:",
        "sumo/simulation/test_takeover_gone.py sumo/simulation/test_vehicles_at_walking_areas.py "
        "sumo/simulation/test_cyclists_taken_over.py sumo/simulation/test_opponents_in_turn.py",
    ),
    Mutation(
        "the way back to the route is forgotten", "sumo/simulation/vehicle_control.py",
        "            self._restore_route(step, taken)\n", "",
        "sumo/simulation/test_takeover_gone.py",
    ),
    Mutation(
        "a plan a step late", "sumo/simulation/attack_schedule.py",
        "(period is not None and elapsed % period == 0)",
        "(period is not None and elapsed % period == 1)",
        "sumo/simulation/test_plan_timing.py sumo/simulation/test_episode_loop.py",
    ),
    Mutation(
        "one hit does not end the other attacks", "sumo/simulation/attack_schedule.py",
        "if ended is None and not over:", "if ended is None:",
        "sumo/simulation/test_attackers_together.py test_two_attackers.py",
    ),
    Mutation(
        "the way back looks at nobody", "sumo/simulation/way_on.py",
        "if target > 0 and not clear(self._look_ahead()):", "if False:",
        "sumo/simulation/test_hand_over.py",
    ),
    Mutation(
        "units of many runs count as many", "results/statistics.py",
        "weights = counts * counts.sum() / (counts @ counts) if runs else counts",
        "weights = counts",
        "results/test_units_of_runs.py results/test_statistics.py",
    ),
    Mutation(
        "draws by chance weigh the same", "results/statistics.py",
        "weights.append(units / draws * (1.0 + (units - draws) / max(left, 1) * unequal))",
        "weights.append(units / draws)",
        "results/test_drawn_moments.py results/test_statistics.py",
    ),
    Mutation(
        "the interval of a difference is a sum", "results/statistics.py",
        "down = math.hypot(new.mean - ours[0], theirs[1] - old.mean)",
        "down = new.mean - ours[0] + theirs[1] - old.mean",
        "results/test_statistics.py",
    ),
    Mutation(
        "a key given twice is taken", "spec/document.py",
        "                if key in seen:\n", "                if False:\n",
        "spec/test_spec.py",
    ),
    Mutation(
        "equal runs have other keys elsewhere", "spec/tasks.py",
        "of[key] = Path(of[key]).name", "of[key] = str(of[key])",
        "spec/test_tasks.py study/sweep/test_inputs.py",
    ),
)  # fmt: skip


def planted(tree: Path, mutation: Mutation, number: int) -> str:
    """Plant a defect in a copy of the tree; returns the text of the file without it."""
    file = tree / PACKAGE / mutation.file
    text = file.read_text("utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.file}: {mutation.old!r} is there {text.count(mutation.old)}x")
    written(file, text.replace(mutation.old, mutation.new), 2 * number)
    return text


def written(file: Path, text: str, second: int) -> None:
    """Write a file with a time of its own: Python takes equal ones for the compiled file."""
    file.write_text(text, "utf-8")
    os.utime(file, (second, second))


class First:
    """Notes the first test that fails."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self._file.exists():
            self._file.write_text(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self._file.exists():
            self._file.write_text(f"{report.nodeid} (cannot be collected)")


def failing(tree: Path, tests: str) -> str:
    """The first test that fails in a tree; empty if none does."""
    found = tree / "failed"
    found.unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        os.chdir(tree)
        sys.path.insert(0, str(tree))
        for stream in (1, 2):
            os.dup2(os.open(tree / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
            del sys.modules[name]
        files = [f"tests/{name}" for name in tests.split()]
        options = ["-qx", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:xdist"]
        os._exit(pytest.main([*options, "--basetemp", str(tree / "temp"), *files], [First(found)]))
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED) and not found.exists():
        raise SystemExit((tree / "output").read_text("utf-8")[-3000:])
    return found.read_text("utf-8") if found.exists() else ""


def results(tree: Path, chosen: list[Mutation]) -> Iterator[tuple[Mutation, str]]:
    """Each defect, and the first test that sees it."""
    for number, mutation in enumerate(chosen, 1):
        text = planted(tree, mutation, number)
        try:
            yield mutation, failing(tree, mutation.tests)
        finally:
            written(tree / PACKAGE / mutation.file, text, 2 * number + 1)


def main() -> None:
    """Plant the defects whose names hold one of the given words, by default all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of names")
    names = parser.parse_args().names
    chosen = [one for one in MUTATIONS if not names or any(part in one.name for part in names)]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["PYTHONPATH"] = ""
    for module in LOADED:
        importlib.import_module(module)
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in COPIED:
            if (ROOT / name).is_dir():
                without = shutil.ignore_patterns("__pycache__")
                shutil.copytree(ROOT / name, tree / name, ignore=without)
            else:
                shutil.copy(ROOT / name, tree / name)
        for mutation, test in results(tree, chosen):
            survived += not test
            print(f"{mutation.name} ({mutation.file}): {test or 'SURVIVED'}", flush=True)
    print(f"{len(chosen) - survived} of {len(chosen)} killed")
    sys.exit(survived > 0)


if __name__ == "__main__":
    main()
