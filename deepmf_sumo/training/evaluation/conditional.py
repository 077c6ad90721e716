"""The conditional network: its gain from another vehicle's future, the true or a shuffled one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.predict import Conditional, ConditionalPrediction
from deepmf_sumo.scene import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.training.evaluation.forecasts import FEW, ForecastTarget, add_shapes
from deepmf_sumo.training.evaluation.marginal import Marginals
from deepmf_sumo.training.evaluation.measures import (
    HORIZONS,
    STEPS,
    final_errors,
    log_likelihoods,
    nearest_modes,
    path_errors,
)
from deepmf_sumo.training.evaluation.table import ALL, Figure, Figures, Key, ObjectValues
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

MARGINAL: Final = "marginal"
NOTHING, TRUE, SHUFFLED = "given_nothing", "given_true", "given_shuffled"
"""Conditions: the marginal network; the conditional one given nothing, the other's true future, or
the future of another scene's vehicle, moved to the other's pose."""
ATTACKED: Final = "attacked"
"""Group of AVs that were attacked in simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedPair:
    """A target, the partner whose future is given, and the predictions of the marginal network.

    ``group``: that the pair is of besides the target's role.
    """

    target: ForecastTarget
    partner: Future
    marginals: Marginals
    group: str | None = None


class ConditionalFigures:
    """Measures the conditional network.

    The shuffled future is that of a partner in the same role in the scene before; the first scene
    gets that of the last one, in `finish`.

    Args:
        modes: numbers of modes, `FEW` among them.
    """

    def __init__(self, modes: Sequence[int]) -> None:
        self.modes = modes
        self.samples = ObjectValues("conditional")
        self.pairs = 0
        self._before: list[tuple[str, Floats]] = []
        self._first: list[PredictedPair] = []

    def add(self, conditional: Conditional, pairs: Sequence[PredictedPair]) -> None:
        """Add the pairs of one scene."""
        if not pairs:
            return
        if self._before:
            self._measure_all(conditional, pairs)
        else:
            self._first = list(pairs)
        self._before = [
            (pair.target.role, motion(pair.target.view, pair.partner)) for pair in pairs
        ]

    def finish(self, conditional: Conditional) -> None:
        """Measure the first scene; if it is the only one, nothing is shuffled."""
        if self._first and self.pairs == 0:
            self._before = []
        self._measure_all(conditional, self._first)

    def figures(self) -> Figures:
        """All figures, with the gains of each condition.

        A gain is that of likelihood, or the decrease of an error, over the marginal network or
        (``_over_nothing``) over the conditional network given nothing.
        """
        found = {Key("conditional", "targets"): Figure(self.pairs), **self.samples.figures()}
        for quantity, sign in (("log_likelihood", 1), ("min_fde", -1), ("most_probable_fde", -1)):
            found |= self.samples.gains(quantity, sign, f"{quantity}_gain", MARGINAL)
            found |= self.samples.gains(quantity, sign, f"{quantity}_gain_over_nothing", NOTHING)
        return found

    def _measure_all(self, conditional: Conditional, pairs: Sequence[PredictedPair]) -> None:
        for number, pair in enumerate(pairs):
            same = [moved for role, moved in self._before if role == pair.target.role]
            same = same or [moved for _, moved in self._before]
            view, agent_id = pair.target.view, pair.partner.agent_id
            shuffled = moved_to(view, agent_id, same[number % len(same)]) if same else None
            self._measure(conditional, pair, shuffled)

    def _measure(
        self, conditional: Conditional, pair: PredictedPair, shuffled: Futures | None
    ) -> None:
        target = pair.target
        conditions: dict[str, Futures | None] = {NOTHING: None, TRUE: given(pair.partner)}
        if shuffled is not None:
            conditions[SHUFFLED] = shuffled
        prediction = conditional.predict(target.view, target.agent_id, planner=target.planner)
        found = self._forecasts(prediction, conditions)
        more = [ATTACKED] if target.planner else []
        groups = (ALL, target.role, *more, *([pair.group] if pair.group else []))
        for condition, forecasts in ({MARGINAL: pair.marginals.forecasts} | found).items():
            self._add_errors(target, forecasts, condition, groups)
        self.samples.add(pair.marginals.log_likelihood, None, MARGINAL, groups)
        for condition, futures in conditions.items():
            density = partial(prediction.end_density, futures)
            most = found[condition][max(self.modes)]
            logs = log_likelihoods(most, target.future, density)
            self.samples.add(logs, None, condition, groups)
        self._add_given_true(prediction, target, conditions[TRUE], found[TRUE])
        self.pairs += 1

    def _add_errors(
        self,
        target: ForecastTarget,
        forecasts: Mapping[int, Forecast],
        condition: str,
        groups: Sequence[str],
    ) -> None:
        positions = {modes: each.futures.position_m for modes, each in forecasts.items()}
        for modes, modes_m in positions.items():
            errors = final_errors(modes_m, target.future, "min_fde")
            self.samples.add(errors, modes, condition, groups)
        likeliest = final_errors(positions[FEW][:1], target.future, "most_probable_fde")
        self.samples.add(likeliest, 1, condition, groups)

    def _add_given_true(
        self,
        prediction: ConditionalPrediction,
        target: ForecastTarget,
        true: Futures | None,
        forecasts: Mapping[int, Forecast],
    ) -> None:
        """Also measured given the true future: ADE, misses, plausibility and calibration."""
        future, add = target.future, self.samples.add
        for modes, forecast in forecasts.items():
            add(path_errors(forecast.futures.position_m, future, target.speed_mps), modes, TRUE)
        uncalibrated = replace(prediction, temperature=1.0).given(true, FEW)[0]
        add_shapes(self.samples, target, forecasts, uncalibrated, TRUE)
        for seconds in HORIZONS:
            if future.valid[STEPS[seconds]]:
                (few,) = prediction.given(true, FEW, chosen_at=STEPS[seconds])
                add(nearest_modes(few, future, "_of_horizon", (seconds,)), FEW, TRUE)

    def _forecasts(
        self, prediction: ConditionalPrediction, conditions: Mapping[str, Futures | None]
    ) -> dict[str, dict[int, Forecast]]:
        """Forecasts by condition and number of modes; all given futures are one batch."""
        given = {name: futures for name, futures in conditions.items() if futures is not None}
        first, *more = given.values()
        together = given_both(first, more[0]) if more else first
        found: dict[str, dict[int, Forecast]] = {name: {} for name in conditions}
        for modes in self.modes:
            found[NOTHING][modes] = prediction.given(None, modes)[0]
            forecasts = prediction.given(together, modes)
            for name, forecast in zip(given, forecasts, strict=True):
                found[name][modes] = forecast
        return found


def given(future: Future) -> Futures:
    """An agent's future as the one condition."""
    return Futures(
        agent_id=future.agent_id,
        position_m=future.position_m[None],
        heading_rad=future.heading_rad[None],
    )


def given_both(one: Futures, other: Futures) -> Futures:
    """Two conditions on the same agent at the same time."""
    return Futures(
        agent_id=one.agent_id,
        position_m=np.concatenate([one.position_m, other.position_m]),
        heading_rad=np.concatenate([one.heading_rad, other.heading_rad]),
    )


def motion(view: View, future: Future) -> Floats:
    """(80, 3) a future in the frame of its own agent."""
    return windows.local_future(view, future.agent_id, future)


def moved_to(view: View, agent_id: AgentId, moved: Floats) -> Futures:
    """Another vehicle's motion (80, 3), started at the agent's pose."""
    row = view.history.row(agent_id)
    origin, heading = view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])
    return Futures(
        agent_id=agent_id,
        position_m=frames.to_scene(moved[None, :, :2], origin, heading),
        heading_rad=frames.wrap(moved[None, :, 2] + heading),
    )
