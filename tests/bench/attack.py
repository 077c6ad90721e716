"""What `deepmf-sumo attack` costs: ``python -m tests.bench.attack CONFIG... [-- OPTIONS]``.

Every CONFIG, a .sumocfg, is attacked with the code of this checkout and with that of an earlier
commit (one try a moment), in turns. Printed: seconds of processor time of the whole commands, with
their start, workers and risk map, of each round, and the ratio of their medians. OPTIONS are for
`attack` here alone, e.g. ``--set adversary.tries=1``.
"""

import argparse
import ctypes
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from tests.golden.__main__ import ROOT, checkout

LIMIT: Final = 2.2
"""The ratio that an attack may have: its tries must not cost what they are worth."""
_CHILD_SUBREAPER = 36
_PROGRAM = "import sys; from deepmf_sumo.cli.main import main; sys.exit(main())"


def main() -> None:
    """Print a line for each configuration; ends with 1 where a ratio is above `LIMIT`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("configs", metavar="CONFIG", nargs="+", type=Path)
    parser.add_argument("--base", default="d79e5b9", help="the earlier commit, or its files")
    parser.add_argument("--moments", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    here = sys.argv[1:]
    cut = here.index("--") if "--" in here else len(here)
    options, more = parser.parse_args(here[:cut]), here[cut + 1 :]
    base = Path(options.base) if Path(options.base).is_dir() else checkout(options.base)
    adopt_orphans()
    worst = 0.0
    for config in options.configs:
        spent: tuple[list[float], list[float]] = ([], [])
        with tempfile.TemporaryDirectory() as folder:
            for number in range(-1, options.rounds):  # the first one compiles and warms up
                for tree, seconds, given in ((base, spent[0], []), (ROOT, spent[1], more)):
                    asked = [str(config.absolute()), "--moments", str(options.moments), *given]
                    found = attacked(tree, asked, Path(folder))
                    if number >= 0:
                        seconds.append(found)
        ratio = statistics.median(spent[1]) / statistics.median(spent[0])
        worst = max(worst, ratio)
        before, now = (", ".join(f"{one:.1f}" for one in each) for each in spent)
        load = os.getloadavg()[0]
        print(f"{config.name}: {before} s before, {now} s now; ratio {ratio:.2f} (load {load:.1f})")
    sys.exit(worst > LIMIT)


def attacked(tree: Path, options: list[str], folder: Path) -> float:
    """Seconds of processor time of an attack with the code of ``tree``, one worker."""
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "PYTHONPYCACHEPREFIX": str(folder / "compiled"),
        "PYTHONDONTWRITEBYTECODE": "",
        "DEEPMF_SUMO_HOME": str(folder / "home"),
    }
    begin = spent()
    with tempfile.TemporaryDirectory(dir=folder) as out:
        subprocess.run(
            [sys.executable, "-c", _PROGRAM, "attack", *options, "--jobs", "1", "--out", out],
            env=environment,
            cwd=folder,
            check=True,
            capture_output=True,
        )
        wait_for_orphans()
    return spent() - begin


def adopt_orphans() -> None:
    """Become the parent of workers' processes whose parent has ended: else nobody counts them."""
    ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)


def wait_for_orphans() -> None:
    """Until no process is left."""
    while True:
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def spent() -> float:
    """Seconds of processor time of all processes that have ended and been waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
