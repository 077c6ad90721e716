"""Cards, evaluation and runs of a variant -> its row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any, Final

from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.metrics.statistics import Interval, wilson
from deepmf_sumo.predictors.weights import Network

HORIZON: Final = "8.0"
MODES: Final = ("6", "16", "32")
_MINUTES: Final = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A mean and its standard error; None where it was not measured."""

    mean: float | None
    standard_error: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """The attacks on one planner.

    Attributes:
        runs: that went through. not_ok: failed, timed out or skipped. failed: without the skipped.
        hits: runs in which the opponent hit the AV first. rate: of the runs; None without any.
        rms_mps2: the opponent's RMS acceleration, mean over the runs.
    """

    planner: str
    runs: int
    not_ok: int
    failed: int
    hits: int
    rate: Interval | None
    rms_mps2: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One variant.

    Attributes:
        networks: the variant whose networks it uses.
        cards: by network.
        scenes, refused: recordings that were evaluated, and that could not be.
        min_fde_m: by number of modes, at 8 s, of ``objects`` vehicles.
        log_likelihood: nats, at 8 s.
        gain_true, gain_shuffled: of the AV's log likelihood, given the other's future, nats, at
            8 s, of ``avs`` AVs.
        cycle_ms: median over the replanning ``cycles`` of all runs.
    """

    variant: str
    networks: str
    cards: Mapping[Network, Mapping[str, Any]]
    scenes: int
    refused: int
    min_fde_m: Mapping[str, Estimate]
    objects: int
    log_likelihood: Estimate
    gain_true: Estimate
    gain_shuffled: Estimate
    avs: int
    cycle_ms: float | None
    cycles: int
    attacks: tuple[Attacked, ...]

    @property
    def weights(self) -> int:
        """Of all three networks."""
        return sum(card["weights"] for card in self.cards.values())

    @property
    def minutes(self) -> float:
        """Of training the marginal and the conditional network."""
        return _MINUTES * float(
            self.cards["marginal"]["hours"] + self.cards["conditional"]["hours"]
        )

    @property
    def opponent_minutes(self) -> float:
        """Of training the opponent network, which all variants share."""
        return _MINUTES * float(self.cards["opponent"]["hours"])


def row(
    variant: str,
    networks: str,
    cards: Mapping[Network, Mapping[str, Any]],
    evaluation: Mapping[str, Any],
    results: Mapping[str, Sequence[Result]],
) -> Row:
    """The row of a variant.

    Args:
        variant: its name.
        networks: name of the variant whose networks it uses.
        cards: by network.
        evaluation: as `training.evaluation.evaluate` gives it.
        results: of the attacks, by planner.
    """
    marginal = evaluation["marginal"][HORIZON]
    gains = evaluation["conditional"][HORIZON]["by_role"]["av"]
    cycles = [
        sum(parts.values())
        for each in results.values()
        for one in each
        for parts in one["timings"].get("plans_ms", ())
    ]
    return Row(
        variant=variant,
        networks=networks,
        cards=cards,
        scenes=evaluation["scenes"],
        refused=evaluation["refused"],
        min_fde_m={
            modes: Estimate(
                mean=marginal["min_fde"][modes],
                standard_error=marginal["min_fde_standard_error"][modes],
            )
            for modes in MODES
        },
        objects=marginal["objects"],
        log_likelihood=_estimate(marginal, "log_likelihood"),
        gain_true=_estimate(gains, "log_likelihood_gain_true"),
        gain_shuffled=_estimate(gains, "log_likelihood_gain_shuffled"),
        avs=gains["log_likelihood_objects"],
        cycle_ms=median(cycles) if cycles else None,
        cycles=len(cycles),
        attacks=tuple(_attacked(planner, each) for planner, each in results.items()),
    )


def _estimate(values: Mapping[str, Any], name: str) -> Estimate:
    return Estimate(mean=values[name], standard_error=values[f"{name}_standard_error"])


def _attacked(planner: str, results: Sequence[Result]) -> Attacked:
    done = [one for one in results if one["status"] == "ok"]
    hits = sum(one["outcome"] == "av_opponent" for one in done)
    rms = [
        value
        for one in done
        if (value := one["metrics"]["opponent_rms_acceleration"]["value"]) is not None
    ]
    return Attacked(
        planner=planner,
        runs=len(done),
        not_ok=len(results) - len(done),
        failed=sum(one["status"] in {"failed", "timeout"} for one in results),
        hits=hits,
        rate=wilson(hits, len(done)) if done else None,
        rms_mps2=fmean(rms) if rms else None,
    )
