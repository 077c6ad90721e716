"""Looks for moments in a process of its own: SUMO may crash, and libsumo runs once a process."""

import json
import os
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from deepmf_sumo import files
from deepmf_sumo.benchmark import pool
from deepmf_sumo.benchmark.moments.choice import choose, turns_of
from deepmf_sumo.benchmark.moments.encounters import encounters
from deepmf_sumo.benchmark.moments.moment import Found, Moment, Wish
from deepmf_sumo.errors import DeepmfError, SimulationError, UsageError
from deepmf_sumo.network.sumo_net import NetFile, read_once
from deepmf_sumo.simulation.sumo_config import read_configuration
from deepmf_sumo.simulation.traffic_survey import EVERY_S, Scouting, scout


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    scouting: Scouting
    wish: Wish
    answer: Path


def find(scouting: Scouting, wish: Wish, timeout_s: float | None = None) -> Found:
    """Simulate the configuration once, and choose moments of it.

    Where the wish names times, nothing later than attacks at them is looked at, unless
    ``scouting`` says so.

    Raises SimulationError, with SUMO's own words, where it cannot be run, and UsageError where the
    wish names a vehicle, a type or a time that is not in the traffic.
    """
    times = wish.at_s or tuple(time_s for _, time_s in wish.again)
    scouting = replace(scouting, at_s=times)
    if times and scouting.until_s is None:
        scouting = replace(scouting, until_s=max(times) + wish.duration_s + EVERY_S)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        search = _Search(scouting=scouting, wish=wish, answer=Path(folder) / "found.json")
        (ending,) = pool.run(_search, [search], jobs=1, timeout_s=timeout_s)
        if ending.status != "done":
            raise SimulationError(f"SUMO cannot run '{scouting.config}': {ending.reason}.")
        answer = json.loads(search.answer.read_text("utf-8"))
    if "error" in answer:
        raise (UsageError if answer["usage"] else SimulationError)(answer["error"])
    return _found(answer)


def _search(search: _Search) -> None:
    """The worker's part."""
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # what SUMO prints is in its errors, too
        os.dup2(silence, stream)
    scouting = search.scouting
    try:
        sightings = scout(scouting)
        net = read_once(read_configuration(scouting.config, scouting.sumo_options).net)
        met = encounters(sightings, net, search.wish.duration_s)
        found = choose(sightings, turns_of(net), search.wish, met)
        answer: dict[str, Any] = asdict(_named(found, net))
    except DeepmfError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    files.write_json(search.answer, answer)


def _named(found: Found, net: NetFile) -> Found:
    """With the names of the streets."""
    names = {one.edge: net.edges[one.edge].name for one in found.moments if one.edge in net.edges}
    moments = (replace(one, street=names.get(one.edge, "")) for one in found.moments)
    return replace(found, moments=tuple(moments))


def _found(answer: dict[str, Any]) -> Found:
    moments = tuple(Moment(**one) for one in answer.pop("moments"))
    return Found(moments=moments, **answer)
