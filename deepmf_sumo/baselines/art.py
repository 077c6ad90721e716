"""ART: a bounded perturbation, found by gradient descent, brings the opponent into the AV's path.

Source: Zhang et al., On Adversarial Robustness of Trajectory Prediction for Autonomous Vehicles,
CVPR 2022, which perturbs the *history* of a vehicle by at most 1 m a point so that a predictor
errs, within bounds on speed, acceleration and jerk. Adapted to an attack on the AV in two forms:

- ``future`` (default): the opponent's unattacked future is perturbed until its box meets the AV's
  unattacked one. This form is much stronger: within the bounds, a perturbed history shifts little
  probability between the futures that the predictor proposes anyway. Its bound of 32 m is what
  1 m/s2 reaches in 8 s; DeepMF's authors report Hausdorff distances of 30 to 39 m for ART.
- ``history``: the last second is perturbed, with gradients through our marginal predictor; the
  likeliest future that it then predicts is driven.

Points are at 2 Hz as in the paper, and smooth in between: free points at 10 Hz would be jitter.
In both forms the trajectory is tracked within DeepMF's limits before it is evaluated and driven.

Budget: gradient steps, not simulations: ``restarts`` x ``iterations`` (10 x 100 as in the paper),
at most ``seconds`` if that is set; and two simulations, one unattacked and the attack. With more,
every further round aims at the AV's rollout of the round before, until it is hit.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    OpponentChoice,
    Scouted,
    deadline,
    limited,
    plan_of,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines._open_loop import Aimed, AimedSettings, attack_in_rounds
from deepmf_sumo.deepmf.networks.predict import MOST_MODES
from deepmf_sumo.deepmf.situation import footprint
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import Attack, Budget, Case, Floats

if TYPE_CHECKING:
    from deepmf_sumo.baselines._art_descent import ArtDescent, Effort, PerturbationBounds

FORESIGHT = "the un-attacked motion of the AV, where it aims, and of the opponent, where it begins"


class Settings(AimedSettings):
    """The perturbation and its bounds.

    Attributes:
        form: what is perturbed: the opponent's ``future``, or the ``history`` that the predictor
            sees.
        reach_m: largest move of a point of the future.
        history_reach_m: largest move of a point of the history.
        restarts, iterations: descents, and gradient steps of each at most.
        seconds: time limit if the budget has none; null: no limit. With a limit the result depends
            on the machine.
        modes: futures that are predicted under a perturbed history; the likeliest is driven.
        speed_mps, jerk_mps3: bounds of the perturbed trajectory; that of its acceleration is the
            larger of ``accel_mps2`` and ``brake_mps2``.
    """

    form: Literal["history", "future"] = "future"
    reach_m: float = Field(default=32.0, gt=0.0)
    history_reach_m: float = Field(default=1.0, gt=0.0)
    restarts: int = Field(default=10, ge=1)
    iterations: int = Field(default=100, ge=1)
    seconds: float | None = Field(default=None, gt=0.0)
    modes: int = Field(default=6, ge=1, le=MOST_MODES)
    speed_mps: float = Field(default=30.0, gt=0.0)
    jerk_mps3: float = Field(default=20.0, gt=0.0)


class ART:
    """Attacks by bounded perturbation."""

    several = True

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._opponent = OpponentChoice(settings.opponent, weights)

    def load(self) -> None:
        """Load torch and the networks."""
        from deepmf_sumo.deepmf.networks.weights import need

        need("torch", "The adversary art, which follows gradients,")
        from deepmf_sumo.baselines import _art_descent  # noqa: F401

        if self._settings.form == "history":
            from deepmf_sumo.baselines import _art_history  # noqa: F401
            from deepmf_sumo.deepmf.networks.weights import cached_predictors

            cached_predictors(self._weights, "torch")
        self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds."""
        chosen = self._settings
        self.load()  # before the time counts
        choose = self._opponent.of(case)
        budget = limited(budget, 1 + chosen.rounds, chosen.seconds)
        until = deadline(budget)
        perturb = self._history if chosen.form == "history" else self._future

        def aim(scouted: Scouted, rollouts: Sequence[AgentMotion]) -> Aimed:
            return self._aim(scouted, rollouts[-1], *perturb(scouted, rollouts[-1], until, rng))

        return attack_in_rounds(case, simulate, choose, aim, chosen.rounds, budget)

    def _future(
        self, scouted: Scouted, av: AgentMotion, deadline: float, rng: np.random.Generator
    ) -> tuple[Floats, "ArtDescent"]:
        """(R, K, 2) the opponent's reference, made drivable and bent into the AV's path."""
        from deepmf_sumo.baselines import _art_descent

        view, chosen = scouted.view, self._settings
        start = Start.of(view, scouted.opponent_id)
        reference = open_loop.continued(scouted.reference, start)
        calm = track(reference[None], start, chosen.limits.rows(1)).position_m[0]
        target = _art_descent.ArtTarget(
            position_m=open_loop.continued(av, Start.of(view, view.av_id)),
            heading_rad=av.heading_rad,
            there=av.valid,
            av_size_m=footprint(view, view.av_id),
            own_size_m=footprint(view, scouted.opponent_id),
        )
        bounds = self._bounds(chosen.reach_m)
        found = _art_descent.bend(calm, start, target, bounds, self._effort(deadline), rng)
        return calm + found.offset_m, found

    def _history(
        self, scouted: Scouted, av: AgentMotion, deadline: float, rng: np.random.Generator
    ) -> tuple[Floats, "ArtDescent"]:
        """(R, 80, 2) the likeliest futures of the opponent under perturbed histories."""
        from deepmf_sumo.baselines import _art_history
        from deepmf_sumo.deepmf.networks.densetnt import DenseTNT
        from deepmf_sumo.deepmf.networks.weights import DEVICE, cached_predictors

        view, chosen, agent_id = scouted.view, self._settings, scouted.opponent_id
        marginal = cached_predictors(self._weights, "torch").marginal  # for gradients
        net = marginal.net
        assert isinstance(net, DenseTNT)
        if net.widths.device.type != "cpu":
            raise WeightsError(
                f"art with form 'history' computes on the CPU; unset {DEVICE}, or choose another"
                " form."
            )
        past = _art_history.PerturbedPast(view, agent_id, net)
        av_m = open_loop.continued(av, Start.of(view, view.av_id))
        meeting = _art_history.GoalMeeting(view, agent_id, av_m, av.valid)
        bounds = self._bounds(chosen.history_reach_m)
        found = _art_history.perturb(net, past, meeting, bounds, self._effort(deadline), rng)
        forecasts = [
            marginal.predict(past.view(offset), agent_id).modes(chosen.modes)
            for offset in found.offset_m
        ]
        return np.stack([forecast.futures.position_m[0] for forecast in forecasts]), found

    def _effort(self, deadline: float) -> "Effort":
        from deepmf_sumo.baselines._art_descent import Effort

        return Effort(self._settings.restarts, self._settings.iterations, deadline)

    def _bounds(self, reach_m: float) -> "PerturbationBounds":
        from deepmf_sumo.baselines._art_descent import PerturbationBounds

        chosen = self._settings
        return PerturbationBounds(
            reach_m=reach_m,
            speed_mps=chosen.speed_mps,
            accel_mps2=max(chosen.accel_mps2, chosen.brake_mps2),
            jerk_mps3=chosen.jerk_mps3,
        )

    def _aim(
        self, scouted: Scouted, av: AgentMotion, reference_m: Floats, found: "ArtDescent"
    ) -> Aimed:
        """The smallest perturbation that meets the AV when tracked, else the nearest miss."""
        view = scouted.view
        start = Start.of(view, scouted.opponent_id)
        tracked = track(reference_m, start, self._settings.limits.rows(len(reference_m)))
        gap = open_loop.gaps(scouted, av, tracked.position_m, tracked.heading_rad).min(axis=1)
        moved = np.hypot(found.offset_m[..., 0], found.offset_m[..., 1]).mean(axis=1)
        row = int(np.lexsort((moved, gap))[0])
        return Aimed(
            plan=plan_of(view, scouted.opponent_id, tracked, row),
            parameters={
                "restart": float(row),
                "iterations": float(found.iterations),
                "mean_move_m": float(moved[row]),
                "predicted_gap_m": float(gap[row]),
            },
        )


def build(settings: Settings, weights: str) -> ART:
    """The adversary; ``weights`` hold the networks, see `networks.weights.load`."""
    return ART(settings, weights)
