"""Rebuild every network of this folder from its plain-XML sources: ``python sumo_nets/build.py``.

Each ``*/*.netccfg`` is a netconvert configuration. The comment that netconvert puts on top of its
output (date, version, paths) is removed, so that the same sources give the same bytes.
"""

# ruff: noqa: INP001, T201 - a script beside data, not a package

import re
import subprocess
import sys
from pathlib import Path

import sumo

HERE = Path(__file__).resolve().parent
NETCONVERT = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
HEADER = re.compile(r"<!-- generated on .*?-->\n*", re.DOTALL)


def build(config: Path, folder: Path) -> Path:
    """Build one network into ``folder`` and return its file; raises CalledProcessError."""
    net = folder / f"{config.stem}.net.xml"
    draft = net.with_suffix(".draft")
    command = [str(NETCONVERT), "-c", config.name, "--output-file", str(draft)]
    subprocess.run(command, cwd=config.parent, check=True, capture_output=True, text=True)
    text = HEADER.sub("", draft.read_text(encoding="utf-8"), count=1)
    draft.write_text(text, encoding="utf-8")
    return draft.replace(net)


def main() -> int:
    """Rebuild all networks in place."""
    for config in sorted(HERE.glob("*/*.netccfg")):
        try:
            net = build(config, config.parent)
        except subprocess.CalledProcessError as error:
            print(f"{config}: {error.stderr.strip()}", file=sys.stderr)
            return 1
        print(f"{net.relative_to(HERE)}: {net.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
