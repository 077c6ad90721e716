"""Cores, memory, weights and the cache."""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Final

from deepmf_sumo.cli.health.finding import Finding, probe

_MB: Final = 2**20
_RUN_MB: Final = 1000
"""A run with DeepMF's networks, and the process that leads it."""
_CGROUP: Final = Path("/sys/fs/cgroup/memory.max")


def cores() -> Finding:
    """Cores that this process may use, for --jobs."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return Finding(name="cores", state="ok", text=f"{usable or 1}: --jobs {usable or 1}")


def memory() -> Finding:
    """Memory that is free, within the container's limit."""
    free, limit = _free_mb(), _limit_mb()
    if free is None:
        return Finding(name="memory", state="ok", text="not known on this system")
    usable = min(free, limit) if limit is not None else free
    enough = usable >= _RUN_MB
    told = f"{free:.0f} MB free" + (f", limit {limit:.0f} MB" if limit is not None else "")
    need = f"; a run needs about {_RUN_MB} MB" if not enough else ""
    return Finding(name="memory", state="ok" if enough else "warning", text=told + need)


def weights(name: str) -> Finding:
    """Whether a set of weights is there and fits the networks; which others there are."""
    good, text = probe(
        "import sys; from deepmf_sumo.errors import DeepmfError\n"
        "from deepmf_sumo.predictors import weights\n"
        f"try: folder = weights.load({name!r}).folder; lacking = weights.unchecked(folder)\n"
        "except DeepmfError as error: sys.exit(' '.join(str(error).split()))\n"
        "print(folder, *([f'({len(lacking)} cards without a digest of their tensors)']"
        " if lacking else []))"
    )
    there = {file.parent.name for home in _homes() for file in home.glob("*/opponent.json")}
    also = f"; also there: {', '.join(sorted(there - {name}))}" if there - {name} else ""
    return Finding(name=f"weights {name}", state="ok" if good else "broken", text=text + also)


def cache() -> Finding:
    """Whether converted networks can be kept, how much is, and how much space is left."""
    from deepmf_sumo.benchmark.home import cache_folder

    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        hint = "set DEEPMF_SUMO_HOME to a folder that can"
        text = f"{folder} cannot be written ({error.strerror}); {hint}"
        return Finding(name="cache", state="broken", text=text)
    held = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / _MB
    free = shutil.disk_usage(folder).free / _MB
    text = f"{folder}, {held:.0f} MB in it, {free:.0f} MB left"
    return Finding(name="cache", state="ok" if free >= 100 else "warning", text=text)


def _homes() -> list[Path]:
    """Where sets of weights are looked up by name."""
    root = os.environ.get("DEEPMF_SUMO_HOME")
    return [Path(".weights"), *([Path(root) / "weights"] if root else [])]


def _free_mb() -> float | None:
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return None
    sizes = {line.partition(":")[0]: line.split()[1] for line in lines if line.endswith("kB")}
    return float(sizes["MemAvailable"]) / 1024 if "MemAvailable" in sizes else None


def _limit_mb() -> float | None:
    """Of the container; None without one."""
    try:
        text = _CGROUP.read_text("ascii").strip()
    except OSError:
        return None
    return None if text == "max" else int(text) / _MB
