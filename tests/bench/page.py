"""Size of a report, and how long a browser takes to show it: ``python -m tests.bench.page OUT``.

OUT is a result folder, say of ``deepmf-sumo attack ... --moments 1000``. Printed: runs, the time
to write the page and its size, and how long headless Chromium takes from its start to a picture of
the page, beside an empty page.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from deepmf_sumo.report import page

BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--window-size=1400,1000",
)  # fmt: skip


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path, help="result folder")
    parser.add_argument("--tries", type=int, default=5)
    options = parser.parse_args()
    start = time.perf_counter()
    written = page.write(options.out.resolve())
    took = time.perf_counter() - start
    runs = sum(1 for _ in (options.out / "runs").iterdir())
    size = written.stat().st_size
    print(f"{runs} runs: {size / 1e6:.1f} MB, {size / 1e3 / runs:.1f} kB a run, {took:.1f} s")
    if BROWSER is None:
        print("no Chromium: how long the page takes to open is not measured")
        return
    load = os.getloadavg()[0]
    shown, empty = (seconds(url, options.tries) for url in (written.as_uri(), "about:blank"))
    print(f"shown in {shown:.1f} s, an empty page in {empty:.1f} s (median, load {load:.1f})")


def seconds(url: str, tries: int) -> float:
    """Median time from the start of the browser to a picture of the page."""
    times = []
    for _ in range(tries):
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / "page.png"
            command = [str(BROWSER), *FLAGS, f"--user-data-dir={folder}/user"]
            start = time.perf_counter()
            subprocess.run(
                [*command, f"--screenshot={picture}", url], check=True, capture_output=True
            )
            times.append(time.perf_counter() - start)
            assert picture.stat().st_size
    return statistics.median(times)


if __name__ == "__main__":
    main()
