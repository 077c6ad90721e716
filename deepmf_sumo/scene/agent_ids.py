"""Ids of road users. SUMO has two name spaces: a vehicle and a person may have the same id.

A vehicle's agent has SUMO's id, a person's has ``person`` and a blank before it. SUMO accepts no
blanks in ids of demand files, so that no vehicle has such an id. A vehicle that bends (a train, an
articulated bus) is several boxes: the first has the vehicle's id, those behind it are its parts,
``ID part 2`` and so on.
"""

from collections.abc import Iterable
from typing import Final

from deepmf_sumo.scene.scene import AgentId

_PERSON: Final = "person "
_PART: Final = " part "


def of_person(name: str) -> AgentId:
    """The agent of a person of SUMO."""
    return _PERSON + name


def person_of(agent: AgentId) -> str | None:
    """SUMO's id of a person; None if the agent is not a person of SUMO."""
    return agent.removeprefix(_PERSON) if agent.startswith(_PERSON) else None


def of_part(vehicle: AgentId, number: int) -> AgentId:
    """The agent of a part of a vehicle; the one behind the first has number 2."""
    return f"{vehicle}{_PART}{number}"


def whole_of(agent: AgentId) -> AgentId:
    """The vehicle that an agent is a part of; itself if it is none."""
    vehicle, part, number = agent.rpartition(_PART)
    return vehicle if part and number.isdecimal() else agent


def wholes(agents: Iterable[AgentId]) -> tuple[AgentId, ...]:
    """The road users that agents are, or are parts of, each once and in their order."""
    return tuple(dict.fromkeys(map(whole_of, agents)))
