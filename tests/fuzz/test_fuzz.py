"""A few changed inputs of each kind; ``make fuzz`` tries 2000."""

import pytest

from tests.fuzz import kinds, runner

pytestmark = pytest.mark.sumo

COUNT = 8


@pytest.mark.parametrize("kind", kinds.all_kinds(), ids=lambda kind: kind.name)
def test_changed_inputs_are_accepted_or_refused(kind):
    found = list(runner.run(kind, COUNT, seed=1))
    assert len(found) == COUNT
    assert not [one for one in found if one.result in runner.BAD], runner.table(found)


@pytest.mark.parametrize("kind", kinds.all_kinds(), ids=lambda kind: kind.name)
def test_the_input_that_all_are_made_of_is_valid(kind, tmp_path):
    unchanged = runner.Kind(kind.name, kind.make, lambda rng, path: None, kind.use)
    (one,) = runner.run(unchanged, 1, seed=1)
    assert one.result == "accepted", one.said
