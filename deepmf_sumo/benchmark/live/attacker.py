"""Attacks around the steps of somebody's own script."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from deepmf_sumo.benchmark.live import assembly
from deepmf_sumo.benchmark.live.record import Record
from deepmf_sumo.datatypes import AgentId
from deepmf_sumo.live.connection import shared

_WAYS: Final = "overwrite=True deletes them, another folder for out keeps them"


class Attacker:
    """Attacks a vehicle of a simulation that the caller's script steps.

    ::

        with deepmf_sumo.Attacker(traci, av="ego", trigger="ttc=4") as attacker:
            while traci.simulation.getMinExpectedNumber() > 0:
                attacker.before_step()
                traci.simulationStep()
                attacker.after_step()

    The script drives the AV and steps, one step between the two calls; the opponent is driven here
    while an attack goes on, and is SUMO's again afterwards. Leaving the block hands it back.

    Args:
        conn: the module ``libsumo`` or ``traci``, or what ``traci.connect`` returned.
        av: id of the vehicle under test; it may come and go.
        trigger: ``time=S``, ``edge=ID``, ``ttc=S``, several of them, or ``call``: only when
            `attack` is called. None: whenever somebody can attack.
        duration_s: of an attack, at most. pause_s: after it, before the next.
        sets: ``key=value`` as in specs, or several, of ``adversary``, ``weights`` and ``seed``.
        net: the network file; None asks SUMO, which names it relative to where it was started.
        out: folder for ``attacks.jsonl`` and the attacks as runs of a result folder; None writes
            nothing.
        overwrite: delete the results of an earlier command in ``out``; else they are refused.

    Attributes:
        attacks: those that are over, as dictionaries: a line of ``attacks.jsonl`` each.

    Raises SpecError for settings, UsageError for a trigger, a step that does not fit or a network
    that is not found, WeightsError for weights, OutputError for a folder that cannot be used.
    """

    def __init__(
        self,
        conn: Any,
        av: AgentId,
        *,
        trigger: str | Sequence[str] | None = None,
        duration_s: float = 15.0,
        pause_s: float = 5.0,
        sets: str | Sequence[str] = (),
        net: Path | str | None = None,
        out: Path | str | None = None,
        overwrite: bool = False,
    ) -> None:
        texts = (trigger,) if isinstance(trigger, str) else tuple(trigger or ())
        wish = assembly.Wish(
            av=av,
            triggers=texts,
            duration_s=duration_s,
            pause_s=pause_s,
            sets=(sets,) if isinstance(sets, str) else tuple(sets),
            net=None if net is None else Path(net),
        )
        api, spec = shared(conn), assembly.spec_of(wish)
        assembly.triggers_of(wish)
        self._record = Record(
            None if out is None else Path(out), av, spec, overwrite=overwrite, ways=_WAYS
        )
        self._session = assembly.session(api, wish, spec, self._record.add)
        self._record.begin(assembly.stage_of(self._session, wish))

    @property
    def attacks(self) -> list[dict[str, Any]]:
        """Those that are over."""
        return self._record.rows

    @property
    def opponent(self) -> AgentId | None:
        """Who attacks now."""
        return self._session.attacking

    def attack(self) -> None:
        """Attack as soon as somebody can, whatever the trigger."""
        self._session.attack()

    def before_step(self) -> None:
        """Drive the opponent in the coming step."""
        self._session.before_step()

    def after_step(self) -> None:
        """See what has become of the step."""
        self._session.after_step()

    def close(self) -> None:
        """Hand the opponent back and leave."""
        self._session.close()
        self._record.finish("closed", self._session.time_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except Exception:
            if error is None:  # else the script's own error is the one to be seen
                raise
