"""What a benchmark's folder says of its plan: all that tables need, without specs and scenes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo.benchmark import files
from deepmf_sumo.errors import UsageError

FILE: Final = "study.json"
FORMAT_VERSION: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Budgeted:
    """Runs with other budgets than the methods' own.

    Attributes:
        budgets: by method, ``{simulations, seconds}`` each.
        planners, scenes: on which.
    """

    budgets: Mapping[str, list[dict[str, Any]]]
    planners: list[str]
    scenes: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A benchmark.

    Attributes:
        name: of the plan. version: of the program.
        methods, planners, scenes: labels and names, in the plan's order; without methods that are
            run for figures alone.
        baseline, versions, compared: see `plan.Tables`.
        equal_seconds, curves: None where the plan has none.
        runs: run id -> key, in the plan's order; all of them, whatever shard this is.
        plan: as written, with all paths absolute.
    """

    name: str
    version: str
    methods: list[str]
    planners: list[str]
    scenes: list[str]
    baseline: str
    versions: list[str]
    compared: list[str]
    equal_seconds: Budgeted | None
    curves: Budgeted | None
    runs: dict[str, str]
    plan: dict[str, Any]

    def planned(self, method: str, planner: str, most_scenes: int | None = None) -> int:
        """Runs of a method on a planner, with its own budget, on the first scenes of the plan."""
        wanted = self.plan["methods"][method]
        if wanted["planners"] and planner not in wanted["planners"]:
            return 0
        scenes = wanted["scenes"]
        some = len(self.scenes) if scenes == "all" else min(scenes["first"], len(self.scenes))
        some = some if most_scenes is None else min(some, most_scenes)
        return some * len(self.plan["seeds"])

    def write(self, folder: Path) -> None:
        """Write it into a result folder."""
        values = asdict(self)
        values["runs"] = [list(pair) for pair in self.runs.items()]  # JSON objects are sorted here
        files.write_json(folder / FILE, {"format_version": FORMAT_VERSION, **values})


def read(folder: Path) -> Layout:
    """The layout of a benchmark's folder. Raises UsageError where it is none of this version."""
    file = folder / FILE
    try:
        values = json.loads(file.read_text("utf-8"))
    except OSError:
        raise UsageError(f"{folder} is no benchmark's folder: it has no {FILE}.") from None
    except ValueError as error:
        raise UsageError(f"{file} is damaged ({error}); run the benchmark again.") from None
    found = values.get("version") if isinstance(values, dict) else None
    if found != deepmf_sumo.__version__ or values.pop("format_version", None) != FORMAT_VERSION:
        raise UsageError(
            f"{folder} was made by version {found} of deepmf-sumo, and this is"
            f" {deepmf_sumo.__version__}: results of two versions do not go into one table; "
            "choose another folder, or run that version."
        )
    for key in ("equal_seconds", "curves"):
        values[key] = Budgeted(**values[key]) if values[key] else None
    values["runs"] = dict(values["runs"])
    return Layout(**values)
