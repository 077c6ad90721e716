"""A plan on the tiny network: two moments of it, two planners, methods that take no networks."""

from pathlib import Path

POSES = ", ".join(["[56.0, -4.8, 0.0]"] + ["[36.0, -4.8, 0.0]"] * 4)
"""To where the AV is at the first moment, so that it is hit there and not at the second."""

PLAN = f"""version: 1
name: tiny
source:
  - {{network: tiny.sumocfg, start_s: 2.0, av: {{vehicle: av}}}}
  - {{network: tiny.sumocfg, start_s: 3.0, av: {{vehicle: av}}}}
duration_s: 0.5
planners: {{lane: {{name: idm, perception: lane}}, straight: constant_velocity}}
methods:
  none: none
  fixed: {{adversary: {{name: trajectory, agent: leader, poses: [{POSES}]}}}}
tables: {{baseline: fixed, compared: [none, fixed]}}
"""


def write(folder: Path, text: str = PLAN, name: str = "plan.yaml") -> Path:
    """The plan's file, beside the network."""
    (folder / name).write_text(text)
    return folder / name
