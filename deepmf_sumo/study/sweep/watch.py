"""Files that change while a sweep runs: a run that would read an edited file is not made.

All runs of a sweep are in one table, as runs of one planner in one traffic. SUMO, weights and
programs are read anew by each run, and code of the user's by each worker: an edit in the meantime
would split the table in two, and nothing would tell. Only what runs never write is watched: the
network and its traffic, the file of a recording, weights, and code.
"""

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from deepmf_sumo import files, plugins
from deepmf_sumo.spec import Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep.inputs import Input, digest, key_of, paths_of

_seen: dict[Input, tuple[int, int]] = {}
"""Time and size of the files that this process has found as they were when the sweep began."""
_of_specs: dict[str, list[Path]] = {}


def watched(tasks: Iterable[Task], read: Iterable[Input]) -> tuple[Input, ...]:
    """What runs of the tasks read, as it is now; ``read``: what is known of it already."""
    known = {one.path: one.digest for one in read}
    paths = dict.fromkeys(path for task in tasks for path in _files(task.spec))
    every = ((path, known.get(path) or digest(path)) for path in paths)
    return tuple(Input(path=path, digest=found) for path, found in every if found)


def changed(task: Task, begun: Sequence[Input]) -> Path | None:
    """A file that the run would read, and that is not what it was when the sweep began.

    Code that this process has loaded, as it was, stays what it is here.
    """
    own = set(_files(task.spec))
    held = set(_loaded(own)) if _classes(task.spec) else set()
    for one in begun:
        if one.path in own and not (one in _seen and one.path in held) and not _is(one):
            return one.path
    return None


def _is(one: Input) -> bool:
    """Whether a file is as it was; its content is read where time or size differ."""
    try:
        found = one.path.stat()
    except OSError:
        return False
    stamp = found.st_mtime_ns, found.st_size
    if _seen.get(one) != stamp:
        if digest(one.path) != one.digest:
            return False
        _seen[one] = stamp
    return True


def _classes(spec: Spec) -> bool:
    """Whether planner or adversary is a class of the user's, which a worker loads once."""
    return bool(
        plugins.module_of("planners", spec.planner.name)
        or plugins.module_of("adversaries", spec.adversary.name)
    )


def _loaded(paths: Iterable[Path]) -> Iterator[Path]:
    """Those of the files that are code which this process has loaded."""
    files_of = {getattr(module, "__file__", None) for module in list(sys.modules.values())}
    return (path for path in paths if str(path) in files_of)


def _files(spec: Spec) -> list[Path]:
    """Files of a spec's runs that no run writes."""
    key = key_of(spec)
    if key not in _of_specs:
        found: dict[Path, None] = {}
        for use, paths in paths_of(spec).items():
            for path in paths:
                data = use in {"source", "weights"}
                if path.is_dir():
                    with suppress(OSError):  # as digests of what cannot be read
                        inside = [] if data else list(files.inside(path))
                        found |= dict.fromkeys(one for one in inside if one.suffix == ".py")
                elif data or _is_code(path, spec):
                    found[path] = None
        _of_specs[key] = list(found)
    return _of_specs[key]


def _is_code(path: Path, spec: Spec) -> bool:
    started = spec.planner.name == "program" and os.access(path, os.X_OK)
    return path.suffix == ".py" or started
