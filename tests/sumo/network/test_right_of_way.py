"""Who gives way to whom, from the requests of junctions."""

from deepmf_sumo.sumo.network.sumo_net import going_first, read_net

LANE = '<lane id="{0}_0" index="0" speed="10" length="9" shape="0,0 9,0"/>'
INNER = {":j_0": "a", ":j_1": "b", ":j_2": "c", ":j_3": ""}


def written(tmp_path, requests, inner=":j_0_0 :j_3_0 :j_2_0"):
    """Link 1, from b, waits on lane :j_1_0 and goes on over :j_3_0."""
    edges = "".join(
        f'<edge id="{name}" function="internal">{LANE.format(name)}</edge>' for name in INNER
    ) + "".join(f'<edge id="{name}" from="x" to="j">{LANE.format(name)}</edge>' for name in "abc")
    ways = '<connection from="{}" to="out" fromLane="0" toLane="0"{} dir="s" state="m"/>'
    links = "".join(
        ways.format(start, f' via="{name}_0"') for name, start in INNER.items() if start
    )
    links += ways.format(":j_1", ' via=":j_3_0"') + ways.format(":j_3", "")
    out = f'<edge id="out" from="j" to="x">{LANE.format("out")}</edge>'
    junction = f'<junction id="j" type="priority" x="0" y="0" intLanes="{inner}">{requests}'
    file = tmp_path / "made.net.xml"
    file.write_text(f"<net>{edges}{out}{junction}</junction>{links}</net>", "utf-8")
    return file


def request(index, response):
    return f'<request index="{index}" response="{response}" foes="111" cont="0"/>'


def test_a_response_is_read_from_its_last_letter_on(tmp_path):
    file = written(tmp_path, request(0, "000") + request(1, "001") + request(2, "011"))
    assert going_first(read_net(file)) == {
        ":j_1_0": (":j_0_0",),
        ":j_3_0": (":j_0_0",),
        ":j_2_0": (":j_0_0", ":j_1_0", ":j_3_0"),
    }


def test_requests_may_stand_in_any_order_and_know_more_than_lanes(tmp_path):
    file = written(tmp_path, request(2, "1000") + request(1, "0000") + request(0, "0100"))
    assert going_first(read_net(file)) == {":j_0_0": (":j_2_0",)}


def test_without_requests_nobody_is_known_to_go_first(tmp_path):
    assert going_first(read_net(written(tmp_path, "", inner=""))) == {}
