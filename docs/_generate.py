"""A hook of mkdocs: tables of the reference, links to the glossary, and old addresses of pages.

A line ``<!-- generate: NAME ARGUMENT -->`` of a page becomes the table that the function NAME
returns for ARGUMENT. The first use of each word of the glossary on a page becomes a link to it,
unless the glossary has the word with a bracket behind it.
"""

import importlib
import posixpath
import re
import types
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from griffe import Docstring, DocstringSectionAttributes
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from deepmf_sumo import plugins
from deepmf_sumo.errors import EXIT_CODES
from deepmf_sumo.judge import metrics
from deepmf_sumo.results.quantities import QUANTITIES
from deepmf_sumo.spec.profiles import LONG_S, PROFILES

FEW = 3
"""A map with more keys has a table of its own."""
PLACE = re.compile(r"<!-- generate: (\w+)(?: (\S+))? -->")
GLOSSARY = "reference/glossary.md"
MOVED = {
    "architecture": "developers/architecture",
    "explain/risk": "reference/risk-map#how-the-numbers-are-made",
    "howto/benchmark": "howto/compare#compare-methods",
    "howto/conflicts": "howto/network#count-conflicts",
    "howto/countermeasures": "howto/network#try-a-change",
    "howto/results-in-python": "reference/python#results-as-tables",
    "howto/screen": "howto/network#check-it-against-a-guideline",
    "howto/stacks": "reference/stacks",
    "howto/steering": "howto/attack#steer-the-attack",
    "reference/evidence": "reference/risk-map#tables-of-evidence",
    "reference/wishes": "developers/wishes",
}
"""Old addresses of pages, and where their content is now."""
_ITEM = " " * 8
"""Before an item of a section of a class's docstring."""
_REFERENCE = re.compile(r"[,:;]? see `[\w.]+`,?| \(`[\w.]+`\)")
"""To an object of the code, which is on no page."""
_ENTRY = re.compile(r"^(\w[^\n:]*)\n:   (.+(?:\n    .+)*)", re.MULTILINE)
_NOT_PROSE = (
    r"^```.*?^```|^---$.*?^---$|<!--.*?-->|^:::[^\n]*(?:\n    [^\n]*)*|^#[^\n]*|^    [^\n]*"
    r"|<[^>\n]*>|!?\[[^\]]*\]\([^)]*\)|`[^`\n]*`"
)


def on_page_markdown(markdown: str, page: Any = None, **_: Any) -> str:
    """Called by mkdocs with the text of each page."""
    text = PLACE.sub(lambda found: GENERATED[found[1]](*filter(None, [found[2]])), markdown)
    if page is None:
        return text
    own = page.file.src_uri
    if own == GLOSSARY:
        return _ENTRY.sub(
            lambda found: f"{found[1]} {{: #{slug(found[1])} }}\n:   {found[2]}", text
        )
    return explained(text, posixpath.relpath(GLOSSARY, posixpath.dirname(own)))


def slug(word: str) -> str:
    """The anchor of a word of the glossary."""
    return re.sub(r"\W+", "-", word.lower()).strip("-")


@cache
def words() -> dict[str, tuple[str, str]]:
    """Anchor and definition, as plain text, of each word of the glossary that pages link to."""
    text = (Path(__file__).parent / GLOSSARY).read_text("utf-8")
    plain = {
        name: " ".join(re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", said).split())
        for name, said in _ENTRY.findall(text)
        if "(" not in name
    }
    return {
        one.lower(): (slug(name), said.replace('"', "'"))
        for name, said in plain.items()
        for one in name.split(", ")
    }


def explained(text: str, glossary: str) -> str:
    """The text of a page in which the first use of each word of the glossary is a link to it."""
    known = words()
    longest_first = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    pattern = re.compile(
        rf"{_NOT_PROSE}|(?<![\w-])(?P<word>{longest_first})(?P<plural>e?s)?(?![\w-])",
        re.MULTILINE | re.DOTALL | re.IGNORECASE,
    )
    left = {anchor for anchor, _ in known.values()}

    def link(found: re.Match[str]) -> str:
        if not found["word"]:
            return found[0]
        anchor, said = known[found["word"].lower()]
        if anchor not in left:
            return found[0]
        left.remove(anchor)
        return f'[{found[0]}]({glossary}#{anchor} "{said}")'

    return pattern.sub(link, text)


def on_post_build(config: Any, **_: Any) -> None:
    """Called by mkdocs at the end: a page at each old address leads to the new one."""
    for old, new in MOVED.items():
        folder = Path(config["site_dir"], old)
        folder.mkdir(parents=True, exist_ok=True)
        target = posixpath.relpath(new.partition("#")[0], old) + "/"
        mark = new.partition("#")[2]
        address = f"{target}#{mark}" if mark else target
        (folder / "index.html").write_text(
            f'<!doctype html><meta charset="utf-8"><title>Moved</title>\n'
            f'<meta http-equiv="refresh" content="0; url={address}">\n'
            f'<a href="{address}">Moved</a>\n',
            "utf-8",
        )


def on_page_content(html: str, **_: Any) -> str:
    """Called by mkdocs with the HTML of each page; mkdocs-click shows the lack of a default."""
    return html.replace("<code>Sentinel.UNSET</code>", "")


def table(headings: str, rows: Iterable[Iterable[object]]) -> str:
    """A table of Markdown; ``headings`` are separated by commas."""
    names = headings.split(", ")
    lines = [names, ["---"] * len(names), *rows]
    cells = [[" ".join(str(cell).split()).replace("|", "\\|") for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def named(place: str) -> Any:
    """The object of ``module:Name`` in the package."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(f"deepmf_sumo.{module}"), name)


def readable(kind: Any) -> str:  # noqa: PLR0911
    """A type as people write it in a spec."""
    if hasattr(kind, "__metadata__"):
        return readable(get_args(kind)[0])
    if get_origin(kind) is Literal:
        return ", ".join(f"`{value}`" for value in get_args(kind))
    if get_origin(kind) in {types.UnionType, Union}:
        return " or ".join(dict.fromkeys(map(readable, get_args(kind))))
    inner = [readable(one) for one in get_args(kind) if one is not ...]
    if get_origin(kind) in {list, tuple}:
        return f"list of {inner[0]}"
    if get_origin(kind) is dict:
        return f"map of {inner[0]} to {inner[1]}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        keys = [f"`{name}`" for name in kind.model_fields]
        return "map" if len(keys) > FEW else f"map with {', '.join(keys)}"
    words = {bool: "true or false", float: "number", int: "whole number", str: "text", Path: "path"}
    return words.get(
        kind, "null" if kind is types.NoneType else "map" if is_typeddict(kind) else "any"
    )


def described(model: type) -> dict[str, str]:
    """What the sections ``Attributes`` of a class and of those before it say about its fields."""
    found: dict[str, str] = {}
    for one in reversed(model.__mro__):
        if one.__module__.startswith("deepmf_sumo") and one.__doc__:
            text = re.sub(r"(?<=\. )(?=[a-z]\w*: )", f"\n{_ITEM}", one.__doc__)  # several in a line
            for section in Docstring(text).parse("google", warnings=False):
                if isinstance(section, DocstringSectionAttributes):
                    for item in section.value:
                        words = " ".join(item.description.split())
                        more = item.annotation if item.name.endswith(",") else ""  # `a, b: text`
                        found |= dict.fromkeys(re.findall(r"\w+", f"{item.name} {more}"), words)
    return {name: _REFERENCE.sub("", text) for name, text in found.items()}


def inner_metadata(kind: Any) -> Iterator[Any]:
    """What is annotated to the members of a union: bounds of a value that may be null."""
    for one in get_args(kind) if get_origin(kind) in {types.UnionType, Union} else ():
        for more in getattr(one, "__metadata__", ()):
            yield from more.metadata if isinstance(more, FieldInfo) else (more,)


def own_fields(place: str) -> str:
    """The keys that a pydantic model has beside those of the model before it."""
    inherited = named(place).__mro__[1].model_fields
    return "\n".join(
        line
        for line in fields(place).splitlines()
        if line.partition("`")[2].partition("`")[0] not in inherited
    )


def fields(place: str) -> str:
    """The keys of a pydantic model, or those of a TypedDict or a dataclass."""
    model = named(place)
    said = described(model)
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        kinds = get_type_hints(model)
        return table(
            "key, type, meaning",
            ([f"`{k}`", readable(v), said.get(k, "")] for k, v in kinds.items()),
        )
    rows = []
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        bounds = [
            f"{sign} {getattr(one, key):.10g}"
            for one in (*field.metadata, *inner_metadata(field.annotation))
            for key, sign in (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))
            if getattr(one, key, None) is not None
        ]
        kind = ", ".join([readable(field.annotation), *bounds])
        rows.append([f"`{name}`", kind, default(field), field.description or said.get(name, "")])
    return table("key, value, default, meaning", rows)


def default(field: FieldInfo) -> str:
    """A default as YAML has it; nothing for an empty one."""
    if field.is_required():
        return "" if "by default" in (field.description or "") else "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel) or value in ((), {}, []):
        return ""
    if isinstance(value, tuple):
        return f"`[{', '.join(map(str, value))}]`"
    words = {None: "null", True: "true", False: "false"}
    return f"`{words[value] if value is None or isinstance(value, bool) else value}`"


def settings(kind: str) -> str:
    """All plug-ins of a kind: what each is, and its settings."""
    parts = []
    for name in plugins.names(kind):  # type: ignore[arg-type]
        module = plugins.load(kind, name)  # type: ignore[arg-type]
        place = module.__name__.removeprefix("deepmf_sumo.")
        first = (module.__doc__ or "").split("\n\n")[0]
        keys = module.Settings.model_fields
        parts += [f"### `{name}`", first, fields(f"{place}:Settings") if keys else "No settings."]
    return "\n\n".join(parts)


def profiles() -> str:
    """What each profile of a spec stands for."""
    rows = (
        [
            f"`{name}`",
            ", ".join(f"`{one}`" for one in known.constraints) or "none",
            f"`{known.form}`",
            f"`{known.rule}`" if known.rule else "the form's",
            "`in_turn`" if known.in_turn else "`one`",
            f"{known.tries}",
        ]
        for name, known in PROFILES.items()
    )
    return table(f"profile, constraints, form, rule, opponents above {LONG_S:g} s, tries", rows)


def metric_tables() -> str:
    """All metrics by their module, with the definitions that results print."""
    by_module: dict[str, list[metrics.Metric]] = {}
    for one in metrics.own().values():
        by_module.setdefault(one.compute.__module__.rpartition(".")[2], []).append(one)
    parts = []
    for module, those in sorted(by_module.items()):
        text = importlib.import_module(f"deepmf_sumo.judge.metrics.{module}").__doc__ or ""
        rows = ([f"`{one.name}`", one.unit, one.better, one.definition] for one in those)
        parts += [
            f"## {module}",
            text.split("\n\n")[0],
            table("metric, unit, better for the attacker, definition", rows),
        ]
    return "\n\n".join(parts)


def quantities() -> str:
    """Columns of comparisons, thresholds and tables of benchmarks."""
    rows = ([f"`{one.name}`", one.unit, one.over, one.definition] for one in QUANTITIES)
    return table("quantity, unit, over runs that were, definition", rows)


def columns(place: str) -> str:
    """The names of a tuple of columns, as a line."""
    return ", ".join(f"`{name}`" for name in named(place))


def exit_codes() -> str:
    """The exit codes of all commands."""
    return table("ending, exit code", sorted(EXIT_CODES.items(), key=lambda one: one[1]))


GENERATED = {
    "columns": columns, "exit_codes": exit_codes, "fields": fields, "metrics": metric_tables,
    "own_fields": own_fields, "profiles": profiles,
    "quantities": quantities, "settings": settings,
}  # fmt: skip
