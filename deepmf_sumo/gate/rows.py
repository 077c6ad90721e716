"""Result folder -> what a gate needs of each run; and the small file that stores it.

A later job compares with that file (`results.json`): a result folder is too large to keep.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate.setups import moment_of, setup_of
from deepmf_sumo.results import reader, sessions, stored
from deepmf_sumo.results.quantities import COMPARABLE, judged, without_ladder
from deepmf_sumo.results.result import Result
from deepmf_sumo.tasks import slug

FORMAT_VERSION: Final = 3
"""Files of format 2 are read: they contain less of the setup of attacks."""
_KIND: Final = "deepmf-sumo results"
_DIGITS: Final = 6

Status = Literal["ok", "failed", "timeout", "skipped", "missing"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One run.

    Attributes:
        spec: its name, for a run without a result, too.
        network: the .sumocfg without its suffix, or the recording's scene.
        scene: the situation: of a recording, or a moment of a network's traffic.
        planner: its label in tables, e.g. ``idm corridor``.
        moment: when and of which vehicle a network is attacked; empty of a recording.
        attack: digest of what makes the attack, see `setups.setup_of`; `Results.attacks` has it.
        source: digest of the network and its traffic, or of the recording.
        status: ``missing`` for a run of the manifest that has no result.
        judged: whether it says something about the AV, see `quantities.judged`.
        reason: why there is no result. broken: expectations of the spec that do not hold.
        values: by quantity, those that are defined.
    """

    run_id: str
    spec: str
    network: str
    scene: str
    seed: int
    method: str = ""
    planner: str = ""
    moment: str = ""
    attack: str = ""
    source: str = ""
    status: Status
    judged: bool = False
    reason: str = ""
    broken: tuple[str, ...] = ()
    wall_s: float = 0.0
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """All runs of a batch or benchmark, by id, and the version of the program that made them.

    Attributes:
        attacks: by the digest in `Row.attack`, the setup, see `setups.setup_of`.
        switched_off: sentences on times in which a live session could not attack.
        earlier: a sentence on hits that an earlier version judged without a ladder; else empty.
    """

    source: Path
    version: str
    rows: dict[str, Row]
    attacks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    switched_off: tuple[str, ...] = ()
    earlier: str = ""


def read(path: Path) -> Results:
    """The results of a result folder, or of a file of `write`.

    Raises UsageError where it is neither, is damaged, or is of another format.
    """
    return _of_folder(path) if path.is_dir() else _of_file(path)


def write(path: Path, found: Results) -> None:
    """Write the file that a later job compares with. Raises OutputError."""
    rows = [asdict(row) for row in found.rows.values()]
    for row in rows:
        del row["wall_s"]  # so that equal results are equal files
    values = {
        "kind": _KIND,
        "format_version": FORMAT_VERSION,
        "version": found.version,
        "attacks": found.attacks,
        "runs": rows,
    }
    with files.writing(path):
        files.write_json(path, values)


def _of_folder(out: Path) -> Results:
    manifest = stored.manifest_of(out)
    rows: dict[str, Row] = {}
    attacks: dict[str, dict[str, Any]] = {}
    planned = reader.planned(out)
    for run_id, result in planned.items():
        if result is not None:
            rows[run_id] = _row(result)
            attacks.setdefault(rows[run_id].attack, setup_of(result))
    known = stored.planned_of(out)
    lacking = [run_id for run_id, result in planned.items() if result is None]
    for run_id in lacking:
        rows[run_id] = _missing(run_id, known.get(run_id) or _guessed(run_id, rows.values()))
    rows = {run_id: rows[run_id] for run_id in planned}
    return Results(
        source=out, version=str(manifest.get("version")), rows=rows, attacks=attacks,
        switched_off=sessions.switched_off(out),
        earlier=without_ladder(one for one in planned.values() if one is not None),
    )  # fmt: skip


def _missing(run_id: str, known: Mapping[str, Any]) -> Row:
    """The row of a run without a result of this batch."""
    return Row(
        run_id=run_id,
        spec=known["spec"],
        network=known["network"] or known["scene"],
        scene=known["scene"],
        seed=known["seed"],
        method=known["method"],
        planner=known["planner_label"],
        status="missing",
        reason="the run has no result: it was not started, or interrupted",
    )


def _guessed(run_id: str, others: Iterable[Row]) -> dict[str, Any]:
    """What the id of a run says of it, where an earlier version wrote the manifest.

    Ids are in small letters and dashes: names are as in the runs of the same spec, if there are
    any, and network and planner where all of these have the same.
    """
    spec, scene, seed = run_id.rsplit("--", 2)
    of_spec = [row for row in others if slug(row.spec) == spec and row.status != "missing"]

    def common(name: str, otherwise: str) -> str:
        found = {getattr(row, name) for row in of_spec}
        return str(found.pop()) if len(found) == 1 else otherwise

    return {
        "spec": common("spec", spec),
        "scene": scene,
        "network": common("network", scene),
        "seed": int(seed),
        "method": common("method", ""),
        "planner_label": common("planner", ""),
    }


def _row(result: Result) -> Row:
    went = result["status"] == "ok"
    found = {name: one.of(result) for name, one in COMPARABLE.items()} if went else {}
    attack = json.dumps(setup_of(result), sort_keys=True).encode()
    return Row(
        run_id=result["run_id"],
        spec=result["spec"],
        network=result["network"] or result["scene"],
        scene=result["scene"],
        seed=result["seed"],
        method=result["method"] or result["spec"],
        planner=result["planner_label"] or result["planner"],
        moment=moment_of(result),
        attack=hashlib.sha256(attack).hexdigest()[:16],
        source=result["inputs"].get("source", "")[:16],
        status=result["status"],
        judged=judged(result),
        reason=result["error"] if not went or judged(result) else "no vehicle to attack",
        broken=tuple(result["expectations_broken"]),
        wall_s=float(result["timings"]["wall_s"]),
        values={name: round(value, _DIGITS) for name, value in found.items() if value is not None},
    )


def _of_file(file: Path) -> Results:
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
        attacks = {str(digest): dict(setup) for digest, setup in values["attacks"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f"{file} is damaged ({error}); write it with --write-baseline.") from None
    by_id = {row.run_id: row for row in rows}
    return Results(source=file, version=version, rows=by_id, attacks=attacks)


def _kept(values: dict[str, Any]) -> Row:
    """A row of a results file. Raises KeyError or TypeError for what is none."""
    numbers = values["values"]
    if not all(isinstance(number, int | float) for number in dict(numbers).values()):
        raise TypeError("a value is not a number")
    return Row(**{**values, "broken": tuple(values["broken"])})
