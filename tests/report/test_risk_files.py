import csv
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest
from risk_doubles import LEFT_IN, Attacks, eastward, straight

from deepmf_sumo.benchmark import risk
from deepmf_sumo.errors import OutputError
from deepmf_sumo.network import programs
from deepmf_sumo.report import risk as files
from deepmf_sumo.report.risk.polygons import colour

BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A map of three attacks: two on an edge, one of them a hit, and one in the junction."""
    root = tmp_path_factory.mktemp("risk")
    out = Attacks(root / "out")
    out.add("</script>", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    out.add("b", av=eastward(x=-130.0), opponent=straight((-60.0, -12.0), 0.0, 0.0))
    left = straight((-60.0, -1.6), 10.0, 0.0, steps=51)
    out.add("c", av=left, opponent=eastward(), hit=50, moment=(*LEFT_IN, "left"))
    [written] = files.write(root / "map", risk.read([root / "out"]), "my <map>")
    return written


def test_the_table_has_a_row_a_place(made):
    with (made.folder / "risk.csv").open() as lines:
        table = list(csv.DictReader(lines))
    assert len(table) == len(made.rows)
    [edge] = [row for row in table if row["place"] == "w_in" and row["counted"] == "decided"]
    assert (edge["attacks"], edge["hits"], edge["avoidable"], edge["judged"]) == (
        "2",
        "1",
        "1",
        "1",
    )
    assert float(edge["hit_rate"]) == 0.5


def test_conflicts_have_a_row_a_pair_of_places(made):
    with (made.folder / "conflicts.csv").open() as lines:
        table = list(csv.DictReader(lines))
    assert sum(int(row["attacks"]) for row in table) == 3
    assert table[0]["hits"] == "1"
    assert list(table[0])[:2] == ["place", "against"]


def test_edge_data_are_meandata(made):
    root = ET.parse(made.folder / "edges.xml").getroot()
    assert root.tag == "meandata"
    by_edge = {edge.get("id"): edge for edge in root.iter("edge")}
    assert by_edge["w_in"].get("attacks") == "2"
    assert by_edge["w_in"].find("lane").get("id") == "w_in_1"
    inner = [edge for name, edge in by_edge.items() if name.startswith(":centre")]
    assert {edge.get("hits") for edge in inner if edge.get("attacks")} == {"1"}
    numbers = [value for name, value in by_edge["w_in"].items() if name != "id"]
    assert [float(value) for value in numbers]


def test_movements_are_edge_relations(made):
    root = ET.parse(made.folder / "movements.xml").getroot()
    found = {(one.get("from"), one.get("to")): one for one in root.iter("edgeRelation")}
    one = found[LEFT_IN]
    assert (one.get("junction"), one.get("turn")) == ("centre", "left")
    assert one.get("began_hits") == one.get("hits") == "1"


def test_sumo_reads_network_and_polygons_without_a_word(made):
    """Ids with blanks, for instance, it drops with a warning."""
    done = subprocess.run(
        [programs.program("sumo"), "-c", made.folder / "risk.sumocfg", "--no-step-log"],
        env=programs.environment(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "Warning" not in done.stderr
    shapes = [one.get("id") for one in ET.parse(made.folder / "polygons.add.xml").iter("poly")]
    assert "risk.edge.w_in.0" in shapes
    assert "risk.junction.centre.0" in shapes
    assert len(set(shapes)) == len(shapes)


def test_colours_go_from_yellow_to_red():
    assert [colour(share) for share in (0.0, 0.5, 1.0)] == [
        "255,243,176",
        "244,163,43",
        "193,18,31",
    ]


def test_the_page_needs_nothing_else(made):
    page = (made.folder / "risk.html").read_text("utf-8")
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="(?!#)', page)
    assert page.count("</script>") == 2
    content = json.loads(page.split('id="content">')[1].split("</script>")[0])
    assert content["title"] == "my <map>"
    assert len(content["rows"]) == len(content["shapes"]) == len(made.rows)
    assert [attack[2] for attack in content["attacks"]] == [1, 0, 1]


def test_a_browser_lists_the_worst_place_first(made):
    if BROWSER is None:
        pytest.skip("no browser")
    shown = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
         (made.folder / "risk.html").as_uri()],
        capture_output=True, text=True, check=True, timeout=120,
    ).stdout  # fmt: skip
    cells = re.findall(r'<td class="name"><button type="button">([^<]*)<', shown)
    assert cells == [row.title for row in risk.worst(made.rows)]
    assert shown.count('class="attack hit"') == 2


def test_a_folder_with_other_files_is_left_alone(made, tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        files.write(tmp_path, [made.network])
    again = files.write(made.folder, [made.network], "my <map>")
    assert again[0].rows == made.rows
