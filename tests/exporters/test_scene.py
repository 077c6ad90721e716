"""A rollout as a recording: the pair is labelled, and nothing is known of the AV after the end."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import Plan

from tests.support.rollout_doubles import case_of, rollout_of, straight


def test_the_av_ends_with_the_episode_and_the_opponent_drives_its_plan():
    paths = {"av": straight(0, 0, 10, steps=41), "b": straight(30, 0, 5, steps=41)}
    ahead = np.stack([30 + 5 * 0.1 * np.arange(1, 81), np.zeros(80)], -1)
    plan = Plan(
        agent_id="b",
        first_step=11,
        position_m=ahead,
        heading_rad=np.zeros(80),
        speed_mps=np.full(80, 5.0),
    )
    rollout = rollout_of(paths, plans=[plan])
    scene = scene_of(Exportable.of(rollout, replace(case_of(), duration_steps=80)))
    assert scene.tracks.steps == 91
    assert scene.partner_id == "b"
    assert scene.tracks.valid[scene.tracks.row("av")].tolist() == [True] * 41 + [False] * 50
    row = scene.tracks.row("b")
    assert scene.tracks.valid[row].all()
    assert np.allclose(np.diff(scene.tracks.position_m[row, 30:, 0]), 0.5)
    assert np.allclose(scene.tracks.velocity_mps[row, 50], [5.0, 0.0])
