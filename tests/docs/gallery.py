"""The pictures of docs/gallery.md: ``python -m tests.docs.gallery``, a minute.

Every packaged scenario is run, and the picture of each hit becomes a WebP file in
``docs/pictures/gallery``. The paper's figures are those of ``docs/figures``,
which need recordings (see ``docs/results.md``).
"""

import shutil
import sys
import tempfile
from pathlib import Path

from matplotlib import image

import deepmf_sumo
from deepmf_sumo.cli.init import lay_out

from tests.docs.pages import DOCS

PICTURES = DOCS / "pictures" / "gallery"


def keep(picture: Path, name: str) -> None:
    """A picture of a run, as WebP."""
    pixels = image.imread(picture)[..., :3]
    image.imsave(PICTURES / f"{name}.webp", pixels, pil_kwargs={"quality": 80, "method": 6})


def main() -> int:
    """Run, convert, and say which runs hit."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp())
    lay_out(folder)
    specs = sorted((folder / "scenarios").glob("*.yaml"))
    found = deepmf_sumo.run(specs, folder / "all", sets=["expect={}"], pictures=True, jobs=2)
    for spec, run in zip(specs, found.runs, strict=True):
        if run.hit:
            keep(run.folder / "picture.png", spec.stem)
        print(
            spec.stem, run.row["outcome"], run.row["contact_time_s"], run.row["contact_speed_mps"]
        )
    shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
