import numpy as np
import shapely
import shapely.affinity

from deepmf_sumo.deepmf.candidates import collisions
from deepmf_sumo.scene import Forecast, Futures


def box(position, heading, size):
    shape = shapely.box(-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2)
    turned = shapely.affinity.rotate(shape, heading, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, *position)


def wander(rng, modes, steps, spread):
    course = rng.uniform(-3, 3, (modes, 1)) + rng.normal(scale=0.05, size=(modes, steps)).cumsum(1)
    move = rng.uniform(0, 1.2, (modes, 1, 1)) * np.stack([np.cos(course), np.sin(course)], -1)
    position = rng.uniform(-spread, spread, (modes, 1, 2)) + move.cumsum(1)
    return Futures(agent_id="b", position_m=position, heading_rad=course)


def test_against_polygons():
    rng = np.random.default_rng(1)
    own, size, av_size = wander(rng, 6, 30, 7), np.array([4.8, 2.0]), np.array([9.0, 2.5])
    reactions = [
        Forecast(futures=wander(rng, 4, 30, 7), probability=np.full(4, 0.25)) for _ in range(6)
    ]
    horizon = 25
    collides, first = collisions(own, reactions, size, av_size, horizon)
    expected = np.full((6, 4), 30.0)
    for j in range(6):
        for k in range(4):
            other = reactions[j].futures
            for step in range(horizon):
                mine = box(own.position_m[j, step], own.heading_rad[j, step], size)
                theirs = box(other.position_m[k, step], other.heading_rad[k, step], av_size)
                if mine.intersection(theirs).area > 1e-9:
                    expected[j, k] = step
                    break
    np.testing.assert_array_equal(first, expected)
    np.testing.assert_array_equal(collides, expected < 30)
    assert 5 < collides.sum() < 24


def test_corners_reach_farther_than_bumpers():
    """Two cars, a diagonal of each on one line: 5.1 m apart, each reaches 2.6 m on it."""
    size = np.array([4.8, 2.0])
    along = -np.arctan2(2.0, 4.8)
    own, av = (
        Futures(
            agent_id="b",
            position_m=np.full((1, 5, 2), [x, 0.0]),
            heading_rad=np.full((1, 5), along),
        )
        for x in (0.0, 5.1)
    )
    collides, _ = collisions(own, [Forecast(futures=av, probability=np.ones(1))], size, size, 5)
    assert collides.all()


def test_one_reaction_to_all_candidates():
    rng = np.random.default_rng(2)
    own, size = wander(rng, 12, 30, 7), np.array([4.8, 2.0])
    alone = Forecast(futures=wander(rng, 5, 30, 7), probability=np.full(5, 0.2))
    copies = [
        Forecast(
            futures=Futures(
                agent_id="b",
                position_m=alone.futures.position_m.copy(),
                heading_rad=alone.futures.heading_rad.copy(),
            ),
            probability=alone.probability,
        )
        for _ in range(12)
    ]
    collides, first = collisions(own, [alone] * 12, size, size, 25)
    expected, when = collisions(own, copies, size, size, 25)
    np.testing.assert_array_equal(collides, expected)
    np.testing.assert_array_equal(first, when)
    assert 5 < collides.sum() < 55


def test_only_the_time_that_is_left_counts():
    along = np.arange(80.0)
    own = Futures(
        agent_id="b",
        position_m=np.stack([along, 0 * along], -1)[None],
        heading_rad=np.zeros((1, 80)),
    )
    there = Futures(
        agent_id="av", position_m=np.full((1, 80, 2), [60.0, 0.0]), heading_rad=np.zeros((1, 80))
    )
    reactions = [Forecast(futures=there, probability=np.ones(1))]
    size = np.array([4.0, 2.0])
    collides, first = collisions(own, reactions, size, size, 80)
    assert (bool(collides[0, 0]), first[0, 0]) == (True, 57.0)
    collides, first = collisions(own, reactions, size, size, 57)
    assert (bool(collides[0, 0]), first[0, 0]) == (False, 80.0)
    collides, _ = collisions(own, reactions, size, size, 0)
    assert not collides.any()
