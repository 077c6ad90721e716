"""AVs and moments of a SUMO configuration to attack: ``source.moments`` of a spec, and `attack`."""

from deepmf_sumo.study.moments.made_people import people_later
from deepmf_sumo.study.moments.moment import FoundMoments, Moment, WantedMoments
from deepmf_sumo.study.moments.search import (
    MomentRequest,
    at,
    documents,
    find,
    flow_rows,
    flow_table,
    request,
    rows,
    spec_of,
    table,
    tasks,
)

__all__ = [
    "FoundMoments",
    "Moment",
    "MomentRequest",
    "WantedMoments",
    "at",
    "documents",
    "find",
    "flow_rows",
    "flow_table",
    "people_later",
    "request",
    "rows",
    "spec_of",
    "table",
    "tasks",
]
