"""Ids of road users. SUMO has two name spaces: a vehicle and a person may have the same id.

A vehicle's agent has SUMO's id, a person's has ``person`` and a blank before it. SUMO accepts no
blanks in ids of demand files, so that no vehicle has such an id.
"""

from typing import Final

from deepmf_sumo.datatypes.scene import AgentId

_PERSON: Final = "person "


def of_person(name: str) -> AgentId:
    """The agent of a person of SUMO."""
    return _PERSON + name


def person_of(agent: AgentId) -> str | None:
    """SUMO's id of a person; None if the agent is not a person of SUMO."""
    return agent.removeprefix(_PERSON) if agent.startswith(_PERSON) else None
