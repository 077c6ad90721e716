"""AVs and moments of a SUMO configuration to attack: ``source.moments`` of a spec, and `attack`."""

from deepmf_sumo.study.moments.moment import Found, Moment, Wish
from deepmf_sumo.study.moments.search import (
    Request,
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
    "Found",
    "Moment",
    "Request",
    "Wish",
    "at",
    "documents",
    "find",
    "flow_rows",
    "flow_table",
    "request",
    "rows",
    "spec_of",
    "table",
    "tasks",
]
