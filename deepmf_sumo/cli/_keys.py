"""Keys of ``--set`` that say how a command works, and not what a spec means.

``sweep.KEY`` of `run`, `attack` and `try`, ``live.KEY`` of `attach` and `serve`, and the keys of
commands without a spec.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, TypeVar

from pydantic import Field

from deepmf_sumo.errors import SpecError
from deepmf_sumo.spec.document import Document
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import ExistingPath, Strict
from deepmf_sumo.study.sweep.limits import MEMORY_MB, TIMEOUT_S

SWEEP: Final = "sweep"
LIVE: Final = "live"
Keys = TypeVar("Keys", bound=Strict)


class SweepKeys(Strict):
    """How runs are done and judged; nothing here changes a run."""

    executor: str = Field(
        default="local",
        description="local: on this machine; ray: on its Ray cluster; or ray://HOST:PORT",
    )
    timeout_s: float | None = Field(
        default=TIMEOUT_S, gt=0, description="a run that takes longer is ended"
    )
    memory_mb: float | None = Field(
        default=MEMORY_MB, gt=0, description="a run that takes more memory is ended"
    )
    max_minutes: float | None = Field(
        default=None,
        gt=0,
        description="no run starts after this time: exit code 130, --resume continues",
    )
    gui: bool = Field(default=False, description="each run is shown in sumo-gui, one at a time")
    junit: bool = Field(default=False, description="junit.xml is written into the folder")
    thresholds: ExistingPath | None = Field(
        default=None, description="file by which results are judged, as `check` does"
    )
    baseline: ExistingPath | None = Field(
        default=None, description="earlier results to compare with, as `check` does"
    )
    risk: bool = Field(default=True, description="of attack: the risk map is written at the end")
    figures: bool = Field(default=True, description="of a plan: its figures are drawn")


class LiveKeys(Strict):
    """Attacks on a running simulation; times in seconds of the simulation."""

    pause_s: float = Field(default=5.0, ge=0, description="time without an attack after each")
    attacks: int | None = Field(
        default=None, ge=1, description="number of attacks after which the command ends"
    )
    http: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="port of this machine that shows what happens, with a switch for new attacks",
    )


class AttachKeys(LiveKeys):
    """Where SUMO is, and how long to wait for it."""

    order: int = Field(default=2, description="this client's number (setOrder)")
    wait_s: float = Field(
        default=10.0, ge=0, description="time to wait until SUMO listens on the port"
    )
    patience_s: float = Field(default=600.0, ge=0, description="time to wait for the AV")
    net: ExistingPath | None = Field(
        default=None, description="network file; by default that which SUMO names"
    )


class RecordKeys(Strict):
    """Which scenes of a traffic are recorded."""

    start_s: float = Field(default=60.0, ge=0, description="first time of the simulation")
    every_s: float = Field(default=9.0, ge=0.1, description="time between two recordings")
    avs: int = Field(default=1, ge=1, description="most scenes at a time, each around another AV")
    diverse: bool = Field(
        default=True, description="false: vehicles keep the types of the demand, none is added"
    )


class ConflictKeys(Strict):
    """What counts as a conflict."""

    ttc_s: float = Field(default=1.5, ge=0.1, le=10, description="largest time to collision")
    pet_s: float = Field(default=5.0, ge=0.1, le=20, description="largest post-encroachment time")


def taken(sets: Sequence[str], model: type[Keys], head: str = "") -> tuple[Keys, list[str]]:
    """The keys ``head.KEY`` of ``--set``, or without ``head`` all, and what else is set.

    Raises SpecError for unknown keys and wrong values.
    """
    document = Document(file=Path("--set"), values={head: {}} if head else {})
    others = []
    for one in sets:
        if head and one.partition("=")[0].strip().partition(".")[0] != head:
            others.append(one)
        else:
            document.assign(one)
    values = document.values[head] if head else document.values
    if not isinstance(values, dict):
        raise SpecError(f"{document.place((head,))}: write {head}.KEY=VALUE.")
    context = {"folder": "."}
    return checked(model, values, (head,) if head else (), document, context), others
