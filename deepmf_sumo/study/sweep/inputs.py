"""The files that tasks read: whether they are the same as before, and on another machine.

The code of a user's plug-in is among them: its files, those of its own that it imports, and data
that it names. What Python brings and what is installed (``site-packages``) is not looked at, apart
from the plug-in's own package: a planner that lies there counts, numpy does not. Imports are read
from the source, also those inside functions, and looked up in what the imported modules hold, so
that a module that was imported by a computed name is found, too. Nothing is imported here.
"""

import ast
import functools
import hashlib
import importlib.util
import os
import re
import site
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Final, Literal

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.spec import FromNetwork, Plugin, Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.sumo.simulation import sumo_options
from deepmf_sumo.sumo.simulation.files_read import files_read

_READ_BYTES: Final = 2**28
"""Up to this size files are compared by content, above by names and sizes, apart from code."""

Use = Literal["source", "weights", "planner", "adversary", "others"]
"""What a run reads a file for; ``source``: the network and its traffic, or the recording."""

_CLASS: Final = re.compile(r"([A-Za-z_][\w.]*):[A-Za-z_]\w*")
"""``my_package.my_module:MyPlanner``"""
_LARGEST: Final = 2**24
"""Bytes of a source file."""
_LONGEST_NAME: Final = 300
_OWN: Final = Path(__file__).parents[2].resolve()
_IMPORTING: Final = frozenset({"import_module", "__import__"})
_WRITES: Final = frozenset("wax")


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """A file or folder, and what is in it."""

    path: Path
    digest: str


def inputs_of(tasks: Sequence[Task]) -> tuple[Input, ...]:
    """Recordings, configurations and the files they name, weights, planners and tables of drives.

    What does not exist here is left out: the run itself says so better.
    """
    return fingerprinted(tasks)[1]


def of_exporter(name: str) -> tuple[Input, ...]:
    """Code of an exporter of the user's: no run reads it, but what it wrote depends on it."""
    module = plugins.module_of("exporters", name)
    paths = of_module(module) if module else []
    return tuple(Input(path=path, digest=got) for path in paths if (got := digest(path)))


def fingerprinted(tasks: Sequence[Task]) -> tuple[list[Task], tuple[Input, ...]]:
    """The tasks, each with the digest of what it reads, and all that they read.

    Files' names are not in it: copies of a file elsewhere are the same.
    """
    looked = _Looked()
    marked = [replace(task, inputs=looked.inputs(task.spec)) for task in tasks]
    return marked, looked.every()


class _Looked:
    """Each file is read once: thousands of tasks may read the same ones."""

    def __init__(self) -> None:
        self._by_spec: dict[str, tuple[tuple[str, str], ...]] = {}
        self._digests: dict[Path, str] = {}

    def inputs(self, spec: Spec) -> tuple[tuple[str, str], ...]:
        """For each use the digest of the files that a spec's runs read."""
        key = key_of(spec)
        if key not in self._by_spec:
            self._by_spec[key] = tuple(
                (use, _joined(found))
                for use, paths in paths_of(spec).items()
                if (found := [got for path in dict.fromkeys(paths) if (got := self._digest(path))])
            )
        return self._by_spec[key]

    def _digest(self, path: Path) -> str:
        if path not in self._digests:
            self._digests[path] = digest(path)
        return self._digests[path]

    def every(self) -> tuple[Input, ...]:
        """What all specs read that were asked about."""
        return tuple(Input(path=path, digest=got) for path, got in self._digests.items() if got)


def _joined(digests: Iterable[str]) -> str:
    return hashlib.sha256(" ".join(digests).encode()).hexdigest()


def lacking(inputs: Iterable[Input]) -> str:
    """What this machine lacks, as the end of a sentence; empty where it has all."""
    for one in inputs:
        found = digest(one.path)
        if not found:
            return f"has no {one.path}"
        if found != one.digest:
            return f"has another {one.path}"
    return ""


def digest(path: Path) -> str:
    """Of a file or of all in a folder; empty where there is none that can be read."""
    try:
        found = list(files.inside(path)) if path.is_dir() else [path]
        found = [one for one in found if one.parent.name != "__pycache__"]
        sizes = [one.stat().st_size for one in found]
        small = sum(sizes) <= _READ_BYTES
        hasher = hashlib.sha256()
        for file, size in zip(found, sizes, strict=True):
            name = os.fsencode(file.relative_to(path))
            hasher.update(b"%s %d " % (name, size))
            whole = small or file.suffix == ".py"
            for piece in files.pieces(file, _READ_BYTES) if whole else ():
                hasher.update(piece)
    except (OSError, ValueError):
        return ""
    return hasher.hexdigest()


def key_of(spec: Spec) -> str:
    """The same for specs whose runs read the same files."""
    source = spec.source
    if isinstance(source, FromNetwork):
        read: tuple[object, ...] = (source.network, source.sumo_options)
    else:
        read = (source.recording,)
    return repr((*read, spec.weights, spec.planner, spec.adversary))


def paths_of(spec: Spec) -> dict[Use, list[Path]]:
    """The files that a spec's runs read, by what they are for."""
    source = spec.source
    read = _of_sumo(source) if isinstance(source, FromNetwork) else [source.recording]
    return {
        "source": read,
        "weights": _weights(spec.weights),
        "planner": list(_of_plugin("planners", spec.planner)),
        "adversary": list(_of_plugin("adversaries", spec.adversary)),
        "others": list(_of_others(("metrics", "readers"))),
    }


def _of_plugin(kind: plugins.Kind, choice: Plugin) -> Iterator[Path]:
    """Code of the user's, and what its settings name: other code, programs, tables, folders."""
    module = plugins.module_of(kind, choice.name)
    yield from of_module(module) if module else ()
    for text in _texts(choice.settings):
        if match := _CLASS.fullmatch(text):
            yield from of_module(match[1])
            continue
        path = Path(text).absolute()
        with suppress(OSError, ValueError):  # a text is rarely a name of a file
            if path.is_file():
                yield from of_program(path)
            elif os.sep in text.strip(os.sep) and path.is_dir():
                yield path


def _texts(value: object) -> Iterator[str]:
    """All texts in the settings of a plug-in, at any depth."""
    inside = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, str):
        yield value
    elif isinstance(inside, Iterable):
        for one in inside:
            yield from _texts(one)


def _of_others(kinds: Sequence[plugins.Kind]) -> Iterator[Path]:
    """Code of plug-ins that no spec names: metrics are measured, and readers tried, in any case."""
    for kind in kinds:
        for name in plugins.names(kind):
            module = plugins.module_of(kind, name)
            yield from of_module(module) if module else ()


def _of_sumo(source: FromNetwork) -> list[Path]:
    """What SUMO reads; of options beside the configuration that are wrong the run tells."""
    beside: dict[str, str] = {}
    with suppress(UsageError):
        beside = sumo_options.parse(source.sumo_options)
    return files_read(source.network, beside)


def _weights(name: str) -> list[Path]:
    """The networks of a set of weights, and their cards.

    None for ``open``, which is part of the program, whose version is compared, and for those that
    are nowhere, which are those of methods that use none.
    """
    if name == "open":
        return []
    folder = Path(name)
    if not folder.is_absolute():
        from deepmf_sumo.deepmf.networks.weights import find

        try:
            folder = find(name).absolute()
        except WeightsError:
            return []
    kinds = {".json", ".onnx", ".safetensors"}
    return sorted(file for file in folder.glob("*") if file.suffix in kinds)


def of_module(name: str) -> list[Path]:
    """Files and folders that count for the module of a plug-in; none where it is not found.

    The folder of its package; of other modules of the user's that are imported, the sources; and
    of each source the files that a text in it names, beside it or in the working folder.
    """
    root = _found(name)
    if root is None:
        return []
    package = _package_of(name)
    found = dict.fromkeys([package or root])
    left, seen = [name], set[str]()
    while left:
        module = left.pop()
        if module in seen:
            continue
        seen.add(module)
        file = _found(module)
        if file is None or not (module == name or _of_user(file)):
            continue
        found[file] = None
        tree = _tree(file)
        if tree is not None:
            found |= dict.fromkeys(_named_in(tree, file.parent))
            left += _imported(tree, module, is_package=file.name == "__init__.py")
        left += _held(module)
    return [path for path in found if path == package or package not in path.parents]


def of_program(file: Path) -> list[Path]:
    """A program; of one in Python also what it imports from beside itself, and the files it names.

    None where it does not exist.
    """
    found, left = dict[Path, None](), [file]
    while left:
        one = left.pop()
        if one in found or not one.is_file():
            continue
        found[one] = None
        tree = _tree(one)
        if tree is None:
            continue
        found |= dict.fromkeys(_named_in(tree, one.parent))
        for name in _imported(tree, "", is_package=False):
            beside = file.parent.joinpath(*name.split("."))
            left += [beside.with_suffix(".py"), beside / "__init__.py"]
    return list(found)


@functools.cache
def _installed() -> frozenset[Path]:
    """Folders of what Python brings and what is installed."""
    named = sysconfig.get_paths()
    kinds = ("stdlib", "platstdlib", "purelib", "platlib", "include", "platinclude")
    paths = [named[kind] for kind in kinds if kind in named]
    paths += [*site.getsitepackages(), site.getusersitepackages()]
    paths += [entry for entry in sys.path if entry.endswith(("site-packages", "dist-packages"))]
    return frozenset(Path(path).resolve() for path in paths)


def _of_user(file: Path) -> bool:
    """Whether a file is neither of this package, of Python, nor installed."""
    parents = file.resolve().parents
    return _OWN not in parents and _installed().isdisjoint(parents)


def _found(module: str) -> Path | None:
    """The file of a module, which is not imported for that."""
    origin = getattr(sys.modules.get(module), "__file__", None)
    package = module.rpartition(".")[0]
    if origin is None and package and package not in sys.modules:  # looking it up would import it
        return _beside_others(module)
    if origin is None:
        try:
            spec = importlib.util.find_spec(module)
        except (ImportError, ValueError, AttributeError):
            return None
        origin = spec.origin if spec and spec.has_location else None
    return Path(origin).absolute() if origin else None


def _beside_others(module: str) -> Path | None:
    for entry in sys.path:
        base = Path(entry or ".").joinpath(*module.split("."))
        for file in (base / "__init__.py", base.with_name(f"{base.name}.py")):
            if file.is_file():
                return file.absolute()
    return None


def _package_of(name: str) -> Path | None:
    """The folder of the topmost package that a module is in.

    None for a module without one, and in a folder without ``__init__.py``, which may be a project.
    """
    top = _found(name.split(".", maxsplit=1)[0])
    return top.parent if top is not None and top.name == "__init__.py" else None


def _tree(file: Path) -> ast.Module | None:
    """The source in a file; None for what is not Python."""
    if file.suffix != ".py":
        return None
    try:
        return ast.parse(files.content(file, _LARGEST))
    except (OSError, ValueError, SyntaxError, RecursionError):
        return None


def _imported(tree: ast.Module, module: str, *, is_package: bool) -> Iterator[str]:
    """Names of what a source imports; a name after ``from`` may be a module or not."""
    package = module if is_package else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                yield from _with_packages(one.name)
        elif isinstance(node, ast.ImportFrom):
            upwards = package.split(".") if node.level and package else []
            upwards = upwards[: len(upwards) - max(node.level - 1, 0)]
            base = ".".join([*upwards, *([node.module] if node.module else [])])
            yield from _with_packages(base)
            yield from (f"{base}.{one.name}" if base else one.name for one in node.names)
        elif isinstance(node, ast.Call) and _last_name(node.func) in _IMPORTING:
            yield from (name for text in _strings(node.args[:1]) for name in _with_packages(text))


def _with_packages(name: str) -> Iterator[str]:
    """``a``, ``a.b`` and ``a.b.c`` of ``a.b.c``."""
    parts = name.strip(".").split(".")
    yield from (".".join(parts[: count + 1]) for count in range(len(parts)) if parts[0])


def _last_name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _held(module: str) -> Iterator[str]:
    """Modules that an imported module holds, or that what it holds is from."""
    for value in list(vars(sys.modules.get(module, ModuleType(""))).values()):
        origin = value.__name__ if isinstance(value, ModuleType) else _origin_of(value)
        if isinstance(origin, str):
            yield origin


def _origin_of(value: object) -> object:
    try:
        return getattr(value, "__module__", None)
    except Exception:  # noqa: BLE001 - an object of the user's may raise anything
        return None


def _named_in(tree: ast.Module, folder: Path) -> Iterator[Path]:
    """Files that the texts of a source name, but not those that it opens to write."""
    nodes = list(ast.walk(tree))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    written = {text for call in calls if _writes(call) for text in _strings(call.args[:1])}
    named = set(_strings(nodes))
    named |= {"/".join(_strings(call.args)) for call in calls}  # join("models", "net.onnx")
    named |= {"/".join(_strings(_divided(node))) for node in nodes}  # HERE / "models" / "net.onnx"
    for text in sorted(named - written):
        yield from _file_called(text, folder)


def _strings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def _divided(node: ast.AST) -> list[ast.AST]:
    """The parts of a path that is put together with slashes."""
    if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)):
        return []
    left = _divided(node.left) or [node.left]
    return [*left, node.right]


def _writes(call: ast.Call) -> bool:
    """Whether a call names a mode in which files are written, e.g. ``open(name, "w")``."""
    given = [*call.args[1:], *(one.value for one in call.keywords)]
    return any(len(mode) <= len("wb+") and _WRITES & set(mode) for mode in _strings(given))


def _file_called(text: str, folder: Path) -> Iterator[Path]:
    if not text or len(text) > _LONGEST_NAME or "\n" in text or "\0" in text:
        return
    for place in (folder, Path.cwd()):
        try:
            path = place / Path(text).expanduser()
            if path.is_file() and _of_user(path):
                yield path.absolute()
                return
        except (OSError, RuntimeError):  # e.g. a user that does not exist
            continue
