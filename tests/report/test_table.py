from dataclasses import asdict

from deepmf_sumo.report import table
from deepmf_sumo.report.tables import layouts
from deepmf_sumo.results import findings

from tests.support import worth_doubles

OK = {
    "run_id": "a--b--0",
    "status": "ok",
    "error": "",
    "outcome": "av_opponent",
    "contacts": [
        {"kind": "opponent_other", "time_s": 1.0, "relative_mps": 1.0, "sector": 1},
        {"kind": "av_opponent", "time_s": 2.54, "relative_mps": 6.0, "sector": 7},
    ],
    "opponent": "cutter",
    "opponent_score": 0.734,
    "expectations_broken": [],
    "timings": {"generation_s": 1.234},
}


def test_row_tells_of_the_contact_that_counts():
    (row,) = table.rows([OK])
    expected = ("2.5 s", "6.0 m/s", "cutter (0.73)", "front right", "1.23 s")
    assert row == ("a--b--0", "AV hit by opponent", *expected)
    assert len(row) == len(table.HEADINGS)


def test_no_contact_and_nobody():
    quiet = {**OK, "outcome": "none", "opponent": None, "opponent_score": None}
    (row,) = table.rows([quiet])
    assert row[1:6] == ("no contact", "-", "-", "-", "-")


def test_failures_and_broken_expectations_are_said():
    failed = {"run_id": "x", "status": "timeout", "error": "longer than 8 s"}
    broken = {**OK, "expectations_broken": ["av_collision is true, expected false"]}
    rows = table.rows([failed, broken])
    assert rows[0][1] == "timeout: longer than 8 s"
    assert "EXPECTATION BROKEN: av_collision is true" in rows[1][1]


def test_totals():
    summary = {
        "runs": 3,
        "attacked": 2,
        "hits": 1,
        "findings": asdict(findings.count([worth_doubles.worth()])),
        "status": {"ok": 2, "failed": 1},
        "collision_rate": {"rate": 0.5, "low": 0.09, "high": 0.91},
        "contact_speed_mps_mean": 6.04,
        "expectations_broken": {"a": ["b"]},
    }
    assert table.totals(summary) == (
        "3 runs: 2 ok, 1 failed; AV hit by opponent in 1 of 2 attacked, 50 %"
        " (95 % interval 9-91 %); 1 finding: 0 by an error of the AV (A), 1 avoidable (B;"
        " avoided by cc 1, search 1); apart from these 0 contrived (C), 0 unavoidable (D);"
        " mean contact speed 6.0 m/s; 1 with broken expectations"
    )
    assert [line.partition(":")[0] for line in table.meanings(summary)] == ["B", "cc", "search"]


def test_tables_of_versions_without_findings_are_read(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("method,valid_collision_rate,valid_collision_rate_lo\na,0.5,0.1\n")
    assert layouts._rows(file) == [
        {"method": "a", "finding_rate": "0.5", "finding_rate_lo": "0.1"},
    ]
