"""An episode that waits for another thread's commands."""

import threading
import warnings
from contextlib import closing
from types import SimpleNamespace

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.planners._checked import Guard
from deepmf_sumo.planners._stepped import Ended, SteppedEpisode
from deepmf_sumo.scene import Command

GO = Command(kind="sumo")


def views(steps):
    return [SimpleNamespace(step=step) for step in range(steps)]


def test_views_and_commands_take_turns_until_the_end():
    heard = []

    def episode(planner):
        planner.reset(None, None)
        heard.extend(planner.act(view) for view in views(3))
        return "over"

    stepped = SteppedEpisode(episode, None)
    came = [stepped.next()]
    while not isinstance(came[-1], Ended):
        came.append(stepped.next(GO))
    assert [view.step for view in came[:-1]] == [0, 1, 2]
    assert came[-1].result == "over"
    assert heard == [GO, GO, GO]


def test_what_the_callers_code_sets_in_libraries_stays():
    """It runs in the caller's thread while the episode waits for a command."""
    before = warnings.filters[:]

    def episode(planner):
        with closing(Guard(planner)) as guarded:
            guarded.reset(None, None)
            guarded.act(SimpleNamespace(step=0))

    with warnings.catch_warnings():
        stepped = SteppedEpisode(episode, None)
        stepped.next()
        warnings.filterwarnings("error", "of the caller")
        assert isinstance(stepped.next(GO), Ended)
        assert [one for one in warnings.filters if one not in before]


def test_leaving_unwinds_the_simulation():
    closed = threading.Event()

    def episode(planner):
        planner.reset(None, None)
        try:
            planner.act(views(1)[0])
        finally:
            closed.set()

    stepped = SteppedEpisode(episode, None)
    stepped.next()
    stepped.leave()
    assert closed.is_set()


def test_a_search_over_episodes_is_refused():
    def episode(planner):
        for _ in range(2):
            planner.reset(None, None)
            planner.act(views(1)[0])

    stepped = SteppedEpisode(episode, None)
    stepped.next()
    with pytest.raises(UsageError, match="simulates an attack more than once"):
        stepped.next(GO)
