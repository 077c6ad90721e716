"""Where tasks are done: in processes of this machine, or on the machines of a Ray cluster."""

import re
from typing import Final

from deepmf_sumo.benchmark.executors.base import Executor, Limits, Local, Work
from deepmf_sumo.benchmark.executors.cluster import Cluster
from deepmf_sumo.errors import UsageError

_ADDRESS: Final = re.compile(r"ray://(\[[0-9a-fA-F:]+\]|[^\s:/]+)(?::(\d{1,5}))?/?")
_CLIENT_PORT: Final = 10001
"""Of Ray's own for programs outside the cluster."""


def chosen(text: str = "local", jobs: int | None = None) -> Executor:
    """The executor of the option ``--executor``: ``local``, ``ray`` or ``ray://host:port``.

    Args:
        text: ``ray`` is the cluster that this machine is part of, or a new one of this machine.
        jobs: workers; None is 1 of this machine, and all processors of a cluster.

    Raises UsageError for anything else.
    """
    if text == "local":
        return Local(jobs=jobs or 1)
    if text == "ray":
        return Cluster(jobs=jobs)
    found = _ADDRESS.fullmatch(text)
    if found is None or int(found[2] or 0) > 65535:
        raise UsageError(
            f"--executor {text}: must be local, ray, or ray://HOST:PORT, e.g."
            f" ray://head.example.org:{_CLIENT_PORT}."
        )
    return Cluster(host=found[1].strip("[]"), port=int(found[2] or _CLIENT_PORT), jobs=jobs)


__all__ = ["Executor", "Limits", "Work", "chosen"]
