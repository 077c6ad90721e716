import errno
import os
import re
import sys
import types

import numpy as np
import pytest
import torch

from deepmf_sumo.errors import RunError
from deepmf_sumo.training.fit import loop
from deepmf_sumo.training.fit.checkpoints import Checkpoints, LearningCurves
from deepmf_sumo.training.fit.loop import Schedule

from tests.support import tiny_training

pytestmark = pytest.mark.slow_unit

SCHEDULE = Schedule(steps=60, batch=16, evaluate_every=15, average=0.95, rate=0.02)


class CutError(Exception):
    pass


def train(folder, *, schedule=SCHEDULE, cache=None, cut=None, lines=None):
    """The trained network and what came of it; ``cut`` ends it before a step, as a kill would."""
    cache = cache or tiny_training.cache()
    net = tiny_training.net()
    inner, made = tiny_training.loss_of(net), []

    def loss(batch, generator):
        if net.training:
            made.append(1)
            if len(made) == cut:
                raise CutError
        return inner(batch, generator)

    report = lines.append if lines is not None else lambda _: None
    names = [source.name for source in cache.sources]
    curves = LearningCurves(folder / "curves.csv", names, report)
    found = loop.train(net, cache, loss, schedule, Checkpoints(folder / "a"), curves, report)
    return net, found, len(made)


def same(one, other):
    return all(
        torch.equal(a, b)
        for a, b in zip(one.state_dict().values(), other.state_dict().values(), strict=True)
    )


@pytest.mark.parametrize("cut", [2, 17, 31, 59])
@pytest.mark.parametrize("checkpoint_s", [1000.0, 0.0])
def test_an_interrupted_run_ends_as_if_it_had_not_been_interrupted(tmp_path, cut, checkpoint_s):
    schedule = Schedule(
        steps=60, batch=16, evaluate_every=15, average=0.95, rate=0.02, checkpoint_s=checkpoint_s
    )
    whole, outcome, steps = train(tmp_path / "whole", schedule=schedule)
    assert steps == 60
    with pytest.raises(CutError):
        train(tmp_path / "part", schedule=schedule, cut=cut)
    again, resumed, steps = train(tmp_path / "part", schedule=schedule)
    assert steps == 60 - (cut - 1 if checkpoint_s == 0.0 else (cut - 1) // 15 * 15)
    assert same(whole, again)
    assert resumed.held_out == outcome.held_out
    assert resumed.best_step == outcome.best_step

    def curve(name):
        rows = (tmp_path / name / "curves.csv").read_text().splitlines()
        return [row.split(",")[:-1] for row in rows]  # the last column is the pace

    assert curve("part") == curve("whole")
    assert len(curve("whole")) == 5


def test_a_look_says_how_long_it_takes_at_most(tmp_path):
    lines = []
    train(tmp_path, lines=lines)
    looks = [line for line in lines if line.startswith("step ")]
    assert len(looks) == 4
    assert all(re.search(r"ms a step, at most \d+ s left$", line) for line in looks[:3])
    assert looks[3].endswith("ms a step")


def test_a_finished_run_is_not_repeated_while_its_checkpoint_is_there(tmp_path):
    first, _, _ = train(tmp_path)
    second, outcome, steps = train(tmp_path)
    assert steps == 0
    assert outcome.steps == 60
    assert same(first, second)


def test_a_checkpoint_cut_short_gives_way_to_the_one_before(tmp_path):
    whole, _, _ = train(tmp_path / "whole")
    with pytest.raises(CutError):
        train(tmp_path / "part", cut=50)
    file = tmp_path / "part" / "a"
    file.write_bytes(file.read_bytes()[:-100])
    lines = []
    again, _, steps = train(tmp_path / "part", lines=lines)
    assert steps == 30
    assert "is damaged; the previous checkpoint is used" in lines[0]
    assert "resuming from step 30" in lines[1]
    assert same(whole, again)


def test_with_both_checkpoints_damaged_training_starts_from_step_0(tmp_path):
    whole, _, _ = train(tmp_path / "whole")
    with pytest.raises(CutError):
        train(tmp_path / "part", cut=50)
    for name in ("a", "a.previous"):
        content = bytearray((tmp_path / "part" / name).read_bytes())
        content[200] ^= 1
        (tmp_path / "part" / name).write_bytes(content)
    lines = []
    again, _, steps = train(tmp_path / "part", lines=lines)
    assert steps == 60
    assert "training starts from step 0" in lines[0]
    assert same(whole, again)


def test_a_full_disk_costs_a_checkpoint_and_nothing_else(tmp_path, monkeypatch):
    whole, _, _ = train(tmp_path / "whole")
    saved, real = [], os.fsync

    def full(descriptor):
        saved.append(1)
        if len(saved) in {2, 3}:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    monkeypatch.setattr(LearningCurves, "write", lambda *_: None)  # it flushes files, too
    lines = []
    with pytest.raises(CutError):
        train(tmp_path / "part", cut=50, lines=lines)
    warnings = [line for line in lines if line.startswith("warning")]
    assert len(warnings) == 2
    assert "No space left on device" in warnings[0]
    assert [path.name for path in (tmp_path / "part").iterdir()] == ["a"]
    again, _, steps = train(tmp_path / "part")
    assert steps == 45
    assert same(whole, again)


def test_a_loss_that_is_not_a_number_stops_with_step_and_scenes(tmp_path):
    source = tiny_training.source("bad", 200)
    source.arrays["x"][37, 1] = np.nan
    lines = []
    with pytest.raises(RunError, match=r"\d+: the loss is nan; .*: 37, of scenes bad: bad-3;"):
        train(tmp_path, cache=tiny_training.cache(source), lines=lines)


def test_the_last_checkpoint_stays_when_the_loss_is_not_a_number(tmp_path):
    with pytest.raises(CutError):
        train(tmp_path, cut=40)
    before = (tmp_path / "a").read_bytes()
    source = tiny_training.source("one", 200)
    source.arrays["y"][:] = np.inf
    with pytest.raises(RunError, match="step 31: the loss is inf"):
        train(tmp_path, cache=tiny_training.cache(source))
    assert (tmp_path / "a").read_bytes() == before


def test_training_stops_where_nothing_is_gained(tmp_path):
    cache = tiny_training.cache()
    cache.sources[0].arrays["y"][cache.rows(held_out=False)] *= -1
    schedule = Schedule(steps=400, batch=16, evaluate_every=5, rate=0.05, patience=3)
    lines = []
    _, outcome, steps = train(tmp_path, schedule=schedule, cache=cache, lines=lines)
    assert steps < 400
    assert steps == outcome.steps == outcome.best_step + 15
    assert f"stopped at step {steps}" in lines[-1]
    assert train(tmp_path, schedule=schedule, cache=cache)[2] == 0


def test_the_criterion_is_the_mean_over_sources_by_share(tmp_path):
    cache = tiny_training.cache(
        tiny_training.source("a", 100, weight=3.0),
        tiny_training.source("bb", 100, weight=1.0, slope=-1.0),
    )
    lines = []
    _, outcome, _ = train(tmp_path, cache=cache, lines=lines)
    one, other = outcome.by_source
    assert outcome.held_out == pytest.approx(0.75 * one + 0.25 * other)
    assert one < other
    assert "bb" in lines[-1]
    head = (tmp_path / "curves.csv").read_text().splitlines()[0]
    assert head == "step,loss,held_out,held_out a,held_out bb,rate,ms_a_step"


def test_with_nothing_held_out_the_last_weights_are_kept(tmp_path):
    cache = tiny_training.cache(tiny_training.source("a", 40, scenes=1))
    _, outcome, _ = train(tmp_path, cache=cache)
    assert outcome.held_out is None
    assert outcome.best_step == 60


def test_averaged_weights_are_what_is_kept(tmp_path):
    schedule = Schedule(steps=30, batch=16, evaluate_every=30, rate=0.02, average=0.9)
    averaged, _, _ = train(tmp_path, schedule=schedule)
    saved = Checkpoints(tmp_path / "a").load("cpu", print)
    last, kept = saved["net"]["0.weight"], averaged.state_dict()["0.weight"]
    assert torch.equal(kept, saved["average"]["0.weight"])
    began = tiny_training.net().state_dict()["0.weight"]
    assert 0 < (kept - last).norm() < 0.5 * (began - last).norm()
    assert averaged.state_dict()["1.num_batches_tracked"] == 30


def test_bf16_trains_too(tmp_path):
    half = Schedule(steps=30, batch=16, evaluate_every=30, rate=0.02, precision="bf16")
    _, outcome, _ = train(tmp_path, schedule=half)
    assert np.isfinite(outcome.held_out)


def test_curves_go_to_tensorboard_where_it_is_installed(tmp_path, monkeypatch):
    events = []

    class SummaryWriter:
        def __init__(self, folder, purge_step):
            events.append((folder, purge_step))

        def add_scalar(self, name, value, step):
            events.append((name, step))

        def flush(self):
            pass

        def close(self):
            events.append("closed")

    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = SummaryWriter
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    train(tmp_path)
    assert events[0] == (str(tmp_path / "curves"), 1)
    assert ("held_out", 15) in events
    assert ("loss", 60) in events
    assert events[-1] == "closed"


def test_held_out_samples_that_are_not_numbers_stop_it(tmp_path):
    cache = tiny_training.cache()
    cache.sources[0].arrays["y"][cache.rows(held_out=True)[3]] = np.inf
    with pytest.raises(RunError, match="held-out scenes of one is inf"):
        train(tmp_path, cache=cache)
    assert not (tmp_path / "a").exists()
