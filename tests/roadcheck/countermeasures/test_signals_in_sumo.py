"""A changed signal shows in SUMO what was asked for, whatever controls it."""

import itertools
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import sumo

from deepmf_sumo.errors import UsageError
from deepmf_sumo.roadcheck.countermeasures import building, document, signals
from deepmf_sumo.sumo.network import sumo_tools

from tests.support import crossing_network

SUMO = Path(sumo.SUMO_HOME) / "bin" / "sumo"
ROUTES = """<routes><route id="over" edges="west east far"/><route id="up" edges="south north"/>
<flow id="o" begin="0" end="200" period="6" route="over"/>
<flow id="u" begin="0" end="200" period="7" route="up"/></routes>"""
WANTED = "version: 1\nchanges:\n  - {signal: mid, yellow_s: 5, all_red_s: 2}\n"


def crossing(folder, control):
    return crossing_network.build(
        folder, "--tls.default-type", control, middle="traffic_light", routes=ROUTES
    )


def built(config, text=WANTED, *options):
    file = config.parent / "changes.yaml"
    file.write_text(text)
    return building.build(config, document.load(file), config.parent / "out", options)


def runs_of(config, folder):
    """(seconds, state) of the light as plain SUMO shows it, second by second."""
    more = folder / "watch.add.xml"
    more.write_text('<additional><timedEvent type="SaveTLSStates" source="mid" dest="s.xml"/>'
                    "</additional>")  # fmt: skip
    command = [str(SUMO), "-c", str(config), "-a", str(more), "--end", "200", "--no-step-log"]
    subprocess.run(command, check=True, capture_output=True)
    states = [one.get("state") for one in ET.parse(folder / "s.xml").iter("tlsState")]
    changes = [0, *(at for at in range(1, len(states)) if states[at] != states[at - 1])]
    return [(end - at, states[at]) for at, end in itertools.pairwise(changes)]


@pytest.mark.sumo
@pytest.mark.parametrize("control", ["static", "actuated", "delay_based", "NEMA"])
def test_yellow_and_all_red_are_those_asked_for(control, tmp_path):
    found = built(crossing(tmp_path, control))
    assert found.done[-1] == "signal 'mid': SUMO shows what was asked for"
    runs = runs_of(found.after, tmp_path)
    yellows = {seconds for seconds, state in runs if "y" in state.lower()}
    pauses = {seconds for seconds, state in runs if set(state) == {"r"}}
    assert (yellows, pauses) == ({5}, {2})


@pytest.mark.sumo
def test_options_of_sumo_that_name_what_is_changed_are_refused(tmp_path):
    """They hide the change from both sides: the option is stronger than the configuration."""
    config = crossing(tmp_path, "static")
    for option in ("-n", "--net-file", "-a", "--additional-files"):
        name = "net-file" if "n" in option[:3] else "additional-files"
        with pytest.raises(UsageError, match=f"option --{name} cannot be given here"):
            built(config, WANTED, option, "other.xml")
    assert not (tmp_path / "out").exists()
    assert (
        built(config, WANTED, "--scale", "1.5").done[-1].endswith("SUMO shows what was asked for")
    )


@pytest.mark.sumo
def test_a_controller_that_ignores_the_change_is_refused(tmp_path, monkeypatch):
    """As phases added to a NEMA program are, which that controller does not read."""
    monkeypatch.setattr(signals, "NEMA", "unknown")
    with pytest.raises(UsageError, match=r"SUMO shows 3\.0 s of yellow .* 5 s were asked for"):
        built(crossing(tmp_path, "NEMA"))


@pytest.mark.sumo
def test_left_turns_of_a_nema_controller_are_refused(tmp_path):
    wanted = WANTED.replace("yellow_s: 5, all_red_s: 2", "protected_left_s: 8")
    with pytest.raises(UsageError, match="is a NEMA controller"):
        built(crossing(tmp_path, "NEMA"), wanted)


ARMS = {"w": (-150, 0), "e": (150, 0), "s": (0, -150), "n": (0, 150)}


def four_arms(folder, control, lanes=3, bicycles="", *options):
    """Turning back is allowed; who turns right gives way to a lane of bicycles beside."""
    nodes = "".join(f'<node id="{arm}" x="{x}" y="{y}"/>' for arm, (x, y) in ARMS.items())
    edges = "".join(
        f'<edge id="{start}{to}" from="{start}" to="{to}" numLanes="{many}" speed="13.9"'
        f" {bicycles}/>"
        for arm in ARMS for start, to, many in ((arm, "mid", lanes), ("mid", arm, 2))
    )  # fmt: skip
    middle = '<node id="mid" x="0" y="0" type="traffic_light"/>'
    (folder / "four.nod.xml").write_text(f"<nodes>{middle}{nodes}</nodes>")
    (folder / "four.edg.xml").write_text(f"<edges>{edges}</edges>")
    sumo_tools.run(
        "netconvert", "-n", str(folder / "four.nod.xml"), "-e", str(folder / "four.edg.xml"),
        "-o", str(folder / "four.net.xml"), "--tls.default-type", control, *options,
    )  # fmt: skip
    config = folder / "four.sumocfg"
    config.write_text('<configuration><net-file value="four.net.xml"/></configuration>')
    return config


def ways(net):
    """Direction of each link for cars, and which links meet it, from the file of the network."""
    root = ET.parse(net).getroot()
    cyclists = {one.get("id") for one in root.iter("lane") if one.get("allow") == "bicycle"}
    links = {
        int(one.get("linkIndex")): one.get("dir") for one in root.iter("connection")
        if one.get("tl") == "mid" and f"{one.get('from')}_{one.get('fromLane')}" not in cyclists
    }  # fmt: skip
    [middle] = [one for one in root.iter("junction") if one.get("id") == "mid"]
    bits = {int(one.get("index")): one.get("foes")[::-1] for one in middle.iter("request")}
    meets = {link: [at for at, bit in enumerate(row) if bit == "1"] for link, row in bits.items()}
    return links, meets


@pytest.mark.sumo
@pytest.mark.parametrize(
    "roads", [(2, 'bikeLaneWidth="1.5"'), (3, ""), (2, "", "--lefthand"), (3, "", "--lefthand")]
)
@pytest.mark.parametrize("control", ["static", "actuated"])
def test_no_left_turn_finds_gaps_and_the_rest_goes_as_before(control, roads, tmp_path):
    """With a lane of their own they have a green behind the one in which they find gaps.

    Where traffic keeps left, right turns are what crosses the oncoming traffic.
    """
    config = four_arms(tmp_path, control, *roads)
    links, meets = ways(tmp_path / "four.net.xml")
    crossing = {link for link, way in links.items() if way in ("rT" if len(roads) > 2 else "lt")}
    before = runs_of(config, tmp_path)
    changed = built(config, "version: 1\nchanges: [{signal: mid, protected_left_s: 8}]\n")
    after = runs_of(changed.after, tmp_path)

    def gives_way(runs):
        return any(
            state[link] == "g" and any(state[other] in "gG" for other in meets[link])
            for _, state in runs for link in crossing
        )  # fmt: skip

    assert gives_way(before)
    assert not gives_way(after)
    assert not any(set(state) == {"r"} for _, state in after)
    for link in crossing:
        letters = "".join(state[link] for _, state in after)
        assert "G" in letters
        assert "Gr" not in letters
        assert "gr" not in letters
        greens = [seconds for seconds, state in after if state[link] in "gG"]
        assert min(greens) >= 8
    for link in links.keys() - crossing:
        seen = [
            [letter for letter, _ in itertools.groupby(state[link] for _, state in runs)]
            for runs in (before, after)
        ]
        assert len({tuple(one[:5]) for one in seen}) == 1


@pytest.mark.sumo
def test_a_light_of_two_junctions_protects_the_left_turns_of_both(tmp_path):
    places = {"w": (-150, 0), "a": (0, 0), "b": (80, 0), "e": (230, 0),
              "an": (0, 150), "as": (0, -150), "bn": (80, 150), "bs": (80, -150)}  # fmt: skip
    joined = 'type="traffic_light" tl="mid"'
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{y}" {joined * (name in "ab")}/>'
        for name, (x, y) in places.items()
    )
    pairs = [
        ("w", "a"),
        ("a", "b"),
        ("b", "e"),
        *((one, f"{one}{arm}") for one in "ab" for arm in "ns"),
    ]
    edges = "".join(
        f'<edge id="{start}-{to}" from="{start}" to="{to}" numLanes="2" speed="13.9"/>'
        for pair in pairs for start, to in (pair, pair[::-1])
    )  # fmt: skip
    (tmp_path / "two.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
    (tmp_path / "two.edg.xml").write_text(f"<edges>{edges}</edges>")
    net = tmp_path / "two.net.xml"
    sumo_tools.run(
        "netconvert", "-n", str(tmp_path / "two.nod.xml"), "-e", str(tmp_path / "two.edg.xml"),
        "-o", str(net), "--no-turnarounds", "true",
    )  # fmt: skip
    config = tmp_path / "two.sumocfg"
    config.write_text('<configuration><net-file value="two.net.xml"/></configuration>')
    root = ET.parse(net).getroot()
    lefts = [
        int(one.get("linkIndex")) for one in root.iter("connection")
        if one.get("tl") == "mid" and one.get("dir") == "l"
    ]  # fmt: skip
    assert len(lefts) == 8
    before = runs_of(config, tmp_path)
    text = "version: 1\nchanges: [{signal: mid, protected_left_s: 8, cycle: longer}]\n"
    after = runs_of(built(config, text).after, tmp_path)
    permissive = [
        sum("g" in {state[one] for _, state in runs} for one in lefts) for runs in (before, after)
    ]
    assert permissive == [8, 0]
    for link in lefts:
        assert max(seconds for seconds, state in after if state[link] == "G") >= 8


@pytest.mark.sumo
def test_a_signal_without_a_program_is_refused(tmp_path):
    """As rail signals of real networks are."""
    config = four_arms(tmp_path, "static")
    tree = ET.parse(tmp_path / "four.net.xml")
    tree.getroot().remove(tree.getroot().find("tlLogic"))
    tree.write(tmp_path / "four.net.xml")
    with pytest.raises(UsageError, match="signal 'mid' has no program to change"):
        built(config)


def meet(one, other):
    return {one, other} == {0, 1}


@pytest.mark.parametrize(
    ("states", "found"),
    [
        ([(0, "Gr"), (10, "yr"), (13, "rr"), (14, "rG"), (20, "ry"), (24, "Gr")],
         [("yellow", 3.0, 0, 10.0), ("all-red", 1.0, 1, 13.0), ("all-red", 0.0, 0, 24.0)]),
        ([(0, "Gr"), (10, "rr"), (14, "rG")], [("yellow", 0.0, 0, 10.0)]),
        ([(0, "Gr"), (10, "yr"), (14, "rr"), (16, "rG")], []),
        ([(0, "Gr"), (10, "yr"), (12, "Yr"), (14, "rr"), (16, "rG")], []),
        ([(0, "Gr"), (10, "yr"), (12, "Gr")], []),  # it goes on: no yellow has ended
        ([(0, "Gr"), (10, "yr"), (14.0, "rg")], [("all-red", 0.0, 1, 14.0)]),
        ([(0, "rrr")], []),
        ([], []),
    ],
)  # fmt: skip
def test_times_that_are_too_short(states, found):
    wanted = {"yellow": 4.0, "all-red": 2.0}
    assert [tuple(one) for one in building.too_short(states, meet, wanted)] == found


def test_ways_that_do_not_meet_may_follow_immediately():
    states = [(0, "GrG"), (10, "yrG"), (14, "rrG"), (14.5, "rrg"), (15, "rrr"), (15.1, "rGr")]
    found = list(building.too_short(states, lambda one, other: False, {"all-red": 2.0}))
    assert found == []
