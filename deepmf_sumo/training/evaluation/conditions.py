"""What a conditional network is given, and the errors under each condition."""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Floats, Futures, View
from deepmf_sumo.geometry import angles, frames
from deepmf_sumo.training import windows
from deepmf_sumo.training.evaluation.displacement import STEPS
from deepmf_sumo.training.evaluation.estimates import difference, mean
from deepmf_sumo.training.windows import Future

MARGINAL: Final = "marginal"
NOTHING, TRUE, SHUFFLED = "given_nothing", "given_true", "given_shuffled"
CONDITIONS: Final = (MARGINAL, NOTHING, TRUE, SHUFFLED)
"""The marginal network; the conditional one given nothing, the other's true future, or the future
of another scene's vehicle, begun at the other's pose."""


@dataclass(slots=True)
class Observed:
    """Errors under each condition, a value an object, in the same order under all conditions.

    Attributes:
        fde: by condition, number of modes, horizon; 1 is the most probable of the fewest modes.
        log: log likelihood by condition and horizon.
    """

    fde: dict[tuple[str, int, str], list[float]] = field(default_factory=lambda: defaultdict(list))
    log: dict[tuple[str, str], list[float]] = field(default_factory=lambda: defaultdict(list))

    def add_modes(self, condition: str, modes: int, modes_m: Floats, future: Future) -> None:
        """Modes (M, 80, 2) of one object; the best counts."""
        for key, step in STEPS.items():
            if future.valid[step]:
                error = np.linalg.norm(modes_m[:, step] - future.position_m[step], axis=-1)
                self.fde[condition, modes, key].append(float(error.min()))

    def add_log(self, condition: str, values: dict[str, float | None]) -> None:
        """Log likelihoods of one object by horizon."""
        for key, value in values.items():
            if value is not None:
                self.log[condition, key].append(value)

    def joined(self, other: "Observed") -> "Observed":
        """These objects and the others."""
        both = Observed()
        for each in (self, other):
            for place, errors in each.fde.items():
                both.fde[place].extend(errors)
            for spot, logs in each.log.items():
                both.log[spot].extend(logs)
        return both

    def gains(self, key: str) -> dict[str, Any]:
        """Gains in log likelihood at a horizon with standard errors, nats.

        Against the marginal network, and against the conditional one given nothing.
        """
        found: dict[str, Any] = {"log_likelihood_objects": len(self.log[MARGINAL, key])}
        for name, condition in (("true", TRUE), ("shuffled", SHUFFLED), ("nothing", NOTHING)):
            for suffix, against in (("", MARGINAL), ("_over_nothing", NOTHING)):
                if condition != against:
                    label = f"log_likelihood_gain_{name}{suffix}"
                    found[label], found[f"{label}_standard_error"] = difference(
                        self.log[condition, key], self.log[against, key]
                    )
        return found

    def most_probable(self, key: str) -> dict[str, float | None]:
        """Mean error of the most probable mode at a horizon, by condition."""
        return {condition: mean(self.fde[condition, 1, key]) for condition in CONDITIONS}


def given(future: Future) -> Futures:
    """An agent's future as the one condition."""
    return Futures(
        agent_id=future.agent_id,
        position_m=future.position_m[None],
        heading_rad=future.heading_rad[None],
    )


def given_both(one: Futures, other: Futures) -> Futures:
    """Two conditions on the same agent at once."""
    return Futures(
        agent_id=one.agent_id,
        position_m=np.concatenate([one.position_m, other.position_m]),
        heading_rad=np.concatenate([one.heading_rad, other.heading_rad]),
    )


def motion(view: View, future: Future) -> Floats:
    """(80, 3) a future in the frame of its own agent."""
    return windows.local_future(view, future.agent_id, future)


def begun_at(view: View, agent_id: AgentId, moved: Floats) -> Futures:
    """Another's motion (80, 3), begun at the agent's pose."""
    row = view.history.row(agent_id)
    origin, heading = view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])
    return Futures(
        agent_id=agent_id,
        position_m=frames.to_scene(moved[None, :, :2], origin, heading),
        heading_rad=angles.wrap(moved[None, :, 2] + heading),
    )
