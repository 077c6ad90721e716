"""The long commands that `tests.fuzz.signals` ends, each on a network or scenes of seconds."""

import contextlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.scene.readers import npz

from tests.support import synthetic, tiny_network

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = [sys.executable, "-m", "deepmf_sumo.cli.main"]
CHANGE = "version: 1\nchanges:\n  - {edge: ab, limit_mps: 13.5}\n"
CLIENT = """
import sys, time, traci
connection = traci.connect(int(sys.argv[1]), numRetries=600, waitBetweenRetries=0.1)
for _ in range(150):
    connection.simulationStep()
    time.sleep(0.02)
connection.close()
"""


@dataclass(frozen=True, kw_only=True)
class LongCommand:
    """A command; OUT in its arguments is what it makes, PORT a free port that a client steps.

    Attributes:
        runs: whether OUT has a table of runs.
        resumes: given again it goes on; else it begins anew over what it left.
        compares: it makes something, the same each time.
        codes: exit codes of its end.
        timed: files that tell of the machine.
    """

    arguments: tuple[str | Path, ...]
    runs: bool = False
    resumes: bool = True
    compares: bool = True
    codes: tuple[int, ...] = (0,)
    timed: tuple[str, ...] = ()


def prepare(folder: Path) -> None:
    """What the commands work on: a network, scenes, and two planners under an attack that hits."""
    tiny_network.build(folder)
    (folder / "change.yaml").write_text(CHANGE)
    (folder / "scenes").mkdir()
    for number in range(4):
        scene = synthetic.scene(shift=number - 20.0, av_speed=8.0 + number)
        npz.write(scene, folder / "scenes" / f"{number}.npz")
    for planner in ("idm", "sumo"):
        attack = ROOT / "scenarios" / "cut_in.yaml"
        given = ["run", attack, "--no-pictures", "--set", f"planner={planner}", "--out", planner]
        subprocess.run([*PROGRAM, *given], cwd=folder, check=True, capture_output=True)


def commands(folder: Path) -> dict[str, LongCommand]:
    """All of them, by name; they are given in the folder of `prepare`."""
    sweep = ("--jobs", "2", "--no-pictures", "--resume", "--out", "OUT")
    brief = ("--set", "duration_s=1", *sweep)
    (hit,) = (folder / "idm" / "runs").iterdir()
    scenes = folder / "scenes"
    return {
        "run": LongCommand(arguments=("run", *specs(folder), *sweep), runs=True),
        "attack": LongCommand(
            arguments=("attack", "tiny.sumocfg", "--moments", "6", "--tries", "2", *brief),
            runs=True,
        ),
        "try": LongCommand(
            arguments=(
                "try", "tiny.sumocfg", "--change", "change.yaml", "--moments", "4",
                "--set", "adversary=none", "--set", "source.moments.prefer=both", *brief,
            )
        ),
        "serve": LongCommand(
            arguments=(
                "serve", "tiny.sumocfg", "--port", "PORT", "--av", "av", "--out", "OUT",
                "--", "--step-length", "0.1",
            ),
            resumes=False,
            compares=False,
        ),
        "train": LongCommand(
            arguments=(
                "train", "opponent", "--data", scenes, "--out", "OUT/set", "--cache", "OUT/cache",
                "--jobs", "2", "--set", "steps=30", "--set", "opponent.evaluate_every=10",
            ),
            timed=("opponent.json", "opponent.csv", "card.md"),
        ),
        "check": LongCommand(
            arguments=("check", "idm", "--baseline", "sumo", "--same-attacks", "OUT", "-j", "2"),
            codes=(0, 1, 3),
            runs=True,
        ),
        "compare": LongCommand(arguments=("compare", "idm", "sumo"), compares=False),
        "shrink": LongCommand(
            arguments=("shrink", hit, "--out", "OUT", "--simulations", "12"), resumes=False
        ),
        "risk": LongCommand(arguments=("risk", "idm", "--out", "OUT"), resumes=False),
        "record": LongCommand(
            arguments=(
                "data", "record", "tiny.sumocfg", "--generate", "grid", "--networks", "2",
                "--scenes", "2", "--jobs", "2", "--out", "OUT",
            ),
            codes=(0, 3),
        ),
        "convert": LongCommand(
            arguments=("data", "convert", scenes, "--jobs", "2", "--out", "OUT"),
            resumes=False,
            timed=("convert.csv",),
        ),
    }  # fmt: skip


def specs(folder: Path) -> list[Path]:
    """16 runs of a second."""
    source = "{{network: tiny.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
    return [
        tiny_network.spec(
            folder, f"{planner} {start}", planner=planner, source=source.format(start)
        )
        for planner in ("idm", "sumo")
        for start in range(1, 9)
    ]


@contextlib.contextmanager
def stepped(port: int, wanted: bool):
    """A TraCI client that steps what listens on a port, if one is wanted."""
    if not wanted:
        yield
        return
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, str(port)], stdout=-3, stderr=-3, start_new_session=True
    )
    try:
        yield
    finally:
        client.kill()
        client.wait()
