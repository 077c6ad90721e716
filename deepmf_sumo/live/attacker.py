"""Attacks around the steps of somebody's own script."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from zlib import crc32

import numpy as np

from deepmf_sumo.datatypes import AgentId, Plan, TurnRules, View
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.errors import SimulationError, UsageError, nearest
from deepmf_sumo.live.connection import (
    LiveApi,
    Port,
    connect,
    lost,
    of_sumo,
    others,
    road_files,
    shared,
)
from deepmf_sumo.live.engagement import Scenery, Surroundings
from deepmf_sumo.live.observer import Observer
from deepmf_sumo.live.record import Record, Stage
from deepmf_sumo.live.session import End, Fought, Lockstep, Session, Stay
from deepmf_sumo.live.triggers import Always, AtEdge, Trigger, parse
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.spec import Spec, of_document
from deepmf_sumo.spec.document import Document


@dataclass(frozen=True, slots=True)
class OneThread:
    """The policy ``inner``, whose networks compute within ``one_thread``."""

    inner: Policy
    one_thread: Callable[[], AbstractContextManager[None]]

    @property
    def period_steps(self) -> int | None:
        """As of the policy."""
        return self.inner.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """As the policy's."""
        with self.one_thread():
            return self.inner.reset(view, rng)

    def plan(self, view: View) -> Plan | None:
        """As the policy's."""
        with self.one_thread():
            return self.inner.plan(view)


_SHORTEST_S: Final = 3.0
_RADIUS_M: Final = 80.0
"""Around the AV: the opponent network looks no farther, and beyond it is out of reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What the attacks shall be like.

    Attributes:
        av: id of the vehicle.
        triggers: ``time=S``, ``edge=ID``, ``ttc=S``; an attack begins when one of them fires.
            Empty: whenever somebody can attack.
        duration_s: of an attack, at most. pause_s: after it.
        sets: ``key=value`` as in specs: ``adversary``, ``weights`` and ``seed``.
        net: the network file; None asks SUMO.
    """

    av: AgentId
    triggers: tuple[str, ...] = ()
    duration_s: float = 15.0
    pause_s: float = 5.0
    sets: tuple[str, ...] = ()
    net: Path | None = None


def triggers_of(wish: Wish) -> tuple[Trigger, ...]:
    """When attacks begin. Raises UsageError for what is none, or times that cannot be."""
    for name, value, least in (
        ("duration", wish.duration_s, _SHORTEST_S),
        ("pause", wish.pause_s, 0.0),
    ):
        if not least <= value < math.inf:  # nan is neither
            raise UsageError(f"{name} is {value:g} s; it must be {least:g} s at least, and finite.")
    if not wish.triggers:
        return (Always(),)
    return parse([one for one in wish.triggers if one != "call"])


def spec_of(wish: Wish) -> Spec:
    """The settings as a spec would have them. Raises SpecError or UsageError."""
    values: dict[str, Any] = {
        "version": 1,
        "name": "live",
        # a source is none of ours: the simulation runs already
        "source": {"network": ".", "av": {"vehicle": wish.av}},
        "adversary": {"name": "deepmf"},
    }
    document = Document(file=Path("deepmf-sumo attach"), values=values)
    for assignment in wish.sets:
        key = assignment.partition("=")[0].strip()
        if key.partition(".")[0] not in {"adversary", "weights", "seed"}:
            raise UsageError(
                f"--set {assignment}: of a running simulation only adversary, weights and seed can "
                "be set."
            )
        if key.startswith("adversary.") and isinstance(values["adversary"], str):
            values["adversary"] = {"version": values["adversary"]}
        document.assign(assignment)
    spec = of_document(document)
    if spec.adversary.name != "deepmf":
        raise UsageError(
            f"adversary '{spec.adversary.name}' tries attacks in simulations of its own; in a "
            "running one only deepmf attacks (S1, S2, S4 or G)."
        )
    return spec


def policy_of(spec: Spec) -> Policy:
    """What drives the opponents. Raises WeightsError."""
    settings = Settings.model_validate(spec.adversary.settings)
    if settings.opponent == "labelled":
        raise UsageError("adversary.opponent 'labelled': only recordings label an opponent.")
    from deepmf_sumo.predictors import weights  # brings torch along
    from deepmf_sumo.predictors.weights import one_thread

    return OneThread(build(settings, weights.cached_predictors(spec.weights)), one_thread)


def session(
    api: LiveApi,
    wish: Wish,
    spec: Spec,
    finished: Callable[[Fought], None],
    policy: Policy | None = None,
    driven: Callable[[], bool] = lambda: True,
) -> Session:
    """A session on a simulation that stands between two steps; ``driven`` as of `Session`."""
    if wish.net is None:
        net, additional = road_files(api, Path.cwd())
    else:
        net, additional = wish.net, ()
        if not net.is_file():
            raise UsageError(f"There is no network '{net}'.")
    triggers = triggers_of(wish)
    _check_edges(api, triggers)
    scenery = Scenery(
        api=api,
        av_id=wish.av,
        observer=Observer(api, wish.av, _RADIUS_M),
        surroundings=Surroundings(api, net, additional),
        rules=TurnRules(longest_s=wish.duration_s),
    )
    return Session(
        scenery,
        policy or policy_of(spec),
        triggers,
        wish.pause_s,
        np.random.default_rng([spec.seed, crc32(wish.av.encode())]),
        finished,
        driven,
    )


def stage_of(session: Session, wish: Wish, planner: str = "script") -> Stage:
    """Where the attacks of a session take place, and who drives the AV."""
    around = session.surroundings
    return Stage(net=around.net, road=around.road, longest_s=wish.duration_s, planner=planner)


def _check_edges(api: LiveApi, triggers: Sequence[Trigger]) -> None:
    """An edge that does not exist would never be reached. Raises UsageError."""
    wanted = [one.edge for one in triggers if isinstance(one, AtEdge)]
    known = {lane.rpartition("_")[0] for lane in api.lane.getIDList()} if wanted else set()
    for edge in wanted:
        if edge not in known:
            hint = nearest(edge, sorted(known))
            raise UsageError(f"trigger 'edge={edge}': the network has no such edge.{hint}")


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
        wish = Wish(
            av=av,
            triggers=texts,
            duration_s=duration_s,
            pause_s=pause_s,
            sets=(sets,) if isinstance(sets, str) else tuple(sets),
            net=None if net is None else Path(net),
        )
        api, spec = shared(conn), spec_of(wish)
        triggers_of(wish)
        self._record = Record(
            None if out is None else Path(out), av, spec, overwrite=overwrite, ways=_WAYS
        )
        self._session = session(api, wish, spec, self._record.add)
        self._record.begin(stage_of(self._session, wish))

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
    wish: Wish,
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
    triggers_of(wish)  # what is wrong with the command shows before anybody waits for us
    spec = spec_of(wish)
    policy = policy_of(spec)
    record = Record(out, wish.av, spec, overwrite=overwrite)

    def add(fought: Fought) -> None:
        record.add(fought)
        tell(record.rows[-1])

    api = connect(port, stopped)
    with _closed_where_it_fails(api):
        clients = others(api)  # all of them have come by now

        def driven() -> bool:
            return not clients or others(api) != 0

        own = session(api, wish, spec, add, policy, driven)
        collisions = str(api.simulation.getOption("collision.action"))
        record.begin(stage_of(own, wish, planner="sumo" if clients == 0 else "script"))
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
