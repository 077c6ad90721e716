"""A reference driver in the AV's place: along the same path, braking when it perceives a risk."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepmf_sumo.avoidance.approach import Approach
from deepmf_sumo.avoidance.drivers import Driver
from deepmf_sumo.avoidance.path import Path
from deepmf_sumo.datatypes import Bools, Floats
from deepmf_sumo.geometry.slow import STANDING_MPS
from deepmf_sumo.geometry.touching import touching


def drive(
    models: Sequence[Driver], approach: Approach, av_along_m: Floats, start: int = 0
) -> Floats:
    """(D, N, K) where the AV is along its path if driver d takes over at step ``start``.

    Until it perceives a risk the driver does as the AV did, whose arc lengths ``av_along_m`` (K)
    are, K > 1. From then on it brakes as its model says, goes on with the speed that it has where
    the model asks for nothing, and is never faster than the AV was.
    """
    shape, dt = (len(models), len(approach.heading_rad)), approach.dt_s
    speeds = np.maximum(np.gradient(av_along_m, dt), 0.0)
    along = np.tile(av_along_m, (*shape, 1))
    speed, braking = np.full(shape, speeds[start]), np.zeros(shape)
    aware, since = np.zeros(shape, bool), np.zeros(shape)
    risk, wanted = np.zeros(shape, bool), np.zeros(shape)
    for step in range(start, approach.steps - 1):
        seen = approach.seen(step, along[..., step], speed, braking)
        since = np.where(aware, since + dt, 0.0)
        for d, model in enumerate(models):
            risk[d], wanted[d] = model.respond(seen.of(d), since[d])
        aware = aware | risk
        braking = np.where(aware, wanted, 0.0)
        slower = np.minimum(np.maximum(speed - braking * dt, 0.0), speeds[step + 1])
        moved = np.where(aware, (speed + slower) / 2 * dt, av_along_m[step + 1] - av_along_m[step])
        along[..., step + 1] = along[..., step] + moved
        speed = np.where(aware, slower, speeds[step + 1])
        if (aware & (speed == 0.0)).all():  # who has stopped stays where he is
            along[..., step + 2 :] = along[..., step + 1 : step + 2]
            break
    return along


def met(approach: Approach, centre_m: Floats, heading_rad: Floats) -> Bools:
    """(N, K) overlap of AV boxes (N, K, 2), (N, K) and the opponent's; either N may be 1."""
    return touching(
        centre_m,
        heading_rad,
        approach.av_size_m,
        approach.position_m,
        approach.heading_rad,
        approach.size_m,
    )


class Outcome(NamedTuple):
    """How it ends for D drivers and N opponents, (D, N) each.

    ``avoided``: no contact. ``standing``: a contact, but the driver had stopped before, and the
    opponent ran into the standing car.
    """

    avoided: Bools
    standing: Bools


def outcome(
    models: Sequence[Driver], path: Path, approach: Approach, av_along_m: Floats, start: int = 0
) -> Outcome:
    """What becomes of the drivers if each takes over at step ``start``; see `drive`."""
    along = drive(models, approach, av_along_m, start)
    hit = np.stack([met(approach, *path.at(of_one)) for of_one in along])
    first = hit.argmax(axis=-1)[..., None]
    here, before = (np.take_along_axis(along, at, -1)[..., 0] for at in (first, first - 1))
    avoided: Bools = ~np.any(hit, axis=-1)
    stood = (here - before < STANDING_MPS * approach.dt_s) & (first[..., 0] > start)
    return Outcome(avoided, ~avoided & stood)
