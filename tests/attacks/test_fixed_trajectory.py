import gzip
import io
import os
import zlib

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.errors import PluginError, RunError

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import view_of

VIEW = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})
RNG = np.random.default_rng(0)


def build(**values):
    return trajectory.TrajectoryPolicy(plugins.settings("adversaries", "trajectory", values))


def poses(count=30):
    along = -8 + 1.2 * np.arange(1, count + 1)
    return np.stack([along, np.full(count, 3.5), np.zeros(count)], -1)


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def torn(content):
    """Zipped, and damaged in the middle."""
    zipped = bytearray(gzip.compress(content, mtime=0))
    zipped[12:20] = b"\xff" * 8
    with pytest.raises(zlib.error):
        gzip.decompress(bytes(zipped))
    return bytes(zipped)


def test_poses_are_driven_from_the_next_step():
    policy = build(agent="b", poses=poses().tolist())
    assert policy.reset(VIEW, RNG) == ("b",)
    assert policy.period_steps is None
    plan = plan_of(policy, VIEW)
    assert (plan.first_step, len(plan.position_m)) == (11, 30)
    np.testing.assert_allclose(plan.position_m, poses()[:, :2])
    np.testing.assert_allclose(plan.speed_mps, 12.0)


def test_a_result_table_is_a_trajectory(tmp_path):
    file = tmp_path / "tracks.csv.gz"
    lines = ["step,time_s,id,x_m,y_m,heading_rad,speed_mps"]
    for step in range(5, 40):
        lines += [f"{step},0,av,0,0,0,0", f"{step},0,b,{step - 18},3.5,0.125,10"]
    file.write_bytes(gzip.compress("\n".join(lines).encode()))
    plan = plan_of(build(agent="b", file=str(file)), VIEW)
    assert (plan.first_step, len(plan.position_m)) == (11, 29)
    np.testing.assert_allclose(plan.position_m[0], [-7, 3.5])
    np.testing.assert_allclose(plan.heading_rad, 0.125)


def test_npz(tmp_path):
    file = tmp_path / "plan.npz"
    np.savez(file, step=np.arange(11, 41), position_m=poses()[:, :2], heading_rad=poses()[:, 2])
    np.testing.assert_allclose(
        plan_of(build(agent="b", file=str(file)), VIEW).position_m, poses()[:, :2]
    )


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"agent": "b"},
        {"agent": "b", "poses": [[1.0, 2.0]]},
        {"agent": "b", "poses": []},
        {"agent": "b", "poses": [[1.0, 2.0, 3.0]], "file": "x.csv"},
        {"agent": "b", "file": "x.csv", "first_step": 3},
    ],
)
def test_wrong_settings_are_refused(values):
    with pytest.raises(PluginError):
        build(**values)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.csv", b"step,x_m,y_m\n1,2,3\n", "heading_rad"),
        ("b.csv", b"step,x_m,y_m,heading_rad\n11,2,3,0\n13,2,3,0\n", "gaps"),
        ("short.csv", b"step,x_m,y_m,heading_rad\n11,2,3\n", "short.csv"),
        ("flat.npz", npz(step=np.array(11), position_m=np.zeros(2)), "flat.npz"),
        ("torn.csv.gz", torn(b"step,x_m,y_m,heading_rad\n11,2,3,0\n"), "torn.csv.gz"),
        ("c.csv", b"step,x_m,y_m,heading_rad\n11,2,three,0\n", "three"),
        ("d.csv", b"step,x_m,y_m,heading_rad\n11,nan,3,0\n", "finite"),
        ("d.csv", b"step,x_m,y_m,heading_rad\n11,2,3,1e300\n", "heading_rad beyond 10000 rad"),
        ("e.csv", b"step,x_m,y_m,heading_rad,id\n11,2,3,0,c\n", "agent 'b'"),
        ("f.csv.gz", b"no gzip", "f.csv.gz"),
        ("g.npz", b"no zip", "g.npz"),
    ],
)
def test_files_that_cannot_be_used(tmp_path, name, content, problem):
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(PluginError, match=problem):
        build(agent="b", file=str(file))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(PluginError, match="missing"):
        build(agent="b", file=str(tmp_path / "missing.csv"))


def test_who_or_when_that_does_not_fit():
    with pytest.raises(RunError, match="'c'"):
        build(agent="c", poses=poses().tolist()).reset(VIEW, RNG)
    for first in (12, 500):
        with pytest.raises(RunError, match="step 11"):
            plan_of(build(agent="b", poses=poses().tolist(), first_step=first), VIEW)
    with pytest.raises(RunError, match="step 11"):
        plan_of(build(agent="b", poses=poses(3).tolist(), first_step=2), VIEW)


@pytest.mark.timeout(10)
@pytest.mark.parametrize("name", ["pipe.csv", "pipe.npz", "pipe.csv.gz"])
def test_a_pipe_is_no_file_to_wait_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(PluginError, match="it is a pipe, not a regular file"):
        build(agent="b", file=str(tmp_path / name))


def test_a_trajectory_that_begins_elsewhere_begins_where_the_vehicle_is():
    """At -8 m with 12 m/s; its poses begin 3 m beside it: 1.5 s later it is on them."""
    aside = poses() + np.array([0.0, 3.0, 0.0])
    plan = plan_of(build(agent="b", poses=aside.tolist()), VIEW)
    before = np.array([[-8.0, 3.5]])
    steps = np.diff(np.concatenate([before, plan.position_m]), axis=0)
    assert np.abs(steps[:, 1]).max() < 0.32
    np.testing.assert_allclose(steps[:, 0], 1.2)
    np.testing.assert_allclose(plan.position_m[14:], aside[14:, :2])
    assert abs(plan.position_m[0, 1] - 3.5) < 0.05
    np.testing.assert_allclose(plan.speed_mps, np.hypot(*steps.T) / 0.1)


def test_one_that_begins_turned_or_far_away_takes_its_time():
    turned = poses() + np.array([0.0, 0.0, 1.0])
    plan = plan_of(build(agent="b", poses=turned.tolist()), VIEW)
    assert plan.heading_rad[0] < 0.05
    np.testing.assert_allclose(plan.heading_rad[14:], 1.0)
    ahead = poses(60) + np.array([9.0, 0.0, 0.0])
    plan = plan_of(build(agent="b", poses=ahead.tolist()), VIEW)
    assert (np.diff(plan.position_m[:, 0]) / 0.1).max() < 12.0 + 1.5 * 3.0 + 0.1
    np.testing.assert_allclose(plan.position_m[29:], ahead[29:, :2])
    away = poses() + np.array([20.0, 0.0, 0.0])
    np.testing.assert_allclose(
        plan_of(build(agent="b", poses=away.tolist()), VIEW).position_m, away[:, :2]
    )


@pytest.mark.parametrize("kind", ["poses", "npz", "csv"])
def test_speeds_that_are_stated_are_driven(tmp_path, kind):
    stated = np.full(30, 12.3)
    if kind == "poses":
        plan = plan_of(build(agent="b", poses=np.column_stack([poses(), stated]).tolist()), VIEW)
    else:
        file = tmp_path / f"plan.{kind}"
        if kind == "npz":
            np.savez(
                file, step=np.arange(11, 41), position_m=poses()[:, :2], heading_rad=poses()[:, 2],
                speed_mps=stated,
            )  # fmt: skip
        else:
            lines = ["step,speed_mps,x_m,y_m,heading_rad"]
            lines += [f"{11 + row},12.3,{x},{y},{h}" for row, (x, y, h) in enumerate(poses())]
            file.write_text("\n".join(lines))
        plan = plan_of(build(agent="b", file=str(file)), VIEW)
    np.testing.assert_allclose(plan.speed_mps, 12.3)
    np.testing.assert_allclose(plan.position_m, poses()[:, :2])


@pytest.mark.parametrize(
    "wrong", [[[1.0, 2.0, 0.0], [1.0, 2.0, 0.0, 3.0]], [[1.0, 2.0, 0.0, -1.0]]]
)
def test_speeds_are_of_all_rows_and_not_negative(wrong):
    with pytest.raises(PluginError, match="speed_mps"):
        build(agent="b", poses=wrong)
