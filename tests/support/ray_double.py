"""What `sweep.ray_cluster` uses of Ray, in this process, where actors can be lost on purpose."""

from types import SimpleNamespace


class RayError(Exception):
    """As Ray's: the machine, not the program, is to blame."""


class RayTaskError(RayError):
    """As Ray's: an actor's method has raised."""


class Ray:
    """The module. ``lost`` says at which of its calls an actor is lost, by the actor's number."""

    exceptions = SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError)

    def __init__(self, cpus=2, lost=None):
        self.cpus, self.lost = cpus, lost or {}
        self.actors, self.running = [], False

    def is_initialized(self):
        return self.running

    def init(self, **arguments):
        self.running, self.arguments = True, arguments

    def shutdown(self):
        self.running = False

    def cluster_resources(self):
        return {"CPU": self.cpus}

    def put(self, value):
        return value

    def remote(self, kind):
        return SimpleNamespace(
            options=lambda **_: SimpleNamespace(remote=lambda *values: self._hire(kind, values))
        )

    def wait(self, calls, num_returns=1, timeout=None):
        """The one that waits longest, done now."""
        calls = sorted(calls, key=lambda call: call.actor.done)
        for call in calls[:num_returns]:
            call.happen()
        return calls[:num_returns], calls[num_returns:]

    def get(self, call):
        if isinstance(call.answer, Exception):
            raise call.answer
        return call.answer

    def kill(self, actor):
        actor.alive = False

    def _hire(self, kind, values):
        number = len(self.actors)
        self.actors.append(_Actor(kind(*values), self.lost.get(number)))
        return self.actors[-1]


class _Actor:
    def __init__(self, place, lost_at):
        self.place, self.lost_at, self.done, self.alive = place, lost_at, 0, True

    def __getattr__(self, name):
        return SimpleNamespace(remote=lambda *values: _Call(self, name, values))


class _Call:
    def __init__(self, actor, name, values):
        self.actor, self.name, self.values = actor, name, values

    def happen(self):
        self.actor.done += 1
        if self.actor.done == self.actor.lost_at:
            self.actor.place.stop()  # what the kernel does when Ray's process is gone
            self.actor.alive = False
        if not self.actor.alive:
            self.answer = RayError("the actor died\nits machine is gone")
            return
        try:
            self.answer = getattr(self.actor.place, self.name)(*self.values)
        except Exception as error:  # noqa: BLE001 - as Ray does
            self.answer = error
