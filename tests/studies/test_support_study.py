"""The study of supporters: hits repeated with and without them, and the planner that gets away."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.results.reader import Results
from deepmf_sumo.study.sweep import batch
from studies.support import __main__ as study
from studies.support.__main__ import Repeated, needs, repeated
from studies.support.swerving import Settings, Swerving

from tests.deepmf.test_support import LANE_M, road
from tests.support.predictor_doubles import view_of
from tests.test_supporters import SPEC


@pytest.mark.sumo
def test_a_hit_comes_again_with_its_supporter(tmp_path):
    (tmp_path / "helped.yaml").write_text(yaml.safe_dump(SPEC))
    options = batch.Options(out=tmp_path / "out", jobs=1, sumo=False)
    batch.run([spec.load(tmp_path / "helped.yaml")], options)
    (run,) = Results.open(tmp_path / "out").done
    (found,) = repeated([tmp_path / "out"], tmp_path / "again", jobs=1)
    assert found.rung == found.with_it == run.result["finding"]["rung"]
    assert found.without is not None
    again = {one.run_id.split("-")[0]: one for one in Results.open(tmp_path / "again").done}
    assert again["with"].rollout.supporters == run.rollout.supporters
    assert again["without"].rollout.supporters == ()
    step = run.rollout.tracks.steps
    for name in again["with"].rollout.tracks.ids:
        there, before = (
            one.rollout.tracks.position_m[one.rollout.tracks.row(name), :step]
            for one in (again["with"], run)
        )
        np.testing.assert_allclose(there, before, atol=1e-3)
    rows = list(study.by_method([tmp_path / "out"]))
    assert rows[2].split("|")[3:5] == [" 1 ", " 1 "]
    assert len(list(study.published_rates([tmp_path / "out"]))) == 3


@pytest.mark.parametrize(
    ("with_it", "without", "for_hit", "for_finding"),
    [
        ("B", "B", False, False),
        ("B", "", True, True),
        ("A", "D", False, True),
        ("C", "", True, False),
        ("", "", False, False),
        ("B", None, False, False),
    ],
)
def test_what_needs_its_supporter(with_it, without, for_hit, for_finding):
    run = SimpleNamespace(run_id="a")
    one = Repeated(run=run, rung="B", with_it=with_it, without=without)
    assert (one.needed_for_hit, one.needed_for_finding) == (for_hit, for_finding)
    assert needs([one]).startswith("supported hits: 1; ")


def driven(agents, steps=50):
    """(steps, 2) of the AV; all others keep their velocity."""
    planner, path = Swerving.build(Settings()), []
    planner.reset(None, np.random.default_rng(0))
    for step in range(steps):
        command = planner.act(view_of(agents, step=10 + step, road=road()))
        moved = {
            name: (x + 0.1 * v * np.cos(h), y + 0.1 * v * np.sin(h), h, v)
            for name, (x, y, h, v) in agents.items()
        }
        here = (command.x_m, command.y_m, command.heading_rad, command.speed_mps)
        agents = {**moved, "av": here}
        path.append(here)
        for name, (x, y, *_) in agents.items():
            assert name == "av" or np.hypot(x - here[0], y - here[1]) > 2.0, "it hit somebody"
    return np.array(path)


def test_the_planner_gets_away_from_what_stands_and_looks_where_to():
    scene = {"av": (0, 0, 0.0, 12.0), "ahead": (25.0, 0.0, 0.0, 1.0)}
    alone = driven(scene)
    assert np.abs(alone[:, 1]).max() > 1.0
    wall = {f"{side} {x}": (x, side * LANE_M, 0.0, 12.0) for side in (1, -1) for x in (-8, 0, 8)}
    between = driven({**scene, **wall})
    assert np.abs(between[:, 1]).max() < 1.6
    assert between[:, 3].min() < alone[:, 3].min()
