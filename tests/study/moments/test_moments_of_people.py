"""Moments of attacks by people: the AV drives on, and somebody gets onto its way in time."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.study.moments.choice import choose
from deepmf_sumo.study.moments.moment import WantedMoments, drives, reached
from deepmf_sumo.sumo.simulation.traffic_survey import DemandVehicle, Sightings

SECONDS = 30


def traffic(speeds, kinds=None, y=None, **more):
    """Vehicles along x, each on its own y, with a speed (SECONDS) or one for all seconds."""
    kinds = kinds or ["passenger"] * len(speeds)
    y = y or [100.0 * number for number in range(len(speeds))]
    speed = np.array([np.broadcast_to(one, SECONDS) for one in speeds], float)
    x = np.cumsum(speed, axis=1)
    time = np.tile(np.arange(1.0, SECONDS + 1)[:, None], (1, len(speeds)))
    vehicle = np.tile(np.arange(len(speeds)), (SECONDS, 1))
    return Sightings(
        begin_s=0.0, until_s=float(SECONDS), complete=True, persons=True, waiting=0,
        bodies=tuple(
            DemandVehicle(id=f"v{n}", type="t", permission=kind, departed_s=0.0)
            for n, kind in enumerate(kinds)
        ),
        edges=("in", "out"),
        time_s=time.ravel(), vehicle=vehicle.ravel(),
        edge=vehicle.ravel() % 2, following=np.full(time.size, -1),
        position_m=np.stack([x.T, np.broadcast_to(y, x.T.shape)], -1).reshape(-1, 2),
        to_end_m=np.full(time.size, 500.0), speed_mps=speed.T.ravel(),
        parked=np.zeros(time.size, bool), z_m=np.zeros(time.size), **more,
    )  # fmt: skip


def at(sightings, vehicle, mask):
    """The seconds at which a vehicle's sightings are in the mask."""
    return sightings.time_s[mask & (sightings.vehicle == vehicle)].astype(int).tolist()


def test_an_av_drives_if_it_does_so_for_six_of_the_next_eight_seconds():
    """It stands from second 11 on: at 8 it has two seconds left, at 4 six."""
    stops = np.where(np.arange(1, SECONDS + 1) > 10, 0.0, 10.0)
    queue = traffic([stops, 2.0])
    assert at(queue, 0, drives(queue, 8.0)) == [1, 2, 3, 4]
    assert at(queue, 1, drives(queue, 8.0)) == []


def test_who_has_left_the_traffic_does_not_drive():
    road = traffic([10.0])
    assert at(road, 0, drives(road, 8.0)) == [*range(1, SECONDS - 5)]


@pytest.mark.parametrize(("aside_m", "gets_there"), [(2.0, True), (12.0, True), (12.3, False)])
def test_a_person_gets_as_far_as_it_can_hurry_until_the_av_comes(aside_m, gets_there):
    """At 10 m/s the AV of second 1 is beside the person 6 s later.

    After 1 s to set off, it hurries 5 s at 8 km/h, 11.1 m, and half the AV and itself take 1 m.
    """
    road = traffic([10.0], walker_s=np.array([1.0]), walker_m=np.array([[70.0, aside_m]]))
    assert at(road, 0, reached(road, 8.0)) == ([1] if gets_there else [])


def test_cyclists_of_the_traffic_count_too_and_parked_bicycles_do_not():
    both = traffic([4.0, 10.0], ["passenger", "bicycle"], [0.0, 6.0])
    assert 1 in at(both, 0, reached(both, 8.0))
    parked = replace(both, parked=both.vehicle == 1)
    assert not at(parked, 0, reached(parked, 8.0))


def wish(people, **more):
    return WantedMoments(count=3, seed=1, people=people, **more)


def test_moments_of_people_are_those_of_avs_that_drive_with_or_without_vehicles_near():
    stands = traffic([10.0, 0.5])
    found = choose(stands, {}, wish("made"))
    assert {one.av for one in found.moments} == {"v0"}
    assert all(one.start_s <= SECONDS - 5 for one in found.moments)
    assert not choose(stands, {}, WantedMoments(count=3, seed=1)).moments  # nobody near


def test_people_of_the_demand_must_be_there_and_made_ones_need_not():
    empty = traffic([10.0])
    found = choose(empty, {}, wish("existing"))
    assert not found.moments
    assert "no pedestrian and no cyclist could get onto the way" in found.reason
    assert choose(empty, {}, wish("both")).moments


def test_a_time_that_is_named_is_attacked_although_the_av_stands():
    stands = traffic([0.6])
    assert not choose(stands, {}, wish("made")).moments
    found = choose(stands, {}, replace(wish("made", at_s=(10.0,)), count=1))
    assert [one.start_s for one in found.moments] == [10.0]
