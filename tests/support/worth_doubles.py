"""What made-up hits are worth: as values, and as the metrics that results have of them."""

from deepmf_sumo.judge.ladder import DRIVERS, RUNGS
from deepmf_sumo.results.findings import Worth


def worth(rung="B", by=("cc", "search")):
    """On a rung of the ladder."""
    return Worth(rung=rung, finding=rung in "AB", avoided_by=tuple(by))


def metrics(rung="B", by=("cc", "search")):
    """What `findings.worth` reads it from."""
    drivers = {f"avoided_by_{name}": float(name in by) for name in DRIVERS}
    return {"finding": float(rung in "AB"), "rung": float(RUNGS.index(rung)), **drivers}
