"""Run the code blocks of a page as one script: ``python -m tests.docs.blocks [--write] PAGE...``.

The script runs in a folder that ``deepmf-sumo init`` made, block after block, so that later blocks
see the files of earlier ones. ``--write`` puts what the last command of each block prints into the
block ``text`` that follows it, and into those of other pages that are said to be the same.
"""

import argparse
import importlib.util
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.cli.init import lay_out

from tests.docs.pages import DOCS, ROOT, Page

BUILDS = ("pip ", "make ", "git ", "uv ", "docker ")
"""Commands that install or build: in README they are left out, which `Ran.left_out` counts."""
FIRST, LAST = 10, 6
"""Lines of an output that are shown where it has more."""
WIDTH = 118


@dataclass(frozen=True)
class Ran:
    """How the blocks of a page ended; ``outputs`` are those of last commands, by block."""

    returncode: int
    log: str
    outputs: dict[int, str]
    left_out: tuple[str, ...]


def script(page: Page, logs: Path) -> tuple[str, list[str]]:
    """The script of a page, and the lines that are left out of it."""
    lines, left_out = ["set -e -o pipefail"], []
    for number, block in enumerate(page.blocks):
        module = block.mark.removeprefix("needs ") if block.mark.startswith("needs") else ""
        if block.title:
            lines += [
                f"cat > {shlex.quote(block.title)} <<'END_OF_FILE'",
                block.code + "END_OF_FILE",
            ]
        elif not block.runnable:
            continue
        elif module and importlib.util.find_spec(module) is None:
            left_out.append(f"block {number}: {module} is not installed")
        else:
            code = block.code.rstrip("\n")
            if block.commands:
                own = code.replace("\\\n", " ").splitlines()
                left_out += [line for line in own if line.startswith(BUILDS)]
                own = [line for line in own if not line.startswith(BUILDS)] or [":"]
            else:
                own = [f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}"]
            lines += [f"echo '== block {number}' >&2", f"exec > {logs}/{number}.head", *own[:-1]]
            lines += [f"exec > {logs}/{number}.out", "set +e", own[-1], "ended=$?", "set -e"]
            lines.append(f"test $ended = {block.exit_code}")
    return "\n".join([*lines, ""]), left_out


def run(page: Page, folder: Path, limit_s: float = 900) -> Ran:
    """Run the blocks in a new folder below ``folder``."""
    logs, work, programs = folder / "logs", folder / "here", folder / "bin"
    for one in (logs, work, programs):
        one.mkdir(parents=True)
    if not any(block.runnable and "deepmf-sumo init" in block.code for block in page.blocks):
        work = work / "demo"
        lay_out(work)
    program = programs / "deepmf-sumo"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m deepmf_sumo.cli.main "$@"\n')
    program.chmod(0o755)
    text, left_out = script(page, logs)
    path = f"{programs}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {
        **os.environ, "PATH": path, "COLUMNS": str(WIDTH), "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1", "DEEPMF_SUMO_HOME": str(folder / "home"),
    }  # fmt: skip
    with subprocess.Popen(
        ["bash", "-c", text], cwd=work, env=environment, text=True, stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:  # fmt: skip
        try:
            _, log = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGTERM)  # commands that it has started, too
            _, log = process.communicate()
            log += f"ended after {limit_s:g} s\n"
    outputs = {int(file.stem): file.read_text("utf-8") for file in logs.glob("*.out")}
    return Ran(process.returncode, log, outputs, tuple(left_out))


def written(page: Page, ran: Ran, folder: Path) -> str:
    """The text of the page with the outputs of ``ran``."""
    text, blocks = page.text, page.blocks
    for number in reversed(range(len(blocks) - 1)):
        block = blocks[number + 1]
        shown = block.language == "text" and ran.outputs.get(number, "").strip()
        if shown:
            lines = ran.outputs[number].replace(f"{folder}/here/", "").strip("\n").splitlines()
            long = len(lines) > FIRST + LAST + 1  # else the line of dots is no shorter
            cut = [*lines[:FIRST], "...", *lines[-LAST:]] if long else lines
            new = "\n".join(line.rstrip() for line in cut) + "\n"
            text = text[: block.start] + new + text[block.end :]
    return text


def first_output(page: Page) -> str:
    """The first block ``text`` of a page that is its own."""
    own = (one for one in page.blocks if one.language == "text" and not one.mark)
    return next(own).code


def copied(page: Page) -> str:
    """The text of the page with the outputs of other pages that it shows."""
    text = page.text
    for block in reversed(page.blocks):
        if block.mark.startswith("as in "):
            new = first_output(Page(DOCS / block.mark.removeprefix("as in ")))
            text = text[: block.start] + new + text[block.end :]
    return text


def main() -> int:
    """Run pages, print how they ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--limit", type=float, default=900, help="seconds for a page")
    parser.add_argument("--keep", type=Path, help="keep the folder of a single page here")
    options = parser.parse_args()
    worst = 0
    for path in options.pages:
        page, folder = Page(path.resolve()), Path(tempfile.mkdtemp())
        ran = run(page, folder, options.limit)
        print(page.name, ran.returncode, *ran.left_out, sep="\n  ")
        if ran.returncode:
            print(ran.log)
        if options.write:
            path.write_text(written(page, ran, folder), "utf-8")
        if options.keep:
            shutil.copytree(folder, options.keep)
        shutil.rmtree(folder)
        worst = max(worst, ran.returncode)
    if options.write:
        for path in DOCS.rglob("*.md"):
            path.write_text(copied(Page(path)), "utf-8")
    return worst


if __name__ == "__main__":
    sys.exit(main())
