"""One copy of a set of weights in each process, however many adversaries use it."""

from functools import lru_cache
from pathlib import Path

from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.strive.motion_prior import MotionPrior
from deepmf_sumo.predictors.weights import NETWORKS, Predictors


def predictors(name: str | Path) -> Predictors:
    """As `weights.load`; read again where a file of its networks has changed since.

    Raises WeightsError where they cannot be used.
    """
    folder = weights.find(name).resolve()
    files = [
        file  # members of a network have names that begin like its own
        for network in NETWORKS
        for suffix in ("safetensors", "json")
        for file in sorted(folder.glob(f"{network}*.{suffix}"))
    ]
    changed = tuple((file.name, file.stat().st_mtime_ns) for file in files)
    return _loaded(folder, changed)


def motion_prior(name: str | Path) -> MotionPrior:
    """As `weights.motion_prior`; read again where its tensor file has changed since.

    Raises WeightsError where the set has none, or it cannot be used.
    """
    folder = weights.find(name).resolve()
    file = folder / "strive.safetensors"
    return _motion_prior(folder, file.stat().st_mtime_ns if file.is_file() else 0)


@lru_cache(maxsize=2)
def _motion_prior(folder: Path, changed: int) -> MotionPrior:  # noqa: ARG001 - part of the key
    return weights.motion_prior(folder)


@lru_cache(maxsize=4)
def _loaded(
    folder: Path,
    changed: tuple[tuple[str, int], ...],  # noqa: ARG001 - part of the key
) -> Predictors:
    return weights.load(folder)
