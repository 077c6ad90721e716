"""Attacks on vehicles of a simulation that another program steps: `Attacker` and `attach`."""

import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self
from zlib import crc32

import numpy as np

from deepmf_sumo import foreign
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.errors import SimulationError, UsageError, nearest
from deepmf_sumo.live.connection import (
    LiveApi,
    Port,
    abandon,
    connect,
    lost,
    of_sumo,
    others,
    road_files,
    shared,
)
from deepmf_sumo.live.engagement import LiveRoad, Scenery
from deepmf_sumo.live.lockstep import End, Lockstep, Stay
from deepmf_sumo.live.observer import LiveObserver
from deepmf_sumo.live.record import SessionRecord, Setting
from deepmf_sumo.live.session import LiveAttack, Session
from deepmf_sumo.live.triggers import AtEdge, Trigger, parse
from deepmf_sumo.scene import AgentId, Plan, TurnRules, View
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.spec import Spec, of_document
from deepmf_sumo.spec.document import Document
from deepmf_sumo.spec.loading import assign
from deepmf_sumo.spec.profiles import applies_to


@dataclass(frozen=True, slots=True)
class OneThread:
    """The policy ``inner``, with its networks limited to one thread by ``one_thread``."""

    inner: Policy
    one_thread: Callable[[], AbstractContextManager[None]]

    @property
    def period_steps(self) -> int | None:
        """That of the policy."""
        return self.inner.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """As the policy does."""
        with self.one_thread():
            return self.inner.reset(view, rng)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """As the policy does."""
        with self.one_thread():
            return self.inner.plan(view)


class LatePolicy:
    """What `policy_of` makes of a spec, made when an attack first begins: that takes seconds."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec

    @cached_property
    def _policy(self) -> Policy:
        return policy_of(self._spec)

    @property
    def period_steps(self) -> int | None:
        """That of the policy."""
        return self._policy.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """As the policy does. Raises WeightsError."""
        return self._policy.reset(view, rng)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """As the policy does."""
        return self._policy.plan(view)


_SHORTEST_S: Final = 3.0
_RADIUS_M: Final = 80.0
"""Around the AV: the range of the opponent network, and the reach of an attack."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackRequest:
    """The attacks that are wanted.

    Attributes:
        avs: ids of the vehicles that are attacked, each for itself: none of them attacks another.
        triggers: ``time=S``, ``edge=ID``, ``ttc=S``; an attack begins when one of them fires.
            Empty: whenever a vehicle can attack.
        duration_s: maximum of an attack. pause_s: after it.
        sets: ``key=value`` as in specs: ``profile``, ``adversary``, ``weights`` and ``seed``.
        net: the network file; None asks SUMO.
        spared: asked before each attack for the road users that do not attack.
    """

    avs: tuple[AgentId, ...]
    triggers: tuple[str, ...] = ()
    duration_s: float = 15.0
    pause_s: float = 5.0
    sets: tuple[str, ...] = ()
    net: Path | None = None
    spared: Callable[[], Collection[AgentId]] = tuple


def triggers_of(wish: AttackRequest) -> tuple[Trigger, ...]:
    """When attacks on one AV begin.

    Raises UsageError for an invalid trigger, duration or pause, and for an AV that is named twice.
    """
    for av in wish.avs:
        if wish.avs.count(av) > 1:
            raise UsageError(f"AV '{av}' is named {wish.avs.count(av)} times; name it once.")
    for name, value, least in (
        ("duration", wish.duration_s, _SHORTEST_S),
        ("pause", wish.pause_s, 0.0),
    ):
        if not least <= value < math.inf:  # nan is neither
            raise UsageError(f"{name} is {value:g} s; it must be {least:g} s at least, and finite.")
    if not wish.triggers:
        return (Trigger(),)
    return parse([one for one in wish.triggers if one != "call"])


def spec_of(wish: AttackRequest) -> Spec:
    """The settings as a spec of one attack in a network has them.

    Raises SpecError or UsageError.
    """
    values: dict[str, Any] = {
        "version": 3,
        "name": "live",
        # not used: the simulation runs already
        "source": {"network": ".", "av": {"vehicle": wish.avs[0]}},
        "adversary": {"name": "deepmf"},
    }
    document = Document(file=Path("deepmf-sumo attach"), values=values)
    for assignment in wish.sets:
        key = assignment.partition("=")[0].strip()
        if key.partition(".")[0] not in {"profile", "adversary", "weights", "seed"}:
            raise UsageError(
                f"--set {assignment}: of a running simulation only profile, adversary, weights and"
                " seed can be set."
            )
        assign(document, assignment)
    choice = values["adversary"]
    # a running simulation cannot be tried again
    if isinstance(choice, dict) and applies_to(str(choice.get("name", "deepmf"))):
        choice.setdefault("goal", "hit")
        choice.setdefault("tries", 1)
    spec = of_document(document)
    if spec.adversary.name != "deepmf":
        raise UsageError(
            f"adversary '{spec.adversary.name}' tries attacks in simulations of its own; in a "
            "running one only deepmf attacks (S1, S2, S4 or G)."
        )
    return spec


def policy_of(spec: Spec) -> Policy:
    """The policy that drives the opponents. Raises UsageError and WeightsError."""
    from deepmf_sumo.deepmf.networks import weights
    from deepmf_sumo.deepmf.networks.weights import one_thread

    predictors = weights.cached_predictors(spec.weights)
    return OneThread(build(_settings(spec), predictors), one_thread)


def _settings(spec: Spec) -> Settings:
    """Of the opponents' policy. Raises UsageError for what no running simulation allows."""
    settings = Settings.model_validate(spec.adversary.settings)
    if settings.opponent == "labelled":
        raise UsageError("adversary.opponent 'labelled': only recordings label an opponent.")
    if settings.tries > 1:
        raise UsageError(
            f"adversary.tries {settings.tries}: a running simulation cannot be tried again;"
            " leave it at 1."
        )
    if settings.supporting:
        raise UsageError(
            "adversary.supporting 1: in a simulation of another program only attackers are driven;"
            " leave it at 0."
        )
    return settings


def sessions(
    api: LiveApi,
    wish: AttackRequest,
    spec: Spec,
    finished: Callable[[LiveAttack], None],
    policies: Sequence[Policy] = (),
    driven: Callable[[], bool] = lambda: True,
    number: int = 1,
) -> tuple[Session, ...]:
    """A session for each AV of a simulation that stands between two steps.

    ``policies``: one for each AV, instead of `policy_of`. ``driven``: as of `Session`. ``number``:
    of the simulation; each has random numbers of its own.
    """
    if wish.net is None:
        net, additional = road_files(api, Path.cwd())
    else:
        net, additional = wish.net, ()
        if not net.is_file():
            raise UsageError(f"There is no network '{net}'.")
    _check_edges(api, triggers_of(wish))
    surroundings = LiveRoad(api, net, additional)
    found: list[Session] = []

    def taken(av: AgentId) -> set[AgentId]:
        """The other AVs and their opponents, and who is spared."""
        others = [one for one in found if one.av_id != av]
        busy = {one.av_id for one in others}.union(*(one.driving for one in others))
        return busy.union(wish.spared()) - {av}

    for av, policy in zip(wish.avs, policies or [policy_of(spec) for _ in wish.avs], strict=True):
        scenery = Scenery(
            api=api,
            av_id=av,
            observer=LiveObserver(api, av, _RADIUS_M),
            surroundings=surroundings,
            rules=TurnRules(longest_s=wish.duration_s),
            pause_s=wish.pause_s,
        )
        rng = np.random.default_rng([spec.seed, crc32(av.encode()), *range(2, number + 1)])
        found.append(
            Session(
                scenery, policy, triggers_of(wish), rng, finished, driven,
                functools.partial(taken, av),
            )
        )  # fmt: skip
    return tuple(found)


def setting_of(session: Session, wish: AttackRequest, planner: str = "script") -> Setting:
    """Where the attacks of sessions take place, and what drives the AV."""
    around = session.surroundings
    return Setting(net=around.net, road=around.road, longest_s=wish.duration_s, planner=planner)


def _check_edges(api: LiveApi, triggers: Sequence[Trigger]) -> None:
    """Raise UsageError for an edge that the network does not have: the AV would never reach it."""
    wanted = [one.edge for one in triggers if isinstance(one, AtEdge)]
    known = {lane.rpartition("_")[0] for lane in api.lane.getIDList()} if wanted else set()
    for edge in wanted:
        if edge not in known:
            hint = nearest(edge, sorted(known))
            raise UsageError(f"trigger 'edge={edge}': the network has no such edge.{hint}")


_WAYS: Final = "overwrite=True deletes them, another folder for out keeps them"


class Attacker:
    """Attacks a vehicle of a simulation that the caller's script steps, or several.

    ::

        with deepmf_sumo.Attacker(traci, av="ego", trigger="ttc=4") as attacker:
            while traci.simulation.getMinExpectedNumber() > 0:
                attacker.before_step()
                traci.simulationStep()
                attacker.after_step()

    The script drives the AV and steps, one step between the two calls. The attacker drives the
    opponent during an attack; then SUMO drives it again. Leaving the block hands it back.

    Args:
        conn: the module ``libsumo`` or ``traci``, or what ``traci.connect`` returned.
        av: id of the vehicle under test, or several; it may leave and return.
        trigger: ``time=S``, ``edge=ID``, ``ttc=S``, several of them, or ``call``: only when
            `attack` is called. None: whenever a vehicle can attack.
        duration_s: maximum of an attack. pause_s: after it, before the next.
        sets: ``key=value`` as in specs, or several, of ``profile``, ``adversary``, ``weights`` and
            ``seed``.
        net: the network file; None asks SUMO, which names it relative to its working folder.
        out: folder for ``attacks.jsonl`` and the attacks as runs of a result folder; None writes
            nothing.
        overwrite: delete the results of an earlier command in ``out``; else they are an error.
        spared: asked before each attack for ids of road users that do not attack, for example
            vehicles that another program moves.

    Attributes:
        attacks: those that are over, as dictionaries: one for each line of ``attacks.jsonl``.

    Raises SpecError for settings, UsageError for a trigger, an unsuitable step length or a missing
    network, WeightsError for weights, OutputError for a folder that cannot be used.
    """

    @foreign.called()
    def __init__(
        self,
        conn: Any,
        av: AgentId | Sequence[AgentId],
        *,
        trigger: str | Sequence[str] | None = None,
        duration_s: float = 15.0,
        pause_s: float = 5.0,
        sets: str | Sequence[str] = (),
        net: Path | str | None = None,
        out: Path | str | None = None,
        overwrite: bool = False,
        spared: Callable[[], Collection[AgentId]] = tuple,
    ) -> None:
        texts = (trigger,) if isinstance(trigger, str) else tuple(trigger or ())
        wish = AttackRequest(
            avs=(av,) if isinstance(av, str) else tuple(av),
            triggers=texts,
            duration_s=duration_s,
            pause_s=pause_s,
            sets=(sets,) if isinstance(sets, str) else tuple(sets),
            net=None if net is None else Path(net),
            spared=spared,
        )
        api, spec = shared(conn), spec_of(wish)
        triggers_of(wish)
        self._record = SessionRecord(
            None if out is None else Path(out), wish.avs, spec, overwrite=overwrite, ways=_WAYS
        )
        self._sessions = sessions(api, wish, spec, self._record.add)
        for one in self._sessions:
            one.switched = self._record.switch
        self._sessions[0].jumped = self._record.jump
        self._record.begin(setting_of(self._sessions[0], wish))

    @property
    def attacks(self) -> list[dict[str, Any]]:
        """The attacks that are over."""
        return self._record.rows

    def switch(self, *, on: bool) -> None:
        """Turn new attacks on or off; one that goes on ends as it would."""
        for one in self._sessions:
            one.switch(on=on)

    @property
    def opponents(self) -> dict[AgentId, AgentId]:
        """The vehicles that attack now, by the AV that each attacks; of several, the first."""
        return {one.av_id: one.attacking for one in self._sessions if one.attacking is not None}

    @property
    def opponent(self) -> AgentId | None:
        """The vehicle that attacks now, or None; with several AVs see `opponents`."""
        return next(iter(self.opponents.values()), None)

    @property
    def driving(self) -> set[AgentId]:
        """All vehicles that it drives now: attackers, and those on their way back to a lane."""
        return set().union(*(one.driving for one in self._sessions))

    @foreign.called()
    def attack(self, av: AgentId | None = None) -> None:
        """Attack as soon as a vehicle can, whatever the trigger; one AV, or all of them."""
        for one in self._sessions:
            if av in {None, one.av_id}:
                one.attack()

    @foreign.called()
    def before_step(self) -> None:
        """Drive the opponents in the coming step."""
        for one in self._sessions:
            one.before_step()

    @foreign.called()
    def after_step(self) -> None:
        """Observe the step."""
        for one in self._sessions:
            one.after_step()

    @foreign.called()
    def close(self) -> None:
        """Hand the opponents back, and finish the files."""
        for one in self._sessions:
            one.close()
        self._record.finish("closed", self._sessions[0].time_s)
        self._record.close()

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
            if error is None:  # else the error of the script is the one to raise
                raise


@dataclass(frozen=True, slots=True, kw_only=True)
class Attached:
    """The result of `attach`.

    Attributes:
        profile: of the attacks, as `spec.profiles.described` says it.
        rows: the attacks. end: why it left, at ``time_s`` of the simulation.
        last_failure: why the last try to attack failed.
        collisions: what SUMO does at a collision, its ``--collision.action``.
        undriven: attacks that were not over when the script left; they are not in ``rows``.
        watched: whether it could observe that the script left.
        switches: when new attacks were turned off and on, as in ``session.json``.
    """

    profile: str
    rows: list[dict[str, Any]]
    end: End
    time_s: float
    last_failure: str
    collisions: str
    undriven: int
    watched: bool
    switches: list[dict[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """All that a session needs except SUMO: the wish, and what it was made into."""

    wish: AttackRequest
    spec: Spec
    policies: tuple[Policy, ...]
    record: SessionRecord

    def close(self) -> None:
        """Give the folder free, after the last `attach`."""
        self.record.close()


def prepare(wish: AttackRequest, out: Path, *, overwrite: bool = False) -> Prepared:
    """Errors in a command show here, before SUMO waits for this client.

    Args:
        wish: the attacks that are wanted.
        out: folder for the attacks.
        overwrite: delete the results of an earlier command in it, when the session begins.

    The predictors are loaded where the first attack begins.

    Raises SpecError and UsageError for a wrong command, WeightsError for weights, OutputError for a
    folder that cannot be used.
    """
    from deepmf_sumo.deepmf.networks import weights

    triggers_of(wish)
    spec = spec_of(wish)
    _settings(spec)
    weights.check(spec.weights)
    policies = tuple(LatePolicy(spec) for _ in wish.avs)
    record = SessionRecord(out, wish.avs, spec, overwrite=overwrite)
    return Prepared(wish=wish, spec=spec, policies=policies, record=record)


class Client(Protocol):
    """The script that drives the AV, as far as `serve` sees it.

    Attributes:
        left: whether it has left. unused: so without a step: SUMO would wait for it for ever.
    """

    @property
    def left(self) -> bool: ...
    @property
    def unused(self) -> bool: ...


def attach(
    port: Port,
    prepared: Prepared,
    stay: Stay,
    *,
    stopped: Callable[[], bool],
    tell: Callable[[dict[str, Any]], None],
    watch: Callable[[Sequence[Session]], None] = lambda _: None,
    client: Client | None = None,
) -> Attached:
    """Join a running SUMO as one more client, attack, and leave it as it was.

    May be called again with another SUMO: its attacks come into the same folder.

    Args:
        port: where SUMO listens.
        prepared: see `prepare`.
        stay: how long to take part.
        stopped: whether to leave now.
        tell: called with each attack that is over.
        watch: called with the sessions before the first step.
        client: the script that drives the AV; None looks at SUMO's connections.

    Raises UsageError for a wrong command, SimulationError if no SUMO listens, the connection is
    lost or the AV never appears; attacks before that are in the folder.
    """
    record = prepared.record
    api = connect(port, stopped)
    with _closed_where_it_fails(api):
        own, clients = _joined(api, prepared, tell, client)
        collisions = str(api.simulation.getOption("collision.action"))
        watch(own)
        over = stopped if client is None else lambda: stopped() or client.unused
        steps = Lockstep(api, own, stay, over)
    end: str = "failed"
    try:
        why = steps.run()
        if why == "stopped" and not stopped():
            why = "script_left"
        end = why
    except KeyboardInterrupt:
        end = "stopped"
        abandon(api)
        raise
    finally:
        if end == "stopped":
            for one in own:
                one.switch(on=False, door="signal")
        record.finish(end, steps.ended_s)
    return Attached(
        profile=record.profile,
        rows=record.rows,
        end=why,
        time_s=steps.ended_s,
        last_failure=next((one.last_failure for one in own if one.last_failure), ""),
        collisions=collisions,
        undriven=sum(one.undriven for one in own),
        watched=clients is not None,
        switches=record.switches,
    )


def _joined(
    api: LiveApi,
    prepared: Prepared,
    tell: Callable[[dict[str, Any]], None],
    client: Client | None,
) -> tuple[Sequence[Session], int | None]:
    """A session for each AV, and how many other clients there are; None where that is not known."""
    wish, record = prepared.wish, prepared.record

    def add(attack: LiveAttack) -> None:
        record.add(attack)
        tell(record.rows[-1])

    clients = others(api) if client is None else 1  # all of them are connected by now

    def driven() -> bool:
        if client is not None:
            return not client.left
        return not clients or others(api) != 0

    number = record.simulations + 1
    own = sessions(api, wish, prepared.spec, add, prepared.policies, driven, number)
    record.begin(setting_of(own[0], wish, planner="sumo" if clients == 0 else "script"))
    for one in own:
        one.switched = record.switch
    own[0].jumped = record.jump  # all of them see the same
    return own, clients


_NUMBERS = (
    "every client needs a number of its own, live.order here and setOrder in a script, and SUMO"
    " one --num-clients for all of them."
)


@contextmanager
def _closed_where_it_fails(api: LiveApi) -> Iterator[None]:
    """Before the first step: close the connection after any error, for SUMO quits otherwise."""
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
