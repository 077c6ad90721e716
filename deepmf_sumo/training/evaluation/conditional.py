"""The conditional network: what it gains from another's future, true or shuffled."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

from deepmf_sumo.datatypes import Floats, Forecast, Futures
from deepmf_sumo.predictors.conditional import Conditional
from deepmf_sumo.training.evaluation import conditions, likelihood, reactions
from deepmf_sumo.training.evaluation.calibration import ModeCalibration
from deepmf_sumo.training.evaluation.conditions import (
    CONDITIONS,
    MARGINAL,
    NOTHING,
    SHUFFLED,
    TRUE,
    Observed,
)
from deepmf_sumo.training.evaluation.displacement import EARLY, HORIZONS, STEPS
from deepmf_sumo.training.evaluation.estimates import difference, mean, standard_error
from deepmf_sumo.training.evaluation.forecast_modes import FEW, ForecastModes
from deepmf_sumo.training.evaluation.marginal import Marginals
from deepmf_sumo.training.evaluation.targets import Role, Target
from deepmf_sumo.training.windows import Future


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A target, the partner whose future is given, and what the marginal network said."""

    target: Target
    partner: Future
    marginals: Marginals


@dataclass(slots=True)
class ConditionalFigures:
    """What has been measured of the conditional network.

    The shuffled future is that of the scene before, of a partner in the same role; the first scene
    gets that of the last one, in `finish`.

    Attributes:
        by_role: errors for the AV, and for its partners.
        attacked: errors for AVs that were attacked in simulation.
        informed: its modes, given the true future.
        calibrated_of_horizon: the same, of modes that cover the horizon.
    """

    modes: Sequence[int]
    by_role: dict[Role, Observed] = field(
        default_factory=lambda: {"av": Observed(), "partner": Observed()}
    )
    attacked: Observed = field(default_factory=Observed)
    informed: ForecastModes = field(init=False)
    calibrated_of_horizon: ModeCalibration = field(default_factory=ModeCalibration)
    pairs: int = 0
    _before: list[tuple[Role, Floats]] = field(default_factory=list)
    _first: list[Pair] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.informed = ForecastModes(self.modes)

    def add(self, conditional: Conditional, pairs: Sequence[Pair]) -> None:
        """The pairs of one scene."""
        if not pairs:
            return
        if self._before:
            self._measure_all(conditional, pairs)
        else:
            self._first = list(pairs)
        self._before = [
            (pair.target.role, conditions.motion(pair.target.view, pair.partner)) for pair in pairs
        ]

    def finish(self, conditional: Conditional) -> None:
        """The first scene, which had none before; where it is the only one, nothing is shuffled."""
        if self._first and self.pairs == 0:
            self._before = []
        self._measure_all(conditional, self._first)

    def _measure_all(self, conditional: Conditional, pairs: Sequence[Pair]) -> None:
        for number, pair in enumerate(pairs):
            same = [moved for role, moved in self._before if role == pair.target.role]
            same = same or [moved for _, moved in self._before]
            view, agent_id = pair.target.view, pair.partner.agent_id
            shuffled = (
                conditions.begun_at(view, agent_id, same[number % len(same)]) if same else None
            )
            self._measure(conditional, pair, shuffled)

    def _measure(self, conditional: Conditional, pair: Pair, shuffled: Futures | None) -> None:
        target, future = pair.target, pair.target.future
        seen = [self.by_role[target.role]]
        if target.planner:
            seen.append(self.attacked)
        true = conditions.given(pair.partner)
        asked: dict[str, Futures | None] = {NOTHING: None, TRUE: true}
        if shuffled is not None:
            asked[SHUFFLED] = shuffled
        found = {MARGINAL: pair.marginals.forecasts, **self._react(conditional, target, asked)}
        logs = {MARGINAL: pair.marginals.log_likelihood}
        for condition, futures in asked.items():
            logs[condition] = _log_likelihood(
                conditional, target, futures, found[condition][max(self.modes)]
            )
        for each in seen:
            for condition, forecasts in found.items():
                for modes, forecast in forecasts.items():
                    each.add_modes(condition, modes, forecast.futures.position_m, future)
                each.add_modes(condition, 1, forecasts[FEW].futures.position_m[:1], future)
                each.add_log(condition, logs[condition])
        warm = copy(conditional)  # shares the network; only the probabilities differ
        warm.temperature = 1.0
        self.informed.add(target, found[TRUE], _answers(warm, target, true, FEW)[0])
        for key, step in STEPS.items():
            if future.valid[step]:
                (few,) = _answers(conditional, target, true, FEW, chosen_at=step)
                self.calibrated_of_horizon.add(few, future, (key,))
        self.pairs += 1

    def _react(
        self, conditional: Conditional, target: Target, asked: dict[str, Futures | None]
    ) -> dict[str, dict[int, Forecast]]:
        """Forecasts by condition and number of modes; given futures go through at once."""
        given = {name: futures for name, futures in asked.items() if futures is not None}
        first, *more = given.values()
        together = conditions.given_both(first, more[0]) if more else first
        found: dict[str, dict[int, Forecast]] = {name: {} for name in asked}
        for modes in self.modes:
            found[NOTHING][modes] = _answers(conditional, target, None, modes)[0]
            answers = _answers(conditional, target, together, modes)
            for name, answer in zip(given, answers, strict=True):
                found[name][modes] = answer
        return found

    def summary(self) -> dict[str, Any]:
        """Figures by horizon; those that name no condition are of the true future given."""
        both = self.by_role["av"].joined(self.by_role["partner"])
        found: dict[str, Any] = {"targets": self.pairs}
        for key in (*EARLY, *HORIZONS):
            found[key] = self._displacement(both, key)
        for key in HORIZONS:
            found[key] |= {
                "log_likelihood": {name: mean(both.log[name, key]) for name in CONDITIONS},
                **both.gains(key),
                "by_role": {
                    role: {
                        "objects": len(each.fde[MARGINAL, FEW, key]),
                        **each.gains(key),
                        "min_fde": {
                            name: mean(each.fde[name, FEW, key]) for name in CONDITIONS
                        },
                        "most_probable_fde": each.most_probable(key),
                    }
                    for role, each in self.by_role.items()
                },
                **self._informed(both, key),
            }  # fmt: skip
        found["reactions"] = reactions.summary(self.attacked)
        return found

    def _informed(self, both: Observed, key: str) -> dict[str, Any]:
        errors = self.informed.displacement(key)
        log = mean(both.log[TRUE, key])
        return {
            "min_ade": errors["min_ade"],
            "miss_rate": errors["miss_rate"],
            "negative_log_likelihood": None if log is None else -log,
            **self.informed.calibration(key),
            "ece_of_horizon": self.calibrated_of_horizon.error(key),
            **self.informed.plausibility(key),
        }

    def _displacement(self, both: Observed, key: str) -> dict[str, Any]:
        found: dict[str, Any] = {"objects": len(both.fde[MARGINAL, FEW, key])}
        for name in CONDITIONS:
            errors = {str(modes): both.fde[name, modes, key] for modes in self.modes}
            label = f"min_fde_{name}"
            found[label] = {modes: mean(each) for modes, each in errors.items()}
            found[f"{label}_standard_error"] = {
                modes: standard_error(each) for modes, each in errors.items()
            }
        for name, condition in (("true", TRUE), ("shuffled", SHUFFLED)):
            apart = {
                str(modes): difference(
                    both.fde[condition, modes, key], both.fde[MARGINAL, modes, key]
                )
                for modes in self.modes
            }
            found[f"min_fde_change_{name}"] = {modes: each[0] for modes, each in apart.items()}
            found[f"min_fde_change_{name}_standard_error"] = {
                modes: each[1] for modes, each in apart.items()
            }
        found["most_probable_fde"] = both.most_probable(key)
        return found


def _log_likelihood(
    conditional: Conditional, target: Target, futures: Futures | None, forecast: Forecast
) -> dict[str, float | None]:
    view, agent_id = target.view, target.agent_id

    def density(ends_m: Floats, kernel_m: float) -> Floats:
        return conditional.end_density(
            view, agent_id, futures, ends_m, kernel_m, planner=target.planner
        )

    return likelihood.by_horizon(forecast, target.future, density)


def _answers(
    conditional: Conditional,
    target: Target,
    given: Futures | None,
    modes: int,
    chosen_at: int | None = None,
) -> list[Forecast]:
    return conditional.react(
        target.view, target.agent_id, given, modes, planner=target.planner, chosen_at=chosen_at
    )
