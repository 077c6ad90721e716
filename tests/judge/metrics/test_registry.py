"""How metrics are declared, shared and joined by those of other packages."""

from importlib.metadata import EntryPoint

import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.avoidability import grading
from deepmf_sumo.judge.metrics import NotMeasurable, conflict, naturalness
from deepmf_sumo.report.tables import text
from deepmf_sumo.scene import MetricValue

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

PATHS = {"av": straight(0, 0, 10), "b": straight(-1, 3.5, 10)}


class Gaps:
    """Steps with a gap below a metre."""

    @staticmethod
    def measure(rollout, case):
        return MetricValue(name="close_steps", value=3.0, unit="1", better="higher")


@metrics.metric("m", better="lower")
def last_gap(episode):
    """Gap at the
    last step.

    Not printed.
    """
    if episode.rollout.opponent_id is None:
        raise NotMeasurable("no opponent")
    return conflict.series(episode).gap_m[-1]


@pytest.fixture
def joined(monkeypatch):
    """Two metrics of an installed package."""
    found = tuple(
        EntryPoint(name, f"{__name__}:{attribute}", "deepmf_sumo.judge.metrics")
        for name, attribute in (("close_steps", "Gaps"), ("last_gap", "last_gap"))
    )
    monkeypatch.setattr(plugins, "_entry_points", lambda kind: found if kind == "metrics" else ())


def test_a_metric_is_a_function_with_a_definition():
    assert (last_gap.name, last_gap.unit, last_gap.better) == ("last_gap", "m", "lower")
    assert last_gap.definition == "gap at the last step"
    assert last_gap.measure(rollout_of(PATHS), case_of()).value == pytest.approx(1.5)
    nobody = last_gap.measure(rollout_of(PATHS, opponent_id=None), case_of())
    assert (nobody.value, nobody.reason) == (None, "no opponent")


def test_names_are_sorted_and_helpers_are_no_metrics():
    names = plugins.names("metrics")
    assert names == sorted(names)
    assert not {"_slices", "conflict", "naturalness", "statistics"} & {*names}
    assert [value.name for value in metrics.measure(rollout_of(PATHS), case_of())] == names


def test_metrics_of_other_packages_join(joined):
    found = {value.name: value for value in metrics.measure(rollout_of(PATHS), case_of())}
    assert list(found) == plugins.names("metrics")
    assert found["close_steps"].value == 3.0
    assert found["last_gap"].value == pytest.approx(1.5)
    assert not plugins.own("metrics", "last_gap")
    assert plugins.own("metrics", "min_gap")
    assert text._metric("close_steps") == "Steps with a gap below a metre."
    assert text._metric("last_gap") == "gap at the last step"
    assert plugins.load("metrics", f"{__name__}:last_gap") is last_gap


@pytest.mark.parametrize(
    ("module", "name", "times"),
    [
        (conflict, "over_time", 1),
        (grading, "judge", 1),
        (naturalness, "samples", 2),  # raw and smooth
        (naturalness, "paths", 2),  # whole and cut
    ],
)
def test_what_several_metrics_need_is_computed_once(monkeypatch, module, name, times):
    calls, real = [], getattr(module, name)

    def counted(*arguments, **options):
        calls.append(arguments)
        return real(*arguments, **options)

    monkeypatch.setattr(module, name, counted)
    metrics.measure(rollout_of(PATHS, contacts=[contact_of()]), case_of(PATHS))
    assert len(calls) == times
