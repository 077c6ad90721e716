"""The files of a result folder, read with a size limit and checked for the shape that readers use.

A folder may come from elsewhere, or be damaged. An error is one sentence that names the file.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TextIO, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.exporters import fcd
from deepmf_sumo.judge.ladder import Rung
from deepmf_sumo.results import result
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec.tasks import is_run_id
from deepmf_sumo.tables import read_csv

_LARGEST: Final = 2**26
"""Bytes of a JSON file: thousands of trials of a search are some MB."""

_LARGEST_UNPACKED: Final = 2**28
"""Bytes of tracks or plans."""

MOST_STEPS: Final = 1_000_000
"""A day is 864 000."""

DAMAGE: Final = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, MemoryError,
    EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, UsageError,
)  # fmt: skip
"""What files raise that are cut short, or contain something else."""

FORMAT_VERSION: Final = 1
RUNS: Final = "runs.csv"
MANIFEST: Final = "manifest.json"
SUMMARY: Final = "summary.json"
MOMENTS: Final = "moments.csv"
FLOW: Final = "flow.csv"
RESULT: Final = "result.json"
"""Of the folder of a run, as the two that follow."""
SPEC: Final = "spec.yaml"
LOG: Final = "log.txt"

NEEDED: Final = (
    "run_id", "status", "spec", "scene", "planner", "perception", "adversary", "version", "seed",
    "outcome", "opponent", "contact_time_s", "contact_speed_mps", "generation_s", "cycle_ms_median",
)  # fmt: skip
"""Columns of ``runs.csv`` in all versions."""

_WITHOUT: Final = "run it again, or remove it: places then come from the tracks alone"
_NO_FLOW: Final = "run it again, or remove it: the map is then without flows"
_AGAIN: Final = "remove the run's folder and go on with --resume"


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


class _Metric(_Part):
    value: float | None
    unit: str = ""
    reason: str = ""


_Pose = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Contact(_Part):
    kind: str
    step: int = Field(default=0, ge=0)
    pose_first: _Pose = [0.0] * 3
    pose_second: _Pose = [0.0] * 3
    first_id: str = ""
    second_id: str = ""
    relative_mps: float = 0.0
    sector: int = Field(default=0, ge=0, le=7)
    time_s: float = 0.0


class _Event(_Part):
    step: int
    agent_id: str
    kind: str


class _Turn(_Part):
    opponent: str
    begin_s: float
    end_s: float
    ended: str
    outcome: str
    hit_speed_mps: float | None
    metrics: dict[str, float | None]


class _Samples(_Part):
    opponent_m: list[Annotated[list[float], Field(min_length=2, max_length=2)]]
    attack_mps2: list[float]
    recorded_mps2: list[float]


class _SearchPart(_Part):
    simulations: int
    tries: list[str] = []


class _BudgetPart(_Part):
    simulations: int | None = None
    seconds: float | None = None


class _Settings(_Part):
    planner: dict[str, Any]
    adversary: dict[str, Any]


class _Timings(_Part):
    wall_s: float
    generation_s: float | None = None
    cycle_ms_median: float | None = None
    simulation_s: float | None = None


class _Verdict(_Part):
    """`judge.ladder.Verdict`."""

    rung: Rung
    reasons: list[str]
    av_error: str
    opponent_error: str
    avoided_by: list[str]


class _Cause(_Part):
    """`judge.causes.Cause`."""

    change: str
    what: str
    last_moment_s: dict[str, float | None]
    changes: dict[str, bool]


class _PlannedRun(_Part):
    """`result.identity`."""

    spec: str
    scene: str
    network: str | None
    seed: int
    method: str
    planner_label: str
    part: str


class _Result(_Part):
    """``result.json``; keys with a default are not in those of all versions."""

    run_id: str
    key: str
    spec: str
    scene: str
    network: str | None = None
    planner: str
    perception: str | None = None
    adversary: str
    profile: str = ""
    constraints: list[str] = []
    method: str = ""
    planner_label: str = ""
    base_method: str = ""
    part: str = "main"
    weights: str | None = None
    seed: int
    settings: _Settings
    budget: _BudgetPart = _BudgetPart()
    setup: dict[str, Any] | None = None
    inputs: dict[str, str] = {}
    planner_fault: str | None = None
    status: Literal["ok", "failed", "timeout", "skipped"]
    error: str
    expectations_broken: list[str]
    timings: _Timings


class _Made(_Part):
    """Somebody who was made, see `scene.MadeRoadUser`."""

    id: str
    place: str


class _Support(_Part):
    """`scene.plan.Support`, and the first step of its plan."""

    step: int
    agent_id: str | None
    ways: dict[str, float]
    probability: float
    note: str


class _Finished(_Result):
    """That of a run that succeeded."""

    outcome: str
    ended: str
    steps: int = Field(ge=0)
    duration_steps: int = 0
    opponent: str | None
    counterfactual: str | None = None
    opponent_score: float | None = None
    contacts: Sequence[_Contact]
    events: list[_Event] = []
    metrics: Mapping[str, _Metric]
    finding: _Verdict | None = None
    cause: _Cause | None = None
    plain: Mapping[str, _Metric] = {}
    samples: _Samples | None = None
    rules: list[str] = []
    repairs: list[str] = []
    search: _SearchPart
    turns: list[_Turn] | None = None
    support: list[_Support] = []
    made: list[_Made] = []


class _WholeMetric(_Metric):
    unit: str
    better: str


class _WholeContact(_Contact):
    step: int = Field(ge=0)
    relative_mps: float
    sector: int = Field(ge=0, le=7)
    time_s: float


class _WholeTimings(_Timings):
    generation_s: float
    cycle_ms_median: float | None
    simulation_s: float | None


class _Whole(_Finished):
    """As this version writes it: the source of a batch's tables."""

    budget: _BudgetPart
    opponent_score: float | None
    contacts: Sequence[_WholeContact]
    metrics: Mapping[str, _WholeMetric]
    timings: _WholeTimings


def result_of(file: Path, *, whole: bool = False) -> Result:
    """A run's ``result.json``, ``whole`` as this version writes it.

    What results of earlier versions lack has the defaults of `_Finished`, so that readers find
    every key that they have there. Raises UsageError where it cannot be read, or is not one.
    """
    found = mapping(file, again=_AGAIN)
    went: type[_Result] = _Whole if whole else _Finished
    shape = went if found.get("status") == "ok" else _Result
    try:
        _complete(shape.model_validate(found), found)
    except ValidationError as error:
        raise UsageError(
            f"{file} is not a result of this version of deepmf-sumo ({first_wrong(error)});"
            f" {_AGAIN}."
        ) from None
    if not is_run_id(found["run_id"]):
        raise _damaged(file, f"run_id: {found['run_id'][:80]!r} is not the id of a run", _AGAIN)
    return cast(Result, found)


def _complete(part: _Part, found: dict[str, Any]) -> None:
    """Add the defaults of the keys that are missing, at all depths."""
    for name in type(part).model_fields:
        value = getattr(part, name)
        inside = found.setdefault(name, value.model_dump() if isinstance(value, _Part) else value)
        if isinstance(value, _Part):
            _complete(value, inside)
        elif isinstance(value, list) or name in {"metrics", "plain"}:
            known = value.items() if isinstance(value, dict) else enumerate(value)
            for key, one in known:
                if isinstance(one, _Part):
                    _complete(one, inside[key])


def run_folder(out: Path, run_id: object, file: str) -> Path:
    """The folder of a run that ``file`` of a result folder names.

    Raises UsageError for what is not the id of a run: it could be a path to somewhere else.
    """
    if not is_run_id(run_id):
        raise UsageError(
            f"{out / file} is damaged: {str(run_id)[:80]!r} is not the id of a run (lower-case"
            " letters, digits and dashes); run it again."
        )
    return out / "runs" / str(run_id)


def manifest_of(out: Path) -> dict[str, Any]:
    """The manifest of a result folder. Raises UsageError where there is none of this version."""
    file = out / MANIFEST
    if not file.exists():
        raise UsageError(f"{out} is not a result folder: it has no manifest.json.")
    manifest = mapping(file)
    if manifest.get("tool") != "deepmf-sumo":
        raise UsageError(f"{file} is not a manifest of deepmf-sumo.")
    if manifest.get("format_version") != FORMAT_VERSION:
        raise UsageError(
            f"{out} has format {manifest.get('format_version')}, this version of deepmf-sumo reads"
            f" format {FORMAT_VERSION}; run it again."
        )
    return manifest


def keys_of(out: Path) -> dict[str, str]:
    """Run id -> key of all runs of a folder's manifest. Raises UsageError where it is damaged."""
    file = out / MANIFEST
    keys = mapping(file).get("runs")
    if not isinstance(keys, dict) or not all(isinstance(key, str) for key in keys.values()):
        raise UsageError(f"{file} is damaged: it names no runs; run it again.")
    for run_id in keys:
        run_folder(out, run_id, file.name)
    return keys


def missing(out: Path) -> int:
    """Runs without a row in ``runs.csv``, with those whose moments are not decided yet.

    Raises UsageError where manifest or table are damaged.
    """
    undecided = mapping(out / MANIFEST).get("undecided", 0)
    return len(keys_of(out)) - len(rows_of(out)) + (undecided if isinstance(undecided, int) else 0)


def planned_of(out: Path) -> dict[str, dict[str, Any]]:
    """`result.identity` of each run of the manifest; earlier versions did not write it.

    Raises UsageError where it is damaged.
    """
    file = out / MANIFEST
    found = mapping(file).get("planned", {})
    try:
        return {str(run_id): dict(_PlannedRun.model_validate(one)) for run_id, one in found.items()}
    except (AttributeError, ValidationError):
        raise _damaged(file, "planned: it does not name the runs", "run it again") from None


def inputs_of(out: Path) -> dict[str, str]:
    """Digests of the files that the runs of the manifest read, by path; none without a manifest."""
    try:
        found = mapping(out / MANIFEST)["machine"]["inputs"]
    except (UsageError, LookupError, TypeError):
        return {}
    return dict(found) if isinstance(found, dict) else {}


def rows_of(out: Path) -> list[dict[str, str]]:
    """The rows of ``runs.csv``, in its order.

    Raises UsageError where there is no such file, or it is damaged or cut short: part of the runs
    must not pass for all of them.
    """
    file = out / RUNS
    if not file.is_file():
        begun = (out / MANIFEST).is_file()
        rest = "finish it with --resume" if begun else "give the --out of an earlier command"
        raise UsageError(f"{out} is not a complete result folder: it has no runs.csv; {rest}.")
    rows = read_csv(file)
    lost = [name for name in NEEDED if rows and name not in rows[0]]
    if lost:
        raise UsageError(f"{file} has no column '{lost[0]}': it is not of deepmf-sumo.")
    return rows


def moments_of(out: Path) -> dict[str, dict[str, str]]:
    """Where each AV was and went, by run: ``moments.csv``; empty where no moments were chosen.

    Raises UsageError where it is damaged.
    """
    file = out / MOMENTS
    if not file.is_file():
        return {}
    rows = read_csv(file, _WITHOUT)
    if rows and "run_id" not in rows[0]:
        raise UsageError(f"{file} is not a table of moments (column run_id); {_WITHOUT}.")
    return {row["run_id"]: row for row in rows}


def flows_of(out: Path) -> list[dict[str, str]]:
    """Vehicles at each place of the traffic: ``flow.csv``; empty where no moments were chosen.

    Raises UsageError where it is damaged.
    """
    file = out / FLOW
    if not file.is_file():
        return []
    rows = read_csv(file, _NO_FLOW)
    if rows and not {"spec", "edge", "following", "vehicles", "near", "hours"} <= rows[0].keys():
        raise UsageError(f"{file} is not a table of flows; {_NO_FLOW}.")
    return rows


def result_folders(folder: Path) -> list[Path]:
    """The folder itself, or the result folders in it, by name.

    Raises UsageError where there is none.
    """
    if (folder / MANIFEST).is_file():
        return [folder]
    inside = sorted(file.parent for file in folder.glob(f"*/{MANIFEST}"))
    if not inside:
        raise UsageError(
            f"{folder} is not a result folder, and contains none: there is no manifest.json; give"
            " the --out of run or attack."
        )
    return inside


def net_file(folder: Path) -> Path | None:
    """The network in a run's folder."""
    return next(iter(sorted((folder / "sumo").glob("net.net.xml*"))), None)


def map_file(folder: Path) -> Path | None:
    """What is drawn beside the network in a run's folder; earlier versions kept none."""
    file = folder / "sumo" / fcd.MAP
    return file if file.is_file() else None


def mapping(file: Path, *, again: str = "run it again") -> dict[str, Any]:
    """The JSON object in a file. Raises UsageError where there is none, saying ``again``."""
    try:
        found: Any = json.loads(files.content(file, _LARGEST))
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {files.reason(error)}.") from None
    except ValueError as error:
        raise _damaged(file, f"{error}"[:200], again) from None
    except RecursionError:
        raise _damaged(file, "nested too deeply", again) from None
    if not isinstance(found, dict):
        raise _damaged(file, "it is not a mapping of names to values", again)
    if wrong := result.not_finite(found):  # e.g. 1e400: nothing here writes that
        raise _damaged(file, f"{wrong} is not a finite number", again)
    return found


@contextmanager
def arrays(file: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """The arrays of a ``.npz``. Raises OSError and what a damaged file raises, see `DAMAGE`."""
    content = io.BytesIO(files.content(file, _LARGEST))
    with zipfile.ZipFile(content) as archive:
        if sum(member.file_size for member in archive.infolist()) > _LARGEST_UNPACKED:
            raise ValueError(f"{file.name} unpacks to more than {_LARGEST_UNPACKED} bytes")
    content.seek(0)
    with np.load(content, allow_pickle=False) as found:
        yield found


@contextmanager
def tracks(file: Path) -> Iterator[TextIO]:
    """The text of a ``tracks.csv.gz``. Raises OSError, here or from reading, UnicodeError."""
    with (
        files.unpacked(file, _LARGEST_UNPACKED) as stream,
        io.TextIOWrapper(stream, "utf-8", newline="") as text,
    ):
        yield text


def first_wrong(error: ValidationError) -> str:
    """The first key that is wrong, and why."""
    first = error.errors()[0]
    key = ".".join(map(str, first["loc"]))
    return f"{key}: {first['msg'].lower()}"


def _damaged(file: Path, why: str, again: str) -> UsageError:
    return UsageError(f"{file} is damaged ({why}); {again}.")
