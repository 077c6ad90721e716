"""Different drivers for a demand that has one vehicle type: models, tempers, vehicle sizes."""

from pathlib import Path

import numpy as np

from deepmf_sumo.simulation.sumo_api import SumoApi

_TYPES = 32
_MODELS = ("IDM", "IDM", "EIDM", "Krauss", "Krauss", "W99", "ACC")
_PREFIX = "deepmf_driver_"


class DriverMix:
    """Vehicle types drawn at random; every passenger car that departs is given one of them.

    Args:
        file: additional file to write the types to.
        rng: draws the types and who gets which.
    """

    def __init__(self, file: Path, rng: np.random.Generator) -> None:
        self.file = file
        self._rng = rng
        lines = [_vehicle_type(number, rng) for number in range(_TYPES)]
        file.write_text("<additional>\n" + "\n".join(lines) + "\n</additional>\n", "utf-8")

    def assign(self, api: SumoApi) -> None:
        """Give those who departed in the last step their type and temper."""
        for name in sorted(api.simulation.getDepartedIDList()):
            if api.vehicle.getVehicleClass(name) != "passenger":
                continue
            api.vehicle.setType(name, f"{_PREFIX}{self._rng.integers(_TYPES)}")
            factor = float(np.clip(self._rng.normal(1.0, 0.12), 0.7, 1.35))
            api.vehicle.setSpeedFactor(name, factor)


def _vehicle_type(number: int, rng: np.random.Generator) -> str:
    model = _MODELS[number % len(_MODELS)]
    length = rng.uniform(3.8, 5.4)
    draws = {
        "length": length,
        "width": 1.3 + 0.12 * length + rng.uniform(-0.05, 0.1),
        "height": rng.uniform(1.4, 1.9),
        "accel": rng.uniform(1.2, 3.2),
        "decel": rng.uniform(2.0, 4.5),
        "emergencyDecel": 8.5,
        "tau": rng.uniform(0.8, 2.0),
        "minGap": rng.uniform(1.2, 3.0),
        "lcStrategic": rng.uniform(0.5, 2.0),
        "lcCooperative": rng.uniform(0.2, 1.0),
        "lcSpeedGain": rng.uniform(0.5, 3.0),
        "lcAssertive": rng.uniform(0.7, 3.0),
        "lcSigma": rng.uniform(0.0, 0.3),
        "lcImpatience": rng.uniform(0.0, 0.6),
        "impatience": rng.uniform(0.0, 0.6),
        "maxSpeedLat": rng.uniform(0.8, 1.5),
        "minGapLat": rng.uniform(0.2, 0.6),
        "jmTimegapMinor": rng.uniform(0.5, 1.5),
        "jmIgnoreFoeProb": rng.choice([0.0, 0.0, 0.0, 0.05]),
        "jmIgnoreFoeSpeed": 6.0,
    }
    if model == "Krauss":
        draws["sigma"] = rng.uniform(0.2, 0.6)
    written = " ".join(f'{key}="{value:.3f}"' for key, value in draws.items())
    return f'<vType id="{_PREFIX}{number}" carFollowModel="{model}" vClass="passenger" {written}/>'
