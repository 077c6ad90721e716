"""TTC, DRAC and PET against SUMO's own device for surrogate safety measures, where both have them.

Both look at the same episode: SUMO's traffic, which nobody touches.
"""

import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import sumo

from deepmf_sumo.judge.metrics import conflict, traffic_conflicts
from deepmf_sumo.planners import sumo as sumo_planner
from deepmf_sumo.roadcheck.motion_survey import Survey, survey
from deepmf_sumo.sumo.simulation import network_case, simulate

pytestmark = pytest.mark.sumo

SUMO = Path(sumo.SUMO_HOME) / "bin"
ENVIRONMENT = {**os.environ, "SUMO_HOME": sumo.SUMO_HOME}
CONFIG = """<configuration><input><net-file value="net.net.xml"/>
<route-files value="net.rou.xml"/></input></configuration>"""

ROAD = {
    "nod": '<nodes><node id="a" x="0" y="0"/><node id="b" x="600" y="0"/></nodes>',
    "edg": '<edges><edge id="ab" from="a" to="b" numLanes="1" speed="20"/></edges>',
    "rou": """<routes><vType id="slow" maxSpeed="5" sigma="0"/><vType id="fast" sigma="0"/>
<vehicle id="foe" type="slow" depart="0" departPos="120" departSpeed="5">
  <route edges="ab"/></vehicle>
<vehicle id="av" type="fast" depart="0" departPos="10" departSpeed="15">
  <route edges="ab"/></vehicle></routes>""",
}
CROSSING = {
    "nod": """<nodes><node id="w" x="-150" y="0"/><node id="e" x="150" y="0"/>
<node id="s" x="0" y="-150"/><node id="n" x="0" y="150"/><node id="c" x="0" y="0"/></nodes>""",
    "edg": "".join(
        ["<edges>"]
        + [
            f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="14"/>'
            for a, b in ("wc", "ce", "sc", "cn")
        ]
        + ["</edges>"]
    ),
    "rou": """<routes><vType id="blind" sigma="0" speedDev="0" maxSpeed="10" jmIgnoreFoeProb="1"
  jmIgnoreFoeSpeed="100"/>
<vehicle id="av" type="blind" depart="0" departPos="20" departSpeed="10">
  <route edges="wc ce"/></vehicle>
<vehicle id="foe" type="blind" depart="0" departPos="0" departSpeed="10">
  <route edges="sc cn"/></vehicle></routes>""",
}


class Onlooker:
    """Names the other vehicle the opponent, and leaves it to SUMO."""

    period_steps = None

    def reset(self, view, rng):
        return ("foe",)

    def plan(self, view):
        return {}


def built(folder, parts):
    for name, text in parts.items():
        (folder / f"net.{name}.xml").write_text(text)
    (folder / "net.sumocfg").write_text(CONFIG)
    command = [SUMO / "netconvert", "-n", "net.nod.xml", "-e", "net.edg.xml", "-o", "net.net.xml"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=ENVIRONMENT)
    return folder / "net.sumocfg"


def encounter(config):
    """SUMO's account: the conflict of av and foe."""
    file = config.with_name("ssm.xml")
    options = {
        "--step-length": "0.1",
        "--seed": "0",
        "--end": "40",
        "--collision.action": "none",
        "--device.ssm.explicit": "av",
        "--device.ssm.measures": "TTC DRAC PET",
        "--device.ssm.thresholds": "100 0.0 100",
        "--device.ssm.range": "200",
        "--device.ssm.file": str(file),
    }
    command = [SUMO / "sumo", "-c", config, *(word for pair in options.items() for word in pair)]
    subprocess.run(command, check=True, capture_output=True, env=ENVIRONMENT)
    conflict = ET.parse(file).getroot().find("conflict")
    return {name: conflict.find(name).attrib["value"] for name in ("minTTC", "maxDRAC", "PET")}


def rollout(config, start_s, steps):
    case = network_case(config, start_s, "av", steps, seed=0)
    planner = sumo_planner.build(sumo_planner.Settings())
    return simulate(case, planner, Onlooker(), rng=np.random.default_rng(0))


def test_following(tmp_path):
    config = built(tmp_path, ROAD)
    theirs, ours = encounter(config), conflict.over_time(rollout(config, 1.0, 100))
    assert ours.ttc_s.min() == pytest.approx(float(theirs["minTTC"]), abs=0.01)
    assert ours.drac_mps2.max() == pytest.approx(float(theirs["maxDRAC"]), abs=0.01)
    # behind a leader that keeps its speed DRAC is what braking needs
    assert ours.braking_mps2.max() == pytest.approx(ours.drac_mps2.max(), rel=0.01)
    assert theirs["PET"] == "NA"  # SUMO has none for followers


def test_crossing(tmp_path):
    config = built(tmp_path, CROSSING)
    theirs, ours = encounter(config), rollout(config, 2.0, 140)
    assert ours.contacts == ()
    # SUMO's area is as wide as the lanes, and it finds the times between steps; ours are steps
    pet = conflict.encroachment_s(ours)
    assert float(theirs["PET"]) <= pet <= float(theirs["PET"]) + 0.3
    assert conflict.over_time(ours).ttc_s.min() == pytest.approx(float(theirs["minTTC"]), abs=0.15)


def test_following_in_plain_traffic(tmp_path):
    config = built(tmp_path, ROAD)
    theirs = encounter(config)
    seen = survey(Survey(config=config, seed=0, until_s=40.0))
    limits = traffic_conflicts.ConflictLimits(ttc_s=float(theirs["minTTC"]) + 0.5)
    [ours] = traffic_conflicts.find(seen.motions, limits).conflicts
    assert ours.ttc_s == pytest.approx(float(theirs["minTTC"]), abs=0.01)
    assert [seen.names[one] for one in (ours.first, ours.second)] == ["foe", "av"]
    assert ours.type == "rear end"
