"""Which faults the gate of `deepmf-sumo check` reports when one method attacks all planners.

Each planner has a result folder; that of the control is the baseline of the others, at the same
moments. The control is the careful planner by its own IDM, as copies with a fault drive. Every run
is attacked, and measured without attack, too. What the first seeds do not report gets the later
seeds as well.

The hits of both planners are repeated (`check --same-attacks`): a hit that the control avoids where
the opponent drives the same path is the fault's own.

False alarms: the careful planner has runs of other seeds, and each set of runs is compared with all
before it. At the same moments it would only be compared with its own equal runs; so copies of the
control that know speeds to a few per cent, each with other errors, are compared with each other.
"""

import argparse
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import yaml

from deepmf_sumo import spec as specs
from deepmf_sumo.results import gate
from deepmf_sumo.results.changes import LEANING
from deepmf_sumo.results.quantities import COMPARABLE
from deepmf_sumo.results.reader import Results
from deepmf_sumo.spec import FromMoments, Spec
from deepmf_sumo.study import same_attacks
from deepmf_sumo.study.plans import run_specs
from deepmf_sumo.study.sweep import batch
from deepmf_sumo.tables import to_markdown
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.halves import halves
from studies.planner_faults.own_causes import First, first_cause
from studies.planner_faults.people import FAULTS as OF_PEOPLE

SUITE: Final = Path(__file__).resolve().parents[2] / "suite"
"""Moments of the packaged networks' traffic: each is a situation of its own for the gate.

Its subfolder ``people`` is for faults of people.
"""
FAULTY: Final = "studies.planner_faults.faults:Faulty"
FAULTY_WITH_PEOPLE: Final = "studies.planner_faults.people:FaultyWithPeople"
BY_PEOPLE: Final = "{name: deepmf, attackers: people}"
CONTROL: Final = "careful by its own IDM"
_CONTROL: Final[Mapping[str, Any]] = {"fault": "none", "unguarded": True}


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is measured.

    Attributes:
        method: an adversary as in a spec, YAML; its ``opponent`` stays that of each spec
            that names one.
        budget: simulations of an attack; None is the method's own.
        moments: in place of the number in specs that choose moments; None keeps it.
        later_seeds: of planners that are not reported with the first ``seeds``, added to these.
        other_seeds: of the runs for false alarms, one set each.
        alike: seeds of the errors of equally good planners, for false alarms at equal moments.
        thresholds: a file of `check`; None judges what `check` judges by itself.
        planner: the copies; with the setting ``fault: none`` it has none.
    """

    method: str
    budget: int | None
    moments: int | None
    jobs: int
    seeds: tuple[int, ...]
    later_seeds: tuple[int, ...] = ()
    other_seeds: tuple[tuple[int, ...], ...]
    alike: tuple[int, ...] = ()
    faults: tuple[str, ...]
    specs: tuple[Path, ...]
    thresholds: Path | None
    out: Path
    planner: str = FAULTY

    @classmethod
    def of(cls, given: argparse.Namespace) -> Self:
        """Of the command line."""
        known = OF_PEOPLE if given.people else FAULTS
        half = halves(FAULTS)
        chosen = given.faults or [name for name in known if half.get(name) != "held out"]
        suite = SUITE / "people" if given.people else SUITE
        return cls(
            method=given.method or (BY_PEOPLE if given.people else "deepmf"),
            budget=given.budget,
            moments=given.moments,
            jobs=given.jobs,
            seeds=tuple(given.seeds),
            later_seeds=tuple(given.later_seeds),
            other_seeds=tuple(given.false_alarms),
            alike=tuple(given.alike),
            faults=tuple(known) if chosen == ["all"] else tuple(chosen),
            specs=tuple(given.specs or sorted(suite.glob("*.yaml"))),
            thresholds=given.thresholds,
            out=given.out,
            planner=FAULTY_WITH_PEOPLE if given.people else FAULTY,
        )


class Found(NamedTuple):
    """What the gate says of a planner's runs, against those of its baseline.

    ``episodes``: simulated attacks, all tries counted, without the ``repeated`` ones. ``own``: hits
    that the baseline avoids in the same attack; ``baseline_own``: the other way round.
    ``by``: what is reported, by kind of failure and quantity; empty: nothing.
    """

    runs: int
    episodes: int
    hits: int
    findings: int
    own: int = 0
    baseline_own: int = 0
    repeated: int = 0
    by: tuple[str, ...] = ()


class Line(NamedTuple):
    """A planner: with the first seeds, with the later ones too (None: not needed), first cause."""

    planner: str
    first: Found
    later: Found | None = None
    cause: First | None = None


def measured(asked: Asked, say: Callable[[str], None] = lambda _: None) -> list[Line]:
    """The control, each faulty copy, and what is without fault, compared with itself.

    ``say`` gets a line when a planner is done. Raises DeepmfError.
    """
    thresholds = gate.load(asked.thresholds)
    lines: list[Line] = []
    steps = (_copies, _careful_with_itself, _alike)
    for line in chain.from_iterable(step(asked, thresholds) for step in steps):
        lines.append(line)
        say(_told(line, asked))
    return lines


def _copies(asked: Asked, thresholds: gate.Thresholds) -> Iterator[Line]:
    baseline = _run(asked, _CONTROL, "control", asked.seeds)
    yield Line(CONTROL, _found(baseline))
    for name in asked.faults:
        out = _run(asked, {"fault": name}, name, asked.seeds, baseline)
        found, later = _judged(asked, out, baseline, thresholds), None
        if asked.later_seeds and not found.by:
            out, later = _with_later_seeds(asked, name, thresholds)
        yield Line(name, found, later, first_cause(name, out) if name in FAULTS else None)


def _careful_with_itself(asked: Asked, thresholds: gate.Thresholds) -> Iterator[Line]:
    """At other moments."""
    sets = []
    for seeds in (asked.seeds, *asked.other_seeds) if asked.other_seeds else ():
        name = "-".join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))
        sets.append(_run(asked, {"fault": "none"}, f"careful_{name}", seeds))
        for old in sets[:-1]:
            found = _judged(asked, sets[-1], old, thresholds, again=False)
            yield Line(f"{_name(sets[-1])} against {_name(old)}", found)


def _alike(asked: Asked, thresholds: gate.Thresholds) -> Iterator[Line]:
    """At the same moments, with other errors."""
    baseline, sets = asked.out / "control", list[Path]()
    for seed in asked.alike:
        settings = {**_CONTROL, "noise": seed}
        sets.append(_run(asked, settings, f"alike_{seed}", asked.seeds, baseline))
        for old in sets[:-1]:
            found = _judged(asked, sets[-1], old, thresholds)
            yield Line(f"{_name(sets[-1])} against {_name(old)}", found)


def _name(folder: Path) -> str:
    return folder.name.replace("_", " seed ")


def _with_later_seeds(asked: Asked, fault: str, thresholds: gate.Thresholds) -> tuple[Path, Found]:
    """All seeds of a copy, and of the control; runs that are there are kept."""
    seeds = (*asked.seeds, *asked.later_seeds)
    for one in ("control", fault):
        if not (asked.out / f"{one}_later").exists():
            shutil.copytree(asked.out / one, asked.out / f"{one}_later")
    baseline = _run(asked, _CONTROL, "control_later", seeds)
    out = _run(asked, {"fault": fault}, f"{fault}_later", seeds, baseline)
    return out, _judged(asked, out, baseline, thresholds)


HEAD: Final = (
    "planner", "half", "runs", "episodes", "hits", "findings", "own", "first seeds", "all seeds",
    "reported by", "first cause",
)  # fmt: skip


def table(lines: Sequence[Line]) -> str:
    """A Markdown table with a line a planner, and how many of each kind the gate reports."""
    half = halves(FAULTS)
    rows = to_markdown(HEAD, [_cells(one) for one in lines])
    copies = {one.planner: half.get(one.planner, "of people") for one in lines
              if one.planner in half or one.planner in OF_PEOPLE}  # fmt: skip
    rows.append("")
    for kind in ("open", "held out", "of people"):
        of = [one for one in lines if copies.get(one.planner) == kind]
        if not of:
            continue
        first = sum(bool(one.first.by) for one in of)
        all_seeds = sum(_reported(one) for one in of)
        causes = sum(bool(one.cause and one.cause.own) for one in of)
        rows.append(
            f"{kind}: {first} of {len(of)} reported with the first seeds, {all_seeds} with all;"
            f" of {causes} the first cause is the fault's own"
        )
    for kind, said in (("careful", "careful with itself"), ("alike", "equally good planners")):
        pairs = [one for one in lines
                 if one.planner.startswith(kind) and " against " in one.planner]  # fmt: skip
        alarms = sum(bool(one.first.by) for one in pairs)
        rows.append(f"{said}: {alarms} of {len(pairs)} reported")
    return "\n".join(rows)


def _reported(line: Line) -> bool:
    return bool(line.first.by or (line.later and line.later.by))


def _cells(line: Line) -> tuple[str, ...]:
    found = line.later or line.first
    own = f"{found.own}, {found.baseline_own}"
    cause = "-"
    if line.cause:
        cause = f"{'own' if line.cause.own else 'another'}: {line.cause.sentence}"
    return (
        line.planner, halves(FAULTS).get(line.planner, ""), str(found.runs), str(found.episodes),
        str(found.hits), str(found.findings), own, "yes" if line.first.by else "no",
        "-" if line.later is None else "yes" if line.later.by else "no",
        "; ".join(found.by) or "-", cause,
    )  # fmt: skip


def _told(line: Line, asked: Asked) -> str:
    stages = [(asked.seeds, line.first)]
    if line.later:
        stages.append(((*asked.seeds, *asked.later_seeds), line.later))
    said = (
        f"seeds {' '.join(map(str, seeds))}: {found.hits} hits of {found.runs},"
        f" {'; '.join(found.by) or 'nothing reported'}"
        for seeds, found in stages
    )
    return f"{line.planner}: {' | '.join(said)}"


def _run(
    asked: Asked, settings: Mapping[str, Any], folder: str, seeds: Sequence[int],
    like: Path | None = None,
) -> Path:  # fmt: skip
    """The result folder of a planner; with ``like`` at the moments of that folder's runs."""
    out = asked.out / folder
    loaded = [spec_of(file, asked, settings, like) for file in asked.specs]
    each = [one.model_copy(update={"seed": seed}) for one in loaded for seed in seeds]
    run_specs(each, batch.Options(out=out, jobs=asked.jobs, resume=out.exists()))
    return out


def spec_of(
    file: Path, asked: Asked, settings: Mapping[str, Any], like: Path | None = None
) -> Spec:
    """A spec with the method and the copy with these settings in place of its own."""
    before = specs.load(file).adversary.settings
    method: Any = yaml.safe_load(asked.method)
    adversary = {"name": method} if isinstance(method, str) else dict(method)
    if "opponent" in before and adversary.get("name", "deepmf") == "deepmf":
        adversary.setdefault("opponent", before["opponent"])
    sets = [
        f"planner={yaml.safe_dump({'name': asked.planner, **settings}, default_flow_style=True)}",
        f"adversary={yaml.safe_dump(adversary, default_flow_style=True)}",
        "expect={}",
    ]
    if asked.budget is not None:
        sets.append(f"budget={{simulations: {asked.budget}}}")
    spec = specs.load(file, sets)
    if not isinstance(spec.source, FromMoments):
        return spec
    if like is not None:
        sets.append(f"source.moments={{of: {json.dumps(str(like.resolve()))}}}")
    elif asked.moments is not None:
        sets.append(f"source.moments.count={asked.moments}")
    return specs.load(file, sets)


def _found(out: Path) -> Found:
    """A planner's runs alone."""
    done = Results.of(out).done
    return Found(
        runs=len(done),
        episodes=sum(int(run.result["search"]["simulations"]) for run in done),
        hits=sum(run.hit for run in done),
        findings=sum(run.metric("finding") == 1 for run in done),
    )


def _judged(
    asked: Asked, out: Path, baseline: Path, thresholds: gate.Thresholds, *, again: bool = True
) -> Found:
    """What the gate says of a planner's runs; ``again``: hits are repeated with both planners.

    A planner compared with itself has no own hits, so that its hits need not be repeated.
    """

    def repeat(new: Path, old: Path) -> gate.SameAttacks:
        folder = asked.out / "same_attacks" / f"{out.name}--{baseline.name}"
        level = thresholds.baseline.confidence
        return same_attacks.repeated(new, old, folder, level, asked.jobs)

    verdict = gate.check(out, thresholds, baseline, repeat=repeat if again else None)
    found, same = _found(out)._replace(by=reported(verdict)), verdict.same_attacks
    if same is None:
        return found
    return found._replace(
        own=len(same.own),
        baseline_own=len(same.baseline_own),
        repeated=2 * (same.hits + same.baseline_hits),
    )


def reported(verdict: gate.GateVerdict) -> tuple[str, ...]:
    """What is broken or worse, by kind of failure and quantity."""
    by = [_named(one.limit) for one in verdict.judgements if one.state == "broken"]
    by += [_named(one.quantity) for one in verdict.compared if one.state == "worse"]
    same = verdict.same_attacks
    by += [f"own hits (chance {same.chance:.1g})"] if same and same.state == "worse" else []
    return tuple(by)


def _named(quantity: str) -> str:
    """``red run (av_red_run_rate)``."""
    known = COMPARABLE.get(quantity.removeprefix(LEANING))
    return f"{known.failure} ({quantity})" if known and known.failure else quantity
