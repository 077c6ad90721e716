"""A straight road with a follower and a leader, built by netconvert in half a second."""

import os
import subprocess
from pathlib import Path

import sumo

NODES = '<nodes><node id="a" x="0" y="0"/><node id="b" x="400" y="0"/></nodes>'
EDGES = '<edges><edge id="ab" from="a" to="b" numLanes="2" speed="13.9"/></edges>'
ROUTES = """<routes>
<vehicle id="leader" depart="0" departPos="60" departLane="0" departSpeed="8">
  <route edges="ab"/></vehicle>
<vehicle id="av" depart="0" departPos="20" departLane="0" departSpeed="8">
  <route edges="ab"/></vehicle>
</routes>"""
CONFIG = """<configuration><input><net-file value="tiny.net.xml"/>
<route-files value="tiny.rou.xml"/></input></configuration>"""

CRASHING = """
import os, signal, time
from pathlib import Path
from deepmf_sumo.planners.idm import Settings, build as build_idm

class _Planner:
    Settings = Settings
    def __init__(self, settings): self.idm, self.steps = build_idm(settings), 0
    model = property(lambda self: self.idm.model)
    @classmethod
    def build(cls, settings): return cls(settings)
    def reset(self, case, rng): self.idm.reset(case, rng)
    def act(self, view):
        self.steps += 1
        if self.steps == 3: self.go_wrong()
        return self.idm.act(view)

class Crash(_Planner):
    def go_wrong(self): os.kill(os.getpid(), signal.SIGSEGV)

class Hang(_Planner):
    def go_wrong(self): time.sleep(600)

class Raise(_Planner):
    def go_wrong(self): raise ZeroDivisionError("a bug\\nof the planner")

class Wait(_Planner):
    def go_wrong(self):
        here = Path(__file__).parent.with_suffix(".said")  # not in the folder, which is an input
        (here / f"waits-{os.getpid()}").touch()
        for _ in range(1200):
            if (here / "go").exists(): return
            time.sleep(0.1)
        raise TimeoutError("nobody said go")
"""


def build(folder: Path, lanes: int = 2, more_edges: str = "") -> Path:
    """The configuration, and the module ``bad_planners`` beside it."""
    edges = EDGES.replace("</edges>", f"{more_edges}</edges>")
    for name, text in {
        "tiny.nod.xml": NODES,
        "tiny.edg.xml": edges.replace('numLanes="2"', f'numLanes="{lanes}"'),
        "tiny.rou.xml": ROUTES,
        "tiny.sumocfg": CONFIG,
        "bad_planners.py": CRASHING,
    }.items():
        (folder / name).write_text(text)
    netconvert = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    subprocess.run(
        [netconvert, "-n", "tiny.nod.xml", "-e", "tiny.edg.xml", "-o", "tiny.net.xml"],
        cwd=folder,
        check=True,
        capture_output=True,
        env={**os.environ, "SUMO_HOME": sumo.SUMO_HOME},
    )
    return folder / "tiny.sumocfg"


def spec(folder: Path, name: str, **changes: str) -> Path:
    """A spec file beside the network; ``changes`` are YAML texts of its keys."""
    keys = {
        "version": "1",
        "name": name,
        "source": "{network: tiny.sumocfg, start_s: 2.0, av: {vehicle: av}}",
        "duration_s": "1.0",
        "adversary": "none",
        **changes,
    }
    path = folder / f"{name}.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return path
