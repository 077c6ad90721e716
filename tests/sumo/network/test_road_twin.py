"""Our reading of a network is SUMO's own: lanes, neighbours, ways on, and lights over a cycle."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
import sumo

from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links

from tests.conftest import ROOT
from tests.support import crossing_network
from tests.support.sumo_twin import differences

OURS = sorted((ROOT / "sumo_nets").glob("*/*.net.xml"))
OTHERS = sorted((ROOT.parent / "shared" / "networks").glob("*/*.net.xml*"))
EXAMPLES = sorted((Path(sumo.SUMO_HOME) / "tools").glob("**/*.net.xml*"))

pytestmark = pytest.mark.sumo


def shown(net: Path) -> str:
    return "/".join(net.parts[-2:])


@pytest.mark.parametrize("net", OURS, ids=shown)
def test_our_networks(net):
    assert differences(net) == []


@pytest.mark.slow
@pytest.mark.parametrize("net", [*OTHERS, *EXAMPLES], ids=shown)
def test_networks_of_others(net):
    assert differences(net) == []


def converted(net: Path, folder: Path, *options: str) -> Path:
    command = [str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"), "-s", str(net), *options]
    found = folder / "other.net.xml"
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run([*command, "-o", found], check=True, capture_output=True, env=environment)
    return found


@pytest.mark.parametrize(
    "options",
    [
        ("--no-internal-links",),
        ("--no-internal-links", "--lefthand"),
        ("--lefthand",),
        ("--crossings.guess", "--sidewalks.guess"),
    ],
)
def test_other_forms_of_a_network(tmp_path, options):
    signals = next(net for net in OURS if net.parent.name == "four_way")
    assert differences(converted(signals, tmp_path, *options)) == []


def test_without_lanes_inside_each_way_has_its_own_light(tmp_path):
    crossing_network.build(tmp_path, "--no-internal-links", middle="traffic_light")
    net = tmp_path / "crossing.net.xml"
    assert differences(net) == []
    ways, lanes = signal_links(net), road_of_net(net).lanes
    red, green = ways[":south_0>east_0"], ways[":west_0>east_0"]
    assert red != green
    assert lanes["south_0"].next == (":south_0>east_0", ":south_0>north_0")
    assert set(lanes["east_0"].previous) == {":south_0>east_0", ":west_0>east_0"}
    way = lanes[":south_0>north_0"]
    assert way.interpolating
    assert way.centre_m[0].tolist() == lanes["south_0"].centre_m[-1].tolist()
    assert way.next == ("north_0",)


def test_a_sign_with_a_higher_limit_holds_up_to_the_next_lane(tmp_path):
    """Over the junction the lower limit of the two holds, with signs as without."""
    crossing_network.build(tmp_path, "--no-internal-links", middle="traffic_light")
    net, signs = tmp_path / "crossing.net.xml", tmp_path / "signs.add.xml"
    way, plain = ":south_0>north_0", road_of_net(net).lanes
    for lanes, more_mps in (("south_0", 0.0), ("south_0 north_0", 5.0)):
        limit = plain["north_0"].speed_limit_mps + 5.0
        step = f'<step time="0" speed="{limit}"/><step time="9" speed="1"/>'
        sign = f'<variableSpeedSign id="v" lanes="{lanes}">{step}</variableSpeedSign>'
        signs.write_text(f"<additional>{sign}</additional>")
        found = road_of_net(net, [signs]).lanes
        assert found["south_0"].speed_limit_mps == plain["south_0"].speed_limit_mps + 5.0
        assert found[way].speed_limit_mps == plain[way].speed_limit_mps + more_mps


def test_the_rails_of_a_crossing_show_no_light(tmp_path):
    text = (OURS[1].parent / "four_way.net.xml").read_text()
    light, index = 'tl="', ' linkIndex="'
    at = text.index(index, text.index(light))
    end = text.index('"', at + len(index))
    net = tmp_path / "rails.net.xml"
    net.write_text(text[: at + len(index)] + "-1" + text[end:])
    plain = signal_links(OURS[1].parent / "four_way.net.xml")
    assert len(signal_links(net)) == len(plain) - 1
    assert all(link.index >= 0 for (link,) in signal_links(net).values())


def test_a_light_in_the_middle_of_a_junction_is_that_of_the_second_lane(tmp_path):
    packed = [net for net in EXAMPLES if net.name == "ingolstadt.net.xml.gz"]
    if not packed:
        pytest.skip("SUMO comes without its example of Ingolstadt")
    net = shutil.copy(packed[0], tmp_path / "net.net.xml.gz")
    links = signal_links(net)  # the states themselves: `test_networks_of_others`
    assert links[":gneJ21_22_0"] != links[":gneJ21_40_0"]


def test_lanes_count_as_sumo_counts_them(tmp_path):
    text = OURS[0].read_text()
    net = tmp_path / "zero.net.xml"
    net.write_text(text.replace(' index="1"', ' index="0"').replace(' index="2"', ' index="0"'))
    ours, right = road_of_net(net).lanes, road_of_net(OURS[0]).lanes
    assert {name: lane.left for name, lane in ours.items()} == {
        name: lane.left for name, lane in right.items()
    }
