"""The thresholds file: strict YAML, like specs."""

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from deepmf_sumo.benchmark.quantities import COMPARABLE, TTC_CEILING_S
from deepmf_sumo.spec.document import read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import Strict

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


class Limits(Strict):
    """Bounds over a group of runs; None is no bound.

    Attributes:
        max_av_collision_rate: see `quantities.COMPARABLE` for this and the other rates.
        min_ttc_p05: seconds; the least time to collision that 95 % of the attacked runs keep.
        max_delta_v_mps, max_collision_speed_mps: of the worst hit.
        max_failed_runs: failed, timed out or missing ones.
        min_judged_runs: fewer of them are no basis for a judgement.
    """

    max_av_collision_rate: Share | None = None
    max_collision_rate: Share | None = None
    max_valid_collision_rate: Share | None = None
    max_avoidable_rate: Share | None = None
    max_av_at_fault_rate: Share | None = None
    min_ttc_p05: Annotated[float, Field(ge=0, lt=TTC_CEILING_S)] | None = None
    min_gap_p05: Positive | None = None
    max_delta_v_mps: Positive | None = None
    max_collision_speed_mps: Positive | None = None
    max_failed_runs: Count | None = None
    max_skipped_runs: Count | None = None
    min_judged_runs: Count = 1


def _known(name: str) -> str:
    if name not in COMPARABLE:
        rule = f"'{name}' is no quantity. Known: {', '.join(COMPARABLE)}"
        raise PydanticCustomError("rule", "{rule}", {"rule": rule})
    return name


QuantityName = Annotated[str, AfterValidator(_known)]
COMPARED: Final = ("impact_mps",)
"""One quantity, so that few specs suffice: every contact of the AV, and how hard it is."""
SHOWN: Final = ("impact_mps", "av_collision_rate", "valid_collision_rate", "ttc_s", "min_gap_m")
"""For the reader, judged or not."""


class Baseline(Strict):
    """What the results are compared with.

    Attributes:
        results: a results file or a result folder, beside the thresholds file; ``--baseline``
            names another.
        by: compare all runs together, or those of each planner, spec or network.
        quantities: judged; the fewer, the smaller a difference that is seen.
        confidence: of all intervals together, at each of their ends.
        tolerance: how much worse a quantity may be, in its unit; else what is negligible.
        rule_out: how much worse it must not be able to be for a pass; else the quantity's own.
    """

    results: str | None = None
    by: Literal["all", "planner", "spec", "network"] = "all"
    quantities: Annotated[tuple[QuantityName, ...], Field(strict=False, min_length=1)] = COMPARED
    confidence: Annotated[float, Field(ge=0.5, lt=1)] = 0.95
    tolerance: dict[QuantityName, Positive] = {}
    rule_out: dict[QuantityName, Positive] = {}


def _named(value: object) -> object:
    return {"results": value} if isinstance(value, str) else value


Groups = dict[str, Limits]


class Thresholds(Limits):
    """Bounds over all runs, and over those of single specs, networks and planners.

    Attributes:
        max_failed_runs: without it a single one is too many.
        specs, networks, planners: by name; ``*`` and ``?`` stand for other characters.
    """

    version: Literal[1]
    max_failed_runs: Count = 0
    specs: Groups = {}
    networks: Groups = {}
    planners: Groups = {}
    baseline: Annotated[Baseline, BeforeValidator(_named)] = Baseline()


def load(file: Path) -> Thresholds:
    """The thresholds in a file. Raises SpecError with file, line and key."""
    document = read(file)
    found: Thresholds = checked(Thresholds, document.values, (), document)
    results = found.baseline.results
    if results is None:
        return found
    beside = str(file.parent / Path(results).expanduser())
    return found.model_copy(
        update={"baseline": found.baseline.model_copy(update={"results": beside})}
    )


__all__ = ["COMPARED", "SHOWN", "Baseline", "Limits", "Thresholds", "load"]
