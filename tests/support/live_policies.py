"""What drives an opponent in live attacks, without networks."""

from deepmf_sumo.scene import Plan


class Keep:
    """The leader goes on as it does."""

    period_steps = 10

    def reset(self, view, rng):
        return ("leader",) if "leader" in view.history.ids else ()

    def plan(self, view):
        row = view.history.row("leader")
        x, y = view.history.position_m[row, -1]
        speed = float(view.history.speed_mps[row, -1])
        return {
            "leader": Plan(
                agent_id="leader",
                first_step=view.step + 1,
                position_m=[(x + 0.1 * speed * step, y) for step in range(1, 81)],
                heading_rad=[0.0] * 80,
                speed_mps=[speed] * 80,
            )
        }
