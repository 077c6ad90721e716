"""A set of runs to judge, or to compare with another: of a result folder, or of a small file.

A later job compares with that file (`results.json`): a result folder is too large to keep.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import planned, sessions, stored
from deepmf_sumo.results.frames import digest_of
from deepmf_sumo.results.quantities import COMPARABLE
from deepmf_sumo.results.reader import Run, without_ladder
from deepmf_sumo.results.setups import renewed, setup_of

FORMAT_VERSION: Final = 3
"""Files of format 2 are read: they contain less of the setup of attacks."""
_KIND: Final = "deepmf-sumo results"
_DIGITS: Final = 6
_KEYS: Final = {
    "run_id": "run_id", "spec": "spec", "network": "network", "scene": "scene", "seed": "seed",
    "method": "method", "planner": "planner_label", "moment": "moment", "attack": "setup",
    "source": "source", "status": "status", "judged": "judged", "reason": "error",
    "broken": "expectations_broken",
}  # fmt: skip
"""Keys of a run in the file, in their order, and the columns of the frame that they contain."""
_TEXTS: Final = frozenset(_KEYS.values()) - {"seed", "judged", "expectations_broken"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunSet:
    """Runs without those of other budgets and figures, and the version of their program.

    Attributes:
        runs: a frame as of `Results.frame`, with all runs that were planned. No text is missing:
            the network of a recording is its scene, ``error`` says why a run has no value.
        attacks: by the digest in the column ``setup``, what makes the attack, see `setups`.
        switched_off: sentences on times in which a live session could not attack.
        earlier: a sentence on hits that an earlier version judged without a ladder; else empty.
        each: the runs themselves, in the order of the frame; none of a file.
    """

    source: Path
    version: str
    runs: pd.DataFrame
    attacks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    switched_off: tuple[str, ...] = ()
    earlier: str = ""
    each: tuple[Run, ...] = ()


def read(path: Path) -> RunSet:
    """The runs of a result folder, or of a file of `write`.

    Raises UsageError where it is neither, is damaged, or is of another format.
    """
    return _of_folder(path) if path.is_dir() else _of_file(path)


def write(path: Path, found: RunSet) -> None:
    """Write the file that a later job compares with. Raises OutputError."""
    rows = [
        {key: row[column] for key, column in _KEYS.items()}
        | {"values": {name: row[name] for name in COMPARABLE if not pd.isna(row[name])}}
        for row in found.runs.to_dict("records")
    ]
    values = {
        "kind": _KIND,
        "format_version": FORMAT_VERSION,
        "version": found.version,
        "attacks": found.attacks,
        "runs": rows,
    }
    with files.writing(path):
        files.write_json(path, values)


def _of_folder(out: Path) -> RunSet:
    version = str(stored.manifest_of(out).get("version"))
    found = planned.read(out)
    setups = [setup_of(run.result) for run in found.runs if run.has_result]
    runs = found.frame()
    runs["wall_s"] = runs["wall_s"].fillna(0.0)
    runs["network"] = runs["network"].where(runs["network"].notna(), runs["scene"])
    ended = runs["status"] == "ok"
    runs.loc[ended, "error"] = ""
    runs.loc[ended & ~runs["judged"], "error"] = "no vehicle to attack"
    return RunSet(
        source=out,
        version=version,
        runs=_rounded(_with_texts(runs)),
        attacks={digest_of(setup): setup for setup in setups},
        switched_off=sessions.switched_off(out),
        earlier=without_ladder(found.runs),
        each=found.runs,
    )


def _with_texts(runs: pd.DataFrame) -> pd.DataFrame:
    texts = {name: runs[name].where(runs[name].notna(), "").astype(object) for name in _TEXTS}
    return runs.assign(**texts)


def _rounded(runs: pd.DataFrame) -> pd.DataFrame:
    """As the file keeps them, so that a folder and its file are compared alike."""
    values = {
        name: [value if pd.isna(value) else round(float(value), _DIGITS) for value in runs[name]]
        for name in COMPARABLE
    }
    return runs.assign(**values)


def _of_file(file: Path) -> RunSet:
    if not file.exists():
        raise UsageError(f"{file}: no such file or folder; write it with --write-baseline.")
    values = stored.mapping(file, again="write it with --write-baseline")
    if values.get("kind") != _KIND:
        raise UsageError(f"{file} is not a results file; write it with --write-baseline.")
    if values.get("format_version") not in {2, FORMAT_VERSION}:
        raise UsageError(
            f"{file} has format {values.get('format_version')}, this version of deepmf-sumo reads"
            f" format {FORMAT_VERSION}; write it again with --write-baseline."
        )
    try:
        rows = [_kept(row) for row in values["runs"]]
        version = str(values["version"])
        attacks = {str(digest): renewed(setup) for digest, setup in values["attacks"].items()}
        runs = frame_of(rows)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f"{file} is damaged ({error}); write it with --write-baseline.") from None
    return RunSet(source=file, version=version, runs=runs, attacks=attacks)


def _kept(values: dict[str, Any]) -> dict[str, Any]:
    """A row of a results file. Raises KeyError or TypeError for what is none."""
    numbers = dict(values["values"])
    if not all(isinstance(number, int | float) for number in numbers.values()):
        raise TypeError("a value is not a number")
    whole = dict.fromkeys(_KEYS, "") | {"judged": False} | values
    row = {column: whole[key] for key, column in _KEYS.items()}
    needed = {key: values[key] for key in ("run_id", "spec", "network", "scene", "seed", "status")}
    return {**numbers, **row, **needed, "expectations_broken": tuple(values["broken"])}


def frame_of(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """The frame of rows of a file, without columns of which a file says nothing."""
    names = [*_KEYS.values(), *COMPARABLE]
    runs = pd.DataFrame({name: [row.get(name) for row in rows] for name in names})
    kinds = dict.fromkeys(COMPARABLE, float) | dict.fromkeys(_TEXTS, object)
    return _with_texts(runs.astype({**kinds, "seed": int, "judged": bool}))
