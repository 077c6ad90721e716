"""What pages, tables and exports say of people who are not in the demand."""

import base64
import json
import re
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import pytest
import yaml

from deepmf_sumo.cli import main
from deepmf_sumo.report import table
from deepmf_sumo.results import exports, risk

from tests.support import tiny_network

GIVEN = {"who": "made", "given": [{"position_m": [140.0, -7.5], "heading_rad": 1.57}]}


@pytest.fixture(scope="module")
def out(tmp_path_factory, starts_sumo):
    """One run in which somebody given walks onto the road, along poses of the spec."""
    folder = tmp_path_factory.mktemp("made")
    config = tiny_network.build(folder)
    walk = [[140.0, round(-7.5 + 0.05 * step, 3), 1.57] for step in range(1, 61)]
    spec = {
        "version": 3,
        "name": "walks out",
        "source": {
            "network": str(config), "start_s": 3.0, "av": {"vehicle": "av"}, "people": GIVEN,
        },
        "adversary": {"name": "trajectory", "agent": "made_pedestrian_1", "poses": walk},
    }  # fmt: skip
    (folder / "walks.yaml").write_text(yaml.safe_dump(spec))
    out = folder / "out"
    code = main.run(["run", str(folder / "walks.yaml"), "--out", str(out), "--report", "-j", "1"])
    assert code == 0
    return out


def result_of(out):
    (file,) = out.glob("runs/*/result.json")
    return json.loads(file.read_text())


def test_the_result_names_them_and_their_place(out):
    (made,) = result_of(out)["made"]
    assert made["id"] == "made_pedestrian_1"
    assert made["place"] == "given"
    assert made["position_m"] == [140.0, -7.5]
    assert result_of(out)["opponent"] == "made_pedestrian_1"


def test_tables_show_and_page_say_so(out, capsys):
    assert main.run(["show", str(out)]) == 0
    told = "put where people could be: 1 in 1 run; 1 attack by them"
    assert told in capsys.readouterr().out
    assert "made_pedestrian_1, made" in table.rows([result_of(out)])[0][4]
    page = (out / "report.html").read_text("utf-8")
    assert "the opponent was made: it is not in the demand" in page
    packed = re.search(r'id="run-0"[^>]*>\s*([A-Za-z0-9+/=]+)', page).group(1)
    details = json.loads(zlib.decompress(base64.b64decode(packed)))
    assert details["made"] == ["made_pedestrian_1 (given)"]


def test_sumo_files_and_openscenario_say_so(out, tmp_path):
    (folder,) = out.glob("runs/*")
    types = (folder / "sumo" / "types.add.xml").read_text()
    assert "people who are not in the demand" in types
    fcd = ET.parse(folder / "sumo" / "fcd.xml")
    of = {one.get("id"): one.get("type") for one in fcd.iter("vehicle")}
    assert of["made_pedestrian_1"].endswith("_made")
    assert not of["av"].endswith("_made")
    form = exports.Format.named("openscenario")
    written = exports.written(exports.run_in(folder), tmp_path / "osc", form)
    assert written.outcome == "written", written.reason
    (scenario,) = Path(tmp_path / "osc").glob("*.xosc")
    things = ET.parse(scenario).iter("ScenarioObject")
    marked = [
        one.get("name") for one in things if one.find(".//Property[@name='made']") is not None
    ]
    assert marked == ["made_pedestrian_1"]


def test_evidence_counts_attacks_by_them_apart(out):
    ((network),) = risk.read([out])
    cells = {(one.subject, one.name): one for one in risk.coverage(network)}
    assert cells["made attacker", "made pedestrian"].attacks == 1
