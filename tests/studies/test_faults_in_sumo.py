"""Faulty copies in SUMO, which would brake for them: what they do not see, they hit."""

import numpy as np
import pytest

from deepmf_sumo.sumo.simulation import network_case, simulate
from studies.planner_faults.faults import Faulty, Settings

from tests.support import crossing_network, tiny_network

pytestmark = pytest.mark.sumo

STANDS = """<routes><vType id="t" vClass="truck" length="10"/>
<vehicle id="leader" type="{kind}" depart="0" departPos="75" departLane="0" departSpeed="0">
  <route edges="ab"/><stop lane="ab_0" endPos="80" duration="60"/></vehicle>
<vehicle id="av" depart="0" departPos="10" departLane="0" departSpeed="8">
  <route edges="ab"/></vehicle>
</routes>"""


@pytest.fixture(scope="module")
def networks(tmp_path_factory, starts_sumo):
    """A standing car, and a standing truck, in the AV's lane, which is the only one."""
    found = {}
    for name, kind in (("car", "DEFAULT_VEHTYPE"), ("truck", "t")):
        folder = tmp_path_factory.mktemp(name)
        found[name] = tiny_network.build(folder, lanes=1)
        (folder / "tiny.rou.xml").write_text(STANDS.format(kind=kind))
    return found


def driven(fault, config):
    case = network_case(config, 2.0, "av", 120)
    planner = Faulty.build(Settings(fault=fault))
    return simulate(case, planner, None, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("fault", "stands", "hits"),
    [
        ("none", "car", False),
        ("none", "truck", False),
        ("no_standing", "car", True),
        ("no_trucks", "truck", True),
        ("no_trucks", "car", False),
        ("no_small", "car", False),
    ],
)
def test_what_it_does_not_see_it_hits(networks, fault, stands, hits):
    rollout = driven(fault, networks[stands])
    assert (rollout.first("av_other") is not None) == hits
    if not hits:
        assert rollout.tracks.speed_mps[rollout.tracks.row("av"), -1] < 0.5


def test_late_is_late_behind_a_vehicle_of_its_lane(networks):
    """SUMO's IDM brakes at once; a copy that answers 1 s later brakes harder in the end."""
    good, bad = (driven(fault, networks["car"]) for fault in ("none", "late_10"))
    hardest = [
        -np.diff(one.tracks.speed_mps[one.tracks.row("av"), one.now :]).min() * 10
        for one in (good, bad)
    ]
    assert hardest[1] > hardest[0] + 0.5


CROSSES = """<routes><route id="over" edges="west east far"/><route id="up" edges="south north"/>
<vehicle id="av" depart="0" departPos="80" departSpeed="8" route="up"/>
<vehicle id="first" depart="0" departPos="40" departSpeed="max" route="over"/>
</routes>"""


def test_bold_gaps_takes_the_way_of_a_crossing_vehicle_that_sumo_would_let_pass(tmp_path):
    config = crossing_network.build(tmp_path, middle="priority", routes=CROSSES)
    crossed = {}
    for fault in ("none", "bold_gaps"):
        tracks = driven(fault, config).tracks
        y = tracks.position_m[tracks.row("av"), :, 1]
        x = tracks.position_m[tracks.row("first"), :, 0]
        crossed[fault] = int((y > 150).argmax()) - int((x > 150).argmax())  # steps
    assert crossed["none"] > 10 > -10 > crossed["bold_gaps"]
