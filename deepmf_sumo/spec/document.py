"""YAML text -> plain values, with the place of every key.

Stricter than PyYAML: a key that is given twice is refused, and so are aliases (a small file could
unfold into gigabytes), keys that are not text, whole numbers that are not plain decimals, and what
takes long to read: deep nesting, very many values, and numbers of very many digits.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, cast

import yaml

from deepmf_sumo import files
from deepmf_sumo.errors import SpecError

LARGEST_BYTES: Final = 1_000_000
_PLAIN: Final = re.compile(r"[-+]?(0|[1-9][0-9]*)")
"""YAML 1.1 knows other whole numbers: 010 is 8, 1:30 is 90, 0x10 is 16."""
_DEEPEST: Final = 50
_MOST_VALUES: Final = 20_000
_LONGEST_TEXT: Final = 10_000
_LONGEST_NUMBER: Final = 100
"""Characters of all that is not text: long numbers take quadratic time."""
_TEXT: Final = "tag:yaml.org,2002:str"

KeyPath = tuple[str | int, ...]


@dataclass
class Document:
    """A mapping; ``places`` says where each key is: ``file:line`` or ``--set key=value``."""

    file: Path
    values: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place(self, path: KeyPath) -> str:
        """Where a key is, or the nearest key around it."""
        for end in range(len(path), 0, -1):
            if path[:end] in self.places:
                return self.places[path[:end]]
        return f"{self.file}:1"

    def assign(self, assignment: str) -> None:
        """Apply ``dotted.key=value``; the value is YAML. Raises SpecError where it cannot."""
        place = f"--set {assignment}"
        key, equals, text = assignment.partition("=")
        path = tuple(key.strip().split("."))
        if not (equals and all(path) and len(path) <= _DEEPEST):
            raise SpecError(f"{place}: must be key=value, e.g. adversary.period_s=2.0.")
        node = self.values
        for depth, part in enumerate(path[:-1], start=1):
            node = node.setdefault(part, {})
            if not isinstance(node, dict):
                raise SpecError(
                    f"{place}: '{'.'.join(path[:depth])}' holds no keys, but {node!r:.80}."
                )
        loader = _Loader(text, place, self.places, path)
        node[path[-1]] = loader.read()
        self.places[path] = place


def read(file: Path, begins: str = "specs and plans begin with 'version: 3'") -> Document:
    """The file's values; ``begins``: how such files do.

    Raises SpecError with file and line for all that is not a mapping.
    """
    try:
        text = files.text(file, LARGEST_BYTES, "utf-8-sig")
    except OSError as error:
        raise SpecError(f"{file}: cannot be read: {files.reason(error)}.") from None
    except UnicodeDecodeError as error:
        raise SpecError(f"{file}: is not UTF-8 text (byte {error.start}).") from None
    places: dict[KeyPath, str] = {}
    values = _Loader(text, str(file), places, ()).read()
    if not isinstance(values, dict):
        raise SpecError(f"{file}:1: must be a mapping; {begins}.")
    return Document(file=file, values=values, places=places)


class _Bounded(yaml.SafeLoader):
    """PyYAML's, with limits.

    What is beyond them, or is not a value of its type, is a MarkedYAMLError.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _refused(event, f"aliases (*{event.anchor:.80}) are refused")
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > _DEEPEST:
            raise _refused(event, f"it is nested more than {_DEEPEST} deep")
        if self._count > _MOST_VALUES:
            raise _refused(event, f"it holds more than {_MOST_VALUES} values")
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.ScalarNode):
            longest = _LONGEST_TEXT if node.tag == _TEXT else _LONGEST_NUMBER
            if len(node.value) > longest:
                what = f"{node.value[:20]}... has more than {longest} characters"
                raise _refused(node, what)
            if re.search("[\\0\ud800-\udfff]", node.value):
                raise _refused(node, f"{node.value!r:.80} has a character that no text may have")
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep=deep)
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError):
            kind = node.tag.rpartition(":")[2]
            raise _refused(node, f"{node.value!r:.80} is not of the type '{kind:.80}'") from None


def _refused(what: yaml.Node | yaml.Event, why: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=why, problem_mark=cast(yaml.Mark, what.start_mark))


class _Loader:
    """One YAML text; ``at`` is the key path that its values hang under."""

    def __init__(self, text: str, name: str, places: dict[KeyPath, str], at: KeyPath) -> None:
        self.text, self.name, self.places, self.at = text, name, places, at
        self.in_file = not at

    def read(self) -> Any:
        try:
            loader = _Bounded(self.text)
            node = loader.get_single_node()
            if node is None:
                return None
            self._visit(node, self.at)
            return loader.construct_document(node)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            place = f"{self.name}:{mark.line + 1}" if mark and self.in_file else self.name
            raise SpecError(f"{place}: is not YAML: {error.problem}.") from None
        except (yaml.YAMLError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SpecError(f"{self.name}: is not YAML: {reason}.") from None

    def _visit(self, node: yaml.Node, path: KeyPath) -> None:
        if node.tag == "tag:yaml.org,2002:int" and not _PLAIN.fullmatch(str(node.value)):
            raise SpecError(
                f"{self._place(node)}: key '{'.'.join(map(str, path))}': {node.value!r} is not a"
                " plain decimal number; write e.g. 8, or put text in quotes."
            )
        if isinstance(node, yaml.SequenceNode):
            for index, item in enumerate(node.value):
                self.places[*path, index] = self._place(item)
                self._visit(item, (*path, index))
        elif isinstance(node, yaml.MappingNode):
            seen: dict[str, str] = {}
            for key_node, value_node in node.value:
                place = self._place(key_node)
                if key_node.tag != _TEXT:
                    raise SpecError(f"{place}: key {key_node.value!r:.80} is not text.")
                key = key_node.value
                if key in seen:
                    dotted = ".".join(str(part) for part in (*path, key))
                    raise SpecError(
                        f"{place}: key '{dotted}' is given twice, first at {seen[key]}."
                    )
                seen[key] = self.places[*path, key] = place
                self._visit(value_node, (*path, key))

    def _place(self, node: Any) -> str:
        return f"{self.name}:{node.start_mark.line + 1}" if self.in_file else self.name
