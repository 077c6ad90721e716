from deepmf_sumo.cli import main

from tests.support import tiny_network


def test_a_run_writes_its_page(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    path = tiny_network.spec(tiny, "paged")
    assert main.run(["run", str(path), "--out", str(out), "--no-pictures", "--report"]) == 0
    assert "report.html" in capsys.readouterr().out
    assert "paged--tiny--0" in (out / "report.html").read_text("utf-8")


def test_a_page_is_written_again_and_shown(tiny, tmp_path, capsys, monkeypatch):
    out = tmp_path / "seeds" / "1"
    path = tiny_network.spec(tiny, "paged")
    assert main.run(["run", str(path), "--out", str(out), "--no-pictures"]) == 0
    assert not (out / "report.html").exists()
    shown = []
    monkeypatch.setattr("click.launch", shown.append)
    assert main.run(["report", str(out.parent), "--open"]) == 0
    assert shown == [str(out / "report.html")]
    assert "MB" in capsys.readouterr().out


def test_what_is_no_result_folder_is_refused_in_one_line(tmp_path, capsys):
    assert main.run(["report", str(tmp_path)]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert "is not a result folder, and contains none" in line
