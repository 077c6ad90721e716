"""A result folder as figures need it: its runs, what each did, and the road that it was on."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import readers
from deepmf_sumo.benchmark import stored
from deepmf_sumo.benchmark.home import cache_folder
from deepmf_sumo.datatypes import Contact, RoadMap, Rollout
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES
from deepmf_sumo.network.sumo_road import road_of_net
from deepmf_sumo.report.figures import tracks
from deepmf_sumo.report.run_table import runs_of
from deepmf_sumo.report.table import SECTORS
from deepmf_sumo.spec import document

HIT: Final = "av_opponent"
KEPT: Final = ("contacts", "ended", "metrics", "opponent", "settings")
"""Of ``result.json``."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run that went through.

    Attributes:
        method: its label in the plan; the spec's name where there is no plan.
        planner: its label in the plan; else name and perception.
        version: the paper's name for the period between plans, or empty.
    """

    run_id: str
    folder: Path
    method: str
    planner: str
    scene: str
    adversary: str
    version: str
    seed: int
    outcome: str

    @property
    def hit(self) -> bool:
        """Whether the opponent hit the AV."""
        return self.outcome == HIT

    @cached_property
    def result(self) -> dict[str, Any]:
        """What figures need of ``result.json``: the trials of thousands of searches are large."""
        found = stored.result_of(self.folder / "result.json")
        return {key: found[key] for key in KEPT}

    @property
    def accident(self) -> str:
        """Name of the accident; empty where there was none, or that version did not know."""
        number = self.metric("accident_type")
        name = "" if number is None else ACCIDENT_TYPES[int(number)].replace("_", "-")
        return "T-bone" if name == "t-bone" else name

    @property
    def attacked(self) -> bool:
        """Whether there was somebody to attack with."""
        return self.result["opponent"] is not None

    @property
    def recorded(self) -> bool:
        """Whether the tracks are there."""
        return (self.folder / "tracks.csv.gz").is_file()

    @cached_property
    def rollout(self) -> Rollout:
        """What happened; plans without their reasons, velocities along the headings."""
        known = {field.name for field in fields(Contact)}
        contacts = [
            Contact(**{name: value for name, value in one.items() if name in known})
            for one in self.result["contacts"]
        ]
        return tracks.read_rollout(self.folder, contacts, self.result["ended"])

    @cached_property
    def contact(self) -> Contact | None:
        """The contact that the outcome names, where the AV takes part in it."""
        if not self.outcome.startswith("av"):
            return None
        return next((one for one in self.rollout.contacts if one.kind == self.outcome), None)

    @property
    def sector(self) -> int | None:
        """Where the opponent hit the AV."""
        contacts = self.result["contacts"] if self.hit else []
        return next((one["sector"] for one in contacts if one["kind"] == HIT), None)

    @property
    def asked_sector(self) -> int | None:
        """The impact sector that the attack was asked for."""
        asked = self.result["settings"]["adversary"].get("sector")
        return SECTORS.index(asked.replace("_", " ")) if isinstance(asked, str) else asked

    def metric(self, name: str) -> float | None:
        """Value of a metric; None where it is not defined, or not known to that version."""
        value: float | None = self.result["metrics"].get(name, {}).get("value")
        return value

    @property
    def clean(self) -> bool:
        """Whether nothing speaks against the hit: limits, road, third parties, avoidability."""
        valid = self.metric("valid_collision")
        if valid is not None:
            return valid >= 1.0
        names = ("feasible", "on_road", "collision_clean")
        return all((self.metric(name) or 0.0) >= 1.0 for name in names)

    def road(self) -> tuple[RoadMap, str]:
        """The recording's map, or the network's; and why it is not the one that was attacked on.

        The network in the run's folder stands in for a recording that is not there any more.
        """
        source = source_of(self.folder)
        lost = ""
        if "recording" in source:
            try:
                return _recorded_road(Path(source["recording"]), self.scene), ""
            except (ReaderError, UsageError) as error:
                lost = f"{self.run_id}: road of the converted network, since {error}"
        nets = sorted((self.folder / "sumo").glob("net.net.xml*"))
        if not nets:
            raise UsageError(f"{self.folder}/sumo holds no net.net.xml; run it again for figures.")
        return road_of_net(nets[0]), lost


def source_of(folder: Path) -> dict[str, Any]:
    """Of a run's spec; live attacks have none, and their network lies in the folder."""
    file = folder / "spec.yaml"
    if not file.is_file():
        return {}
    source = document.read(file).values.get("source")
    if not isinstance(source, dict):
        raise UsageError(f"{file} is damaged: it has no key 'source' with keys; run it anew.")
    return source


@dataclass(frozen=True, kw_only=True)
class Results:
    """The runs of a folder that went through, in its order; those of other budgets are left out.

    Attributes:
        planned: rows of ``runs.csv``, those of other budgets left out.
        steered: runs that a plan has for figures alone: they asked for an impact sector.
    """

    out: Path
    runs: tuple[Run, ...]
    planned: int
    steered: tuple[Run, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """In the order of ``runs.csv``."""
        return tuple(dict.fromkeys(run.method for run in self.runs))

    @property
    def planners(self) -> tuple[str, ...]:
        """In the order of ``runs.csv``."""
        return tuple(dict.fromkeys(run.planner for run in self.runs))


@lru_cache(maxsize=16)
def _recorded_road(recording: Path, scene: str) -> RoadMap:
    """Kept, for several figures show the same scene."""
    return readers.scene(recording, scene, cache_folder()).road


def read(out: Path) -> Results:
    """The runs of a result folder. Raises UsageError where it is none, or its table is damaged."""
    every = runs_of(out)
    main = [row for row in every if row.get("part") in {None, "", "main"}]
    done = [row for row in main if row["status"] == "ok"]
    steered = [row for row in every if row.get("part") == "figures" and row["status"] == "ok"]
    return Results(
        out=out,
        runs=tuple(run_of(out, row) for row in done),
        planned=len(main),
        steered=tuple(run_of(out, row) for row in steered),
    )


def run_of(out: Path, row: Mapping[str, str]) -> Run:
    """The run of a row of ``runs.csv``. Raises UsageError where that is damaged."""
    seed = row["seed"]
    if not (seed.isascii() and seed.isdecimal() and len(seed) < 20):
        raise UsageError(
            f"{out / 'runs.csv'} is damaged: the seed of {row['run_id']} is {seed!r:.80}; write it"
            " anew with --resume."
        )
    return Run(
        run_id=row["run_id"],
        folder=stored.run_folder(out, row["run_id"], "runs.csv"),
        method=row.get("method") or row["spec"],
        planner=row.get("planner_label") or f"{row['planner']} {row['perception']}".strip(),
        scene=row["scene"],
        adversary=row["adversary"],
        version=row["version"],
        seed=int(seed),
        outcome=row["outcome"],
    )
