"""Costs and side effects of attacks in a foreign simulation: ``python -m tests.bench.live``.

A grid with traffic is stepped by a script that drives nobody; a second client attaches. Printed:
steps a second with a second client that only steps and with ours before any attack; what a step
takes the script behind `serve`, and with SUMO alone; and, with attacks, how many pairs of
bystanders overlap that do not without us.
"""

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import sumo

from deepmf_sumo.scene.geometry import boxes, frames

BIN = Path(sumo.SUMO_HOME) / "bin"
TOOLS = Path(sumo.SUMO_HOME) / "tools"
FCD = ("--device.fcd.period", "0.5", "--precision", "3", "--fcd-output")
_CAR_M = np.array([5.0, 1.8])
PROGRAM = Path(sys.executable).with_name("deepmf-sumo")
CLIENT = """
import json, statistics, sys, time, traci
port, order, seconds = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
questions = int(sys.argv[4]) if len(sys.argv) > 4 else 0
for _ in range(300):
    try:
        api = traci.connect(port, numRetries=0)
        break
    except traci.exceptions.FatalTraCIError:
        time.sleep(0.1)
if order:
    api.setOrder(order)
steps, took = 0, []
while 0.1 * steps < seconds - 0.05:
    begin = time.perf_counter()
    api.simulationStep()
    for _ in range(questions):
        api.vehicle.getIDCount()
    steps += 1
    if steps > 300:
        took.append(time.perf_counter() - begin)
fast, middle = (statistics.quantiles(took, n=20)[row] for row in (1, 9))
print(json.dumps({"fast": fast, "middle": middle, "steps": steps,
                  "time": api.simulation.getTime()}))
api.close()
"""


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=600.0, help="of the simulation")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pause", type=float, default=5.0, help="seconds after an attack")
    parser.add_argument("--gui", action="store_true", help="sumo-gui in place of sumo")
    parser.add_argument("--only", choices=["rate", "serve", "lockstep"])
    options = parser.parse_args()
    program = "sumo-gui" if options.gui else "sumo"
    os.environ["SUMO_HOME"] = sumo.SUMO_HOME
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        traffic(folder, options.seconds + 60)
        if options.only in {None, "rate"}:
            rates(folder, program, min(options.seconds, 150.0), options.rounds)
        if options.only in {None, "serve"}:
            behind_serve(folder, min(options.seconds, 150.0), options.rounds)
        if options.only in {None, "lockstep"}:
            lockstep(folder, program, options.seconds, options.pause)


def rates(folder: Path, program: str, seconds: float, rounds: int) -> None:
    """What a step takes the script, with a bare second client and with ours, by turns.

    Where others use the machine, the fastest tenth of the steps says what a step costs.
    """
    found: dict[str, list[dict]] = {"": [], "time=1e9": [], "ttc=0.01": []}
    for _ in range(rounds):
        for trigger, values in found.items():
            client = ["--trigger", trigger] if trigger else None
            values.append(together(folder, program, seconds, client))
    bare = found.pop("")
    for trigger, values in found.items():
        for name in ("fast", "middle"):
            ours, theirs = ([one[name] for one in runs] for runs in (values, bare))
            shares = [b / a for a, b in zip(ours, theirs, strict=True)]
            print(
                f"{program}, no attack, --trigger {trigger}, {name} step: "
                f"{1e3 * statistics.median(ours):.2f} ms, with a bare client "
                f"{1e3 * statistics.median(theirs):.2f} ms; share of the rate "
                f"{statistics.median(shares):.2f} ({', '.join(f'{one:.2f}' for one in shares)})"
            )


def behind_serve(folder: Path, seconds: float, rounds: int) -> None:
    """What a step takes the script, with SUMO alone and behind `serve` before any attack."""
    for trigger in ("time=1e9", "ttc=0.01"):
        for questions in (0, 10):
            found = []
            for _ in range(rounds):
                asked = [str(seconds), str(questions)]
                found.append((alone(folder, asked), served(folder, asked, trigger)))
            for name in ("fast", "middle"):
                ours, theirs = ([one[side][name] for one in found] for side in (1, 0))
                ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
                print(
                    f"serve --trigger {trigger}, {name} step with {questions} questions: "
                    f"{1e3 * statistics.median(ours):.2f} ms, SUMO alone "
                    f"{1e3 * statistics.median(theirs):.2f} ms; ratio "
                    f"{statistics.median(ratios):.2f} ({', '.join(f'{one:.2f}' for one in ratios)})"
                )


def alone(folder: Path, asked: list[str]) -> dict:
    """What the script says of SUMO."""
    port = str(free_port())
    command = [BIN / "sumo", "-c", "grid.sumocfg", "--remote-port", port, "--no-step-log"]
    with subprocess.Popen([*command, "--no-warnings"], cwd=folder, stdout=subprocess.DEVNULL):
        return scripted(port, asked)


def served(folder: Path, asked: list[str], trigger: str) -> dict:
    """What the script says of `serve`."""
    port = str(free_port())
    command = [PROGRAM, "serve", "grid.sumocfg", "--port", port, "--av", "ego", "--overwrite",
               "--trigger", trigger, "--out", "served",
               "--", "--no-step-log", "--no-warnings"]  # fmt: skip
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=folder, **quiet):
        return scripted(port, asked)


def scripted(port: str, asked: list[str]) -> dict:
    """What the script says."""
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, port, "0", *asked], check=True, capture_output=True
    )
    return json.loads(done.stdout)


def lockstep(folder: Path, program: str, seconds: float, pause_s: float) -> None:
    """The whole time with attacks, and what became of the bystanders."""
    make(
        folder,
        [BIN / "sumo", "-c", "grid.sumocfg", "--end", str(seconds), "--no-step-log",
         "--no-warnings", *FCD, "alone.xml"],
    )  # fmt: skip
    attach = ["--out", "live", "--set", f"live.pause_s={pause_s}"]
    with_us = together(folder, program, seconds, attach, fcd="with_us.xml")
    rows = (folder / "live" / "attacks.jsonl").read_text().splitlines()
    driven = {row["opponent"] for row in map(json.loads, rows)}
    ours = overlaps(folder / "with_us.xml", driven)
    theirs = overlaps(folder / "alone.xml", set())
    hits = sum(json.loads(one)["contact"] is not None for one in rows)
    print(
        f"{program}: {with_us['steps']} steps to {with_us['time']:.1f} s in lock-step, "
        f"{len(rows)} attacks, {hits} contacts"
    )
    print(f"bystanders that overlap: without us {len(theirs)}, with us {len(ours)}: {sorted(ours)}")


def together(
    folder: Path, program: str, seconds: float, attach: list[str] | None, fcd: str | None = None
) -> dict:
    """Run SUMO with the script and a second client; what the script says."""
    port = str(free_port())
    shown = ["--start", "--quit-on-end"] if program == "sumo-gui" else []
    if fcd:
        shown += [*FCD, fcd]
    sim = subprocess.Popen(
        [BIN / program, "-c", "grid.sumocfg", "--remote-port", port, "--num-clients", "2",
         "--no-step-log", "--no-warnings", *shown],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    script = [sys.executable, "-c", CLIENT, port]
    user = subprocess.Popen(
        [*script, "1", str(seconds)],
        cwd=folder, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    if attach is None:
        other = [*script, "2", str(seconds)]
    else:
        other = [PROGRAM, "attach", "--port", port, "--av", "ego", "--set", "live.wait_s=60",
                 "--until", str(seconds), *attach]  # fmt: skip
        if "--out" not in attach:
            other += ["--out", str(folder / "unused")]
    second = subprocess.Popen(other, cwd=folder, stdout=subprocess.DEVNULL)
    if second.wait():
        raise SystemExit(f"the second client ended with {second.returncode}")
    told, _ = user.communicate()
    if user.returncode or sim.wait():
        raise SystemExit(f"the script ended with {user.returncode}, SUMO with {sim.returncode}")
    return json.loads(told)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


def overlaps(fcd: Path, without: set[str]) -> set[tuple[str, str]]:
    """Pairs of vehicles that ever overlap, the AV and those named left out."""
    pairs = set()
    for _, moment in ET.iterparse(fcd):
        if moment.tag != "timestep":
            continue
        rows = [row for row in moment if row.get("id") not in without | {"ego"}]
        table = np.array([[float(row.get(key)) for key in ("x", "y", "angle")] for row in rows])
        centre, heading = frames.from_sumo(table[:, :2], table[:, 2], _CAR_M[0])
        size = np.broadcast_to(_CAR_M, (len(rows), 2))
        hit = boxes.overlap(
            centre[:, None], heading[:, None], size[:, None], centre[None], heading[None],
            size[None],
        )  # fmt: skip
        pairs |= {(rows[a].get("id"), rows[b].get("id")) for a, b in np.argwhere(np.triu(hit, 1))}
        moment.clear()
    return pairs


def traffic(folder: Path, seconds: float) -> None:
    """A signalled grid of two-lane streets, a car every 0.8 s, and an AV that drives around."""
    make(
        folder,
        [BIN / "netgenerate", "--grid", "--grid.number", "5", "--grid.length", "200", "-L", "2",
         "--tls.guess", "true", "-o", "grid.net.xml"],
    )  # fmt: skip
    make(
        folder,
        [sys.executable, TOOLS / "randomTrips.py", "-n", "grid.net.xml", "-r", "cars.rou.xml",
         "-e", str(seconds), "-p", "0.8", "--seed", "3", "--fringe-factor", "3", "--validate"],
    )  # fmt: skip
    (folder / "ego.rou.xml").write_text(
        '<routes><vType id="ego" carFollowModel="IDM"/><vehicle id="ego" type="ego" depart="5">'
        f'<route edges="{" ".join(tour(folder / "grid.net.xml"))}"/></vehicle></routes>'
    )
    (folder / "grid.sumocfg").write_text(
        '<configuration><input><net-file value="grid.net.xml"/><route-files value="ego.rou.xml,'
        'cars.rou.xml"/></input><time><step-length value="0.1"/></time><processing>'
        '<collision.action value="none"/></processing></configuration>'
    )


def make(folder: Path, command: list) -> None:
    """Run one of SUMO's tools."""
    subprocess.run(command, cwd=folder, check=True, capture_output=True)


def tour(net_file: Path) -> list[str]:
    """Edges of a long random way."""
    import sumolib

    rng, way = np.random.default_rng(1), [sumolib.net.readNet(str(net_file)).getEdges()[10]]
    while len(way) < 100:
        back = way[-1].getFromNode()
        ahead = [
            one for one in way[-1].getOutgoing() if one.getToNode() != back and one.getOutgoing()
        ]
        way.append(ahead[rng.integers(len(ahead))])
    return [one.getID() for one in way]


if __name__ == "__main__":
    main()
