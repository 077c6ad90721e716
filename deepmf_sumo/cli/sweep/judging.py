"""``--thresholds`` and ``--baseline``: `deepmf-sumo check` at the end of a sweep."""

from pathlib import Path

import deepmf_sumo
from deepmf_sumo.benchmark import gate
from deepmf_sumo.benchmark.gate import junit
from deepmf_sumo.cli.screen import gate as screen
from deepmf_sumo.cli.sweep.options import Sweep
from deepmf_sumo.errors import UsageError


def check(sweep: Sweep) -> None:
    """Raise UsageError for files that no result could be judged by."""
    if sweep.thresholds is None:
        if sweep.baseline:
            raise UsageError(f"--baseline {sweep.baseline}: give --thresholds as well.")
        return
    named = gate.load(sweep.thresholds).baseline.results
    place = sweep.baseline or (Path(named) if named else None)
    if place:
        version = gate.read(place).version
        if version != deepmf_sumo.__version__:
            raise UsageError(
                f"{place} was made by version {version} of deepmf-sumo, and this is"
                f" {deepmf_sumo.__version__}: the attacks differ; write the baseline anew."
            )


def judge(sweep: Sweep) -> int:
    """Judge the result folder, show the verdict, and write it to junit.xml where asked for."""
    assert sweep.thresholds is not None
    verdict = gate.check(sweep.out, gate.load(sweep.thresholds), sweep.baseline)
    screen.show(verdict)
    if sweep.junit:
        junit.write(sweep.out / "junit.xml", verdict)
    return verdict.exit_code
