"""Views by hand with pedestrians and cyclists, and the predictors of tests that know people."""

from dataclasses import dataclass, field, replace

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import policy as policy_module
from deepmf_sumo.deepmf.networks.people import People

from tests.support.predictor_doubles import Doubles, NearestScores, view_of

SIZES = {
    "vehicle": (4.8, 2.0, 1.5),
    "pedestrian": (0.6, 0.6, 1.75),
    "cyclist": (1.8, 0.7, 1.75),
    "other": (4.8, 2.0, 1.5),
}


class VehicleScores(NearestScores):
    """As the opponent network, which scores vehicles alone."""

    def score(self, view):
        rows = [row for row, kind in enumerate(view.history.kinds) if kind == "vehicle"]
        return super().score(replace(view, history=view.history.select(rows)))


@dataclass
class PeopleDoubles(Doubles):
    """The predictors of people are real ones: they have no weights."""

    opponent: VehicleScores = field(default_factory=VehicleScores)
    people: People = field(default_factory=People)


def people_view(agents, **values):
    """A view of agents id -> (kind, x, y, heading, speed), the first of which is the AV."""
    view = view_of({name: row[1:] for name, row in agents.items()}, **values)
    kinds = tuple(row[0] for row in agents.values())
    size_m = np.array([SIZES[kind] for kind in kinds])
    return replace(view, history=replace(view.history, kinds=kinds, size_m=size_m))


def people_policy(**values):
    settings = plugins.settings("adversaries", "deepmf", values)
    return policy_module.build(settings, PeopleDoubles())
