import base64
import csv
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zlib

import pytest

from deepmf_sumo import tables
from deepmf_sumo.errors import OutputError
from deepmf_sumo.judge.conflict_types import TYPES
from deepmf_sumo.report import page as report_page
from deepmf_sumo.report import risk as files
from deepmf_sumo.report.palette import RISK_CLASSES, risk_colour
from deepmf_sumo.results import risk as risk_module
from deepmf_sumo.results import stored
from deepmf_sumo.sumo.network import sumo_tools

from tests.support.risk_doubles import LEFT_IN, Attacks, eastward, straight

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
    [written] = files.write(root / "map", risk_module.read([root / "out"]), "my <map>")
    return written


@pytest.fixture(scope="module")
def nothing(tmp_path_factory):
    """A map of an attack that did not hit."""
    root = tmp_path_factory.mktemp("nothing")
    out = Attacks(root / "out")
    out.add("a", av=eastward(x=-130.0), opponent=straight((-60.0, -12.0), 0.0, 0.0))
    [written] = files.write(root / "map", risk_module.read([root / "out"]))
    return written


def test_the_table_has_a_row_a_place(made):
    with (made.folder / "risk.csv").open() as lines:
        table = list(csv.DictReader(lines))
    assert len(table) == len(made.rows)
    [edge] = [row for row in table if row["place"] == "w_in" and row["counted"] == "decided"]
    assert (edge["attacks"], edge["hits"], edge["findings"], edge["judged"]) == (
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


@pytest.mark.sumo
def test_sumo_reads_network_and_polygons_without_a_word(made):
    """Ids with blanks, for instance, it drops with a warning."""
    done = subprocess.run(
        [sumo_tools.program("sumo"), "-c", made.folder / "risk.sumocfg", "--no-step-log"],
        env=sumo_tools.environment(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "Warning" not in done.stderr
    shapes = [one.get("id") for one in ET.parse(made.folder / "polygons.add.xml").iter("poly")]
    assert "risk.edge.w_in.0" in shapes
    assert "risk.junction.centre.0" in shapes
    assert len(set(shapes)) == len(shapes)


def test_a_risk_has_one_colour_in_every_map():
    """Also in one whose worst place is at 4 %."""
    risks = (0.0, 0.04, 0.05, 0.24, 0.25, 0.6, 0.75, 1.0)
    numbers = [[bound for bound, one in RISK_CLASSES if one == risk_colour(risk)] for risk in risks]
    assert numbers == [[0.0], [0.0], [0.05], [0.1], [0.25], [0.5], [0.75], [0.75]]


@pytest.mark.sumo
def test_places_without_a_hit_have_no_colour(nothing, made):
    shapes = list(ET.parse(nothing.folder / "polygons.add.xml").iter("poly"))
    assert shapes
    assert {one.get("fill") for one in shapes} == {"0"}
    hit = ET.parse(made.folder / "polygons.add.xml").find("poly[@id='risk.edge.w_in.0']")
    assert (hit.get("fill"), hit.get("color")) == ("1", "227,26,28")
    page = browsed(nothing)
    assert 'class="place nothing"' in page
    assert not re.search(r'class="(place|dot|area)"', page)
    assert 'class="place"' in browsed(made)


@pytest.mark.sumo
def test_small_places_keep_their_size_and_a_pick_zooms_there(made):
    seen = """
      const on = (name, what) =>
        Number(document.querySelector(`#map .${name}`).getAttribute(what)) * mapCamera.scale;
      const said = [];
      fitMap([-20000, -20000, 20000, 20000]);
      said.push(on("dot", "r"));
      mapCamera.zoom(1 / 4);
      said.push(on("dot", "r"), on("place", "stroke-width"));
      document.querySelector("td.name button").click();
      said.push(document.getElementById("map").viewBox.baseVal.width);
    """
    far, farther, line, width = map(float, told(made, seen))
    assert far == pytest.approx(6.0)
    assert farther == pytest.approx(6.0)
    assert line == pytest.approx(4.0)
    assert width < 1000.0


@pytest.mark.sumo
def test_attacks_at_no_place_are_counted_in_words(tmp_path):
    for number, sentence in (
        (1, "1 attack is counted at no place: when it was decided, the centre of the AV was"),
        (2, "2 attacks are counted at no place: when they were decided, the centre of the AV was"),
    ):
        out = Attacks(tmp_path / f"out{number}")
        for name in "ab"[:number]:
            beside = straight((100.0, 100.0), 5.0, 0.0)
            out.add(name, av=beside, opponent=straight((100.0, 120.0), 5.0, 0.0))
        [written] = files.write(tmp_path / f"map{number}", risk_module.read([out.out]))
        assert sentence in browsed(written)


def test_the_page_needs_nothing_else(made):
    page = (made.folder / "risk.html").read_text("utf-8")
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="(?!#)', page)
    assert page.count("</script>") == 3
    content = json.loads(_text(page, "content"))
    assert content["title"] == "my <map>"
    content = json.loads(zlib.decompress(base64.b64decode(_text(page, "map-0"))))
    assert len(content["rows"]) == len(content["shapes"]) == len(made.rows)
    assert [attack[3] for attack in content["attacks"]] == [1, 0, 1]


@pytest.mark.sumo
def test_a_browser_lists_the_worst_place_first(made):
    shown = browsed(made)
    cells = re.findall(r'<td class="name"[^>]*><button type="button">([^<]*)<', shown)
    assert cells == [row.title for row in risk_module.worst(made.rows)]
    assert shown.count('class="attack hit"') == 2


def _text(page, name):
    """What the page keeps under an id."""
    return page.split(f'id="{name}">')[1].split("</script>")[0]


def browsed(written, script=""):
    """The page's elements once a browser has shown it, and then run a script."""
    if BROWSER is None:
        pytest.skip("no browser")
    page = (written.folder / "risk.html").read_text("utf-8")
    file = written.folder.parent / "browsed.html"
    script = f"<script>started.then(() => {{{script}}})</script></body>"
    file.write_text(page.replace("</body>", script), "utf-8")
    return subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000",
         "--dump-dom", file.as_uri()],
        capture_output=True, text=True, check=True, timeout=120,
    ).stdout  # fmt: skip


def told(written, script):
    """What a script at the page's end has put into the list ``said``."""
    ended = browsed(written, f"{script}; document.body.dataset.said = said.join(' ');")
    return re.search(r'data-said="([^"]*)"', ended)[1].split()


def test_a_folder_with_other_files_is_left_alone(made, tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        files.write(tmp_path, [made.network])
    again = files.write(made.folder, [made.network], "my <map>")
    assert again[0].rows == made.rows


@pytest.fixture
def reported(tmp_path):
    """The folder of two attacks, one of them a hit, with its ``runs.csv``."""
    out = Attacks(tmp_path / "out")
    hit = out.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    miss = out.add("b", av=eastward(x=-130.0), opponent=straight((-60.0, -12.0), 0.0, 0.0))
    rows = []
    for run_id in (hit, miss):
        values = json.loads((out.out / "runs" / run_id / "result.json").read_text())
        rows.append({name: str(values.get(name) or "") for name in stored.NEEDED})
        rows[-1]["seed"] = "0"
    (out.out / "runs.csv").write_text(tables.to_csv(rows))
    return out.out, hit


@pytest.mark.sumo
def test_a_report_of_attacks_on_a_network_has_the_map_and_links_to_its_runs(reported):
    if BROWSER is None:
        pytest.skip("no browser")
    out, hit = reported
    written = report_page.write(out)
    shown = dumped(f"file://{written}#risk")
    assert '<a href="#risk" aria-current="page">Map</a>' in shown
    assert shown.count('class="attack hit"') == 1
    assert '<main id="overview" tabindex="-1" hidden="">' in shown
    pick = "<script>started.then(() => document.querySelector('td.name button').click())</script>"
    written.write_text(written.read_text("utf-8").replace("</body>", f"{pick}</body>"), "utf-8")
    assert f'<a href="#run={hit}">{hit}</a>: hit' in dumped(f"file://{written}#risk")
    assert '<a href="#" aria-current="page">Runs</a>' in dumped(f"file://{written}")


def test_a_report_without_attacks_on_a_network_has_no_map(reported):
    out, _ = reported
    for file in (out / "runs").glob("*/result.json"):
        file.write_text(json.dumps({**json.loads(file.read_text()), "network": None}))
    content = json.loads(_text(report_page.write(out).read_text("utf-8"), "content"))
    assert (content["maps"], content["withoutMap"]) == ([], "")


def test_a_report_says_why_there_is_no_map(reported):
    out, _ = reported
    for net in (out / "runs").glob("*/sumo/net.net.xml"):
        net.unlink()
    content = json.loads(_text(report_page.write(out).read_text("utf-8"), "content"))
    assert content["maps"] == []
    assert "no net.net.xml" in content["withoutMap"]
    assert len(content["rows"]) == 2


def dumped(address):
    """The page's elements once its scripts have run."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000"]
    done = subprocess.run(
        [BROWSER, *options, "--dump-dom", address],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return re.sub(r"<script.*?</script>", "", done.stdout, flags=re.DOTALL)


def test_kinds_and_coverage_have_tables(made):
    for name, first in (("types.csv", "kind"), ("coverage.csv", "table")):
        with (made.folder / name).open() as lines:
            table = list(csv.DictReader(lines))
        assert next(iter(table[0])) == first
    page = (made.folder / "risk.html").read_text("utf-8")
    content = json.loads(zlib.decompress(base64.b64decode(_text(page, "map-0"))))
    assert sum(row[2] for row in content["types"]) == 3
    assert [of for of, *_ in content["covered"]] == ["movement", "edge"]
    titles, tables = zip(*content["evidence"], strict=True)
    assert len(titles) == 4
    assert [row[0] for row in tables[2]] == list(TYPES)
    assert all(len(row) == len(content["evidenceHeadings"]) for rows in tables for row in rows)


@pytest.mark.sumo
def test_a_browser_shows_kinds_and_what_was_never_attacked(made):
    shown = browsed(made)
    assert re.search(r"rear-end</span></td><td [^>]*>[12]</td>", shown)
    assert re.search(r"\d+ of \d+ edges attacked", shown)
    assert "no such place in the network" in shown


@pytest.mark.sumo
def test_a_pick_lists_the_attacks_there_with_their_kind(made):
    """A page without runs says where their replays are."""
    shown = browsed(made, "document.querySelector('td.name button').click();")
    assert re.search(r"<li>[^<]*: hit, [a-z -]+; opponent at ", shown)
    assert "Replays are in report.html" in shown.split('id="place"')[1]
