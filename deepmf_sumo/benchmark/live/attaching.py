"""One more client of a running SUMO."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepmf_sumo.benchmark.live import assembly
from deepmf_sumo.benchmark.live.record import Record
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.live.connection import LiveApi, Port, connect, lost, of_sumo, others
from deepmf_sumo.live.session import End, Fought, Lockstep, Stay


@dataclass(frozen=True, slots=True, kw_only=True)
class Attached:
    """What `attach` has done.

    Attributes:
        rows: the attacks. end: why it left, at ``time_s`` of the simulation.
        nobody: why the last try to attack was none.
        collisions: what SUMO does with them, its ``--collision.action``.
        undriven: attacks that were not over when the script left; they are not in ``rows``.
        watched: whether it was to be seen that the script left.
    """

    rows: list[dict[str, Any]]
    end: End
    time_s: float
    nobody: str
    collisions: str
    undriven: int
    watched: bool


def attach(
    port: Port,
    wish: assembly.Wish,
    stay: Stay,
    out: Path,
    *,
    overwrite: bool = False,
    stopped: Callable[[], bool],
    tell: Callable[[dict[str, Any]], None],
) -> Attached:
    """Join a running SUMO as one more client, attack, and leave it as it was.

    Args:
        port: where SUMO listens.
        wish: whom to attack, when and how.
        stay: how long.
        out: folder for what happened.
        overwrite: delete the results of an earlier command in it.
        stopped: whether to leave now.
        tell: is told of each attack that is over.

    Raises UsageError for what is wrong in the command, SimulationError where nobody listens, the
    connection is lost or the AV never appears; what was attacked before that is in ``out``.
    """
    assembly.triggers_of(wish)  # what is wrong with the command shows before anybody waits for us
    spec = assembly.spec_of(wish)
    policy = assembly.policy_of(spec)
    record = Record(out, wish.av, spec, overwrite=overwrite)

    def add(fought: Fought) -> None:
        record.add(fought)
        tell(record.rows[-1])

    api = connect(port, stopped)
    with _closed_where_it_fails(api):
        clients = others(api)  # all of them have come by now

        def driven() -> bool:
            return not clients or others(api) != 0

        own = assembly.session(api, wish, spec, add, policy, driven)
        collisions = str(api.simulation.getOption("collision.action"))
        record.begin(assembly.stage_of(own, wish, planner="sumo" if clients == 0 else "script"))
        steps = Lockstep(api, own, wish.av, stay, stopped)
    end: str = "failed"
    try:
        end = left = steps.run()
    finally:
        record.finish(end, steps.ended_s)
    return Attached(
        rows=record.rows,
        end=left,
        time_s=steps.ended_s,
        nobody=own.nobody,
        collisions=collisions,
        undriven=own.undriven,
        watched=clients is not None,
    )


_NUMBERS = (
    "every client needs a number of its own, --order here and setOrder in a script, and SUMO one "
    "--num-clients for all of them."
)


@contextmanager
def _closed_where_it_fails(api: LiveApi) -> Iterator[None]:
    """Before the first step: say goodbye whatever goes wrong, for SUMO quits without."""
    try:
        yield
    except BaseException as error:
        with suppress(Exception):
            api.close()
        if lost(error):
            raise SimulationError(
                f"The connection was lost before the first step ({str(error).strip()}): SUMO has "
                f"ended, or another of its clients broke off; {_NUMBERS}"
            ) from None
        if of_sumo(error):  # also what SUMO answers late to setOrder
            raise SimulationError(
                f"SUMO refused before the first step ({str(error).strip()}); {_NUMBERS}"
            ) from None
        raise
