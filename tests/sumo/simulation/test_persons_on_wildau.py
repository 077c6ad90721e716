"""Persons on a network from elsewhere are walked anywhere and let go."""

from pathlib import Path

import libsumo
import numpy as np
import pytest

from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover

from tests.bench.people import OPTIONS, _Crowd

NET = Path(__file__).parents[4] / "shared" / "networks" / "wildau" / "net.net.xml.gz"


@pytest.mark.slow
@pytest.mark.sumo
@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.skipif(not NET.exists(), reason="needs ../shared/networks/wildau")
def test_persons_on_a_foreign_network_are_let_go_where_sumo_walks_them_on(tmp_path, seed):
    rng = np.random.default_rng(seed)
    libsumo.start(["sumo", "-n", str(NET), *OPTIONS])
    lanes = [
        one for one in libsumo.lane.getIDList() if "pedestrian" in libsumo.lane.getAllowed(one)
    ]
    edges = sorted({one.rpartition("_")[0] for one in lanes if not one.startswith(":")})
    persons = []
    while len(persons) < 40:
        start, end = rng.choice(edges, 2)
        route = libsumo.simulation.findIntermodalRoute(start, end)
        if start != end and route and 50 < route[0].length < 500:
            walk = f'<walk from="{start}" to="{end}"/>'
            persons.append(f'<person id="p{len(persons)}" depart="0">{walk}</person>')
    libsumo.close()
    demand = tmp_path / "walks.rou.xml"
    demand.write_text(f"<routes>{''.join(persons)}</routes>")
    libsumo.start(["sumo", "-n", str(NET), "-r", str(demand), *OPTIONS])
    try:
        libsumo.simulationStep(3.0)
        events = []
        takeover = Takeover(libsumo, events, leaves=True, footways=lambda: footways_of(NET))
        crowd = _Crowd(takeover, rng, 20)
        for step in range(900):
            crowd.step(step)
    finally:
        libsumo.close()
    kinds = [event.kind for event in events]
    assert kinds.count("handed_back") >= 18
    assert crowd.moved_m < 0.75
