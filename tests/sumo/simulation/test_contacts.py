"""Contacts: who, when, where on the box, how hard."""

import numpy as np
import pytest

from deepmf_sumo.scene import Driver
from deepmf_sumo.sumo.simulation.contacts import ContactFinder
from deepmf_sumo.sumo.simulation.frame import Frame, Pose

CAR = np.array([4.0, 2.0])


def frame(**poses):
    """Agents as (x, y, heading, speed)."""
    return Frame.of_poses(
        {
            name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed), Driver.LOG)
            for name, (x, y, heading, speed) in poses.items()
        }
    )


def judged(*frames, opponent="ov", sizes=None):
    judge = ContactFinder("av", () if opponent is None else (opponent,))
    for step, one in enumerate(frames):
        size = np.array([(sizes or {}).get(name, CAR) for name in one.ids])
        judge.look(step, one, size)
    return judge


def test_rear_end_collision():
    before = frame(av=(0, 0, 0, 10), ov=(4.5, 0, 0, 4))
    after = frame(av=(1, 0, 0, 10), ov=(4.9, 0, 0, 4))
    (contact,) = judged(before, after).contacts
    assert (contact.kind, contact.step, contact.sector, contact.striker_id) == (
        "av_opponent",
        1,
        0,
        "av",
    )
    assert contact.relative_mps == pytest.approx(6.0)
    assert contact.closing_mps == pytest.approx(6.0)
    assert contact.delta_v_mps == pytest.approx(3.0)  # equal boxes share the difference


def test_broadside_collision_is_the_strikers():
    before = frame(av=(0, 0, 0, 10), ov=(1.0, -3.3, np.pi / 2, 8))
    after = frame(av=(1, 0, 0, 10), ov=(1.0, -2.5, np.pi / 2, 8))
    (contact,) = judged(before, after).contacts
    assert contact.striker_id == "ov"
    assert contact.sector == 6
    assert contact.relative_mps == pytest.approx(np.hypot(10, 8))


def test_a_vehicle_of_several_boxes_is_met_once_with_its_whole_mass():
    def boxes(x):
        parts = {"tram": (20, 3, 0, 0), "tram part 2": (16, 3, 0, 0), "tram part 3": (12, 3, 0, 0)}
        return frame(av=(x, 1.5 if x > 9 else 0, 0, 10), **parts)

    judge = judged(boxes(8), boxes(11), boxes(15), boxes(19), opponent=None)
    (contact,) = judge.contacts
    assert (contact.kind, contact.second_id) == ("av_other", "tram part 3")
    assert contact.delta_v_mps == pytest.approx(10 * 3 / 4)


def test_heavier_box_is_slowed_less():
    before = frame(av=(0, 0, 0, 10), ov=(6.6, 0, 0, 0))
    after = frame(av=(1, 0, 0, 10), ov=(6.6, 0, 0, 0))
    (contact,) = judged(before, after, sizes={"ov": np.array([8.0, 2.0])}).contacts
    assert contact.delta_v_mps == pytest.approx(10 * 2 / 3)


def test_a_pair_counts_once_and_third_parties_are_kept_apart():
    frames = [
        frame(av=(0, 0, 0, 0), ov=(20, 0, 0, 0), x=(0, 5, 0, 9), y=(20, 5, 0, 9)),
        frame(av=(0, 0, 0, 0), ov=(20, 0, 0, 0), x=(0, 1, 0, 9), y=(20, 1, 0, 9)),
        frame(av=(0, 0, 0, 0), ov=(20, 0, 0, 0), x=(0, 5, 0, 9), y=(20, 5, 0, 9)),
        frame(av=(0, 0, 0, 0), ov=(20, 0, 0, 0), x=(0, 1, 0, 9), y=(20, 1, 0, 9)),
    ]
    found = [(one.kind, one.first_id, one.second_id, one.step) for one in judged(*frames).contacts]
    assert found == [("av_other", "av", "x", 1), ("opponent_other", "ov", "y", 1)]


def test_av_and_opponent_are_one_contact_not_two():
    frames = [frame(av=(0, 0, 0, 5), ov=(9, 0, 0, 0)), frame(av=(6, 0, 0, 5), ov=(9, 0, 0, 0))]
    assert [one.kind for one in judged(*frames).contacts] == ["av_opponent"]


def test_overlap_from_the_beginning_or_out_of_nowhere_is_no_contact():
    frames = [
        frame(av=(0, 0, 0, 0), ov=(1, 0, 0, 0)),
        frame(av=(0, 0, 0, 0), ov=(1, 0, 0, 0), ghost=(-3, 1, 0, 0)),
    ]
    judge = judged(*frames)
    assert judge.contacts == []
    assert [event.kind for event in judge.events] == ["overlap_at_start", "appeared_in_overlap"]
