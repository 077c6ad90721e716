"""What `deepmf_sumo.live.autoware_carla` derives from, as far as it uses it, over libsumo.

Names and meanings are those of autoware-carla-scenario 19.3. ``tests/live/test_autoware_carla.py``
runs the package itself where it is installed.
"""

import types
from types import SimpleNamespace

import libsumo

REGISTERED = {}


class RefusedError(RuntimeError):
    """Both errors of the package."""


class Config(SimpleNamespace):
    """Options of SUMO's traffic; ``config`` is the ``.sumocfg``, ``seen`` who is in CARLA."""

    @classmethod
    def from_mapping(cls, values):
        return cls(**values)


class Traffic:
    """The package's SumoTrafficBackend: a tick is two steps of SUMO."""

    def __init__(self, config=None):
        self._config, self._traci, self._running = config, None, False
        self._ambient, self._external, self._driven = {}, {}, {}
        self._ego_actor = self._context = self._network = None

    def prepare(self, context):
        self.close()
        self._context, self._traci = context, libsumo
        self._network = SimpleNamespace(net_file=self._config.net)
        libsumo.start(["sumo", "-c", str(self._config.config), *self._config.arguments])
        self._running = True

    def start(self, world, *, skip_actor_ids=()):
        self._step_sumo(world)  # its warm-up
        self._ego_actor = SimpleNamespace(id=7)
        if self._config.ego:
            self._external[self._config.ego] = self._ego_actor
        self._ambient = {one: SimpleNamespace(id=one) for one in self._config.seen}

    def tick(self, world, elapsed):
        self._step_sumo(world)
        self.controls = {one: self._control(one) for one in self._ambient}

    def _step_sumo(self, world):
        for _ in range(2):
            self._traci.simulationStep()

    def close(self):
        if self._running:
            libsumo.close()
        self._running = False
        self._ambient, self._external, self._driven = {}, {}, {}

    def describe(self):
        return {"backend": "sumo"}

    def background_actors(self, world):
        return {f"sumo:{one}": actor for one, actor in self._ambient.items()}

    def _control(self, sumo_id):
        return "physics"

    def _to_mesoscopic(self, sumo_id, now):
        return True


def modules():
    """The package, by the names under which it is imported."""

    def made(name, **content):
        module = types.ModuleType(name)
        vars(module).update(content)
        return module

    top = "autoware_carla_scenario"
    traffic = {
        "TrafficBackendError": RefusedError, "TrafficBackendUnavailable": RefusedError,
        "register_backend": REGISTERED.__setitem__,
    }  # fmt: skip
    return {
        top: made(top),
        f"{top}.traffic": made(f"{top}.traffic", **traffic),
        f"{top}.traffic.sumo": made(f"{top}.traffic.sumo"),
        f"{top}.traffic.sumo.backend": made("backend", SumoTrafficBackend=Traffic),
        f"{top}.traffic.sumo.config": made("config", SumoBackendConfig=Config),
    }
