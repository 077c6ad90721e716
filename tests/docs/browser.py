"""Pictures of pages, taken by Chromium without a window."""

import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
# No sandbox: it does not start in containers, and the pages are our own. Replays stand at contact.
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--hide-scrollbars", "--force-prefers-reduced-motion", "--virtual-time-budget=5000",
)  # fmt: skip
LIMIT_S = 120


def photograph(page: Path, picture: Path, width: int = 1280, height: int = 900) -> bool:
    """Write the top of a page as WebP; without Chromium the picture stays as it is."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        print(f"{picture.name} is not made again: it needs Chromium, which is not installed")
        return False
    with tempfile.TemporaryDirectory() as name:
        shot = Path(name) / "page.png"
        command = [program, *OPTIONS, f"--user-data-dir={name}/profile"]
        command += [f"--window-size={width},{height}", f"--screenshot={shot}", page.as_uri()]
        subprocess.run(command, check=True, timeout=LIMIT_S, capture_output=True)
        Image.open(shot).convert("RGB").save(picture, quality=80, method=6)
    return True
