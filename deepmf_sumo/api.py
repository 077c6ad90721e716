"""What a program calls in place of the command line; offered by `deepmf_sumo` itself."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from deepmf_sumo import readers, spec
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.readers import Refusal
from deepmf_sumo.report import picture
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
    """Run specs and write a result folder, as ``deepmf-sumo run`` does: the same files and bytes.

    Runs are done in worker processes, so a script calls this below ``if __name__ == "__main__":``.

    Args:
        specs: a spec file, or several.
        out: the result folder.
        sets: ``KEY=VALUE``, each overrides a key of every spec.
        seeds: every spec is run with each of these; none means the spec's own seed.
        jobs: number of runs at a time.
        pictures: draw each run as ``picture.png``.
        resume: keep the runs that an earlier call finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.

    Returns all runs, those that failed included: see ``status``.

    Raises SpecError for a wrong spec, OutputError for a folder that cannot be used; RunError where
    no worker starts.
    """
    paths = [specs] if isinstance(specs, str | Path) else specs
    loaded = [spec.load(Path(path), list(sets)) for path in paths]
    if seeds:
        loaded = [one.model_copy(update={"seed": seed}) for one in loaded for seed in seeds]
    options = batch.Options(
        out=Path(out),
        jobs=jobs,
        draw=picture.draw if pictures else None,
        resume=resume,
        overwrite=overwrite,
    )
    batch.run(loaded, options)
    return Results.of(Path(out))


def read_scenes(*paths: str | Path) -> Iterator[Scene | Refusal]:
    """All scenes of recorded files and folders, one at a time, of any format that is read.

    A scene that cannot be used comes as a `Refusal` with its reason.

    Raises UsageError if a path does not exist.
    """
    return readers.scenes([Path(path) for path in paths])
