"""Pages of README and site, and what is in them: blocks of code, words, numbers, pictures, links.

A comment in the line before a block says how it is run::

    <!-- not run: REASON -->     it is not
    <!-- exit code 1 -->         its last command ends with this code
    <!-- needs MODULE -->        it is run where this Python module is installed
    <!-- as in PAGE -->          it is the first output of another page of docs/

A block with a title is a file of that name. All other blocks of commands and of Python are run.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SHELL = {"sh", "bash", "console", "shell"}
PROGRAMS = ("deepmf-sumo ", "make ", "pip ", "git ", "uv ", "docker ", "python ")
"""What a command begins with, in blocks that name no language."""
_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>not run: [^\n]+|as in \S+|exit code \d+|needs \w+) -->\n)?"
    r"^```(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<code>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"(?<![\w.])\d[\d.,]*(?![\w])")


@dataclass(frozen=True)
class Block:
    """A fenced block; ``start`` and ``end`` are of its code in the page's text."""

    language: str
    title: str
    mark: str
    code: str
    start: int
    end: int

    @property
    def commands(self) -> bool:
        """Whether it is for a shell."""
        if self.language:
            return self.language in SHELL
        return any(line.startswith(PROGRAMS) for line in self.code.splitlines())

    @property
    def runnable(self) -> bool:
        """Whether it is code that is run."""
        code = self.commands or self.language == "python"
        return code and not self.title and not self.mark.startswith("not run")

    @property
    def exit_code(self) -> int:
        """Of its last command."""
        return int(self.mark.removeprefix("exit code ")) if self.mark.startswith("exit") else 0


@dataclass(frozen=True)
class Page:
    """A page of Markdown."""

    path: Path

    @property
    def name(self) -> str:
        """As test ids have it."""
        return str(self.path.relative_to(ROOT))

    @cached_property
    def text(self) -> str:
        """All of it."""
        return self.path.read_text("utf-8")

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Fenced blocks in their order."""
        return tuple(
            Block(
                found["language"], found["title"] or "", found["mark"] or "", found["code"],
                found.start("code"), found.end("code"),
            )
            for found in _BLOCK.finditer(self.text)
        )  # fmt: skip

    @cached_property
    def prose(self) -> str:
        """The text that is written by hand for readers: no code blocks, comments, link targets."""
        text = _BLOCK.sub("", self.text)
        text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
        text = re.sub(r"^::: .*(\n    .*)*", "", text, flags=re.MULTILINE)
        return re.sub(r"\]\([^)]*\)", "]", text)

    @property
    def words(self) -> int:
        """Of the prose."""
        return len(re.findall(r"\w[\w'-]*", self.prose))

    @property
    def numbers(self) -> int:
        """Of the prose, not those in names, code or numbered headings."""
        text = re.sub(r"`[^`]*`", "", self.prose)
        text = re.sub(r"^(#+ )?\d+\. ", "", text, flags=re.MULTILINE)
        return len(_NUMBER.findall(text))

    @property
    def pictures(self) -> int:
        """Images on the page."""
        return len(re.findall(r"!\[[^\]]*\]\(|<img ", self.text))

    @property
    def outputs(self) -> int:
        """Blocks that show what a command prints."""
        return sum(block.language in {"text", "json"} for block in self.blocks)

    @property
    def anchors(self) -> set[str]:
        """Of its headings, as mkdocs and GitHub make them for plain words."""
        text = _BLOCK.sub("", self.text)
        titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
        plain = (re.sub(r"[^\w\s-]", "", title).strip().lower() for title in titles)
        return {re.sub(r"\s+", "-", title) for title in plain}

    @property
    def links(self) -> list[str]:
        """Targets of its links to files and headings of the repository."""
        found = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", _BLOCK.sub("", self.text)))
        return [one for one in found if "://" not in one and not one.startswith("mailto:")]


def nav() -> list[str]:
    """The pages that mkdocs.yml lists."""
    text = re.sub(r"!!python\S+", "", (ROOT / "mkdocs.yml").read_text("utf-8"))

    def of(entry):
        if isinstance(entry, str):
            return [entry]
        return [
            page
            for part in (entry.values() if isinstance(entry, dict) else entry)
            for page in of(part)
        ]

    return of(yaml.safe_load(text)["nav"])


README = Page(ROOT / "README.md")
SITE = tuple(Page(path) for path in sorted(DOCS.rglob("*.md")))
NOTEBOOK = tuple(Page(path) for path in sorted((ROOT / "studies").rglob("*.md")))
