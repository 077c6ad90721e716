"""Who is where when, while nobody attacks."""

import numpy as np
import pytest

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.planners import idm
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.simulation import network_case, simulate, traffic_survey
from deepmf_sumo.sumo.simulation.traffic_survey import TrafficSurvey, survey_traffic

from tests.support.tiny_network import build


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiny")
    file = build(folder)
    outputs = '<output><fcd-output value="fcd.xml"/></output>'
    random = '<random_number><random value="true"/></random_number>'
    detector = '<additional><edgeData id="e" file="edges.xml"/></additional>'
    (folder / "out.add.xml").write_text(detector)
    additional = '<additional-files value="out.add.xml"/></input>'
    text = file.read_text().replace("</input>", additional)
    file.write_text(text.replace("</conf", f"{outputs}{random}</conf"))
    return file


def look(config, *options, **more):
    return survey_traffic(TrafficSurvey(config=config, sumo_options=options, seed=0, **more))


def test_everybody_is_seen_once_a_second_and_when_asked(config):
    seen = look(config, at_s=(2.5,))
    assert [body.id for body in seen.bodies] == ["av", "leader"]
    assert {body.type for body in seen.bodies} == {"DEFAULT_VEHTYPE"}
    assert seen.time_s[:10:2] == pytest.approx([1.0, 2.0, 2.5, 3.0, 4.0])
    assert seen.complete
    assert not seen.persons
    assert seen.edges == ("ab",)
    assert (seen.following == -1).all()
    assert not seen.parked.any()
    av = seen.vehicle == 0
    assert (np.diff(seen.position_m[av, 0]) > 0).all()
    assert seen.to_end_m[av] == pytest.approx(400 - seen.position_m[av, 0] - 2.5, abs=0.01)


def test_a_run_finds_the_traffic_that_was_seen(config):
    seen = look(config)
    rollout = simulate(
        network_case(config, 5.0, "av", 2), idm.build(idm.Settings()), None,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    at = (seen.time_s == 5.0) & (seen.vehicle == 1)
    tracks = rollout.tracks
    there = tracks.position_m[tracks.row("leader"), rollout.now]
    assert there == pytest.approx(seen.position_m[at][0], abs=1e-9)


def test_outputs_of_the_configuration_are_not_written_over(config):
    look(config)
    assert not [path.name for path in config.parent.rglob("*") if path.name.startswith("fcd")]
    assert not (config.parent / "edges.xml").exists()


def test_it_ends_with_the_configuration_as_told_or_where_it_gets_too_long(config, monkeypatch):
    ended = look(config, "--end", "4")
    assert (ended.until_s, ended.complete) == (4.0, True)
    ended = look(config, "--end", "4", until_s=9.0)
    assert (ended.until_s, ended.complete) == (4.0, True)
    told = look(config, until_s=3.0)
    assert (told.until_s, told.complete) == (3.0, False)
    monkeypatch.setattr(traffic_survey, "MOST_VEHICLE_STEPS", 400)
    short = look(config)
    assert (short.until_s, short.complete) == (2.0, False)


def test_a_survey_goes_on_while_the_number_of_vehicles_grows(tmp_path, monkeypatch):
    """A flow on a road of 400 m: the first vehicles leave after half a minute."""
    config = build(tmp_path)
    (tmp_path / "tiny.rou.xml").write_text(
        '<routes><flow id="f" begin="0" end="900" period="1" departSpeed="13.9" from="ab"'
        ' to="ab"/></routes>'
    )
    monkeypatch.setattr(traffic_survey, "MOST_VEHICLE_STEPS", 6000)
    assert look(config).until_s == 20.0
    settled = look(config, settles=True)
    counts = np.unique(settled.time_s, return_counts=True)[1]
    assert not traffic_survey.growth(counts).goes_on
    assert traffic_survey.growth(counts[:-1]).goes_on
    assert 30.0 < settled.until_s < 60.0
    monkeypatch.setattr(traffic_survey, "MOST_WHILE_GROWING", 8000)
    assert 20.0 < look(config, settles=True).until_s < 30.0
    assert look(config, settles=True, until_s=5.0).until_s == 5.0


def test_a_missing_file_is_named(config, tmp_path):
    with pytest.raises(SimulationError, match=r"missing\.rou\.xml', which does not exist"):
        look(config, "-r", str(tmp_path / "missing.rou.xml"), "--begin", "1")


def test_who_is_sent_elsewhere_again_and_again_is_followed(tmp_path):
    """SUMO gives the name of a route that is no longer driven to a longer one."""
    ring = 'numLanes="1" speed="14"'
    (tmp_path / "n.nod.xml").write_text(
        '<nodes><node id="a" x="0" y="0"/><node id="b" x="60" y="0"/><node id="c" x="0" y="60"/>'
        "</nodes>"
    )
    (tmp_path / "e.edg.xml").write_text(
        f'<edges><edge id="ab" from="a" to="b" {ring}/><edge id="bc" from="b" to="c" {ring}/>'
        f'<edge id="ca" from="c" to="a" {ring}/></edges>'
    )
    sumo_tools.run(
        *("netconvert", "-n", str(tmp_path / "n.nod.xml"), "-e", str(tmp_path / "e.edg.xml")),
        *("-o", str(tmp_path / "r.net.xml")),
    )
    rerouters = "".join(
        f'<rerouter id="{at}" edges="{at}"><interval begin="0" end="999">'
        f'<destProbReroute id="{to}"/></interval></rerouter>'
        for at, to in (("ab", "ca"), ("ca", "ab"))
    )
    (tmp_path / "r.add.xml").write_text(f"<additional>{rerouters}</additional>")
    trips = "".join(f'<trip id="v{n}" depart="{n}" from="ab" to="ca"/>' for n in (0, 3))
    (tmp_path / "r.rou.xml").write_text(f"<routes>{trips}</routes>")
    config = tmp_path / "r.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="r.net.xml"/><route-files value="r.rou.xml"/>'
        '<additional-files value="r.add.xml"/></input><time><end value="100"/></time>'
        "</configuration>"
    )
    seen = look(config)
    assert seen.until_s == 100.0
    assert set(seen.edges) == {"ab", "bc", "ca"}
    mine = seen.vehicle == 0
    assert len(np.unique(seen.edge[mine][-20:])) == 3
