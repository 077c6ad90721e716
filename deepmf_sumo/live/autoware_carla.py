"""The traffic backend ``deepmf`` of autoware-carla-scenario: SUMO's, whose traffic attacks the ego.

That package finds `register` by its entry point ``autoware_carla_scenario.traffic_backends``, steps
SUMO once or several times in each tick of CARLA, and moves the cars in CARLA after SUMO's. Here an
`Attacker` stands around each of these steps.

Why it is as it is:

- Only SUMO's own vehicles that are in CARLA attack. A vehicle of the scenario has its script, and
  one that is not in CARLA cannot be seen by the ego. People do not attack.
- The car of an opponent is put where SUMO has it, as with ``vehicle_control: teleport``, and stays
  so: the physics of CARLA would lag behind the plan.
- What fails during a run ends the attacks, not the run: the package asks that of each backend. The
  result of the run says so.

The class that it derives from is not meant for it, and some names that it uses are private there:
it is for versions 19.3 and later of the package, below 20.
"""

import logging
import os
import sys
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, Final

from autoware_carla_scenario.traffic import (
    TrafficBackendError,
    TrafficBackendUnavailable,
    register_backend,
)
from autoware_carla_scenario.traffic.sumo.backend import SumoTrafficBackend
from autoware_carla_scenario.traffic.sumo.config import SumoBackendConfig
from pydantic import ValidationError

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.live.attacker import Attacker, AttackRequest, policy_of, spec_of, triggers_of
from deepmf_sumo.live.session import parts_of_a_step
from deepmf_sumo.scene import AgentId, agent_ids

_LOGGER: Final = logging.getLogger(__name__)
NAME: Final = "deepmf"


class Attacks(plugins.Settings):
    """``traffic.options.attacks``: arguments of `Attacker` by the same names."""

    trigger: list[str] = []
    duration_s: float = 15.0
    pause_s: float = 5.0
    sets: list[str] = []


def register() -> None:
    """Make ``traffic.backend=deepmf`` known to the package.

    CARLA's client (typesafe-carla 0.8.5) brings an OpenMP library of its own, beside which torch
    2.13 ends the process: ONNX Runtime computes the networks, unless the user has chosen.
    """
    if "torch" not in sys.modules:
        os.environ.setdefault(weights.RUNTIME, "onnx")
    register_backend(NAME, traffic)


def traffic(options: Mapping[str, Any]) -> "DeepmfTraffic":
    """The backend of ``traffic.options``: those of ``sumo``, and ``attacks``.

    Raises ValueError, as the package expects it, naming the key.
    """
    own = dict(options)
    try:
        attacks = Attacks.model_validate(dict(own.pop("attacks", None) or {}))
    except ValidationError as error:
        raise ValueError(f"traffic.options.attacks: {plugins.explain(error, Attacks)}") from None
    return DeepmfTraffic(SumoBackendConfig.from_mapping(own), attacks)


class AttackedSteps:
    """The module libsumo or traci, with an attacker around each step.

    ``failed``: called with what the attacker raised; it then gives its opponents back, and is not
    asked again.
    """

    def __init__(
        self, simulation: Any, attacker: Attacker, failed: Callable[[Exception], None]
    ) -> None:
        self._simulation = simulation
        self._attacker: Attacker | None = attacker
        self._failed = failed

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def simulationStep(self, *until_s: float) -> Any:  # noqa: N802  (SUMO's name)
        """One step of SUMO."""
        self._tell(Attacker.before_step)
        found = self._simulation.simulationStep(*until_s)
        self._tell(Attacker.after_step)
        return found

    def leave(self) -> Any:
        """Hand the opponents back and finish the files; the module alone."""
        self._tell(Attacker.close)
        self._attacker = None
        return self._simulation

    def _tell(self, what: Callable[[Attacker], None]) -> None:
        if self._attacker is None:
            return
        try:
            what(self._attacker)
        except Exception as error:  # noqa: BLE001  (the run goes on without attacks)
            with suppress(Exception):
                self._attacker.close()
            self._attacker = None
            self._failed(error)


class DeepmfTraffic(SumoTrafficBackend):
    """SUMO's traffic in CARLA, which attacks the ego.

    It keeps the name ``sumo``, by which the package finds the parameters that its drivers take.

    Args:
        config: of SUMO, as for the backend ``sumo``.
        attacks: when and how it attacks.

    Raises ValueError for attacks that are not possible.
    """

    _traci: Any  # libsumo or traci; alone, or within `AttackedSteps`
    _attacker: Attacker | None
    _placed: set[AgentId]  # in this run, by an attack
    _trouble: str

    def __init__(
        self, config: SumoBackendConfig | None = None, attacks: Attacks | None = None
    ) -> None:
        super().__init__(config)
        self._attacks = attacks or Attacks()
        self._forget_attacks()
        try:
            triggers_of(self._wish())
            spec_of(self._wish())
        except DeepmfError as error:
            raise ValueError(f"traffic.options.attacks: {error}") from None

    def prepare(self, context: Any) -> None:
        """Start SUMO; refuse a run in which no attack is possible."""
        super().prepare(context)
        try:
            parts_of_a_step(float(self._traci.simulation.getDeltaT()))
            policy_of(spec_of(self._wish()))
        except DeepmfError as error:
            self.close()
            raise TrafficBackendUnavailable(f"traffic.backend={NAME}: {error}") from None

    def start(self, world: Any, *, skip_actor_ids: Collection[int] = ()) -> None:
        """Put the run's vehicles into SUMO, warm the traffic up, and attack from now on."""
        super().start(world, skip_actor_ids=skip_actor_ids)
        if not self._running:
            return
        ego = self._ego_id()
        if ego is None:
            self._no_attacks("the ego is not on SUMO's network")
            return
        own, context = self._attacks, self._context
        try:
            self._attacker = Attacker(
                self._traci, ego, trigger=own.trigger, duration_s=own.duration_s,
                pause_s=own.pause_s, sets=[f"seed={context.random_seed}", *own.sets],
                net=self._network.net_file, out=_unused(Path(context.output_dir) / NAME),
                spared=self._spared,
            )  # fmt: skip
        except DeepmfError as error:
            raise TrafficBackendError(f"traffic.backend={NAME}: {error}") from None
        self._traci = AttackedSteps(self._traci, self._attacker, self._no_attacks)

    def close(self) -> None:
        """End the attacks, then the run."""
        if isinstance(self._traci, AttackedSteps):
            self._traci = self._traci.leave()
        self._forget_attacks()
        super().close()

    def describe(self) -> dict[str, Any]:
        """What the backend ``sumo`` says, and the attacks so far."""
        attacks: dict[str, Any] = {**self._attacks.model_dump(), "fought": self._fought()}
        if self._trouble:
            attacks["ended"] = self._trouble
        return {**super().describe(), "backend": NAME, "attacks": attacks}

    def background_actors(self, world: Any) -> dict[str, Any]:
        """What other adversities may take over: not the opponents."""
        found = super().background_actors(world)
        ours = {self._ambient[one].id for one in self._driving() if one in self._ambient}
        return {name: actor for name, actor in found.items() if actor.id not in ours}

    def _control(self, sumo_id: str) -> str:
        """How the car in CARLA follows: what attacked stays teleported."""
        self._placed |= self._driving()
        return "teleport" if sumo_id in self._placed else super()._control(sumo_id)

    def _to_mesoscopic(self, sumo_id: str, now: float) -> bool:
        return sumo_id not in self._driving() and super()._to_mesoscopic(sumo_id, now)

    def _wish(self) -> AttackRequest:
        """The attacks before the ego has an id."""
        own = self._attacks
        return AttackRequest(
            avs=("ego",), triggers=tuple(own.trigger), duration_s=own.duration_s,
            pause_s=own.pause_s, sets=tuple(own.sets),
        )  # fmt: skip

    def _ego_id(self) -> AgentId | None:
        """SUMO's id of the ego."""
        actors = self._external | {name: one.actor for name, one in self._driven.items()}
        ego = self._ego_actor
        found = (name for name, actor in actors.items() if ego is not None and actor.id == ego.id)
        return next(found, None)

    def _spared(self) -> set[AgentId]:
        """All road users that are not SUMO's own vehicles in CARLA."""
        people = map(agent_ids.of_person, self._traci.person.getIDList())
        return (set(self._traci.vehicle.getIDList()) - set(self._ambient)).union(people)

    def _driving(self) -> set[AgentId]:
        return set() if self._attacker is None else self._attacker.driving

    def _fought(self) -> list[dict[str, Any]]:
        """The attacks that are over, each in a few words; their folders have the rest."""
        rows = [] if self._attacker is None else self._attacker.attacks
        return [{key: row[key] for key in _SAID} for row in rows]

    def _no_attacks(self, why: str | Exception) -> None:
        """There is no attack from now on in this run."""
        error = why if isinstance(why, Exception) else None
        self._trouble = str(why) if error is None else f"{type(error).__name__}: {error}"
        text = "traffic.backend=%s: no attacks from now on: %s"
        _LOGGER.error(text, NAME, self._trouble, exc_info=error)

    def _forget_attacks(self) -> None:
        self._attacker = None
        self._placed = set()
        self._trouble = ""


_SAID: Final = ("begin_s", "opponent", "ended", "min_gap_m")


def _unused(folder: Path) -> Path:
    """The folder, or folder-2, folder-3 ..., the first that does not exist: runs may share it."""
    others = (folder.with_name(f"{folder.name}-{number}") for number in count(2))
    return folder if not folder.exists() else next(one for one in others if not one.exists())
