"""The pictures of docs/gallery.md: ``python -m tests.docs.gallery``, a minute.

Every packaged scenario is run, and the picture of each hit becomes a WebP file in
``docs/pictures/gallery``; ``docs/pictures/report_page.webp`` is the report of these runs in a
browser. The risk map's page is made by ``front_page.py``. The paper's figures are those of
``docs/figures``, which need recordings (see ``docs/results.md``).
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from matplotlib import image

from deepmf_sumo.cli.init import lay_out
from deepmf_sumo.results.reader import Results

from tests.docs import drawn
from tests.docs.browser import photograph

PICTURES = drawn.PICTURES / "gallery"
OUT = "packaged-attacks"


def keep(picture: Path, name: str) -> None:
    """A picture of a run, as WebP."""
    pixels = image.imread(picture)[..., :3]
    image.imsave(PICTURES / f"{name}.webp", pixels, pil_kwargs={"quality": 80, "method": 6})


def attacked(folder: Path) -> list[Path]:
    """Run the packaged scenarios in this folder, and write their report."""
    lay_out(folder)
    specs = sorted(Path(folder, "scenarios").glob("*.yaml"))
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", "run"]
    command += [f"scenarios/{spec.name}" for spec in specs]
    command += ["--set", "expect={}", "--jobs", "2", "--report", "--out", OUT]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=folder)
    return specs


def main() -> int:
    """Run, convert, and say which runs hit."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        specs = attacked(folder)
        for spec, run in zip(specs, Results.open(folder / OUT).runs, strict=True):
            if run.hit:
                keep(run.folder / "picture.png", spec.stem)
            said = ("outcome", "contact_time_s", "contact_speed_mps")
            print(spec.stem, *(run.row[key] for key in said))
        drawn.keep("gallery")
        if photograph(folder / OUT / "report.html", drawn.PICTURES / "report_page.webp"):
            drawn.keep("report_page.webp")
    return 0


if __name__ == "__main__":
    sys.exit(main())
