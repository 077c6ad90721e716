"""The predictor of people, and what the conditional network makes of a person's future.

Targets are all pedestrians and cyclists in view at the current step of a recording, whether they
move or not. The groups ``moving`` leave out those that are slower than 0.5 m/s now.
"""

import zlib
from collections import Counter
from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, KNOTS_S
from deepmf_sumo.deepmf.networks.people import People, PeoplePrediction
from deepmf_sumo.deepmf.networks.predict import Conditional
from deepmf_sumo.scene import ROLLOUT, Floats, Scene, View
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.training.evaluation.conditional import ConditionalFigures, PredictedPair
from deepmf_sumo.training.evaluation.forecasts import FEW, ForecastTarget
from deepmf_sumo.training.evaluation.marginal import Marginals, constant_velocity
from deepmf_sumo.training.evaluation.measures import (
    STEPS,
    Measured,
    final_errors,
    path_errors,
)
from deepmf_sumo.training.evaluation.table import (
    NETWORK,
    Figure,
    Figures,
    Key,
    ObjectValues,
)
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

CONSTANT_VELOCITY: Final = "constant_velocity"
INSIDE: Final = (0.5, 0.9)
"""Shares of the mass: as many outcomes should be inside the densest region that has it."""
_DRAWN: Final = 1000
NEAR_M: Final = 15.0
"""A person whose way comes this close to the AV's, with 2 m a second between, may be given."""


class PeopleFigures:
    """Measures the predictor of people, by class, and the AV's reaction to them."""

    def __init__(self) -> None:
        self.samples = ObjectValues("people")
        self.counts: Counter[str] = Counter()
        self.reactions = ConditionalFigures((FEW,))

    def add(self, people: People, scene: Scene, view: View) -> None:
        """Add the people of one scene; simulated attacks give none, their people are the log's."""
        if scene.source.dataset == ROLLOUT:
            return
        for future in windows.people(scene, scene.now):
            self._add(people.predict(view, future.agent_id), _target(scene, view, future))

    def _add(self, prediction: PeoplePrediction, target: ForecastTarget) -> None:
        future, kind = target.future, target.view.history.kinds[target.row]
        moving = target.speed_mps > WAITING_MPS
        groups = (kind, f"moving {kind}") if moving else (kind,)
        self.counts.update(groups)
        ways = {
            NETWORK: prediction.modes(FEW).futures.position_m,
            CONSTANT_VELOCITY: constant_velocity(target),
        }
        for condition, modes_m in ways.items():
            errors = final_errors(modes_m, future, "min_fde")
            errors |= path_errors(modes_m, future, target.speed_mps)
            self.samples.add(errors, len(modes_m), condition, groups)
        for seconds, step in STEPS.items():
            modes_m = prediction.modes(FEW, chosen_at=step).futures.position_m
            errors = final_errors(modes_m, future, "min_fde_of_horizon", (seconds,))
            self.samples.add(errors, FEW, groups=groups)
        self.samples.add(densities(prediction, future), groups=groups)

    def add_reaction(
        self, conditional: Conditional, scene: Scene, view: View, alone: Marginals | None
    ) -> None:
        """The AV's future given that of the person who comes closest to it.

        ``alone``: the marginal network's prediction of the AV; None where the AV is no target.
        """
        if alone is None or scene.source.dataset == ROLLOUT:
            return
        person = windows.nearest_person(scene, scene.av_id, scene.now, NEAR_M)
        if person is None:
            return
        av = _target(scene, view, windows.future_of(scene, scene.av_id, scene.now))
        kind = view.history.kinds[view.history.row(person.agent_id)]
        pair = PredictedPair(
            target=replace(av, role="av"), partner=person, marginals=alone, group=f"given {kind}"
        )
        self.reactions.add(conditional, [pair])
        straight = final_errors(constant_velocity(av), av.future, "min_fde")
        self.reactions.samples.add(straight, 1, CONSTANT_VELOCITY, (f"given {kind}",))
        self.counts[f"given {kind}"] += 1

    def figures(self, conditional: Conditional) -> Figures:
        """All figures."""
        self.reactions.finish(conditional)
        counts: Figures = {
            Key("people", "targets", group=group): Figure(count)
            for group, count in self.counts.items()
        }
        reactions = {
            key: figure
            for key, figure in self.reactions.figures().items()
            if key.group.startswith("given ")
        }
        return counts | self.samples.figures() | reactions


def _target(scene: Scene, view: View, future: Future) -> ForecastTarget:
    row = view.history.row(future.agent_id)
    return ForecastTarget(
        scene=scene,
        view=view,
        future=future,
        partner=None,
        row=row,
        speed_mps=float(view.history.speed_mps[row, -1]),
        role="partner",
    )


def densities(prediction: PeoplePrediction, future: Future) -> dict[Measured, float]:
    """At each known knot: negative log density, and whether the outcome is inside the mass.

    It is inside a share of the mass if its density is larger than that of the rest of 1000 places
    drawn from the prediction, with a fixed seed.
    """
    knots_m: Floats = future.position_m[list(KNOT_STEPS)]
    log = prediction.knot_log_density(knots_m[None])[0]
    rng = np.random.default_rng(zlib.crc32(future.agent_id.encode()))
    drawn = prediction.knot_log_density(prediction.drawn(_DRAWN, rng))
    found: dict[Measured, float] = {}
    for knot, seconds in enumerate(KNOTS_S):
        if future.valid[KNOT_STEPS[knot]]:
            found["negative_log_density", seconds] = -float(log[knot])
            for share in INSIDE:
                least = np.quantile(drawn[:, knot], 1 - share)
                found[f"inside_{100 * share:g}", seconds] = float(log[knot] >= least)
    return found
