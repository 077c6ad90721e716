"""Result folders for reading: the runs, what each of them did, and the road that it was on.

::

    from deepmf_sumo import Results

    results = Results.open("results")
    results.frame()[["run_id", "outcome", "min_gap"]]
    results.runs[0].rollout.tracks
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.judge.avoidability.counterfactual import Counterfactual
from deepmf_sumo.judge.ladder import Rung
from deepmf_sumo.results import artifacts, findings, stored, tracks
from deepmf_sumo.results.findings import Worth
from deepmf_sumo.results.result import ContactValues, MetricValues, Result, known_of
from deepmf_sumo.scene import Contact, RoadMap, Rollout, Scene, readers
from deepmf_sumo.scene.geometry.impact import SECTORS
from deepmf_sumo.spec import document
from deepmf_sumo.sumo.network.sumo_road import road_of_net

if TYPE_CHECKING:
    import pandas as pd

    from deepmf_sumo.results.frames import Kind

HIT: Final = "av_opponent"
MISSING: Final = "missing"
"""Status of a run of the manifest that has no result."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of a result folder. Its files are read on demand.

    Attributes:
        folder: of the run, in ``runs`` of the result folder.
        row: its row of ``runs.csv``.
        method: its label in the plan; the spec's name where there is no plan.
        planner: its label in the plan; else name and perception.
        part: ``main``, ``budgets`` or ``figures``: the part of a plan that it belongs to.
        version: the paper's name for the period between plans, or empty.
    """

    folder: Path
    row: Mapping[str, str]
    run_id: str
    method: str
    planner: str
    part: str
    scene: str
    adversary: str
    version: str
    seed: int
    status: str
    outcome: str

    @classmethod
    def of_row(cls, out: Path, row: Mapping[str, str]) -> Self:
        """The run of a row of ``runs.csv``. Raises UsageError where the row is damaged."""
        seed = row["seed"]
        if not (seed.isascii() and seed.isdecimal() and len(seed) < 20):
            raise UsageError(
                f"{out / stored.RUNS} is damaged: the seed of {row['run_id']} is {seed!r:.80};"
                " write it again with --resume."
            )
        return cls(
            folder=stored.run_folder(out, row["run_id"], stored.RUNS),
            row=row,
            run_id=row["run_id"],
            method=row.get("method") or row["spec"],
            planner=row.get("planner_label") or f"{row['planner']} {row['perception']}".strip(),
            part=row.get("part") or "main",
            scene=row["scene"],
            adversary=row["adversary"],
            version=row["version"],
            seed=int(seed),
            status=row["status"],
            outcome=row["outcome"],
        )

    @classmethod
    def of_result(cls, out: Path, result: Result) -> Self:
        """The run of a result that is known, and is not read again; its row has all digits."""
        known = known_of(result).items()
        run = cls.of_row(out, {name: "" if one is None else str(one) for name, one in known})
        vars(run)["result"] = without_trials(result)
        return run

    @property
    def has_result(self) -> bool:
        """Whether there is a ``result.json``, readable or not."""
        return "result" in vars(self) or (
            self.status != MISSING and (self.folder / stored.RESULT).is_file()
        )

    @cached_property
    def result(self) -> Result:
        """``result.json`` without the trials of a search: those of thousands of runs are large.

        Raises UsageError where it cannot be read, or is damaged.
        """
        return without_trials(stored.result_of(self.folder / stored.RESULT))

    @property
    def recorded(self) -> bool:
        """Whether the tracks are there."""
        return (self.folder / tracks.FILE).is_file()

    def number(self, name: str) -> float | None:
        """A number of ``runs.csv``; None where the cell is empty.

        Raises UsageError where it is not a number.
        """
        text = self.row[name]
        try:
            return float(text) if text else None
        except ValueError:
            file = self.folder.parents[1] / stored.RUNS
            raise UsageError(
                f"{file} is damaged: {name} of {self.run_id} is {text!r:.80}; write it again with"
                " --resume."
            ) from None

    @property
    def hit(self) -> bool:
        """Whether the opponent hit the AV."""
        return self.outcome == HIT

    @property
    def tries(self) -> list[str]:
        """What each try for a finding was: ``miss`` or the rung of its hit; empty of other runs."""
        return self.result["search"]["tries"] if self.status == "ok" and self.has_result else []

    @property
    def attacked(self) -> bool:
        """Whether there was a vehicle to attack with."""
        return self.result["opponent"] is not None

    @property
    def accident(self) -> str:
        """Name of the accident; empty where there was none, or that version did not know."""
        number = self.metric("accident_type")
        name = "" if number is None else ACCIDENT_TYPES[int(number)].replace("_", "-")
        return "T-bone" if name == "t-bone" else name

    @property
    def worth(self) -> Worth | None:
        """What the hit is worth; None without a hit, or where that is not known."""
        return findings.worth(self.values) if self.hit else None

    @property
    def rung(self) -> Rung | None:
        """Of the ladder; None without a hit, and in results of versions without a ladder."""
        return self.worth.rung if self.worth is not None else None

    @property
    def finding(self) -> bool:
        """Whether it hit, and the hit is known to be a finding."""
        return self.worth is not None and self.worth.finding

    @property
    def sector(self) -> int | None:
        """Where the opponent hit the AV."""
        contacts = self.result["contacts"] if self.hit else []
        return next((one["sector"] for one in contacts if one["kind"] == HIT), None)

    @property
    def network(self) -> str | None:
        """The .sumocfg without its suffix; None of a recording, or where that is not known."""
        known = self.result if self.has_result else self.row
        return known.get("network") or None

    @property
    def asked_sector(self) -> int | None:
        """The impact sector that the attack aimed at."""
        asked = self.result["settings"]["adversary"].get("sector")
        return SECTORS.index(asked) if isinstance(asked, str) else asked

    @cached_property
    def metrics(self) -> Mapping[str, MetricValues]:
        """The metrics by name; none where the run has no result."""
        return self.result["metrics"] if self.status == "ok" and self.has_result else {}

    @property
    def values(self) -> dict[str, float | None]:
        """The metrics' values by name; None where one is not defined."""
        return {name: one["value"] for name, one in self.metrics.items()}

    def metric(self, name: str) -> float | None:
        """Value of a metric; None where it is not defined, or not known to that version."""
        found = self.metrics.get(name)
        return None if found is None else found["value"]

    @property
    def contacts(self) -> Sequence[ContactValues]:
        """All contacts as in ``result.json``; none where the run has no result."""
        return self.result["contacts"] if self.status == "ok" and self.has_result else ()

    @cached_property
    def rollout(self) -> Rollout:
        """What happened; plans without their reasons, velocities along the headings.

        Raises `stored.DAMAGE`.
        """
        known = {field.name for field in fields(Contact)}
        listed: list[Any] = self.result["contacts"]
        contacts = [
            Contact(**{name: value for name, value in one.items() if name in known})
            for one in listed
        ]
        return artifacts.read_rollout(self.folder, contacts, self.result["ended"])

    @cached_property
    def contact(self) -> Contact | None:
        """The contact that the outcome names, where the AV takes part in it."""
        if not self.outcome.startswith("av"):
            return None
        return next((one for one in self.rollout.contacts if one.kind == self.outcome), None)

    @property
    def spec_text(self) -> str:
        """``spec.yaml``, which repeats the run; empty where there is none, as of live attacks."""
        return _text(self.folder / stored.SPEC)

    @property
    def log_text(self) -> str:
        """What the run printed; empty where it left no log."""
        return _text(self.folder / stored.LOG)

    @property
    def opens_in_sumo(self) -> bool:
        """Whether sumo-gui can show the run."""
        return (self.folder / "sumo" / "replay.sumocfg").is_file()

    @property
    def source(self) -> dict[str, Any]:
        """Of the run's spec. Live attacks have none, and their network is in the folder.

        Raises UsageError where the spec is damaged.
        """
        file = self.folder / stored.SPEC
        if not file.is_file():
            return {}
        source = document.read(file).values.get("source")
        if not isinstance(source, dict):
            raise UsageError(f"{file} is damaged: it has no key 'source' with keys; run it again.")
        return source

    @property
    def av_sees(self) -> str:
        """What the planner was shown, as the spec's key ``av_sees``; empty where nothing is known.

        Raises UsageError where the spec is damaged.
        """
        file = self.folder / stored.SPEC
        return str(document.read(file).values.get("av_sees", "all")) if file.is_file() else ""

    def recording(self) -> Scene | None:
        """The recorded scene, from the run's first step on; None where its source is none.

        Raises ReaderError or UsageError where it cannot be read.
        """
        source = self.source
        if "recording" not in source:
            return None
        scene = _recorded(Path(source["recording"]), self.scene)
        return scene.later(round(source.get("start_s", 0.0) / scene.dt_s))

    def road(self) -> tuple[RoadMap, str]:
        """The recording's map, or the network's; and why it is not the one that was attacked on.

        A network's has the buildings and the water that were there.

        Where the recording is gone, it is the network in the run's folder.
        """
        source = self.source
        lost = ""
        if "recording" in source:
            try:
                return _recorded(Path(source["recording"]), self.scene).road, ""
            except (ReaderError, UsageError) as error:
                lost = f"{self.run_id}: road of the converted network, since {error}"
        net = stored.net_file(self.folder)
        if net is None:
            raise UsageError(f"{self.folder}/sumo holds no net.net.xml; run it again for figures.")
        drawn = stored.map_file(self.folder)
        return road_of_net(net, [drawn] if drawn else []), lost

    def unattacked(self) -> Counterfactual | None:
        """Where the opponent would have been without the attack, as the run was judged.

        None where that is not known. Runs of earlier versions do not tell: they were judged by the
        recording, and on networks by the prediction of the first plan. Raises `stored.DAMAGE`.
        """
        kept = artifacts.read_unattacked(self.folder)
        if kept is not None:
            return kept
        opponent = self.rollout.opponent_id
        try:
            scene = self.recording()
        except (ReaderError, UsageError):
            return None
        if scene is None:
            return artifacts.read_predicted(self.folder)
        tracks = scene.tracks
        if opponent not in tracks.ids:
            return None
        row = tracks.row(opponent)
        return Counterfactual(by="log", position_m=tracks.position_m[row], known=tracks.valid[row])

    @property
    def judged_by_plan(self) -> bool:
        """Whether an earlier version judged it, in SUMO's traffic, by what its own plan predicted.

        Methods whose plans predict nothing were judged without a motion to compare with.
        """
        if self.status != "ok" or not self.has_result:
            return False
        try:
            found, file = self.result, self.folder / stored.SPEC
            if not found["opponent"] or found["counterfactual"] is not None:
                return False
            traffic = document.read(file).values.get("traffic") if file.is_file() else None
        except stored.DAMAGE:  # what is damaged is reported where it is shown
            return False
        return found["network"] is not None or traffic == "sumo"


def without_ladder(runs: Sequence[Run]) -> str:
    """A sentence on the hits of versions without a ladder; empty if there are none."""
    hits = [run for run in runs if run.hit]
    old = sum(findings.earlier(run.metrics) for run in hits)
    return findings.earlier_note(old, len(hits))


def judged_before(runs: Sequence[Run]) -> str:
    """A sentence on the runs that an earlier version judged by their own plans; empty if none."""
    return before_note(sum(run.judged_by_plan for run in runs), len(runs))


def before_note(count: int, among: int) -> str:
    """A sentence on runs that an earlier version judged by their own plans; empty for none."""
    if not count:
        return ""
    return (
        f"an earlier version judged {count} of {among} runs, in traffic of SUMO, by what their"
        " own plan predicted (DeepMF, CAT) or without it (other methods): compare their avoidable"
        " hits neither with each other nor with those of this version; run them again"
    )


@dataclass(frozen=True, kw_only=True)
class Results:
    """The runs of result folders.

    Attributes:
        folders: the result folders.
        runs: all runs that ``runs.csv`` lists, in its order, folder by folder.
    """

    folders: tuple[Path, ...]
    runs: tuple[Run, ...]

    @classmethod
    def open(cls, *folders: Path | str) -> Self:
        """The runs of result folders. A folder may contain result folders instead, e.g. of seeds.

        Raises UsageError where there is no result folder, or ``runs.csv`` is missing or damaged.
        """
        paths = [Path(folder) for folder in folders]
        listed = [
            out
            for path in paths
            for out in ([path] if (path / stored.RUNS).is_file() else stored.result_folders(path))
        ]
        runs = [Run.of_row(out, row) for out in listed for row in stored.rows_of(out)]
        return cls(folders=tuple(listed), runs=tuple(runs))

    @classmethod
    def of(cls, out: Path) -> Self:
        """The runs of one result folder. Raises UsageError where it is none, or is damaged."""
        return cls(folders=(out,), runs=tuple(Run.of_row(out, row) for row in stored.rows_of(out)))

    @property
    def done(self) -> tuple[Run, ...]:
        """The successful runs, without those that a plan has for other budgets or figures."""
        return tuple(run for run in self.runs if run.part == "main" and run.status == "ok")

    @property
    def steered(self) -> tuple[Run, ...]:
        """The successful runs that a plan has for figures: they aimed at an impact sector."""
        return tuple(run for run in self.runs if run.part == "figures" and run.status == "ok")

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods of `done`, in the order of ``runs.csv``."""
        return tuple(dict.fromkeys(run.method for run in self.done))

    @property
    def planners(self) -> tuple[str, ...]:
        """Planners of `done`, in the order of ``runs.csv``."""
        return tuple(dict.fromkeys(run.planner for run in self.done))

    @property
    def missing(self) -> tuple[str, ...]:
        """Ids of runs that a manifest lists and ``runs.csv`` does not: they have not ended."""
        listed = {run.folder for run in self.runs}
        return tuple(
            run_id
            for out in self.folders
            if (out / stored.MANIFEST).is_file()
            for run_id in stored.keys_of(out)
            if out / "runs" / run_id not in listed
        )

    def frame(self, kind: "Kind" = "runs") -> "pd.DataFrame":
        """All runs, attacks or contacts as a table, see docs/reference/python.md.

        Args:
            kind: ``runs``: a row a run, with all quantities and metrics; ``attacks``: a row an
                attack of it, of which there are several where opponents attack in turn;
                ``contacts``: a row a contact.

        A missing value is None or NaN. Raises UsageError where a file of a run is damaged, or for
        another kind.
        """
        from deepmf_sumo.results import frames  # brings pandas along

        return frames.frame(self, kind)


def without_trials(result: Result) -> Result:
    """The result without the trials of a search: those of thousands of runs are large."""
    if result["status"] == "ok":
        result["search"].pop("trials", None)
    return result


def _text(file: Path) -> str:
    return files.content(file).decode("utf-8", "replace") if file.is_file() else ""


@lru_cache(maxsize=16)
def _recorded(recording: Path, scene: str) -> Scene:
    """Kept, since several figures show the same scene."""
    return readers.scene(recording, scene, cache_folder())
