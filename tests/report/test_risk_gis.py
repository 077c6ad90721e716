"""Places and attacks for geographic information systems, read back by others."""

import json
import re
import sqlite3
import struct
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import shapely

from deepmf_sumo.cli import main
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import risk as files
from deepmf_sumo.results import risk
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_net import read_net

from tests.support.risk_doubles import LEFT_IN, NET, Attacks, eastward, straight

UTM = "+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"
OFFSET = (-678_912.25, -5_403_210.5)
NEEDS_PYPROJ = "pyproj is not installed: pip install deepmf-sumo[gis]"


def attacks_on(folder, projection, offset=OFFSET):
    """Two attacks on the edge and one in the junction, of the four-way crossing placed there."""
    net = folder / "there.net.xml"
    where = f'netOffset="{offset[0]},{offset[1]}"'
    text = re.sub(r'netOffset="[^"]*"', where, NET.read_text(), count=1)
    text = re.sub(r'projParameter="[^"]*"', f'projParameter="{projection}"', text, count=1)
    net.write_text(text)
    out = Attacks(folder / "out", net=net)
    out.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    out.add("b, 'q'", av=eastward(x=-130.0), opponent=straight((-60.0, -12.0), 0.0, 0.0))
    left = straight((-60.0, -1.6), 10.0, 0.0, steps=51)
    out.add("c", av=left, opponent=eastward(), hit=50, moment=(*LEFT_IN, "left"))
    return folder / "out", net


def mapped(folder, projection, *forms, **where):
    out, net = attacks_on(folder, projection, **where)
    [written] = files.write(folder / "map", risk.read([out]), "", forms)
    return written, net


def geojson(written, name):
    return json.loads((written.folder / f"{name}.geojson").read_text())["features"]


def features(written, table):
    """(attributes, shape) of a table, by the GeoPackage standard's description of its blobs."""
    with sqlite3.connect(written.folder / "risk.gpkg") as database:
        database.row_factory = sqlite3.Row
        rows = [dict(row) for row in database.execute(f"SELECT * FROM {table} ORDER BY fid")]
    database.close()
    found = []
    for row in rows:
        blob = row.pop("geom")
        magic, version, flags, _ = struct.unpack_from("<2sBBi", blob)
        assert (magic, version, flags & 0b1) == (b"GP", 0, 1)
        envelope = (0, 32, 48, 48, 64)[flags >> 1 & 0b111]
        found.append((row, shapely.from_wkb(blob[8 + envelope :])))
    return found


@pytest.mark.sumo
def test_degrees_are_those_of_sumo(tmp_path):
    pytest.importorskip("pyproj", reason=NEEDS_PYPROJ)
    written, net = mapped(tmp_path, UTM, "geojson")
    routes = tmp_path / "one.rou.xml"
    routes.write_text(
        '<routes><vehicle id="a" depart="0" departPos="30"><route edges="w_in"/></vehicle></routes>'
    )
    shown = {}
    for geo in ("true", "false"):
        fcd = tmp_path / f"{geo}.xml"
        subprocess.run(
            [sumo_tools.program("sumo"), "-n", net, "-r", routes, "--end", "3", "--precision", "4",
             "--precision.geo", "9", "--fcd-output", fcd, "--fcd-output.geo", geo],
            check=True, capture_output=True,
        )  # fmt: skip
        shown[geo] = [(float(one.get("x")), float(one.get("y")))
                      for one in ET.parse(fcd).iter("vehicle")]  # fmt: skip
    from deepmf_sumo.report.risk.gis import _degrees

    ours = _degrees(written.network)(np.array(shown["false"]))
    assert len(ours) >= 3
    assert ours == pytest.approx(np.array(shown["true"]), abs=2e-8)  # 2 mm


def test_geojson_has_the_rows_of_the_tables_at_their_places(tmp_path):
    pyproj = pytest.importorskip("pyproj", reason=NEEDS_PYPROJ)
    written, _ = mapped(tmp_path, UTM, "geojson")
    places, attacks = geojson(written, "places"), geojson(written, "attacks")
    assert [one["properties"] for one in places] == [risk.columns(row) for row in written.rows]
    assert [one["properties"]["run_id"] for one in attacks] == [
        one.run_id for one in written.network.attacks
    ]
    back = pyproj.Proj(UTM)
    for feature, one in zip(attacks, written.network.attacks, strict=True):
        found = np.array(back(*feature["geometry"]["coordinates"])) + OFFSET
        assert found == pytest.approx(one.place_m, abs=0.005)
    [edge] = [one for one in places if one["properties"]["place"] == "w_in"
              and one["properties"]["counted"] == "decided"]  # fmt: skip
    area = shapely.geometry.shape(edge["geometry"])
    assert area.geom_type == "MultiPolygon"
    assert all(part.exterior.is_ccw for part in area.geoms)
    metres = shapely.transform(area, lambda at: np.column_stack(back(*at.T)) + OFFSET)
    lanes = read_net(tmp_path / "there.net.xml").edges["w_in"].lanes
    assert metres.area == pytest.approx(sum(
        shapely.LineString(lane.shape_m[:, :2]).length * lane.width_m for lane in lanes
    ), rel=0.001)  # fmt: skip
    assert metres.buffer(0.01).contains(shapely.LineString(lanes[0].shape_m[:, :2]))


def test_a_geopackage_of_a_network_without_projection_has_its_own_metres(tmp_path):
    written, _ = mapped(tmp_path, "!", "gpkg")
    places, attacks = features(written, "places"), features(written, "attacks")
    assert [(row["kind"], row["place"], row["counted"], row["attacks"]) for row, _ in places] == [
        (row.kind, row.place, row.counted, row.attacks) for row in written.rows
    ]
    assert [(shape.x, shape.y) for _, shape in attacks] == [
        one.place_m for one in written.network.attacks
    ]
    assert [row["scene"] for row, _ in attacks] == ["a", "b, 'q'", "c"]
    assert [row["contact"] for row, _ in attacks] == [1, 0, 1]
    with sqlite3.connect(written.folder / "risk.gpkg") as database:
        [check] = database.execute("PRAGMA integrity_check").fetchone()
        known = database.execute(
            "SELECT table_name, srs_id, geometry_type_name FROM gpkg_geometry_columns"
        ).fetchall()
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    database.close()
    assert check == "ok"
    assert known == [("places", -1, "MULTIPOLYGON"), ("attacks", -1, "POINT")]


@pytest.mark.parametrize("projection", [UTM, "!"])
def test_gdal_reads_the_geopackage(projection, tmp_path):
    pyogrio = pytest.importorskip("pyogrio", reason="pyogrio is not installed")
    if projection != "!":
        pytest.importorskip("pyproj", reason=NEEDS_PYPROJ)
    written, _ = mapped(tmp_path, projection, "gpkg")
    file = written.folder / "risk.gpkg"
    assert dict(pyogrio.list_layers(file)) == {"places": "MultiPolygon", "attacks": "Point"}
    meta, _, shapes, values = pyogrio.raw.read(file, layer="attacks")
    undefined = "Undefined Cartesian SRS" in str(meta["crs"]) or meta["crs"] is None
    assert meta["crs"] == "EPSG:32632" if projection != "!" else undefined
    shift = np.array(OFFSET) if projection != "!" else np.zeros(2)
    points = shapely.get_coordinates(shapely.from_wkb(shapes)) + shift
    expected = [one.place_m for one in written.network.attacks]
    assert points == pytest.approx(np.array(expected), abs=1e-6)
    columns = dict(zip(meta["fields"], values, strict=True))
    assert columns["contact"].tolist() == [True, False, True]
    assert columns["x_m"] == pytest.approx(np.array(expected)[:, 0], abs=1e-3)
    _, _, areas, _ = pyogrio.raw.read(file, layer="places")
    assert shapely.is_valid(shapely.from_wkb(areas)).all()
    assert len(areas) == len(written.rows)


def test_the_same_map_has_the_same_bytes_and_without_the_option_none_is_left(tmp_path):
    written, _ = mapped(tmp_path, "!", "gpkg")
    before = (written.folder / "risk.gpkg").read_bytes()
    again = risk.read([tmp_path / "out"])
    files.write(written.folder, again, "", ["gpkg"])
    assert (written.folder / "risk.gpkg").read_bytes() == before
    files.write(written.folder, again)
    assert not (written.folder / "risk.gpkg").exists()


@pytest.mark.parametrize(("to", "file"), [("geopackage", "risk.gpkg"), ("csv", "conflicts.csv")])
def test_export_writes_the_map_of_risk(to, file, tmp_path):
    out, _ = attacks_on(tmp_path, "!")
    assert main.run(["risk", str(out), "--gis", "gpkg", "--out", str(tmp_path / "risk")]) == 0
    assert main.run(["export", str(out), "--to", to, "--out", str(tmp_path / "exported")]) == 0
    assert (tmp_path / "exported" / file).read_bytes() == (tmp_path / "risk" / file).read_bytes()


@pytest.mark.parametrize("projection", ["!", "-", ".", "..", "..."])
def test_geojson_without_longitude_and_latitude_is_refused_before_anything_is_written(
    projection, tmp_path, capsys
):
    out, _ = attacks_on(tmp_path, projection)
    assert main.run(["risk", str(out), "--gis", "gpkg", "--gis", "geojson"]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert f"the network four_way has the projection '{projection}'" in line
    assert "ask for gpkg" in line
    assert not (out / "risk").exists()


@pytest.mark.parametrize(
    ("projection", "offset", "said"),
    [
        ("+proj=nonsense", OFFSET, "projParameter '+proj=nonsense', which PROJ does not know"),
        (UTM, (1e12, 0.0), "netOffset or projParameter of the network four_way are wrong"),
    ],
)
def test_a_location_that_is_wrong_is_refused_in_one_sentence(projection, offset, said, tmp_path):
    pytest.importorskip("pyproj", reason=NEEDS_PYPROJ)
    with pytest.raises(UsageError, match=re.escape(said)):
        mapped(tmp_path, projection, "geojson", offset=offset)


def test_without_pyproj_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(UsageError, match=r'pip install "deepmf-sumo\[gis\]"'):
        mapped(tmp_path, UTM, "gpkg")
    assert not (tmp_path / "map").exists()


def test_attacks_have_the_words_of_a_conflict_study(tmp_path):
    written, _ = mapped(tmp_path, "!")
    rows = risk.attack_rows(written.network)
    assert rows[0]["kind"] == "rear-end"
    assert [row["place"] for row in rows][:2] == ["w_in", "w_in"]
    third = rows[2]
    assert (third["folder"], third["av"], third["opponent"]) == ("out", "ego", "foe")
    assert third["contact"]
    assert third["title"] == "centre: from west to north (left, permissive)"
    text = (written.folder / "attacks.csv").read_text().splitlines()
    assert text[0] == ",".join(risk.ATTACKED)
    assert len(text) == 1 + 3


def test_a_permissive_left_turn_gives_way_to_oncoming_traffic(tmp_path):
    out = Attacks(tmp_path / "out")
    turning = np.column_stack([np.linspace(-10, 0, 51), np.linspace(-1.6, 4, 51), np.full(51, 0.5)])
    oncoming = straight((45.0, 4.8), 10.0, np.pi, steps=51)
    out.add("a", av=turning, opponent=oncoming, hit=45, moment=(*LEFT_IN, "left"))
    out.add("b", av=oncoming, opponent=turning, hit=45)
    [network] = risk.read([tmp_path / "out"])
    rows = risk.attack_rows(network)
    assert [row["gives_way"] for row in rows] == ["av", "opponent"]
