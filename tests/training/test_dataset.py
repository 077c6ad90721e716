from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.training.samples import dataset
from deepmf_sumo.training.samples.dataset import Joined, mix
from deepmf_sumo.training.samples.places import SceneArea

from tests.support import tiny_training

PARTS = [np.arange(12.0).reshape(3, 4), np.zeros((0, 4)), 100 + np.arange(20.0).reshape(5, 4)]
WHOLE = np.concatenate(PARTS)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(0, 7), max_size=12))
def test_joined_rows_are_those_of_one_array(rows):
    rows = np.array(rows, np.int64)
    joined = Joined(PARTS)
    assert np.array_equal(joined[rows], WHOLE[rows])
    assert np.array_equal(joined[rows, 1:3], WHOLE[rows, 1:3])
    assert np.array_equal(joined[rows, 0], WHOLE[rows, 0])


@pytest.mark.parametrize(
    "key",
    [
        slice(None),
        slice(2, 5),
        (slice(1, 6, 2), 0),
        (slice(0, 4), slice(None, None, 2)),
        WHOLE[:, 0] > 4,
        4,
        -1,
        (3, 2),
    ],
)
@pytest.mark.parametrize("parts", [PARTS, [WHOLE]])
def test_joined_takes_what_numpy_takes(key, parts):
    joined = Joined(parts)
    assert np.array_equal(joined[key], WHOLE[key])
    assert joined.shape == WHOLE.shape
    assert np.array_equal(np.asarray(joined), WHOLE)


def test_sources_keep_their_scenes_apart():
    made = tiny_training.cache(tiny_training.source("a", 40), tiny_training.source("bb", 60))
    assert made.scenes == 40
    assert len(set(made.scene)) == 40
    for number, count in enumerate((40, 60)):
        held = made.rows(held_out=True, source=number)
        train = made.rows(held_out=False, source=number)
        assert len(held) == count // 10
        assert not set(made.scene[held]) & set(made.scene[train])
    assert made.names(np.array([0, 1, 40])) == ["a: a-0", "bb: bb-0"]
    rows = np.array([70, 3, 41])
    assert np.array_equal(made.batch(rows)["y"], np.asarray(made.arrays["y"])[rows])


def test_a_source_of_few_scenes_still_holds_one_out():
    made = tiny_training.cache(tiny_training.source("few", 12, scenes=3))
    assert set(made.scene[made.rows(held_out=True)]) == {2}
    alone = tiny_training.cache(tiny_training.source("alone", 4, scenes=1))
    assert len(alone.rows(held_out=True)) == 0


def test_sources_count_by_their_samples_or_by_their_weights():
    by_samples = tiny_training.cache(tiny_training.source("a", 40), tiny_training.source("b", 120))
    assert by_samples.shares == pytest.approx([0.25, 0.75])
    weighted = tiny_training.cache(
        tiny_training.source("a", 40, weight=3.0), tiny_training.source("b", 120, weight=1.0)
    )
    assert weighted.shares == pytest.approx([0.75, 0.25])
    rows = np.concatenate([rows for _, rows in dataset.batches(weighted, 8, 0, 0, 396)])
    assert (weighted.origin[rows] == 0).mean() == pytest.approx(0.75, abs=0.03)
    seen = np.bincount(rows, minlength=160)
    assert not seen[weighted.rows(held_out=True)].any()
    for number in (0, 1):
        mine = seen[weighted.rows(held_out=False, source=number)]
        assert mine.max() - mine.min() <= 1
    without = replace(weighted, chosen=weighted.origin == 1)
    assert without.shares == pytest.approx([0.0, 1.0])


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 70), st.integers(1, 40), st.integers(0, 3))
def test_batches_from_a_step_on_are_those_of_the_whole_run(first, size, seed):
    made = tiny_training.cache(
        tiny_training.source("a", 40, weight=3.0), tiny_training.source("b", 60, weight=1.0)
    )
    whole = list(islice(dataset.batches(made, size, seed, 0, 71), 71))
    rest = list(dataset.batches(made, size, seed, first, 71))
    assert [step for step, _ in rest] == list(range(first, 71))
    for (_, rows), (_, expected) in zip(rest, whole[first:], strict=True):
        assert np.array_equal(rows, expected)


def test_a_place_is_held_out_in_all_sources_or_in_none():
    areas = [SceneArea("", ((50 * (number // 4), 0),)) for number in range(80)]
    recorded = replace(tiny_training.source("recorded", 800, scenes=80), areas=areas)
    attacked = replace(tiny_training.source("attacked", 160, scenes=80), areas=areas[::-1])
    made = mix([recorded, attacked])
    assert made.is_apart
    both = [*areas, *areas[::-1]]
    kept, trained = (
        {both[scene] for scene in np.unique(made.scene[made.held_out == held])}
        for held in (True, False)
    )
    assert kept
    assert not kept & trained
    assert 0 < len(made.rows(held_out=True)) < 400
