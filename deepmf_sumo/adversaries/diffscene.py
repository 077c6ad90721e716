"""DiffScene: motions drawn from a diffusion model, guided towards a contact with the AV.

Source: Xu et al., DiffScene: Diffusion-based safety-critical scenario generation for autonomous
vehicles, AdvML-Frontiers workshop at ICML 2023. A diffusion model of driving is sampled with the
gradients of three kinds of objectives: safety (come near the AV), functionality (keep the AV from
its route) and constraints (the road, other vehicles, speed). No code is public.

From the source: guided sampling of a diffusion model, the objectives of safety and of constraints.
Ours: the model (`predictors.motion_priors.diffscene`) and all of its sizes, costs in metres, the
limits of motion among the constraints, the choice among the samples, and that the AV is where it
was in its earlier rollout. The objective of functionality is left out, because an episode here is
8 s long and has no route to be kept from.

``samples`` motions are drawn at once and tracked within the limits. Of those that meet the AV's
rollout, and nobody else before, the one that costs the constraints least attacks; if none does, the
one that comes nearest.

Budget: ``steps`` evaluations of the network for each sample; two simulations, one unattacked and
the attack. With more, every further round aims at the AV's rollout of the round before, until it is
hit.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from deepmf_sumo.adversaries import _open_loop as open_loop
from deepmf_sumo.adversaries._episodes import Motion, OpponentChoice, Scouted, plan_of
from deepmf_sumo.adversaries._open_loop import Aimed, AimedSettings, attack_in_rounds
from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case, Floats
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.geometry import frames

if TYPE_CHECKING:
    from deepmf_sumo.predictors.motion_priors.diffscene import DiffusionPrior

FORESIGHT = "the un-attacked motion of the AV and of others, and the AV's answer to every round"


class Settings(AimedSettings):
    """Guided sampling.

    Attributes:
        samples: motions drawn at once. steps: noise levels.
        guidance: how far the costs move a motion at each level, in standard deviations of its
            components; 0 draws ordinary motions and chooses among them.
        off_road, others, hardness: metres of distance to the AV that a metre beyond the lanes, a
            full overlap with another road user, and 1 m/s2 beyond the limits are worth.
    """

    samples: int = Field(default=32, ge=1, le=1024)
    steps: int = Field(default=20, ge=2, le=1000)
    guidance: float = Field(default=10.0, ge=0.0)
    off_road: float = Field(default=1.0, ge=0.0)
    others: float = Field(default=10.0, ge=0.0)
    hardness: float = Field(default=1.0, ge=0.0)


class DiffScene:
    """Attacks by guided diffusion; the first attack loads the model."""

    several = True

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._opponent = OpponentChoice(settings.opponent, weights)

    def check(self) -> None:
        """Raises WeightsError if the set of weights has no diffusion model, or without torch."""
        self._net()

    def load(self) -> None:
        """Load torch and the networks. Raises WeightsError if the set has no diffusion model."""
        self.check()
        # Imports torch, which a check of a spec's settings must not do.
        from deepmf_sumo.adversaries import _diffscene_guidance  # noqa: F401

        self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds. Raises WeightsError if the set has no model."""
        self.load()  # not timed
        choose, rounds = self._opponent.of(case), self._settings.rounds

        def aim(scouted: Scouted, rollouts: Sequence[Motion]) -> Aimed:
            return self._aim(scouted, rollouts[-1], rng)

        return attack_in_rounds(case, simulate, choose, aim, rounds, budget)

    def _net(self) -> "DiffusionPrior":
        from deepmf_sumo.predictors.weights import need

        need("torch", "The adversary diffscene, which follows gradients,")
        from deepmf_sumo.predictors.torch_networks import diffusion_prior  # imports torch

        return diffusion_prior(self._weights)

    def _aim(self, scouted: Scouted, av: Motion, rng: np.random.Generator) -> Aimed:
        """Draw, track, and choose."""
        from deepmf_sumo.adversaries import _diffscene_guidance as guidance

        chosen, view = self._settings, scouted.view
        start = Start.of(view, scouted.opponent_id)
        terms = guidance.Terms(
            off_road=chosen.off_road,
            others=chosen.others,
            hardness=chosen.hardness,
            accel_mps2=chosen.accel_mps2,
            brake_mps2=chosen.brake_mps2,
            lateral_mps2=chosen.lateral_mps2,
        )
        drawn = guidance.draw(
            self._net(), scouted, av, terms, chosen.samples, chosen.steps, chosen.guidance, rng
        )
        reference = frames.to_scene(drawn.position_m, start.position_m, start.heading_rad)
        reference = _as_long(reference, len(av.valid))
        tracked = track(reference, start, chosen.limits.rows(len(reference)))
        gap = open_loop.gaps(scouted, av, tracked.position_m, tracked.heading_rad).min(-1)
        row = _best(gap, drawn.cost_m)
        return Aimed(
            plan=plan_of(view, scouted.opponent_id, tracked, row),
            parameters={
                "sample": float(row),
                "hits": float((gap <= 0).sum()),
                "cost_m": float(drawn.cost_m[row]),
                "predicted_gap_m": float(gap[row]),
            },
        )


def _best(gap_m: Floats, cost_m: Floats) -> int:
    """The cheapest of those that meet the AV; else the one that comes nearest."""
    hits = gap_m <= 0
    return int(np.where(hits, cost_m, np.inf).argmin() if hits.any() else gap_m.argmin())


def _as_long(position_m: Floats, steps: int) -> Floats:
    """(S, steps, 2) positions cut, or continued straight at the last speed."""
    last = position_m[:, -1:] - position_m[:, -2:-1]
    beyond = np.arange(1, max(steps - position_m.shape[1], 0) + 1)[:, None]
    return np.concatenate([position_m, position_m[:, -1:] + beyond * last], axis=1)[:, :steps]


def build(settings: Settings, weights: str) -> DiffScene:
    """The adversary; ``weights`` hold the networks, as `predictors.weights.load` takes them."""
    return DiffScene(settings, weights)
