"""What the observer of an episode does with sumo-gui."""

from types import SimpleNamespace

import pytest

from deepmf_sumo.sumo.simulation import episode
from deepmf_sumo.sumo.simulation.frame import Frame

EMPTY = Frame.of_poses({})


def test_av_and_opponents_are_coloured_and_the_av_is_followed(monkeypatch):
    slept, colours, calls = [], {}, []
    clock = SimpleNamespace(monotonic=lambda: sum(slept), sleep=slept.append)
    monkeypatch.setattr(episode, "time", clock)
    there = ["av", "a", "b"]
    vehicle = SimpleNamespace(
        getIDList=lambda: there,
        setColor=lambda agent, colour: colours.update({agent: colour}),
        getPosition=lambda agent: (100.0, 50.0),
    )
    shown = SimpleNamespace(
        getIDList=lambda: ["View #0"],
        setBoundary=lambda view, *box: calls.append(box),
        trackVehicle=lambda view, agent: calls.append(agent),
        getSchema=lambda view: "standard",
        setSchema=lambda view, name: calls.append(name),
    )
    window = episode.GuiWindow(SimpleNamespace(vehicle=vehicle, gui=shown), "av")
    window.on_step(EMPTY, ("a",))
    first = dict(colours)
    assert set(first) == {"av", "a"}
    assert calls == [(60.0, 10.0, 140.0, 90.0), "av", "real world"]
    window.on_step(EMPTY, ("b",))
    assert colours["b"] == first["a"] != colours["a"]
    assert len(calls) == 3
    there.remove("b")
    window.on_step(EMPTY, ())
    window.on_end()
    assert slept == pytest.approx([0.1, 0.1, 0.1, 2.0])
