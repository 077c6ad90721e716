"""The code of a user's plug-in: its files, those of its own that it imports, and data it names.

What Python brings and what is installed (``site-packages``) is not looked at, apart from the
plug-in's own package: a planner that lies there counts, numpy does not. Imports are read from the
source, also those inside functions, and looked up in what the imported modules hold, so that a
module that was imported by a computed name is found, too. Nothing is imported here.
"""

import ast
import functools
import importlib.util
import site
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Final

from deepmf_sumo import files

_LARGEST: Final = 2**24
"""Bytes of a source file."""
_LONGEST_NAME: Final = 300
_OWN: Final = Path(__file__).parents[2].resolve()
_IMPORTING: Final = frozenset({"import_module", "__import__"})
_WRITES: Final = frozenset("wax")


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
            yield from (name for text in _texts(node.args[:1]) for name in _with_packages(text))


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
    written = {text for call in calls if _writes(call) for text in _texts(call.args[:1])}
    named = set(_texts(nodes))
    named |= {"/".join(_texts(call.args)) for call in calls}  # join("models", "net.onnx")
    named |= {"/".join(_texts(_divided(node))) for node in nodes}  # HERE / "models" / "net.onnx"
    for text in sorted(named - written):
        yield from _file_called(text, folder)


def _texts(nodes: Iterable[ast.AST]) -> Iterator[str]:
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
    return any(len(mode) <= len("wb+") and _WRITES & set(mode) for mode in _texts(given))


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
