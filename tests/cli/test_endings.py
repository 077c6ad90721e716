"""The exit code of a sweep that ends in several ways at a time."""

import itertools
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepmf_sumo.cli import _sweep

RUNS = {
    "fine": ("ok", {}),
    "wrong": ("failed", {"refused": True}),
    "failed": ("failed", {}),
    "broken": ("ok", {"expectations_broken": ["no"]}),
}
CODES = {"fine": 0, "broken": 1, "failed": 3}


@pytest.mark.parametrize("form", [None, "sound", "faulty"])
@pytest.mark.parametrize("judged", [None, "fine", "broken", "failed"])
def test_the_worst_ending_counts(tmp_path, monkeypatch, form, judged):
    monkeypatch.setattr(_sweep, "judge", lambda _: judged)
    for run, missing in itertools.product(RUNS, (0, 1)):
        status, more = RUNS[run]
        each = {"status": status, "expectations_broken": [], "run_id": "a"} | more
        other = {"status": "ok", "expectations_broken": [], "run_id": "b"}
        forms = [] if form is None else [_form(tmp_path / form, whole=form == "sound")]
        options = SimpleNamespace(out=tmp_path, formats=forms)
        sweep = SimpleNamespace(
            options=options, keys=SimpleNamespace(thresholds=judged, baseline=None)
        )
        code = _sweep.exit_code_of(sweep, [each, other], missing)
        if missing:
            expected = 130
        elif run == "wrong":
            expected = 2
        elif form == "faulty":
            expected = 3
        elif judged:
            expected = CODES[judged]
        else:
            expected = CODES[run]
        assert code == expected, (run, missing)


def _form(place: Path, *, whole: bool):
    """A format in which each run, or only none, was written."""
    if whole:
        place.touch()
    return SimpleNamespace(name="made up", place=lambda _: place)
