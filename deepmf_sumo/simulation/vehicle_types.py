"""Vehicle types of our own: the AV's, the placed vehicles', the traffic's."""

from pathlib import Path

from deepmf_sumo.datatypes import VehicleModel

AV_TYPE = "deepmf_av"
PLACED_TYPE = "deepmf_placed"
TRAFFIC_TYPE = "deepmf_traffic"
ANY_ROUTE = "deepmf_any"
"""Route of vehicles that have none of their own."""

# A placed vehicle must be able to have any speed that the log says, else SUMO clamps what followers
# see; apparentDecel is what they believe it can brake with. It may be on lanes for others, too.
_PLACED = (
    f'<vType id="{PLACED_TYPE}" vClass="ignoring" speedFactor="10" speedDev="0" maxSpeed="100" '
    'accel="1000" decel="1000" emergencyDecel="1000" apparentDecel="4.5"/>'
)
_TRAFFIC = (
    f'<vType id="{TRAFFIC_TYPE}" carFollowModel="IDM" accel="1.5" decel="2" emergencyDecel="8" '
    'tau="1.5" minGap="2" speedFactor="1" speedDev="0"/>'
)


def write_types(path: Path, model: VehicleModel | None) -> Path:
    """Write an additional file with the types; without a model there is no AV type."""
    lines = [_PLACED, _TRAFFIC]
    if model is not None:
        lines.append(_av_type(model))
    path.write_text("<additional>\n    " + "\n    ".join(lines) + "\n</additional>\n", "utf-8")
    return path


def _av_type(model: VehicleModel) -> str:
    fastest = "" if model.desired_mps is None else f'maxSpeed="{model.desired_mps:g}" '
    return (
        f'<vType id="{AV_TYPE}" carFollowModel="IDM" accel="{model.accel_mps2:g}" '
        f'decel="{model.decel_mps2:g}" emergencyDecel="{model.emergency_mps2:g}" '
        f'tau="{model.headway_s:g}" minGap="{model.gap_m:g}" delta="{model.exponent:g}" '
        f'{fastest}speedFactor="1" speedDev="0"/>'
    )
