"""Specs with moments -> runs. The search has its own process: SUMO may crash, libsumo runs once."""

import csv
import io
import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import numpy as np

from deepmf_sumo import files, tables
from deepmf_sumo.errors import DeepmfError, SimulationError, UsageError
from deepmf_sumo.results.stored import MOMENTS
from deepmf_sumo.scene.geometry.ground import CLEARANCE_M, ground_of
from deepmf_sumo.spec import FromMoments, Plugin, Spec, of_document
from deepmf_sumo.spec.document import Document
from deepmf_sumo.spec.loading import assign
from deepmf_sumo.spec.tasks import Draw, Task, moment_name, run_id_of, slug
from deepmf_sumo.study.moments.area import AttackArea, area_of, inside
from deepmf_sumo.study.moments.choice import choose, turns_of
from deepmf_sumo.study.moments.encounters import encounters
from deepmf_sumo.study.moments.flow import flows
from deepmf_sumo.study.moments.moment import (
    Flow,
    FoundMoments,
    Moment,
    VehicleTime,
    WantedMoments,
    check_times,
)
from deepmf_sumo.study.moments.promising import POOL
from deepmf_sumo.study.sweep import streams, workers
from deepmf_sumo.sumo.network.sumo_net import NetFile, read_once
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.sumo.simulation import demand
from deepmf_sumo.sumo.simulation.sumo_config import Configuration, read_configuration
from deepmf_sumo.sumo.simulation.traffic_survey import EVERY_S, TrafficSurvey, survey_traffic
from deepmf_sumo.texts import of_cell


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    survey: TrafficSurvey
    wish: WantedMoments
    area: AttackArea | None
    answer: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentRequest:
    """Which moments of a configuration are wanted, and the spec of all runs on it."""

    configuration: Configuration
    spec: Spec
    survey: TrafficSurvey
    wish: WantedMoments
    area: AttackArea | None = None


def request(spec: Spec, *, by_option: bool = False) -> MomentRequest:
    """The request of a spec whose source is `FromMoments`, checked before anything is simulated.

    ``by_option``: see `WantedMoments`. Raises SimulationError or UsageError for what is known to be
    wrong.
    """
    source = spec.source
    assert isinstance(source, FromMoments)
    asked = source.moments
    key = "--moments-of" if by_option else "source.moments.of"
    again = read(asked.of, key, spec.name, spec.seed) if asked.of else ()
    count = asked.count or len(asked.at_s or again) or 10
    attackers, made = spec.adversary.settings.get("attackers"), source.people.who != "existing"
    people = source.people.who if attackers == "people" else ""
    wish = WantedMoments(
        count=count,
        pool=POOL * count if asked.draw == "promising" else 0,
        **asked.model_dump(include={"av", "av_type", "at_s", "from_s"}),
        prefer="spread" if people else asked.prefer,  # encounters are of vehicles
        people=people,
        made_too=attackers == "all" and made,
        again=again,
        duration_s=spec.duration_s,
        seed=spec.seed,
        by_option=by_option,
    )
    configuration = read_configuration(source.network, source.sumo_options)
    check(configuration, wish)
    if asked.av_type is not None:
        wish = replace(wish, av_types=demand.types_of(configuration, asked.av_type))
    if asked.until_s is not None and asked.until_s <= configuration.begin_s:
        raise UsageError(
            f"{wish.named('until_s')} {asked.until_s:.12g}: {configuration.file.name} begins at"
            f" {configuration.begin_s:.12g} s; choose a later time."
        )
    area = area_of(asked, configuration.net, wish.named)
    if area is not None:
        wish = replace(wish, where=str(area))
    survey = TrafficSurvey(
        config=source.network,
        sumo_options=source.sumo_options,
        seed=spec.seed,
        until_s=asked.until_s,
        from_s=asked.from_s if isinstance(asked.from_s, float) else None,
        settles=asked.from_s == "settled",
        corners=area.corners if area else (),
        people=people == "existing",
    )
    return MomentRequest(
        configuration=configuration, spec=spec, survey=survey, wish=wish, area=area
    )


def find(
    survey: TrafficSurvey,
    wish: WantedMoments,
    timeout_s: float | None = None,
    area: AttackArea | None = None,
) -> FoundMoments:
    """Simulate the configuration once, and choose moments of it.

    Where the wish names times, nothing later than attacks at them is looked at, unless
    ``survey`` says so.

    Raises SimulationError, with SUMO's own words, where it cannot be run, and UsageError where the
    wish names a vehicle, a type or a time that is not in the traffic.
    """
    times = wish.at_s or tuple(time_s for _, time_s in wish.again)
    survey = replace(survey, at_s=times)
    if times and survey.until_s is None:
        survey = replace(survey, until_s=max(times) + wish.duration_s + EVERY_S)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        answer_file = Path(folder) / "found.json"
        search = _Search(survey=survey, wish=wish, area=area, answer=answer_file)
        (ending,) = workers.run(_search, [search], jobs=1, timeout_s=timeout_s)
        if ending.status != "done":
            raise SimulationError(f"SUMO cannot run '{survey.config}': {ending.reason}.")
        answer = json.loads(search.answer.read_text("utf-8"))
    if "error" in answer:
        raise (UsageError if answer["usage"] else SimulationError)(answer["error"])
    return _found(answer)


def _search(search: _Search) -> None:
    """The worker's part."""
    streams.silence()  # what SUMO prints is in its errors, too
    survey = search.survey
    try:
        sightings = survey_traffic(survey)
        file = read_configuration(survey.config, survey.sumo_options).net
        net = read_once(file)
        if len(sightings.z_m) and np.ptp(sightings.z_m) >= CLEARANCE_M:
            sightings = replace(sightings, ground=ground_of(road_of_net(file)))
        met = None if search.wish.people else encounters(sightings, net, search.wish.duration_s)
        area, duration_s = search.area, search.wish.duration_s
        within = inside(area, sightings, net, duration_s) if area else None
        found = choose(sightings, turns_of(net), search.wish, met, within)
        found = replace(found, flows=flows(sightings, found.from_s))
        answer: dict[str, Any] = asdict(_named(found, net))
    except DeepmfError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    files.write_json(search.answer, answer)


def _named(found: FoundMoments, net: NetFile) -> FoundMoments:
    """With the names of the streets."""
    names = {one.edge: net.edges[one.edge].name for one in found.moments if one.edge in net.edges}
    moments = (replace(one, street=names.get(one.edge, "")) for one in found.moments)
    return replace(found, moments=tuple(moments))


def _found(answer: dict[str, Any]) -> FoundMoments:
    moments = tuple(Moment(**one) for one in answer.pop("moments"))
    notes, passing = tuple(answer.pop("notes")), tuple(Flow(**one) for one in answer.pop("flows"))
    order = tuple(answer.pop("order"))
    return FoundMoments(moments=moments, notes=notes, flows=passing, order=order, **answer)


_LARGEST: Final = 2**26


def names_of(configs: Sequence[Path]) -> list[str]:
    """Names for the runs of each configuration, all different, even as file names.

    That is the file's name; where several have it, the folders in which they differ. Raises
    UsageError where a configuration is given twice.
    """
    places = [config.resolve() for config in configs]
    for place, times in Counter(places).items():
        if times > 1:
            raise UsageError(f"{place} is given {times} times; give each configuration once.")
    names = [config.stem for config in configs]
    for depth in range(1, max((len(place.parts) for place in places), default=0)):
        taken = Counter(map(slug, names))
        if max(taken.values()) == 1:
            return names
        names = [
            name if taken[slug(name)] == 1 else _by_folder(place, depth)
            for name, place in zip(names, places, strict=True)
        ]
    return [" ".join(place.parts[1:]) for place in places]  # e.g. a.cfg and a.sumocfg in one folder


def _by_folder(place: Path, depth: int) -> str:
    return " ".join(place.parts[1:-1][-depth:]) or place.name


def check(configuration: Configuration, wish: WantedMoments) -> None:
    """Raise UsageError for a vehicle, type or time that cannot be in a configuration's traffic.

    Other mistakes show in the simulation.
    """
    end_s = configuration.end_s
    check_times(wish, configuration.begin_s, math.inf if end_s is None else end_s)
    if isinstance(wish.from_s, float) and end_s is not None and wish.from_s >= end_s:
        raise UsageError(
            f"{wish.named('from_s')} {wish.from_s:.12g}: {configuration.file.name} ends at"
            f" {end_s:.12g} s; choose an earlier time."
        )
    if wish.av is None and wish.av_type is None:
        return
    known = demand.read(configuration)
    if known is None:
        return
    place = f"in the demand of {configuration.file}"
    if wish.av is not None and not known.has_vehicle(wish.av):
        there = ", ".join(known.like_vehicle(wish.av)) or "none"
        option = wish.named("av")
        raise UsageError(f"{option} {wish.av}: no such vehicle is {place}; there are {there}.")
    if wish.av_type is not None and not known.has_type(wish.av_type):
        there = ", ".join(known.like_type(wish.av_type)) or "none"
        option = wish.named("av_type")
        raise UsageError(f"{option} {wish.av_type}: no such type is {place}; there are {there}.")


def read(
    path: Path, key: str = "--moments-of", spec: str = "", seed: int | None = None
) -> tuple[VehicleTime, ...]:
    """Vehicles and times of a result folder of `attack`, or of its moments.csv; each once.

    Where some of its runs are those of a spec of this name, they alone count: vehicles of several
    networks may have one name. Of these, where some have this seed, they alone count: traffic of
    other seeds is another one.

    Raises UsageError, which names ``key``, where there is no such table, or it is empty.
    """
    file = path / MOMENTS if path.is_dir() else path
    try:
        table = io.StringIO(files.text(file, _LARGEST), newline="")
        rows = list(csv.DictReader(table))
        own = [row for row in rows if (row.get("run_id") or "").startswith(f"{slug(spec)}--")]
        same = [row for row in own if row["run_id"].endswith(f"--{seed}")]
        found = tuple(dict.fromkeys(_rows(same or own or rows)))
    except OSError as error:
        raise UsageError(
            f"{key} {path}: {file} cannot be read ({files.reason(error)}); give a result"
            " folder of `deepmf-sumo attack`."
        ) from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise UsageError(
            f"{key} {path}: {file} is not a table of moments (columns av and start_s)."
        ) from None
    if not found:
        raise UsageError(f"{key} {path}: {file} holds no moments.")
    return found


def _rows(table: Iterable[dict[str, str]]) -> Iterable[VehicleTime]:
    for row in table:
        start_s = float(row["start_s"])
        if not math.isfinite(start_s):
            raise ValueError(f"start_s {start_s}")
        yield of_cell(row["av"]), round(start_s, 1)


_SETTABLE: Final = ("source.moments.", "source.people.")
MET: Final = "met"
"""The adversary's ``opponent`` that is the vehicle that the AV is about to meet."""

_OPTIONS: Final = {"count": "--moments", "av": "--av", "at_s": "--at"} | {
    "junctions": "--junction", "edges": "--edge", "from_s": "--from", "until_s": "--until",
    "of": "--moments-of", "seed": "--seed", "planner": "--planner",
}  # fmt: skip


def documents(
    configs: Sequence[Path],
    keys: Mapping[str, Any],
    sets: Sequence[str] = (),
    *,
    sumo_options: Sequence[str] = (),
    **wanted: Any,
) -> list[Document]:
    """The specs that ``attack`` is short for, one for each configuration.

    They say what the options say; the rest is that of every spec of their version and profile.

    Args:
        configs: .sumocfg files; their runs are named after them.
        keys: of all specs; ``seed`` is the configuration's own where it is not given.
        sets: ``key=value`` over them.
        sumo_options: beside the configurations.
        wanted: keys of `Moments`; None is not given.

    Raises SimulationError for a configuration that cannot be read, UsageError for a key that the
    command itself sets, or SpecError.
    """
    found = [
        _document(config, name, keys, sets, sumo_options, wanted)
        for config, name in zip(configs, names_of(configs), strict=True)
    ]
    if len(found) > 1 and found[0].values["source"]["moments"].get("of"):
        raise UsageError(
            f"--moments-of goes with one configuration, and {len(configs)} are given: vehicles are"
            " those of one traffic."
        )
    return found


def _document(
    config: Path,
    name: str,
    keys: Mapping[str, Any],
    sets: Sequence[str],
    sumo_options: Sequence[str],
    wanted: Mapping[str, Any],
) -> Document:
    moments = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in wanted.items()
        if value not in (None, ())
    }
    source = {"network": str(config.absolute()), "moments": moments}
    if sumo_options:
        source["sumo_options"] = list(sumo_options)
    if "seed" not in keys:  # a seed that cannot be used is refused only where it would be used
        keys = {**keys, "seed": read_configuration(config, tuple(sumo_options)).seed}
    values = {"version": 3, "name": name, "source": source, **keys}
    places: dict[Any, str] = {(key,): _OPTIONS.get(key, f"--set {key}") for key in keys}
    places |= {
        ("source", "moments", key): _OPTIONS.get(key, f"--set source.moments.{key}")
        for key in moments
    }
    document = Document(file=Path("deepmf-sumo attack"), values=values, places=places)
    for assignment in sets:
        path = assignment.partition("=")[0].strip()
        key = path.partition(".")[0]
        if key == "source" and not f"{path}.".startswith(_SETTABLE):
            raise UsageError(
                f"--set {assignment}: the source is CONFIG with what stands behind --; of its keys"
                " only those of source.moments can be set, and source.people."
            )
        if key == "version":
            raise UsageError(f"--set {assignment}: attack is short for specs of version 3.")
        assign(document, assignment)
        places.setdefault((key,), f"--set {assignment}")
    return document


def spec_of(document: Document) -> Spec:
    """The spec of one of `documents`, whose files and folders become absolute in it.

    Raises SpecError as `spec.load`, and WeightsError where weights are named that do not exist.
    """
    spec = of_document(document)
    if "weights" in document.values:
        from deepmf_sumo.deepmf.networks import weights

        weights.find(spec.weights)
        document.values["weights"] = spec.weights
    if isinstance(spec.source, FromMoments):
        given = document.values["source"]["moments"]
        for key in ("polygon", "of"):
            if given.get(key):
                given[key] = str(getattr(spec.source.moments, key))
    document.values["profile"] = spec.profile
    return spec


def tasks(spec: Spec, moments: Sequence[Moment]) -> list[Task]:
    """The runs of a spec whose source is `FromMoments`: one for each moment, in order.

    SUMO tells ``A1``, ``a1`` and ``a.1`` apart, but names of files do not: there a checksum does.
    """
    found = [_task(spec, one) for one in moments]
    times = Counter(task.run_id for task in found)
    return [
        task
        if times[task.run_id] == 1
        else replace(task, run_id=run_id_of(spec, _marked(task.scene)))
        for task in found
    ]


def _marked(scene: str) -> str:
    return f"{scene}-{crc32(scene.encode()):08x}"


def _task(spec: Spec, moment: Moment) -> Task:
    scene = moment_name(moment.av, moment.start_s)
    return Task(run_id=run_id_of(spec, scene), spec=at(spec, moment), scene=scene)


def at(spec: Spec, moment: Moment) -> Spec:
    """The spec of one moment, of one whose source is `FromMoments`."""
    source = spec.source
    assert isinstance(source, FromMoments)
    chosen = {
        "source": source.at(moment.start_s, moment.av),
        "adversary": _against(spec.adversary, moment),
    }
    return spec.model_copy(update=chosen)


def _against(adversary: Plugin, moment: Moment) -> Plugin:
    """The adversary; ``opponent: met`` is the vehicle that the AV meets, else as by default."""
    if adversary.settings.get("opponent") != MET:
        return adversary
    settings = {key: value for key, value in adversary.settings.items() if key != "opponent"}
    if moment.meets is not None:
        settings |= {"opponent": moment.meets}
    return Plugin(name=adversary.name, **settings)


def rows(chosen: Iterable[tuple[Task, Moment]]) -> list[dict[str, Any]]:
    """Rows of ``moments.csv``, from runs and their moments."""
    return [
        {"run_id": task.run_id, **asdict(moment), **(asdict(task.draw) if task.draw else {})}
        for task, moment in chosen
    ]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """``moments.csv``; how moments were drawn is in it where that was not by spreading alone."""
    names = ["run_id", *(field.name for field in fields(Moment))]
    how = [field.name for field in fields(Draw)]
    names += [name for name in how if any(row.get(name) for row in rows)]
    return tables.to_csv(rows, names, cell=tables.exact)


def flow_rows(found: Iterable[tuple[Spec, FoundMoments]]) -> list[dict[str, Any]]:
    """Rows of ``flow.csv``, from specs and what was found: vehicles at each place, and hours."""
    return [
        {"spec": spec.name, "network": _network(spec), **asdict(flow), "hours": round(one.hours, 5)}
        for spec, one in found
        for flow in one.flows
    ]


def flow_table(rows: Iterable[Mapping[str, Any]]) -> str:
    """``flow.csv``."""
    names = ["spec", "network", *(field.name for field in fields(Flow)), "hours"]
    return tables.to_csv(rows, names, cell=tables.exact)


def _network(spec: Spec) -> str:
    """As runs name it."""
    assert isinstance(spec.source, FromMoments)
    return spec.source.network.stem
