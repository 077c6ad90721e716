import numpy as np
import pytest
import shapely

from deepmf_sumo.scene.geometry import boxes, impact


@pytest.mark.parametrize(
    ("bearing", "sector"),
    [(0, 0), (45, 1), (90, 2), (135, 3), (180, 4), (225, 5), (270, 6), (315, 7)],
)
def test_sectors_count_counterclockwise_from_the_front(bearing, sector):
    angle = np.radians(bearing)
    square = np.array([2.0, 2.0])
    heading = 0.7
    where = 1.8 * np.array([np.cos(angle + heading), np.sin(angle + heading)])
    assert impact.sectors(np.zeros(2), heading, square, where, heading, square) == sector
    assert len(impact.SECTORS) == 8


def test_names_stand_in_the_order_of_the_sectors():
    car = np.array([4.8, 2.0])
    where = np.array([[4.5, 0.0], [4.5, 1.9], [0.0, 1.9], [-4.5, 1.9], [-4.5, 0], [-4.5, -1.9]])
    found = impact.sectors(np.zeros(2), 0.0, car, where, 0.0, car)
    names = [impact.SECTORS[sector] for sector in found]
    assert names == ["front", "front_left", "left", "rear_left", "rear", "rear_right"]


def test_against_polygons():
    rng = np.random.default_rng(3)
    count = 400
    centre_a, centre_b = rng.uniform(-2, 2, (2, count, 2))
    heading_a, heading_b = rng.uniform(-4, 4, (2, count))
    heading_b[:40] = heading_a[:40]  # parallel edges cross nowhere
    size_a, size_b = np.array([4.8, 2.0]), np.array([9.0, 2.5])
    found = impact.sectors(centre_a, heading_a, size_a, centre_b, heading_b, size_b)
    checked = 0
    for row in range(count):
        first = shapely.Polygon(boxes.corners(centre_a[row], heading_a[row], size_a))
        second = shapely.Polygon(boxes.corners(centre_b[row], heading_b[row], size_b))
        middle = first.intersection(second).centroid
        if middle.is_empty:
            continue
        offset = np.array([middle.x, middle.y]) - centre_a[row]
        bearing = (np.arctan2(offset[1], offset[0]) - heading_a[row]) / (np.pi / 4)
        # On a border, or at the very centre, rounding decides.
        if abs(bearing % 1 - 0.5) > 1e-6 and np.hypot(*offset) > 1e-6:
            checked += 1
            assert found[row] == np.round(bearing) % 8, row
    assert checked > 300


def test_apart_it_is_the_bearing_of_the_other_centre():
    size = np.array([4.0, 2.0])
    assert impact.sectors(np.zeros(2), 0.0, size, np.array([0.0, 30.0]), 0.0, size) == 2


def test_everything_broadcasts():
    size = np.array([4.0, 2.0])
    found = impact.sectors(
        np.zeros((3, 1, 2)), np.zeros((3, 1)), size, np.ones((3, 5, 2)), np.zeros(5), size
    )
    assert found.shape == (3, 5)
