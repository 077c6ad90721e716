"""Each export format on 30 runs, read back: ``python -m tests.bench.exports``.

Runs: 10 on recordings of our own networks, 10 of `scenarios/`, 10 on the networks of
`DEEPMF_SUMO_NETWORKS`, else ``../shared/networks``; says so where there are none. Printed for each
format: runs read back by a reader that is not the exporter's, the largest error of a corner of a
box, and contacts of the AV in which the boxes overlap from the same step on. ``--out`` keeps the
runs for the next time. Ends with 1 where a run is lost, a corner is off by more than 2 cm, or a
contact is at another step. Formats whose extra is not installed are named and left out; ``esmini``
plays what `openscenario` writes, where it is on the path, and judges contacts itself.
"""

import argparse
import os
import pickle
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from deepmf_sumo.cli import main as program
from deepmf_sumo.errors import PluginError
from deepmf_sumo.results import exports
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import readers

from tests.support import foreign_readers as foreign

ROOT = Path(__file__).resolve().parents[2]
NETWORKS = Path(os.environ.get("DEEPMF_SUMO_NETWORKS", ROOT.parent / "shared" / "networks"))
FOREIGN = ("lucas4x4/4x4.sumocfg", "cologne1/cologne1.sumocfg", "ow/OW-traci.sumocfg")
MOST_M = 0.02


def main() -> None:
    """Make the runs, export and read them, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=10, help="of each of the three kinds")
    parser.add_argument("--out", type=Path, help="folder of the runs")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = (options.out or Path(folder)).resolve()
        made = [*recorded(out, options.runs), *own(out, options.runs), *others(out, options.runs)]
        runs = [run for one in made for run in Results.of(one).runs if run.status == "ok"]
        lost = sum(len(Results.of(one).runs) for one in made) - len(runs)
        print(f"{len(runs)} runs, {sum(run.contact is not None for run in runs)} with a contact of"
              f" the AV; {lost} without a result are left out")  # fmt: skip
        print("format        read back  largest error  contacts at our step  seconds a run")
        fine = [row(name, read, runs, Path(folder)) for name, read in READERS.items()]
    sys.exit(not all(fine))


def call(*arguments: object) -> None:
    """One command of `deepmf-sumo`; failed runs and expectations are not the matter here."""
    code = program.run([str(one) for one in arguments])
    if code not in {0, 1, 3}:
        raise SystemExit(f"deepmf-sumo {' '.join(map(str, arguments))} ended with {code}")


def recorded(out: Path, count: int) -> list[Path]:
    """Runs on recordings of the four-way crossing, made here."""
    scenes, spec = out / "scenes", out / "recorded.yaml"
    if not scenes.is_dir():
        net = ROOT / "sumo_nets" / "four_way" / "four_way.sumocfg"
        call(
            "data", "record", net, "--scenes", count, "--set", "avs=2", "--seed", 3, "--out", scenes
        )
    source = {"recording": str(scenes), "scenes": {"first": count}}
    values = {"version": 1, "name": "recorded", "source": source, "planner": "replay",
              "adversary": "deepmf", "weights": "open"}  # fmt: skip
    spec.write_text(yaml.safe_dump(values))
    call("run", spec, "--out", out / "recorded", "--no-pictures", "--resume")
    return [out / "recorded"]


def own(out: Path, count: int) -> list[Path]:
    """The first of our own scenarios."""
    specs = sorted((ROOT / "scenarios").glob("*.yaml"))[:count]
    call("run", *specs, "--out", out / "own", "--no-pictures", "--resume")
    return [out / "own"]


def others(out: Path, count: int) -> list[Path]:
    """Attacks on networks that were not made for this."""
    configs = [NETWORKS / one for one in FOREIGN if (NETWORKS / one).is_file()]
    if not configs:
        print(f"no networks in {NETWORKS}: nothing is exported of networks of others")
        return []
    made = []
    for number, config in enumerate(configs):
        share = count * (number + 1) // len(configs) - count * number // len(configs)
        if share:
            made.append(out / config.stem)
            call("attack", config, "--moments", share, "--seed", 1, "--out", made[-1],
                 "--no-pictures", "--set", "sweep.risk=false", "--resume")  # fmt: skip
    return made


def row(name: str, read: Callable[[Path, Run], Any], runs: Sequence[Run], folder: Path) -> bool:
    """Print the line of a format; whether all is as it should be."""
    try:
        if name == ESMINI and not PLAYER:
            raise PluginError("esmini is not on the path")
        form = exports.Format.named(FORMATS.get(name, name), SETTINGS.get(name))
    except PluginError as lacks:
        print(f"{name}: {lacks}")
        return True
    back, error, contacts, same, seconds = 0, 0.0, 0, 0, 0.0
    for number, run in enumerate(runs):
        path = form.place(folder / name / str(number))
        begin = time.perf_counter()
        made = exports.written(run, path, form)
        seconds += time.perf_counter() - begin
        if made.outcome != "written":
            print(f"{name}: {run.folder}: {made.reason}")
            continue
        found, expected = read(path, run), foreign.boxes_of(run.rollout.tracks)
        if name in SINCE_NOW:
            expected = {key: box for key, box in expected.items() if key[0] >= run.rollout.now}
        back += 1
        error = max(error, foreign.largest_error_m(found, expected))
        if run.contact is not None:
            contacts += 1
            same += at_its_step(found, run)
    print(f"{name:12}  {back:2} of {len(runs):2}   {error:10.5f} m   {same:8} of {contacts:2}"
          f"   {seconds / len(runs):16.2f}", flush=True)  # fmt: skip
    return back == len(runs) and error <= MOST_M and same == contacts


def at_its_step(found: Any, run: Run) -> bool:
    """Whether the boxes of the contact overlap at its step and not at the step before."""
    contact = run.contact
    assert contact is not None
    pair = contact.first_id, contact.second_id
    if isinstance(found, foreign.Played):
        before = found.touching.get((contact.step - 1, pair[0]), set())
        return pair[1] in found.touching[contact.step, pair[0]] - before
    near = {key: box for key, box in found.items()
            if key[1] in pair and key[0] in (contact.step - 1, contact.step)}  # fmt: skip
    return foreign.first_contact(near, *pair) == contact.step


def scene(path: Path, run: Run) -> Any:
    """Of `scene.npz`, by our own reader, up to the end of the episode."""
    [found] = readers.scenes([path])
    return foreign.boxes_of(found.tracks.window(0, run.rollout.tracks.steps))


def scenarionet(path: Path, run: Run) -> Any:
    """Of the pickle, after MetaDrive's rules, up to the end of the episode."""
    found = pickle.loads(path.read_bytes())
    foreign.check_scenario(found)
    steps = run.rollout.tracks.steps
    return {key: box for key, box in foreign.scenario_boxes(found).items() if key[0] < steps}


def openscenario(path: Path, run: Run) -> Any:
    """Of the scenario, with the ids that its entities have as a property."""
    ids = foreign.xosc_ids(path / "scenario.xosc")
    found = foreign.xosc_boxes(path / "scenario.xosc")
    return {(step, ids[name]): box for (step, name), box in found.items()}


def esmini(path: Path, run: Run) -> Any:
    """Of what esmini plays, with the ids that the entities have as a property."""
    assert PLAYER
    ids = foreign.xosc_ids(path / "scenario.xosc")
    found = foreign.played(PLAYER, path)
    return foreign.Played(
        {(step, ids[name]): place for (step, name), place in found.reference_m.items()},
        {ids[name]: ahead for name, ahead in found.ahead_m.items()},
        {(step, ids[name]): {ids[one] for one in others}
         for (step, name), others in found.touching.items()},
    )  # fmt: skip


def womd(path: Path, run: Run) -> Any:
    """Of the Scenario, up to the end of the episode."""
    steps = run.rollout.tracks.steps
    return {key: box for key, box in foreign.womd_boxes(path).items() if key[0] < steps}


def commonroad(path: Path, run: Run) -> Any:
    """Of the scenario with the AV as an obstacle, which begins at the current step."""
    now, steps = run.rollout.now, run.rollout.tracks.steps
    found = foreign.commonroad_boxes(path).items()
    return {(step + now, name): box for (step, name), box in found if step + now < steps}


ESMINI, PLAYER = "esmini", shutil.which("esmini")
FORMATS = {ESMINI: "openscenario"}
SETTINGS = {"commonroad": {"av": "obstacle"}}
SINCE_NOW = {"commonroad"}
"""Formats without what was before the attack."""
READERS: dict[str, Callable[[Path, Run], Any]] = {
    "fcd": lambda path, _: foreign.fcd_boxes(path),
    "scene": scene,
    "ssam": lambda path, _: foreign.ssam_boxes(path),
    "openscenario": openscenario,
    ESMINI: esmini,
    "scenarionet": scenarionet,
    "womd": womd,
    "commonroad": commonroad,
    "osi": lambda path, _: foreign.osi_boxes(path),
}


if __name__ == "__main__":
    main()
