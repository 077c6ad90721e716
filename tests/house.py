"""Marks of the package's structure: ``python -m tests.house``."""

import ast
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from types import FrameType

import click
import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.cli import main
from deepmf_sumo.deepmf import policy
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.planners import idm
from deepmf_sumo.scene import AgentId, Plan, View
from deepmf_sumo.sumo.simulation import simulate

from tests.support import simulated_worlds as worlds

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "deepmf_sumo"
OPTIONAL = ("baselines", "exporters", "live", "roadcheck", "training")
MOST_PARAMETERS = 7


def sources(folder: Path = PACKAGE) -> Iterator[Path]:
    """Python files that people wrote."""
    return (file for file in sorted(folder.rglob("*.py")) if "_pb2" not in file.name)


def repeated_classes() -> dict[str, list[str]]:
    """Names of classes at the top of more than one module; plug-ins share the name ``Settings``."""
    found = defaultdict(list)
    for file in sources():
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.ClassDef) and node.name != "Settings":
                found[node.name].append(str(file.relative_to(PACKAGE)))
    return {name: files for name, files in found.items() if len(files) > 1}


PUBLIC = ("api.py:run", "api.py:attack", "live/attacker.py:__init__")
"""What users call. Keyword-only parameters are its options, as those of commands: each has a
default and is named in the call, and objects that gather them would be one more thing to learn."""


def long_signatures() -> list[str]:
    """Functions with more than `MOST_PARAMETERS`, without those that click fills."""
    return [f"{name} ({count})" for name, count, _ in _signatures() if count > MOST_PARAMETERS]


def public_options() -> dict[str, int]:
    """Keyword-only parameters of what users call."""
    return {name: count for name, _, count in _signatures() if name in PUBLIC}


def _signatures() -> Iterator[tuple[str, int, int]]:
    """Functions with their numbers of parameters and of options."""
    for file in sources():
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            name = f"{file.relative_to(PACKAGE)}:{node.name}"
            plain = [one.arg for one in node.args.posonlyargs + node.args.args]
            options = len(node.args.kwonlyargs)
            if file.parent.name != "cli":
                count = len(set(plain) - {"self", "cls"})
                yield name, count + (0 if name in PUBLIC else options), options


def importers() -> dict[str, set[str]]:
    """The modules that import each module, of the package itself."""
    names = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for file in sources()}
    found: dict[str, set[str]] = {name.removesuffix(".__init__"): set() for name in names}
    for name, file in names.items():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                inner = [f"{node.module}.{one.name}" for one in node.names]
                for module in {one if one in found else node.module for one in inner} & set(found):
                    found[module].add(name.removesuffix(".__init__"))
    return found


def way_of_a_plan() -> list[tuple[str, str]]:
    """File and name of the functions that a plan of DeepMF enters, each once, in order."""
    road = worlds.straight_road()
    motions = {
        "av": worlds.straight_motion(50.0, 0.0, 0.0, 10.0),
        "b": worlds.straight_motion(45.0, 3.2, 0.0, 12.0),
        "c": worlds.straight_motion(90.0, 0.0, 0.0, 10.0),
    }
    entered: dict[tuple[str, str], None] = {}

    def enter(frame: FrameType, event: str, _: object) -> None:
        file, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event == "call" and file.is_relative_to(PACKAGE) and not name.startswith("<"):
            entered.setdefault((str(file.relative_to(PACKAGE)), name))

    class Traced(policy.DeepMF):
        """A policy whose plans are traced."""

        def plan(self, view: View) -> Mapping[AgentId, Plan]:
            sys.setprofile(enter)
            try:
                return super().plan(view)
            finally:
                sys.setprofile(None)

    with tempfile.TemporaryDirectory() as folder:
        case = worlds.case_of(worlds.scene_of(road, motions), Path(folder), steps=12)
        settings = policy.Settings(opponent="b", period_s=None)
        attacker = Traced(settings, weights.cached_predictors("open"))
        simulate(case, idm.build(idm.Settings()), attacker, rng=np.random.default_rng(0))
    return list(entered)


def lines() -> dict[str, int]:
    """Lines of each room, and of ``tests``."""
    found: Counter[str] = Counter()
    for file in sources():
        parts = file.relative_to(PACKAGE).parts
        found[parts[0] if len(parts) > 1 else "(top)"] += len(file.read_text().splitlines())
    found["tests"] = sum(len(one.read_text().splitlines()) for one in sources(ROOT / "tests"))
    return dict(found)


def options() -> dict[str, int]:
    """Options of each command."""
    found: dict[str, int] = {}

    def add(command: click.Command, name: str) -> None:
        if isinstance(command, click.Group):
            context = click.Context(command)
            for each in command.list_commands(context):
                one = command.get_command(context, each)
                assert one is not None
                add(one, f"{name} {each}".strip())
        else:
            found[name] = sum(isinstance(one, click.Option) for one in command.params)

    add(main.commands, "")
    return found


def settings(adversary: str) -> dict[str, int]:
    """Keys of an adversary's settings: how many each has below it, 0 of plain values."""
    keys = plugins.settings_class("adversaries", adversary).model_fields
    below = {name: getattr(key.annotation, "model_fields", {}) for name, key in keys.items()}
    return {name: len(inner) for name, inner in below.items()}


def show() -> None:
    """Print the marks."""
    by_room, by_command = lines(), options()
    optional = sum(by_room[room] for room in OPTIONAL)
    tests = by_room.pop("tests")
    print("class names used more than once:", len(repeated_classes()))
    print(f"functions with more than {MOST_PARAMETERS} parameters:", len(long_signatures()))
    for each in long_signatures():
        print("   ", each)
    print("options of what users call:", public_options())
    by_importer, way = importers(), way_of_a_plan()
    alone = sum(len(one) == 1 for one in by_importer.values())
    print("modules that one other module imports:", alone, "of", len(by_importer))
    files = [file for file, _ in way]
    changes = 1 + sum(one != other for one, other in pairwise(files))
    print("a plan enters functions:", len(way), "files:", len(set(files)), "changes:", changes)
    print("options of all commands:", sum(by_command.values()), "most:", max(by_command.values()))
    keys = settings("deepmf")
    print("settings of deepmf:", len(keys), "and in its mappings:", sum(keys.values()))
    print("lines of rooms:", ", ".join(f"{name} {count}" for name, count in by_room.items()))
    print("lines:", sum(by_room.values()) - optional, "optional:", optional, "tests:", tests)


if __name__ == "__main__":
    show()
