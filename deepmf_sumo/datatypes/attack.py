"""The result of an adversary's search."""

from dataclasses import dataclass

from deepmf_sumo.datatypes.rollout import Rollout


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """What an adversary may spend: whichever runs out first; None is no limit."""

    simulations: int | None = None
    seconds: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One tried attack: its parameters, its objective (higher is worse for the AV)."""

    parameters: dict[str, float]
    objective: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attack:
    """The best rollout found, and what was tried for it.

    ``out_of_time``: the budget's seconds ended the search, so it depends on the machine's speed.
    """

    rollout: Rollout
    trials: tuple[Trial, ...] = ()
    simulations: int = 1
    generation_s: float = 0.0
    out_of_time: bool = False
