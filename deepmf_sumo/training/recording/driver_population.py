"""A mixed driver population: car-following models, driving styles, errors and vehicle sizes.

The ranges are chosen so that starts, stops, turns and cruising resemble recorded traffic: from rest
to 5 m/s in about 4 s with an acceleration that builds up over 1.5 s to 2.3 m/s2, a stop that eases
off from 2.5 m/s2, speeds that are never quite constant.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_PREFIX: Final = "deepmf_driver_"
_MODELS: Final = (*["EIDM"] * 11, *["IDM"] * 4, *["Krauss"] * 3, "W99", "ACC")
_WANDER_STEPS: Final = 10
_WANDER_MEMORY: Final = 0.85
_WANDER_DEVIATION: Final = 0.06


@dataclass(frozen=True, slots=True, kw_only=True)
class _Vehicles:
    """Number of types of a vehicle class, and their sizes (m)."""

    types: int
    length_m: tuple[float, float]
    width_m: tuple[float, float]
    height_m: tuple[float, float]
    vigour: float = 1.0


_CLASSES: Final = {
    "passenger": _Vehicles(types=60, length_m=(3.9, 5.4), width_m=(1.75, 2.1), height_m=(1.4, 1.9)),
    "delivery": _Vehicles(
        types=8, length_m=(5.2, 6.5), width_m=(2.0, 2.3), height_m=(2.0, 2.8), vigour=0.85
    ),
    "truck": _Vehicles(
        types=8, length_m=(7.0, 12.0), width_m=(2.4, 2.55), height_m=(2.8, 3.9), vigour=0.6
    ),
    "bus": _Vehicles(
        types=4, length_m=(9.0, 12.5), width_m=(2.5, 2.6), height_m=(3.0, 3.4), vigour=0.65
    ),
    "motorcycle": _Vehicles(
        types=5, length_m=(2.0, 2.4), width_m=(0.75, 0.95), height_m=(1.3, 1.7), vigour=1.3
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Temper:
    """A driving style; pairs are ranges of uniform distributions."""

    accel: tuple[float, float]
    decel: tuple[float, float]
    tau: tuple[float, float]
    gap_minor: tuple[float, float]
    impatience: tuple[float, float]
    assertive: tuple[float, float]
    speed_gain: tuple[float, float]
    ignore_foe: tuple[float, float]
    pace: float


_ORDINARY: Final = _Temper(
    accel=(1.4, 2.4),
    decel=(1.6, 2.8),
    tau=(0.9, 1.7),
    gap_minor=(0.7, 1.5),
    impatience=(0.0, 0.4),
    assertive=(0.8, 1.6),
    speed_gain=(0.5, 1.5),
    ignore_foe=(0.0, 0.02),
    pace=1.0,
)
_HURRIED: Final = _Temper(
    accel=(2.2, 3.3),
    decel=(2.4, 4.0),
    tau=(0.5, 1.0),
    gap_minor=(0.2, 0.8),
    impatience=(0.4, 1.0),
    assertive=(1.5, 4.0),
    speed_gain=(1.5, 5.0),
    ignore_foe=(0.02, 0.12),
    pace=1.12,
)
_HESITANT: Final = _Temper(
    accel=(0.9, 1.6),
    decel=(1.2, 2.0),
    tau=(1.5, 2.4),
    gap_minor=(1.5, 3.0),
    impatience=(-0.5, 0.0),
    assertive=(0.5, 1.0),
    speed_gain=(0.1, 0.7),
    ignore_foe=(0.0, 0.0),
    pace=0.88,
)
_TEMPERS: Final = (_ORDINARY, _ORDINARY, _HURRIED, _ORDINARY, _HESITANT)


class DriverMix:
    """Random vehicle types; each departing vehicle gets one of its class.

    Args:
        file: additional file to write the types to.
        rng: draws the types, their assignment, and the drift of speeds.
    """

    def __init__(self, file: Path, rng: np.random.Generator) -> None:
        self.file = file
        self._rng = rng
        self._factor: dict[str, float] = {}
        self._drift: dict[str, float] = {}
        self._steps = 0
        self._pace: dict[str, float] = {}
        lines = []
        for vehicle_class, vehicles in _CLASSES.items():
            for number in range(vehicles.types):
                name = f"{_PREFIX}{vehicle_class}_{number}"
                temper = _TEMPERS[int(rng.integers(len(_TEMPERS)))]
                self._pace[name] = temper.pace
                lines.append(_vehicle_type(name, vehicle_class, vehicles, temper, rng))
        file.write_text("<additional>\n" + "\n".join(lines) + "\n</additional>\n", "utf-8")

    def assign(self, api: SumoApi) -> None:
        """Assign types to the vehicles that departed in the last step; call it every step.

        Drivers do not hold a speed exactly: their desired speed drifts by a few per cent within
        seconds.
        """
        vehicle = api.vehicle
        for name in sorted(api.simulation.getDepartedIDList()):
            vehicle_class = vehicle.getVehicleClass(name)
            if vehicle_class not in _CLASSES:
                continue
            number = self._rng.integers(_CLASSES[vehicle_class].types)
            kind = f"{_PREFIX}{vehicle_class}_{number}"
            vehicle.setType(name, kind)
            factor = float(np.clip(self._rng.normal(self._pace[kind], 0.08), 0.7, 1.35))
            vehicle.setSpeedFactor(name, factor)
            self._factor[name], self._drift[name] = factor, 0.0
        for name in api.simulation.getArrivedIDList():
            self._factor.pop(name, None)
        self._steps += 1
        if self._steps % _WANDER_STEPS == 0:
            self._wander(api)

    def _wander(self, api: SumoApi) -> None:
        names = [name for name in sorted(api.vehicle.getIDList()) if name in self._factor]
        fresh = self._rng.normal(0.0, _WANDER_DEVIATION, len(names))
        share = np.sqrt(1.0 - _WANDER_MEMORY**2)
        for name, draw in zip(names, fresh, strict=True):
            drift = _WANDER_MEMORY * self._drift[name] + share * float(draw)
            self._drift[name] = drift
            api.vehicle.setSpeedFactor(name, self._factor[name] * (1.0 + drift))


def _vehicle_type(
    name: str, vehicle_class: str, vehicles: _Vehicles, temper: _Temper, rng: np.random.Generator
) -> str:
    model = str(rng.choice(_MODELS))
    accel = rng.uniform(*temper.accel) * vehicles.vigour
    draws = {
        "length": rng.uniform(*vehicles.length_m),
        "width": rng.uniform(*vehicles.width_m),
        "height": rng.uniform(*vehicles.height_m),
        "accel": accel,
        "decel": rng.uniform(*temper.decel) * min(1.0, vehicles.vigour + 0.2),
        "emergencyDecel": 8.5,
        "tau": rng.uniform(*temper.tau),
        "minGap": rng.uniform(1.2, 3.0),
        "impatience": rng.uniform(*temper.impatience),
        **_manners(temper, rng),
        **_errors(model, rng),
    }
    written = " ".join(f'{key}="{value:.3f}"' for key, value in draws.items())
    if model == "Krauss":
        written += _eased(accel)
    return f'<vType id="{name}" carFollowModel="{model}" vClass="{vehicle_class}" {written}/>'


def _manners(temper: _Temper, rng: np.random.Generator) -> dict[str, float]:
    """Parameters of junctions and lane changes."""
    return {
        "lcStrategic": rng.uniform(1.0, 4.0),
        "lcCooperative": rng.uniform(0.4, 1.0),
        "lcSpeedGain": rng.uniform(*temper.speed_gain),
        "lcKeepRight": rng.uniform(0.0, 1.0),
        "lcAssertive": rng.uniform(*temper.assertive),
        "lcSigma": rng.uniform(0.0, 0.35),
        "lcImpatience": rng.uniform(0.0, 0.7),
        "lcAccelLat": rng.uniform(0.6, 1.2),
        "maxSpeedLat": rng.uniform(0.7, 1.5),
        "minGapLat": rng.uniform(0.2, 0.6),
        "jmTimegapMinor": rng.uniform(*temper.gap_minor),
        "jmCrossingGap": rng.uniform(4.0, 12.0),
        "jmIgnoreFoeProb": rng.uniform(*temper.ignore_foe),
        "jmIgnoreFoeSpeed": 6.0,
        "jmIgnoreJunctionFoeProb": rng.uniform(0.0, temper.ignore_foe[1] / 4),
        "jmDriveAfterYellowTime": rng.uniform(0.0, 3.0),
        "jmStoplineGap": rng.uniform(0.3, 2.5),
        "jmStopSignWait": rng.uniform(0.3, 2.0),
        "jmAllwayStopWait": rng.uniform(0.3, 2.0),
    }


def _errors(model: str, rng: np.random.Generator) -> dict[str, float]:
    """Delays and errors of perception and control."""
    errors = {"startupDelay": rng.uniform(0.0, 1.2)}
    if model == "Krauss":
        errors |= {"sigma": rng.uniform(0.2, 0.6), "sigmaStep": 1.0}
    if model == "EIDM":
        errors |= {
            "taccmax": rng.uniform(1.2, 4.0),
            "Mflatness": rng.uniform(1.0, 2.5),
            "Mbegin": rng.uniform(0.5, 1.0),
            "jerkmax": rng.uniform(1.5, 4.0),
            "treaction": rng.uniform(0.2, 1.0),
            "sigmaerror": rng.uniform(0.02, 0.12),
            "sigmagap": rng.uniform(0.05, 0.2),
            "sigmaleader": rng.uniform(0.01, 0.05),
        }
    return errors


def _eased(accel: float) -> str:
    """Krauss: acceleration that builds up from rest and decreases with speed."""
    wanted = accel * np.array([0.3, 0.8, 1.0, 0.8, 0.5, 0.3])
    table = " ".join(f"{value:.2f}" for value in wanted)
    most = " ".join(f"{accel + 1.0:.2f}" for _ in wanted)
    return f' speedTable="0 1.5 3 9 18 40" desAccelProfile="{table}" maxAccelProfile="{most}"'
