"""YAML text -> plain values, with the place of every key.

Stricter than PyYAML: a key that stands twice is refused, and so are aliases (a small file could
unfold into gigabytes), keys that are not text, and whole numbers that are not plain decimals.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

from deepmf_sumo.errors import SpecError

LARGEST_BYTES: Final = 1_000_000
_PLAIN: Final = re.compile(r"[-+]?(0|[1-9][0-9]*)")
"""YAML 1.1 knows other whole numbers: 010 is 8, 1:30 is 90, 0x10 is 16."""

KeyPath = tuple[str | int, ...]


@dataclass
class Document:
    """A mapping; ``places`` says where each key stands: ``file:line`` or ``--set key=value``."""

    file: Path
    values: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place(self, path: KeyPath) -> str:
        """Where a key stands, or the nearest key around it."""
        for end in range(len(path), 0, -1):
            if path[:end] in self.places:
                return self.places[path[:end]]
        return f"{self.file}:1"

    def assign(self, assignment: str) -> None:
        """Apply ``dotted.key=value``; the value is YAML. Raises SpecError where it cannot."""
        place = f"--set {assignment}"
        key, equals, text = assignment.partition("=")
        path = tuple(key.strip().split("."))
        if not (equals and all(path)):
            raise SpecError(f"{place}: must be key=value, e.g. adversary.period_s=2.0.")
        node = self.values
        for depth, part in enumerate(path[:-1], start=1):
            node = node.setdefault(part, {})
            if not isinstance(node, dict):
                raise SpecError(f"{place}: '{'.'.join(path[:depth])}' holds no keys, but {node!r}.")
        loader = _Loader(text, place, self.places, path)
        node[path[-1]] = loader.read()
        self.places[path] = place


def read(file: Path) -> Document:
    """The file's values. Raises SpecError with file and line for all that is not a mapping."""
    try:
        if file.stat().st_size > LARGEST_BYTES:
            raise SpecError(f"{file}: larger than {LARGEST_BYTES} bytes; this is no spec.")
        text = file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise SpecError(f"{file}: cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise SpecError(f"{file}: is not UTF-8 text (byte {error.start}).") from None
    places: dict[KeyPath, str] = {}
    values = _Loader(text, str(file), places, ()).read()
    if not isinstance(values, dict):
        raise SpecError(f"{file}:1: a spec or a plan is a mapping that begins with 'version: 1'.")
    return Document(file=file, values=values, places=places)


class _Loader:
    """One YAML text; ``at`` is the key path that its values hang under."""

    def __init__(self, text: str, name: str, places: dict[KeyPath, str], at: KeyPath) -> None:
        self.text, self.name, self.places, self.at = text, name, places, at
        self.in_file = not at

    def read(self) -> Any:
        try:
            for token in yaml.scan(self.text, Loader=yaml.SafeLoader):
                if isinstance(token, yaml.AliasToken):
                    raise SpecError(f"{self._place(token)}: aliases (*{token.value}) are refused.")
            node = yaml.compose(self.text, Loader=yaml.SafeLoader)
            if node is None:
                return None
            self._visit(node, self.at)
            return yaml.safe_load(self.text)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            place = f"{self.name}:{mark.line + 1}" if mark and self.in_file else self.name
            raise SpecError(f"{place}: is not YAML: {error.problem}.") from None
        except (yaml.YAMLError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise SpecError(f"{self.name}: is not YAML: {reason}.") from None
        except RecursionError:
            raise SpecError(f"{self.name}: is nested too deeply.") from None

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
                if key_node.tag != "tag:yaml.org,2002:str":
                    raise SpecError(f"{place}: key {key_node.value!r} is not text.")
                key = key_node.value
                if key in seen:
                    dotted = ".".join(str(part) for part in (*path, key))
                    raise SpecError(f"{place}: key '{dotted}' stands twice, first at {seen[key]}.")
                seen[key] = self.places[*path, key] = place
                self._visit(value_node, (*path, key))

    def _place(self, node: Any) -> str:
        return f"{self.name}:{node.start_mark.line + 1}" if self.in_file else self.name
