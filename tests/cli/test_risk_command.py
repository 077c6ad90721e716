import csv
import json

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.cli._sweep import map_risk
from deepmf_sumo.report.risk import gis
from deepmf_sumo.results.folder import RISK_FILES, Store, opened
from deepmf_sumo.results.risk.two_sides import compare

from tests.support.risk_doubles import NET, Attacks, eastward, straight


@pytest.fixture
def out(tmp_path):
    runs = Attacks(tmp_path / "out")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    runs.add("b", av=eastward(x=-130.0))
    return tmp_path / "out"


def test_a_map_is_written_and_its_worst_places_shown(out, capsys):
    assert main.run(["risk", str(out)]) == 0
    told = capsys.readouterr().out
    assert "four_way: 1 attack; not counted: 1 run with no vehicle to attack" in told
    assert "edge w_in" in told
    assert (out / "risk" / "risk.html").is_file()


def test_two_results_side_by_side(out, tmp_path, capsys):
    assert main.run(["compare", str(out), str(out), "--out", str(tmp_path / "both")]) == 0
    told = capsys.readouterr().out
    assert "1 pair of the same moment and seed" in told
    assert "+0 (-0.998 to +0.998; 1 pair)" in told
    assert "cannot tell; at least 28 attacked moments would" in told
    assert "same" not in told.replace("same moment", "")
    assert told.count("cannot tell; at least 17") == 4, "where hits come from as well"
    with (tmp_path / "both" / "origins.csv").open() as lines:
        assert {row["units_needed"] for row in csv.DictReader(lines)} == {"17"}
    text = (tmp_path / "both" / "comparison.md").read_text()
    assert "| place: w_in (w_pocket to centre) | 1 of 1 | 1 of 1 |" in text
    assert (tmp_path / "both" / "differences.csv").read_text().startswith("quantity,unit,a,b,")
    assert (tmp_path / "both" / "origins.csv").is_file()


@pytest.mark.parametrize("arguments", [["risk"], ["compare"]])
def test_what_is_no_result_folder_is_refused_in_one_line(arguments, tmp_path, capsys):
    folders = [str(tmp_path)] * (1 if arguments == ["risk"] else 2)
    assert main.run([*arguments, *folders]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert "is not a result folder" in line


def test_an_unknown_quantity_is_refused(out, capsys):
    assert main.run(["compare", str(out), str(out), "--quantity", "speed"]) == 2
    assert "'speed' is not a quantity" in capsys.readouterr().err


def test_what_differs_on_purpose_is_one_line_for_all_names_of_it(tmp_path, capsys):
    for name in ("before", "after"):
        runs = Attacks(tmp_path / name)
        runs.add("a", av=eastward(), opponent=eastward(), spec=name, network=name)
    assert main.run(["compare", str(tmp_path / "before"), str(tmp_path / "after")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "spec, network, method: before in A, after in B" in [line.strip() for line in lines]


def test_attacks_beside_all_roads_make_an_empty_map(tmp_path, capsys):
    runs = Attacks(tmp_path / "out")
    beside = straight((100.0, 100.0), 5.0, 0.0)
    runs.add("a", av=beside, opponent=straight((100.0, 120.0), 5.0, 0.0))
    assert main.run(["risk", str(tmp_path / "out")]) == 0
    assert "four_way: 1 attack\n" in capsys.readouterr().out
    assert (tmp_path / "out" / "risk" / "risk.csv").read_text() == ""


def test_the_map_after_attacks_replaces_an_earlier_one_and_is_no_error(out, tmp_path, capsys):
    (out / "risk" / "1-earlier").mkdir(parents=True)
    map_risk(out)
    assert capsys.readouterr().out == f"{out}/risk/risk.html\n"
    assert not (out / "risk" / "1-earlier").exists()
    for run in (out / "runs").iterdir():
        (run / "tracks.csv.gz").write_bytes(b"cut")
    map_risk(out)
    assert "no risk map: " in capsys.readouterr().err
    assert not (out / "risk").exists()


def test_sides_that_are_not_alike_are_told_or_refused(tmp_path, capsys):
    other_net = tmp_path / "other.net.xml"
    other_net.write_text(NET.read_text().replace("</net>", "<!-- widened --></net>"))
    for name, net, changes in (
        ("was", NET, {}),
        ("wider", other_net, {}),
        ("both", other_net, {"planner": "sumo"}),
        ("longer", NET, {"duration_steps": 200}),
    ):
        Attacks(tmp_path / name, net=net).add(
            "a", av=eastward(), opponent=eastward(x=-160.0), **changes
        )

    def compared(name):
        code = main.run(["compare", str(tmp_path / "was"), str(tmp_path / name)])
        told = capsys.readouterr()
        return code, " ".join((told.out + told.err).split())

    widened, either = "four_way is not the same in A and B", "planner and network are both"
    assert widened not in compared("was")[1]
    assert widened in compared("wider")[1]
    assert either not in compared("wider")[1]
    assert either in compared("both")[1]
    code, told = compared("longer")
    assert code == 2
    assert "may last 8 s and those of" in told
    assert "longer 20 s, so their hits cannot be compared" in told


def test_traffic_that_has_changed_is_told(tmp_path, capsys):
    for name, digest in (("was", "1"), ("same", "1"), ("more", "2")):
        runs = Attacks(tmp_path / name)
        runs.add("a", av=eastward(), opponent=eastward(x=-160.0))
        file = tmp_path / name / "manifest.json"
        inputs = {f"/{name}/city.rou.xml": digest, f"/{name}/city.net.xml": name}
        manifest = json.loads(file.read_text()) | {"machine": {"inputs": inputs}}
        file.write_text(json.dumps(manifest))
    for other, told in (("same", False), ("more", True)):
        assert main.run(["compare", str(tmp_path / "was"), str(tmp_path / other)]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert ("city.rou.xml: not the same in A and B" in shown) == told


def test_traffic_that_try_itself_changed_is_not_told(tmp_path):
    """An additional file may hold a program of a light, and routes beside it."""
    for name, digest in (("was", "1"), ("is", "2")):
        Attacks(tmp_path / name).add("a", av=eastward(), opponent=eastward(x=-160.0))
        file = tmp_path / name / "manifest.json"
        inputs = {f"/{name}/{one}.add.xml": digest for one in ("lights", "buses")}
        file.write_text(json.dumps(json.loads(file.read_text()) | {"machine": {"inputs": inputs}}))
    found = compare(tmp_path / "was", tmp_path / "is", changed_on_purpose={"lights.add.xml"})
    [note] = [one for one in found.notes if "not the same" in one]
    assert note.startswith("buses.add.xml: not the same in A and B")


def a_network(folder, name):
    """A result folder of an attack on a network of this name."""
    runs = Attacks(folder)
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80, network=name)
    return folder


def test_a_map_of_several_networks_makes_way_for_that_of_one(tmp_path, capsys):
    """The way back, too; what the user has put beside it stays each time."""
    a, b = a_network(tmp_path / "a", "one"), a_network(tmp_path / "b", "two")
    alone = ["risk", str(a)]
    assert main.run(alone) == 0
    (a / "risk" / "notes.txt").write_text("mine")
    first = {path.name for path in (a / "risk").iterdir()}
    for _ in range(2):
        assert main.run([*alone, str(b)]) == 0
        assert {path.name for path in (a / "risk").iterdir()} == {"1-one", "2-two", "notes.txt"}
        assert main.run(alone) == 0
        assert {path.name for path in (a / "risk").iterdir()} == first
    assert (a / "risk" / "notes.txt").read_text() == "mine"


def test_no_command_deletes_a_file_of_the_users_beside_a_map(out, tmp_path, capsys):
    assert main.run(["risk", str(out)]) == 0
    notes = out / "risk" / "notes.txt"
    notes.write_text("mine")
    map_risk(out)
    assert (out / "risk" / "risk.html").is_file()
    Store(out).forget_views()
    assert [path.name for path in (out / "risk").iterdir()] == ["notes.txt"]
    map_risk(out)
    with opened(out, resume=False, overwrite=True):
        assert [path.name for path in (out / "risk").iterdir()] == ["notes.txt"]
    Store(out).forget_views()
    notes.unlink()
    Store(out).forget_views()
    assert not (out / "risk").exists()


def test_all_files_of_a_map_are_known_to_be_of_it(out, capsys):
    assert main.run(["risk", str(out), "--gis", "gpkg"]) == 0
    made = {path.name for path in (out / "risk").iterdir()}
    assert made <= RISK_FILES
    assert gis.FILES < RISK_FILES


def test_tables_of_places_are_exported_without_a_ranking(out, capsys):
    assert main.run(["export", str(out), "--to", "csv"]) == 0
    told = capsys.readouterr().out.strip()
    assert told.startswith(f"{out}/risk/risk.csv, {out}/risk/attacks.csv")
    assert told.count("\n") == 0
    assert "html" not in told
    assert main.run(["export", str(out), "--to", "gpkg"]) == 0
    assert capsys.readouterr().out.strip() == f"{out}/risk/risk.gpkg"
    capsys.readouterr()
    assert main.run(["export", str(out), "--to", "geojson"]) == 2
    told = capsys.readouterr().err
    assert "geojson: the network four_way has the projection" in told
    assert "--gis" not in told
