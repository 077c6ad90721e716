"""What commands print: progress, and results for other programs."""

import io
import json

from rich.console import Console

from deepmf_sumo.cli import _screen as screen
from deepmf_sumo.results import folder
from deepmf_sumo.results.result import profile as profile_of
from deepmf_sumo.spec.profiles import headline
from deepmf_sumo.study.sweep.batch import Progress

from tests.support import gate_doubles

RUN = {"run_id": "one--tiny--0", "status": "ok", "outcome": "none"}


def reported(monkeypatch, *, terminal):
    text = io.StringIO()
    console = Console(file=text, force_terminal=terminal, width=120, highlight=False)
    monkeypatch.setattr(screen, "Console", lambda **_: console)
    with screen.progress() as report:
        report(Progress(done=1, of=7, kept=1))
        for done in range(2, 8):
            report(Progress(done=done, of=7, kept=1, last=RUN))
    return text.getvalue()


def test_progress_in_a_log_is_a_line_for_each_run(monkeypatch):
    lines = reported(monkeypatch, terminal=False).splitlines()
    assert len(lines) == 6
    # no guess before five runs: the first ones wait for their workers
    assert lines[3] == "5 of 7 runs (1 kept from before); last: one--tiny--0, none"
    assert lines[4].startswith("6 of 7 runs (1 kept from before), ")
    assert lines[4].endswith("s left; last: one--tiny--0, none")
    assert lines[5] == "7 of 7 runs (1 kept from before); last: one--tiny--0, none"


def test_progress_on_a_terminal_is_a_bar(monkeypatch):
    shown = reported(monkeypatch, terminal=True)
    assert "runs (1 kept from before)" in shown
    assert "7/7" in shown
    assert "\u2501" in shown


ROWS = [{"name": "a", "value": 0.123456789, "why": None}, {"name": "=c", "value": 2, "why": "|"}]


def test_rows_are_tables(capsys):
    screen.emit("csv", ROWS)
    assert capsys.readouterr().out.splitlines() == ["name,value,why", "a,0.123457,", "'=c,2,|"]
    screen.emit("md", ROWS)
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["| name | value | why |", "| --- | --- | --- |"]
    assert lines[2:] == ["| a | 0.123457 |  |", "| '=c | 2 | / |"]


def test_rows_are_json(capsys):
    screen.emit("json", ROWS)
    assert json.loads(capsys.readouterr().out) == ROWS
    screen.emit("json", [])
    assert capsys.readouterr().out == "[]\n"


def test_the_table_of_runs_begins_with_what_was_meant(tmp_path, capsys):
    runs = [
        gate_doubles.result(name, profile=profile, constraints=constraints, opponent_score=None)
        | {"timings": {"wall_s": 1.0, "generation_s": 1.0}}
        for name, profile, constraints in (("a", "fair", ["fair"]), ("b", "any", []))
    ]
    summary = folder.summary([])
    screen.table(runs, summary | {"profile": headline(map(profile_of, runs))}, tmp_path)
    assert capsys.readouterr().out.startswith("profiles fair (fair) (1 run); any (1 run)\n")
    screen.table(runs, summary, tmp_path)
    assert capsys.readouterr().out.startswith("run ")
