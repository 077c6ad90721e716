"""The conditional network: what it gains from another's future, true or shuffled."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.geometry import frames
from deepmf_sumo.predictors.conditional import Conditional, ConditionalPrediction
from deepmf_sumo.training.evaluation.forecasts import FEW, ForecastModes, Role, Target
from deepmf_sumo.training.evaluation.marginal import Marginals
from deepmf_sumo.training.evaluation.measures import (
    EARLY,
    HORIZONS,
    STEPS,
    ModeCalibration,
    difference,
    log_likelihoods,
    mean,
    standard_error,
)
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

MARGINAL: Final = "marginal"
NOTHING, TRUE, SHUFFLED = "given_nothing", "given_true", "given_shuffled"
CONDITIONS: Final = (MARGINAL, NOTHING, TRUE, SHUFFLED)
"""The marginal network; the conditional one given nothing, the other's true future, or the future
of another scene's vehicle, begun at the other's pose."""
SECONDS: Final = ("1.0", "2.0", "3.0")
_SHOWN: Final = {"most_probable": 1, f"best_of_{FEW}": FEW}


@dataclass(slots=True)
class Observed:
    """Errors under each condition, a value an object, in the same order under all conditions.

    Attributes:
        fde: by condition, number of modes, horizon; 1 is the most probable of the fewest modes.
        log: log likelihood by condition and horizon.
    """

    fde: dict[tuple[str, int, str], list[float]] = field(default_factory=lambda: defaultdict(list))
    log: dict[tuple[str, str], list[float]] = field(default_factory=lambda: defaultdict(list))

    def add_modes(self, condition: str, modes: int, modes_m: Floats, future: Future) -> None:
        """Modes (M, 80, 2) of one object; the best counts."""
        for key, step in STEPS.items():
            if future.valid[step]:
                error = np.linalg.norm(modes_m[:, step] - future.position_m[step], axis=-1)
                self.fde[condition, modes, key].append(float(error.min()))

    def add_log(self, condition: str, values: dict[str, float | None]) -> None:
        """Log likelihoods of one object by horizon."""
        for key, value in values.items():
            if value is not None:
                self.log[condition, key].append(value)

    def joined(self, other: "Observed") -> "Observed":
        """These objects and the others."""
        both = Observed()
        for each in (self, other):
            for place, errors in each.fde.items():
                both.fde[place].extend(errors)
            for spot, logs in each.log.items():
                both.log[spot].extend(logs)
        return both

    def gains(self, key: str) -> dict[str, Any]:
        """Gains in log likelihood at a horizon with standard errors, nats.

        Against the marginal network, and against the conditional one given nothing.
        """
        found: dict[str, Any] = {"log_likelihood_objects": len(self.log[MARGINAL, key])}
        for name, condition in (("true", TRUE), ("shuffled", SHUFFLED), ("nothing", NOTHING)):
            for suffix, against in (("", MARGINAL), ("_over_nothing", NOTHING)):
                if condition != against:
                    label = f"log_likelihood_gain_{name}{suffix}"
                    found[label], found[f"{label}_standard_error"] = difference(
                        self.log[condition, key], self.log[against, key]
                    )
        return found

    def most_probable(self, key: str) -> dict[str, float | None]:
        """Mean error of the most probable mode at a horizon, by condition."""
        return {condition: mean(self.fde[condition, 1, key]) for condition in CONDITIONS}


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A target, the partner whose future is given, and the predictions of the marginal network."""

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
            (pair.target.role, motion(pair.target.view, pair.partner)) for pair in pairs
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
            shuffled = begun_at(view, agent_id, same[number % len(same)]) if same else None
            self._measure(conditional, pair, shuffled)

    def _measure(self, conditional: Conditional, pair: Pair, shuffled: Futures | None) -> None:
        target, future = pair.target, pair.target.future
        seen = [self.by_role[target.role]]
        if target.planner:
            seen.append(self.attacked)
        true = given(pair.partner)
        asked: dict[str, Futures | None] = {NOTHING: None, TRUE: true}
        if shuffled is not None:
            asked[SHUFFLED] = shuffled
        prediction = conditional.predict(target.view, target.agent_id, planner=target.planner)
        found = {MARGINAL: pair.marginals.forecasts, **self._react(prediction, asked)}
        logs = {MARGINAL: pair.marginals.log_likelihood}
        for condition, futures in asked.items():
            density = partial(prediction.end_density, futures)
            logs[condition] = log_likelihoods(found[condition][max(self.modes)], future, density)
        for each in seen:
            for condition, forecasts in found.items():
                for modes, forecast in forecasts.items():
                    each.add_modes(condition, modes, forecast.futures.position_m, future)
                each.add_modes(condition, 1, forecasts[FEW].futures.position_m[:1], future)
                each.add_log(condition, logs[condition])
        warm = replace(prediction, temperature=1.0)
        self.informed.add(target, found[TRUE], warm.given(true, FEW)[0])
        for key, step in STEPS.items():
            if future.valid[step]:
                (few,) = prediction.given(true, FEW, chosen_at=step)
                self.calibrated_of_horizon.add(few, future, (key,))
        self.pairs += 1

    def _react(
        self, prediction: ConditionalPrediction, asked: dict[str, Futures | None]
    ) -> dict[str, dict[int, Forecast]]:
        """Forecasts by condition and number of modes; given futures go through at once."""
        given = {name: futures for name, futures in asked.items() if futures is not None}
        first, *more = given.values()
        together = given_both(first, more[0]) if more else first
        found: dict[str, dict[int, Forecast]] = {name: {} for name in asked}
        for modes in self.modes:
            found[NOTHING][modes] = prediction.given(None, modes)[0]
            answers = prediction.given(together, modes)
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
        found["reactions"] = _reactions(self.attacked)
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


def given(future: Future) -> Futures:
    """An agent's future as the one condition."""
    return Futures(
        agent_id=future.agent_id,
        position_m=future.position_m[None],
        heading_rad=future.heading_rad[None],
    )


def given_both(one: Futures, other: Futures) -> Futures:
    """Two conditions on the same agent at once."""
    return Futures(
        agent_id=one.agent_id,
        position_m=np.concatenate([one.position_m, other.position_m]),
        heading_rad=np.concatenate([one.heading_rad, other.heading_rad]),
    )


def motion(view: View, future: Future) -> Floats:
    """(80, 3) a future in the frame of its own agent."""
    return windows.local_future(view, future.agent_id, future)


def begun_at(view: View, agent_id: AgentId, moved: Floats) -> Futures:
    """Another's motion (80, 3), begun at the agent's pose."""
    row = view.history.row(agent_id)
    origin, heading = view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])
    return Futures(
        agent_id=agent_id,
        position_m=frames.to_scene(moved[None, :, :2], origin, heading),
        heading_rad=frames.wrap(moved[None, :, 2] + heading),
    )


def _reactions(attacked: Observed) -> dict[str, Any]:
    """Error of the AV's most probable mode and of the best of six, at 1, 2, 3 s.

    Given the opponent's true future (reactive), given nothing (blind), and by the marginal network;
    the gain is blind minus reactive.
    """
    found: dict[str, Any] = {}
    for key in SECONDS:
        found[key] = {"objects": len(attacked.fde[TRUE, FEW, key])}
        for label, modes in _SHOWN.items():
            reactive, blind = attacked.fde[TRUE, modes, key], attacked.fde[NOTHING, modes, key]
            gain, gain_error = difference(blind, reactive)
            found[key][label] = {
                "reactive": mean(reactive),
                "reactive_standard_error": standard_error(reactive),
                "blind": mean(blind),
                "blind_standard_error": standard_error(blind),
                "marginal": mean(attacked.fde[MARGINAL, modes, key]),
                "gain": gain,
                "gain_standard_error": gain_error,
            }
    return found
