"""What a result and its screen say of a planner that is not repeatable."""

from deepmf_sumo.report import table
from deepmf_sumo.results import folder, result

from tests.support import gate_doubles


def test_it_is_counted_and_said_once():
    runs = [gate_doubles.result("a", spec=f"spec {number}", metrics={}) for number in range(3)]
    assert "repeatable" not in table.totals(folder.summary(runs))
    for run, away_m in zip(runs, (0.25, 0.03), strict=False):
        run["events"] = [
            {"step": 12, "agent_id": "av", "kind": result.UNREPEATED, "away_m": away_m}
        ]
    summary = folder.summary(runs)
    assert (summary["unrepeated"], summary["unrepeated_m"]) == (2, 0.25)
    assert "not repeatable: in 2 runs it drove up to 0.25 m" in table.totals(summary)
