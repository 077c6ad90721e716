"""What a program calls instead of the command line; offered by `deepmf_sumo` itself."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from deepmf_sumo import moments as moments_module
from deepmf_sumo import plans, readers, spec
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import UsageError
from deepmf_sumo.readers import Refusal
from deepmf_sumo.report import picture, tables
from deepmf_sumo.results.reader import Results
from deepmf_sumo.sweep import batch


def run(
    specs: str | Path | Sequence[str | Path],
    out: str | Path = "results",
    *,
    sets: Sequence[str] = (),
    seeds: Sequence[int] = (),
    jobs: int = 1,
    pictures: bool = False,
    resume: bool = False,
    overwrite: bool = False,
) -> Results:
    """Run specs, or a plan, and write a result folder: that of ``deepmf-sumo run``, byte for byte.

    Runs are done in worker processes, so a script calls this below ``if __name__ == "__main__":``.

    Args:
        specs: a spec file, or several, or one plan; ``"paper"`` is the plan of the package.
        out: the result folder.
        sets: ``KEY=VALUE``, each overrides a key of the plan or of every spec.
        seeds: every spec is run with each of these; none means its own. Those of a plan are a key
            of it.
        jobs: number of runs at a time.
        pictures: draw each run as ``picture.png``.
        resume: keep the runs that an earlier call finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.

    Returns all runs, those that failed included: see ``status``.

    Raises SpecError for a wrong spec, UsageError for a plan beside other files or ``seeds``,
    OutputError for a folder that cannot be used; RunError where no worker starts.
    """
    paths = [Path(path) for path in ([specs] if isinstance(specs, str | Path) else specs)]
    options = _options(out, jobs, pictures, resume, overwrite)
    if any(map(plans.is_plan, paths)):
        if len(paths) > 1 or seeds:
            raise UsageError("A plan is run by itself, and its seeds are its key 'seeds'.")
        plans.run(plans.load(paths[0], sets), replace(options, sumo=False))
        tables.write(options.out)
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
    encounters: bool = False,
    all_conflicts: bool = False,
    seed: int | None = None,
    sets: Sequence[str] = (),
    sumo_options: Sequence[str] = (),
    jobs: int = 1,
    pictures: bool = False,
    resume: bool = False,
    overwrite: bool = False,
) -> Results:
    """Attack vehicles of SUMO configurations, as ``deepmf-sumo attack --no-risk`` does.

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
        encounters: first attack before another vehicle crosses the AV's path, wherever that is;
            without it moments are spread, and such encounters come first at each place.
        all_conflicts: opponents also drive into the AV from behind, against the traffic, or so
            that no driver could avoid it.
        seed: of all choices and of SUMO; None means the configuration's own.
        sets: ``KEY=VALUE``, each a key of the spec of all runs, e.g. ``planner=idm``.
        sumo_options: added to SUMO's command line.
        jobs: number of runs at a time.
        pictures: draw each run as ``picture.png``.
        resume: keep the runs that an earlier call finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.

    Returns all runs, those that failed included: see ``status``.

    Raises UsageError, SpecError or SimulationError for what is wrong, before anything is attacked;
    OutputError for a folder that cannot be used; RunError where no worker starts.
    """
    paths = [Path(path) for path in ([configs] if isinstance(configs, str | Path) else configs)]
    documents = moments_module.documents(
        paths,
        {} if seed is None else {"seed": seed},
        sets,
        sumo_options=sumo_options,
        from_s=from_s,
        until_s=until_s,
        count=moments,
        av=av,
        av_type=av_type,
        at_s=tuple(at_s),
        junctions=tuple(junctions),
        edges=tuple(edges),
        polygon=None if polygon is None else str(Path(polygon).absolute()),
        prefer="encounters" if encounters else None,
    )
    specs = [moments_module.spec_of(one, all_conflicts=all_conflicts) for one in documents]
    plans.run_specs(specs, _options(out, jobs, pictures, resume, overwrite), by_option=True)
    return Results.of(Path(out))


def _options(
    out: str | Path, jobs: int, pictures: bool, resume: bool, overwrite: bool
) -> batch.Options:
    return batch.Options(
        out=Path(out),
        jobs=jobs,
        draw=picture.draw if pictures else None,
        resume=resume,
        overwrite=overwrite,
    )


def read_scenes(*paths: str | Path) -> Iterator[Scene | Refusal]:
    """All scenes of recorded files and folders, one at a time, of any format that is read.

    A scene that cannot be used comes as a `Refusal` with its reason.

    Raises UsageError if a path does not exist.
    """
    return readers.scenes([Path(path) for path in paths])
