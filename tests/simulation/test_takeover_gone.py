"""A driven vehicle that SUMO takes off the road, and brings back."""

from types import SimpleNamespace

from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.vehicle_control import Takeover


def sumo(there, options=None, classes=None):
    vehicle = SimpleNamespace(
        getIDList=lambda: tuple(there),
        getRoute=lambda agent: ("ab",),
        getStops=lambda agent, limit=0: (),
        moveToXY=lambda *_: None,
        setSpeed=lambda *_: None,
        setSpeedMode=lambda *_: None,
        setPreviousSpeed=lambda *_: None,
        getLateralSpeed=lambda _: 0.0,
        getVehicleClass=lambda agent: classes[agent],
        setVehicleClass=lambda agent, name: classes.update({agent: name}),
    )
    simulation = SimpleNamespace(getOption=lambda name: (options or {}).get(name, "0"))
    return SimpleNamespace(vehicle=vehicle, simulation=simulation)


def placed(there, events, positions=None):
    takeover = Takeover(sumo(there), events, positions)
    takeover.place(1, "ov", Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    takeover.after_step(1)
    return takeover


def test_one_that_comes_back_is_not_where_it_was_put():
    there = ["ov"]
    takeover = placed(there, [])
    assert takeover.placed() is not None
    there.clear()
    takeover.after_step(2)
    there.append("ov")
    takeover.after_step(3)
    assert takeover.placed() is None


def test_one_on_no_road_is_not_moved():
    events = []
    takeover = placed(["ov"], events, positions=object())
    takeover.hand_back(2, "ov", None)
    assert takeover.placed() is None
    (event,) = events
    assert (event.kind, event.detail) == ("opponent_gone", "SUMO has taken it off the road")


def test_one_that_comes_back_has_its_own_class():
    there, classes = ["ov"], {"ov": "taxi"}
    takeover = Takeover(sumo(there, {"lanechange.duration": "3"}, classes), [])
    takeover.place(1, "ov", Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    takeover.after_step(1)
    assert classes == {"ov": "ignoring"}
    there.clear()
    takeover.after_step(2)
    there.append("ov")
    takeover.after_step(3)
    assert classes == {"ov": "taxi"}
