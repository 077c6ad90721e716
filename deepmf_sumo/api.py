"""What a program calls instead of the command line; offered by `deepmf_sumo` itself."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from deepmf_sumo import spec
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import benchmark, picture
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Scene, readers
from deepmf_sumo.scene.readers import Refusal
from deepmf_sumo.study import moments as moments_module
from deepmf_sumo.study import plans
from deepmf_sumo.study.sweep import batch
from deepmf_sumo.study.sweep.limits import MEMORY_MB, TIMEOUT_S


def run(
    specs: str | Path | Sequence[str | Path],
    out: str | Path = "results",
    *,
    sets: Sequence[str] = (),
    seeds: Sequence[int] = (),
    jobs: int = 1,
    pictures: bool = False,
    figures: bool = False,
    timeout_s: float | None = TIMEOUT_S,
    memory_mb: float | None = MEMORY_MB,
    resume: bool = False,
    overwrite: bool = False,
) -> Results:
    """Run specs, or a plan, and write a result folder, as ``deepmf-sumo run`` does.

    Runs, tables and limits equal the command's, byte for byte. Two defaults differ: the
    command draws the pictures of specs and the figures of plans unless told otherwise.

    Runs are made in worker processes, so a script calls this below ``if __name__ == "__main__":``.

    Args:
        specs: a spec file, or several, or one plan; ``"paper"`` is the plan of the package.
        out: the result folder.
        sets: ``KEY=VALUE``, each overrides a key of the plan or of every spec.
        seeds: every spec is run with each of these; none means its own. A plan has its own
            key for them.
        jobs: number of runs at a time.
        pictures: draw each run as ``picture.png``.
        figures: draw the figures of a plan.
        timeout_s: end a run that takes longer; None never does.
        memory_mb: end a run that takes more memory; None never does.
        resume: keep the runs that an earlier call finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.

    Returns all runs, also failed ones: see ``status``.

    Raises SpecError for a wrong spec, UsageError for a plan beside other files or ``seeds``,
    OutputError for a folder that cannot be used; RunError where no worker starts.
    """
    paths = _paths(specs)
    options = batch.Options(
        out=Path(out), jobs=jobs, draw=picture.draw if pictures else None, timeout_s=timeout_s,
        memory_mb=memory_mb, resume=resume, overwrite=overwrite,
    )  # fmt: skip
    if any(map(plans.is_plan, paths)):
        if len(paths) > 1 or seeds:
            raise UsageError("A plan is run by itself, and its seeds are its key 'seeds'.")
        plans.run(plans.load(paths[0], sets), replace(options, sumo=False))
        benchmark.finish(options.out, figures=figures)
    else:
        loaded = [spec.load(path, list(sets)) for path in paths]
        if seeds:
            loaded = [one.model_copy(update={"seed": seed}) for one in loaded for seed in seeds]
        plans.run_specs(loaded, options)
    return Results.of(Path(out))


def attack(
    configs: str | Path | Sequence[str | Path],
    out: str | Path = "results",
    *,
    moments: int | None = None,
    av: str | None = None,
    av_type: str | None = None,
    at_s: Sequence[float] = (),
    junctions: Sequence[str] = (),
    edges: Sequence[str] = (),
    polygon: str | Path | None = None,
    from_s: float | None = None,
    until_s: float | None = None,
    prefer: Literal["both", "spread", "encounters"] | None = None,
    draw: Literal["spread", "promising"] | None = None,
    moments_of: str | Path | None = None,
    duration_s: float | None = None,
    opponents: Literal["one", "in_turn"] | None = None,
    tries: int | None = None,
    planner: str | Mapping[str, Any] | None = None,
    profile: spec.ProfileName | None = None,
    seed: int | None = None,
    sets: Sequence[str] = (),
    sumo_options: Sequence[str] = (),
    jobs: int = 1,
    pictures: bool = False,
    timeout_s: float | None = TIMEOUT_S,
    memory_mb: float | None = MEMORY_MB,
    resume: bool = False,
    overwrite: bool = False,
) -> Results:
    """Attack vehicles of SUMO configurations, as ``deepmf-sumo attack`` does.

    Each argument is an option of the command or a key of its spec; there is no risk map, and
    pictures are drawn only where asked for.

    Runs are done in worker processes, so a script calls this below ``if __name__ == "__main__":``.

    Args:
        configs: a .sumocfg file, or several.
        out: the result folder.
        moments: number of attacks of each configuration; None means one for each of ``at_s``, else
            10.
        av: attack only this vehicle.
        av_type: attack only vehicles of this type.
        at_s: attack only at these times of the simulation, in seconds.
        junctions: attack only at these junctions, or just before them.
        edges: attack only on these edges; with junctions or a polygon at any of these places.
        polygon: attack only within the polygons of this file, GeoJSON or SUMO's ``<poly>``.
        from_s: attack from this time on; None means once the number of vehicles has settled, or at
            any time where ``av`` or ``at_s`` is given.
        until_s: look for moments up to this time only.
        prefer: ``spread`` moments over places and time; first ``encounters``, before another
            vehicle crosses the AV's path; None means ``both``: spread, encounters first at each
            place.
        draw: ``promising``: a third of the moments are spread, the others are drawn where conflicts
            came near before; None means ``spread``: all are.
        moments_of: a result folder, or its moments.csv: attack the same vehicles at the same times.
        duration_s: of an attack; None means 8 s.
        opponents: ``one``, or one after another ``in_turn``; None means one up to 15 s.
        tries: simulate an attack at most this often, until it finds an error of the AV or a hit
            that was avoidable, of other profiles than ``fair`` any hit; None means 4 times, once of
            other profiles and for opponents in turn.
        planner: what drives the AV: a name, or a mapping with ``name`` and settings; None means
            ``idm``.
        profile: the kind of attack, see `deepmf_sumo.spec`; None means ``fair``.
        seed: of all choices and of SUMO; None means the configuration's own.
        sets: ``KEY=VALUE``, each a key of the spec of all runs, e.g. ``planner=idm``.
        sumo_options: added to SUMO's command line.
        jobs: number of runs at a time.
        pictures: draw each run as ``picture.png``.
        timeout_s: end a run that takes longer; None never does.
        memory_mb: end a run that takes more memory; None never does.
        resume: keep the runs that an earlier call finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.

    Returns all runs, those that failed included: see ``status``.

    Raises UsageError, SpecError or SimulationError for what is wrong, before anything is attacked;
    OutputError for a folder that cannot be used; RunError where no worker starts.
    """
    keys = {
        "duration_s": duration_s,
        "opponents": opponents,
        "planner": {"name": planner} if isinstance(planner, str) else planner and dict(planner),
        "profile": profile,
        "seed": seed,
    }
    documents = moments_module.documents(
        _paths(configs),
        {key: value for key, value in keys.items() if value is not None},
        sets if tries is None else (f"adversary.tries={tries}", *sets),
        sumo_options=sumo_options,
        from_s=from_s,
        until_s=until_s,
        count=moments,
        av=av,
        av_type=av_type,
        at_s=tuple(at_s),
        junctions=tuple(junctions),
        edges=tuple(edges),
        polygon=_absolute(polygon),
        of=_absolute(moments_of),
        prefer=prefer,
        draw=draw,
    )
    specs = [moments_module.spec_of(one) for one in documents]
    options = batch.Options(
        out=Path(out), jobs=jobs, draw=picture.draw if pictures else None, timeout_s=timeout_s,
        memory_mb=memory_mb, resume=resume, overwrite=overwrite,
    )  # fmt: skip
    plans.run_specs(specs, options, by_option=True)
    return Results.of(Path(out))


def _paths(given: str | Path | Sequence[str | Path]) -> list[Path]:
    return [Path(path) for path in ([given] if isinstance(given, str | Path) else given)]


def _absolute(path: str | Path | None) -> str | None:
    return None if path is None else str(Path(path).absolute())


def read_scenes(*paths: str | Path) -> Iterator[Scene | Refusal]:
    """All scenes of recorded files and folders, one at a time, of any format that is read.

    A scene that cannot be used comes as a `Refusal` with its reason.

    Raises UsageError if a path does not exist.
    """
    return readers.scenes([Path(path) for path in paths])
