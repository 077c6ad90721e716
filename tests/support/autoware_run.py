"""``python -m tests.support.autoware_run BACKEND CONTROL OUT``: traffic of autoware-carla-scenario.

Its own code from the options to the last tick, in a world that stands for CARLA
(`tests.support.carla_double`). A program of its own, since CARLA's client and torch do not share a
process. Prints what happened as JSON.
"""

import json
import sys
from importlib import import_module
from pathlib import Path

import sumolib

from tests.support.carla_double import World

NET = Path(__file__).parents[2] / "sumo_nets" / "arterial" / "arterial.net.xml"
EDGES = ("east_1", "east_bay", "east_2", "east_3", "east_4")
TICK_S, TICKS, EGO_MPS = 0.05, 200, 12.5
WARM_UP_S = 3.0
CARS = {"cutter": (1, 95), "ahead": (0, 140)}
"""Lane, and position in m; the ego is on lane 0 at 90 m."""
DEMAND = "".join(
    f'<vehicle id="{name}" route="east" depart="{WARM_UP_S}" departLane="{lane}"'
    f' departPos="{at}" departSpeed="12.6"/>'
    for name, (lane, at) in CARS.items()
)


def options(backend, control, out):
    """As ``traffic.options`` has them."""
    out.mkdir(parents=True)
    (out / "demand.rou.xml").write_text(
        f'<routes><route id="east" edges="{" ".join(EDGES)}"/>{DEMAND}</routes>'
    )
    found = {
        "net_path": str(NET), "route_path": str(out / "demand.rou.xml"), "warmup_s": WARM_UP_S,
        "sumo_args": ["--no-warnings"], "feedback_distance_m": 0.0,
        "traffic_light_authority": "none", "vehicle_control": control,
    }  # fmt: skip
    return found | ({"attacks": {"trigger": ["time=4"]}} if backend == "deepmf" else {})


def eastwards():
    """The middle of the right lane of the arterial, from 90 m on."""
    net = sumolib.net.readNet(str(NET))
    line = [at[:2] for edge in EDGES for at in net.getEdge(edge).getLane(0).getShape()]
    return [(line[0][0] + 90.0, line[0][1]), *(at for at in line if at[0] > line[0][0] + 90.0)]


def run(backend, control, out):
    """What happened, tick by tick."""
    carla = import_module("typesafe_carla.carla")
    package = import_module("autoware_carla_scenario.traffic")
    package.load_traffic_backend_plugins()
    traffic = package.build_backend(backend, options(backend, control, out))
    world = World(carla, TICK_S)
    ego = world.drive("Ego", eastwards(), EGO_MPS)
    where = {"world": world, "fixed_delta_seconds": TICK_S, "random_seed": 1, "output_dir": out}
    traffic.prepare(package.TrafficContext(**where))
    ticks = []
    try:
        traffic.start(world, skip_actor_ids=[ego.id])
        for tick in range(TICKS):
            world.tick()
            traffic.tick(world, tick * TICK_S)
            ticks.append(
                {
                    "time_s": round(traffic._traci.simulation.getTime(), 2),
                    "offered": [name[5:] for name in sorted(traffic.background_actors(world))],
                    "apart_m": {
                        car.attributes["role_name"][5:]: ego.box().distance(car.box())
                        for car in world.get_actors()[1:]
                    },
                }
            )
        return {"said": traffic.describe(), "failures": traffic._failures, "ticks": ticks}
    finally:
        traffic.close()


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], sys.argv[2], Path(sys.argv[3]))))
