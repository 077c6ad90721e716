"""DiffScene: motions drawn from a diffusion model, guided towards a contact with the AV.

Source: Xu et al., DiffScene: Diffusion-based safety-critical scenario generation for autonomous
vehicles, AdvML-Frontiers workshop at ICML 2023. A diffusion model of driving is sampled with the
gradients of three kinds of objectives: safety (come near the AV), functionality (keep the AV from
its route) and constraints (the road, other vehicles, speed). No code is public.

From the source: guided sampling of a diffusion model, the objectives of safety and of constraints.
Ours: the model (`baselines.priors.diffscene`) and all of its sizes, costs in metres, the
limits of motion among the constraints, the choice among the samples, and that the AV is where it
was in its earlier rollout. The objective of functionality is left out, because an episode here is
8 s long and has no route to be kept from.

``samples`` motions are drawn together and tracked within the limits. Of those that meet the AV's
rollout, and no other road user before, the one with the least cost of road and others up to the
contact attacks; else the cheapest of all that meet the AV; else the one that comes nearest.

Budget: ``steps`` evaluations of the network for each sample, at most ``seconds`` if that is set;
and two simulations, one unattacked and
the attack. With more, every further round aims at the AV's rollout of the round before, until it is
hit.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    OpponentChoice,
    Scouted,
    deadline,
    limited,
    motion_of,
    plan_of,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines._open_loop import Aimed, AimedSettings, attack_in_rounds
from deepmf_sumo.deepmf.situation import Levels, footprint
from deepmf_sumo.deepmf.tracking import Start, Tracked, track
from deepmf_sumo.scene import FUTURE_STEPS, Attack, Bools, Budget, Case, Floats, Ints
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.ground import clear

if TYPE_CHECKING:
    from deepmf_sumo.baselines._diffscene_guidance import Guide
    from deepmf_sumo.baselines.priors.diffscene import DiffusionPrior

FORESIGHT = "the un-attacked motion of the AV and of others"


class Settings(AimedSettings):
    """Guided sampling.

    Attributes:
        samples: motions drawn together. steps: noise levels.
        guidance: the most that the costs move a motion at a level, in standard deviations of its
            components, times the share of noise that is left there; 0 draws ordinary motions and
            chooses among them.
        off_road, others, hardness: metres of distance to the AV that a metre beyond the lanes, a
            full overlap with another road user, and 1 m/s2 beyond the limits are worth.
        seconds: time limit if the budget has none; null: no limit. With a limit the result depends
            on the machine.
    """

    samples: int = Field(default=32, ge=1, le=1024)
    steps: int = Field(default=20, ge=2, le=1000)
    guidance: float = Field(default=10.0, ge=0.0)
    off_road: float = Field(default=1.0, ge=0.0)
    others: float = Field(default=10.0, ge=0.0)
    hardness: float = Field(default=1.0, ge=0.0)
    seconds: float | None = Field(default=None, gt=0.0)


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
        from deepmf_sumo.baselines import _diffscene_guidance  # noqa: F401

        self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds. Raises WeightsError if the set has no model."""
        self.load()  # not timed
        choose, rounds = self._opponent.of(case), self._settings.rounds
        budget = limited(budget, 1 + rounds, self._settings.seconds)
        until = deadline(budget)

        def aim(scouted: Scouted, rollouts: Sequence[AgentMotion]) -> Aimed:
            return self._aim(scouted, rollouts[-1], rng, until)

        return attack_in_rounds(case, simulate, choose, aim, rounds, budget)

    def _net(self) -> "DiffusionPrior":
        from deepmf_sumo.deepmf.networks.weights import need

        need("torch", "The adversary diffscene, which follows gradients,")
        from deepmf_sumo.baselines.priors.reading import diffusion_prior  # imports torch

        return diffusion_prior(self._weights)

    def _aim(
        self, scouted: Scouted, av: AgentMotion, rng: np.random.Generator, until: float
    ) -> Aimed:
        """Draw, track, and choose."""
        chosen, view = self._settings, scouted.view
        start, guide = Start.of(view, scouted.opponent_id), self._guide(scouted, av)
        drawn = guide.draw(chosen.samples, chosen.steps, chosen.guidance, rng, until)
        reference = frames.to_scene(drawn, start.position_m, start.heading_rad)
        reference = _as_long(reference, len(av.valid))
        tracked = track(reference, start, chosen.limits.rows(len(reference)))
        gap = open_loop.gaps(scouted, av, tracked.position_m, tracked.heading_rad)
        meeting = _first(gap <= 0)
        clear = meeting < _first_other(scouted, tracked)
        own = frames.to_local(tracked.position_m, start.position_m, start.heading_rad)
        cost = guide.costs_until(_as_long(own, FUTURE_STEPS), meeting)
        row = _best(gap.min(-1), clear, cost)
        return Aimed(
            plan=plan_of(view, scouted.opponent_id, tracked, row),
            parameters={
                "sample": float(row),
                "hits": float((gap.min(-1) <= 0).sum()),
                "cost_m": float(cost[row]),
                "predicted_gap_m": float(gap[row].min()),
            },
        )

    def _guide(self, scouted: Scouted, av: AgentMotion) -> "Guide":
        from deepmf_sumo.baselines import _diffscene_guidance as guidance

        chosen = self._settings
        terms = guidance.GuidanceTerms(
            off_road=chosen.off_road,
            others=chosen.others,
            hardness=chosen.hardness,
            accel_mps2=chosen.accel_mps2,
            brake_mps2=chosen.brake_mps2,
            lateral_mps2=chosen.lateral_mps2,
        )
        return guidance.Guide(self._net(), scouted, av, terms)


def _best(gap_m: Floats, clear: Bools, cost_m: Floats) -> int:
    """The cheapest hit, one without an earlier contact if there is one; else the nearest."""
    hits = gap_m <= 0
    if not hits.any():
        return int(gap_m.argmin())
    first = hits & clear
    return int(np.where(first if first.any() else hits, cost_m, np.inf).argmin())


def _first(touching: Bools) -> Ints:
    """(S) number of the first step, from 1 on, of rows (S, K); K + 1 where there is none."""
    steps = np.where(touching.any(-1), touching.argmax(-1), touching.shape[-1])
    return steps.astype(np.int64) + 1


def _first_other(scouted: Scouted, tracked: Tracked) -> Ints:
    """(S) first steps at which motions touch other road users, where these drove unattacked."""
    view, rollout = scouted.view, scouted.rollout
    size = footprint(view, scouted.opponent_id)
    steps = tracked.position_m.shape[1]
    touching = np.zeros(tracked.heading_rad.shape, bool)
    levels = Levels.of(view, scouted.opponent_id)
    own_z_m = None if levels is None else levels.opponent_z_m(tracked.position_m)
    for row, name in enumerate(rollout.tracks.ids):
        if name in {scouted.opponent_id, rollout.av_id}:
            continue
        other = motion_of(rollout, name, steps)
        hit = boxes.overlap(
            tracked.position_m, tracked.heading_rad, size, other.position_m, other.heading_rad,
            rollout.tracks.size_m[row, :2],
        ) & other.valid  # fmt: skip
        if own_z_m is not None:
            z_m = rollout.tracks.z_m[row, rollout.now + 1 :][:steps]
            hit[:, : len(z_m)] &= ~clear(own_z_m[:, : len(z_m)], z_m)
        # Recorded boxes sometimes overlap already; the attack does not cause that.
        touching |= hit & ~hit[:, :1]
    return _first(touching)


def _as_long(position_m: Floats, steps: int) -> Floats:
    """(S, steps, 2) positions cut, or continued straight at the last speed."""
    last = position_m[:, -1:] - position_m[:, -2:-1]
    beyond = np.arange(1, max(steps - position_m.shape[1], 0) + 1)[:, None]
    return np.concatenate([position_m, position_m[:, -1:] + beyond * last], axis=1)[:, :steps]


def build(settings: Settings, weights: str) -> DiffScene:
    """The adversary; ``weights`` hold the networks, see `networks.weights.load`."""
    return DiffScene(settings, weights)
