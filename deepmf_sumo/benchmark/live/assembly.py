"""A session put together: settings as of a spec, DeepMF, the road of the simulation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import numpy as np

from deepmf_sumo.benchmark.live.one_thread import OneThread
from deepmf_sumo.benchmark.live.results import Stage
from deepmf_sumo.datatypes import AgentId, TurnRules
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.errors import UsageError, nearest
from deepmf_sumo.live.connection import LiveApi, road_files
from deepmf_sumo.live.engagement import Scenery, Surroundings
from deepmf_sumo.live.observer import Observer
from deepmf_sumo.live.session import Fought, Session
from deepmf_sumo.live.triggers import Always, AtEdge, Trigger, parse
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.spec import Spec, of_document
from deepmf_sumo.spec.document import Document

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
