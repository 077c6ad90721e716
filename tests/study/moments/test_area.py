"""Attacks in a part of a network alone."""

import json
import re

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.spec import Moments
from deepmf_sumo.study.moments import search
from deepmf_sumo.study.moments.area import AttackArea, area_of, inside, read_polygon
from deepmf_sumo.sumo.network.sumo_net import read_net

from tests.study.moments.test_moments_encounters import OVER, UP, drive
from tests.support.crossing_network import build

SQUARE = [[100.0, -20.0], [160.0, -20.0], [160.0, 20.0], [100.0, 20.0], [100.0, -20.0]]
POLY = '<additional><poly id="a" shape="100,-20 160,-20 160,20 100,20"{}/>{}</additional>'


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return build(tmp_path_factory.mktemp("crossing"))


def found(config, **wanted):
    [document] = search.documents([config], {}, count=4, from_s=0.0, **wanted)
    request = search.request(search.spec_of(document), by_option=True)
    return search.find(request.survey, request.wish, area=request.area)


def test_which_vehicles_are_in_an_area(config):
    seen, net = drive([(OVER, 18.3), (UP, 20.3)]), read_net(config.parent / "crossing.net.xml")
    on_east = inside(AttackArea(edges=("east",)), seen, net, 8.0)
    assert {seen.edges[edge] for edge in seen.edge[on_east]} == {"east"}
    assert (seen.to_end_m[on_east] > 0).all()
    middle = inside(AttackArea(junctions=("mid",)), seen, net, 8.0)
    assert {seen.edges[edge] for edge in seen.edge[middle]} == {"west", "south"}
    assert seen.to_end_m[middle].max() == pytest.approx(80.0, abs=10.0)  # 8 s at 10 m/s
    assert (seen.to_end_m[middle] == 0).any(), "those inside the junction as well"


def test_files_of_polygons_are_geojson_or_of_sumo(tmp_path):
    file = tmp_path / "area"
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon"}}
    feature["geometry"]["coordinates"] = [SQUARE]
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point"}}
    point["geometry"]["coordinates"] = [0, 0]
    geojson = {"type": "FeatureCollection", "features": [feature, point]}
    for text, geographic in (
        (json.dumps(geojson), True),
        (json.dumps(feature), True),
        (POLY.format("", ""), False),
        (POLY.format(' geo="true"', "<poi/>"), True),
    ):
        file.write_text(text)
        polygon, of_globe = read_polygon(file, "--polygon")
        assert (polygon.area, of_globe) == (pytest.approx(2400.0), geographic)
    for text, message in (
        ("", "neither GeoJSON nor a file of SUMO polygons"),
        ('{"type": "Feature"', "neither GeoJSON"),
        ("<additional><poly", "neither GeoJSON"),
        (json.dumps(point), "it has no polygon"),
        ("<additional/>", "it has no polygon"),
        (POLY.format("", '<poly id="b" geo="1" shape="0,0 1,0 1,1"/>'), "partly geographic"),
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=message) as error:
            read_polygon(file, "--polygon")
        assert str(file) in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.sumo
def test_attacks_are_in_the_area_alone(config, tmp_path):
    assert {one.edge for one in found(config, edges=("south",)).moments} == {"south"}
    assert {one.edge for one in found(config, junctions=("e",)).moments} == {"east"}
    area = tmp_path / "area.poly.xml"
    area.write_text('<additional><poly id="a" shape="0,145 90,145 90,155 0,155"/></additional>')
    assert {one.edge for one in found(config, polygon=str(area)).moments} == {"west"}
    nothing = found(config, edges=("north",), av="over2")
    assert nothing.reason == "vehicle 'over2' never comes to edge north"
    area.write_text('<additional><poly id="a" shape="900,0 990,0 990,9"/></additional>')
    away = found(config, polygon=str(area))
    assert away.reason == "no vehicle comes to the polygon"


def test_the_name_of_a_street_means_its_edges(config, tmp_path):
    text = (config.parent / "crossing.net.xml").read_text()
    net = tmp_path / "named.net.xml"
    for edge in ("west", "east"):
        text = text.replace(f'<edge id="{edge}"', f'<edge id="{edge}" name="Mill Lane"')
    net.write_text(text)
    area = area_of(Moments(count=1, edges=("Mill Lane", "south")), net, str)
    assert set(area.edges) == {"west", "east", "south"}
    assert str(area) == "edge south, Mill Lane"


@pytest.mark.sumo
def test_geographic_polygons_are_projected_by_sumo(tmp_path):
    """A square around the end of the western arm, 100 m west of the zone's meridian."""
    config = build(tmp_path)
    net_file = tmp_path / "crossing.net.xml"
    location = '<location netOffset="-499850.00,150.00" projParameter="+proj=utm +zone=31 '
    location += '+ellps=WGS84 +datum=WGS84 +units=m +no_defs"'
    text = re.sub(r'<location netOffset="[^"]*"', location, net_file.read_text())
    net_file.write_text(text.replace(' projParameter="!"', ""))
    middle = np.array([3.0 - 100.0 / 111_320, 0.0])
    ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * 60.0 / 111_320
    feature = {"type": "Polygon", "coordinates": [(ring + middle).tolist()]}
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps(feature))
    assert {one.edge for one in found(config, polygon=str(area)).moments} == {"west"}


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"junctions": ("mids",)}, "--junction mids: no such junction is in the network; there"),
        ({"edges": ("wst",)}, "--edge wst: no such edge is in the network; there are west"),
        ({"edges": (":mid_0",)}, "--edge :mid_0: no such edge"),
    ],
)
def test_unknown_ids_are_refused_with_near_ones(config, wanted, message, monkeypatch):
    monkeypatch.setattr(search.workers, "run", None)
    with pytest.raises(UsageError, match=message):
        found(config, **wanted)


def test_a_network_without_a_projection_takes_no_geojson(config, tmp_path, monkeypatch):
    monkeypatch.setattr(search.workers, "run", None)
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [SQUARE]}))
    with pytest.raises(UsageError, match=r"crossing.net.xml has no projection; give polygons of"):
        found(config, polygon=str(area))
