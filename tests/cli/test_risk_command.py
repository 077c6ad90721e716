import pytest
from risk_doubles import Attacks, eastward, straight

from deepmf_sumo.cli import main


@pytest.fixture
def out(tmp_path):
    runs = Attacks(tmp_path / "out")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    runs.add("b", av=eastward(x=-130.0))
    return tmp_path / "out"


def test_a_map_is_written_and_its_worst_places_shown(out, capsys):
    assert main._run(["risk", str(out)]) == 0
    told = capsys.readouterr().out
    assert "four_way: 1 attacks, 1 with nobody to attack left out" in told
    assert "edge w_in" in told
    assert (out / "risk" / "risk.html").is_file()


def test_two_results_side_by_side(out, tmp_path, capsys):
    assert main._run(["compare", str(out), str(out), "--out", str(tmp_path / "both")]) == 0
    told = capsys.readouterr().out
    assert "1 pairs of the same moment and seed" in told
    assert "too few to tell (1 pairs)" in told
    text = (tmp_path / "both" / "comparison.md").read_text()
    assert "| place: w_in (w_pocket to centre) | 1 of 1 | 1 of 1 |" in text
    assert (tmp_path / "both" / "differences.csv").read_text().startswith("quantity,unit,a,b,")
    assert (tmp_path / "both" / "origins.csv").is_file()


@pytest.mark.parametrize("arguments", [["risk"], ["compare"]])
def test_what_is_no_result_folder_is_refused_in_one_line(arguments, tmp_path, capsys):
    folders = [str(tmp_path)] * (1 if arguments == ["risk"] else 2)
    assert main._run([*arguments, *folders]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert "is no result folder" in line


def test_an_unknown_quantity_is_refused(out, capsys):
    assert main._run(["compare", str(out), str(out), "--quantity", "speed"]) == 2
    assert "'speed' is no quantity" in capsys.readouterr().err


def test_what_differs_on_purpose_is_one_line_for_all_names_of_it(tmp_path, capsys):
    for name in ("before", "after"):
        runs = Attacks(tmp_path / name)
        runs.add("a", av=eastward(), opponent=eastward(), spec=name, network=name)
    assert main._run(["compare", str(tmp_path / "before"), str(tmp_path / "after")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "spec, network, method: before in A, after in B" in [line.strip() for line in lines]


def test_attacks_beside_all_roads_make_an_empty_map(tmp_path, capsys):
    runs = Attacks(tmp_path / "out")
    beside = straight((100.0, 100.0), 5.0, 0.0)
    runs.add("a", av=beside, opponent=straight((100.0, 120.0), 5.0, 0.0))
    assert main._run(["risk", str(tmp_path / "out")]) == 0
    assert "four_way: 1 attacks" in capsys.readouterr().out
    assert (tmp_path / "out" / "risk" / "risk.csv").read_text() == ""
