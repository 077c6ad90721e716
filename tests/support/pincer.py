"""An adversary of a user: two vehicles close in on the AV, one from each side."""

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.scene import Attack, Plan
from deepmf_sumo.scene.geometry import frames

REACH_M = 40.0
ASIDE_M = 1.5


class Settings(plugins.Settings):
    """``seconds``: until each of them is where the AV is, if the AV keeps its velocity."""

    seconds: float = 3.0


class Policy:
    """Chooses the nearest vehicle on each side that goes the AV's way; each gets one plan."""

    period_steps = None

    def __init__(self, seconds):
        self.seconds = seconds

    def reset(self, view, rng):
        tracks, av = view.history, view.history.row(view.av_id)
        heading = tracks.heading_rad[:, -1]
        x, y = frames.to_local(tracks.position_m[:, -1], tracks.position_m[av, -1], heading[av]).T
        same_way = np.abs(frames.difference(heading, heading[av])) < 0.3
        able = same_way & (np.hypot(x, y) < REACH_M) & (np.array(tracks.kinds) == "vehicle")
        sides = [np.flatnonzero(able & (side * y > ASIDE_M)) for side in (1, -1)]
        self.pair = tuple(tracks.ids[rows[np.abs(x[rows]).argmin()]] for rows in sides if len(rows))
        return self.pair

    def plan(self, view):
        return {agent: self._way_to_the_av(view, agent) for agent in self.pair}

    def _way_to_the_av(self, view, agent):
        tracks, rows = view.history, [view.history.row(one) for one in (agent, view.av_id)]
        (here, av), (own, its) = tracks.position_m[rows, -1], tracks.velocity_mps[rows, -1]
        time = view.dt_s * np.arange(0, round(self.seconds / view.dt_s) + 1)[:, None]
        share = time / self.seconds
        blend = share**3 * (10 - 15 * share + 6 * share**2)
        way = here + own * time + blend * (av - here + (its - own) * time)
        steps = np.diff(way, axis=0)
        return Plan(
            agent_id=agent,
            first_step=view.step + 1,
            position_m=way[1:],
            heading_rad=np.arctan2(steps[:, 1], steps[:, 0]),
            speed_mps=np.hypot(*steps.T) / view.dt_s,
        )


class Pincer:
    """One episode under the policy."""

    Settings = Settings

    def __init__(self, settings):
        self.settings = settings

    @classmethod
    def build(cls, settings, weights):
        return cls(settings)

    def attack(self, case, simulate, budget, rng):
        return Attack(rollout=simulate(Policy(self.settings.seconds)))
