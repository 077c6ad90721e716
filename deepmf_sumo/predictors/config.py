"""Sizes of the networks: ``light`` runs on a CPU, ``paper`` follows the published sizes."""

import math
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Literal, get_type_hints

from deepmf_sumo.errors import WeightsError
from deepmf_sumo.predictors.lanes import ROAD_CHANNELS

AGENT_CLASSES: Final = ("target", "vehicle", "vru", "av")
_RANGES: Final[dict[str, tuple[float, float]]] = {
    "hidden": (1, 1024),
    "heads": (1, 64),
    "profiles": (7, 1024),
    "raster_pixels": (32, 1024),
    "raster_m": (0, 100),
    "condition_stage": (0, 5),
    "condition_channels": (0, 1024),
    "dropout": (0, 1),
}
"""Smallest and largest sizes, so that no card asks for all memory.

VGG16 halves the image five times; a vehicle has at least five paths, and `evaluate` asks for 32
modes of their goals."""

_WIDEST: Final = 1024
"""Channels of a block of VGG16."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """Sizes of all three networks.

    Attributes:
        hidden: width of VectorNet and of the heads.
        heads: attention heads.
        raster_pixels, raster_m: image side in pixels, and metres a pixel.
        raster_frames: history steps (0..10) that are drawn, one channel each and agent class.
        raster_signals: 3 (red, yellow, green) or 7 (all states) signal channels.
        vgg_widths: channels of VGG16's five blocks.
        condition_stage: pooled blocks before the other vehicle's future enters the image; 0 is the
            input image itself.
        condition_channels: channels of that future; 80 is one a step.
        dropout: of the heads.
        raster, vectors: False leaves the VGG16 or the VectorNet branch out (ablations).
        reactive: a conditional network is told what a driver who follows cars would do, and for
            how long a planner has driven.
        profiles: speed profiles a path that are fitted on data; a conditional network has
            those of `anchors.BRAKING` on top.
    """

    name: str
    hidden: int
    heads: int
    raster_pixels: int
    raster_m: float
    raster_frames: tuple[int, ...]
    raster_signals: Literal[3, 7]
    vgg_widths: tuple[int, int, int, int, int]
    condition_stage: int
    condition_channels: int
    dropout: float = 0.1
    raster: bool = True
    vectors: bool = True
    reactive: bool = False
    profiles: int = 24

    @property
    def raster_channels(self) -> int:
        """Channels of the image: agent classes x frames, road, signals."""
        agents = len(AGENT_CLASSES) * len(self.raster_frames)
        return agents + len(ROAD_CHANNELS) + self.raster_signals

    def record(self) -> dict[str, Any]:
        """For the card of a set of weights."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Any) -> "Preset":
        """The preset of a card. Raises WeightsError where a size is missing, unknown or wrong."""
        known = {each.name for each in fields(cls)}
        if not isinstance(record, dict) or not set(record) <= known:
            raise WeightsError(f"These are no sizes of a network: {str(record)[:200]}.")
        values: dict[str, Any] = {
            key: tuple(v) if isinstance(v, list) else v for key, v in record.items()
        }
        try:
            preset = cls(**values)
        except TypeError as error:
            raise WeightsError(f"Sizes of the network are missing: {error}.") from None
        for key, kind in get_type_hints(cls).items():
            _check(key, getattr(preset, key), kind)
        return preset


LIGHT: Final = Preset(
    name="light",
    hidden=64,
    heads=2,
    raster_pixels=56,
    raster_m=3.0,
    raster_frames=(0, 10),
    raster_signals=3,
    vgg_widths=(8, 16, 32, 32, 32),
    condition_stage=3,
    condition_channels=8,
    reactive=True,
)
"""20 channels at 3 m: 126 m ahead, 42 m behind, 84 m to each side."""

PAPER: Final = Preset(
    name="paper",
    hidden=128,
    heads=2,
    raster_pixels=224,
    raster_m=1.0,
    raster_frames=tuple(range(11)),
    raster_signals=7,
    vgg_widths=(64, 128, 256, 512, 512),
    condition_stage=0,
    condition_channels=80,
    reactive=True,
)
"""VGG16 at full width on 60 channels at 1 m, as M2I sizes DenseTNT's encoder; needs a GPU."""

VECTOR: Final = replace(LIGHT, name="vector", raster=False)
"""Without images: as good as `LIGHT` where few scenes are to learn from."""

PRESETS: Final = {preset.name: preset for preset in (LIGHT, PAPER, VECTOR)}


def preset_named(name: str) -> Preset:
    """A preset. Raises WeightsError for other names."""
    if name not in PRESETS:
        raise WeightsError(f"There is no preset '{name}'; choose one of {', '.join(PRESETS)}.")
    return PRESETS[name]


def changed(preset: Preset, name: str, sizes: dict[str, Any]) -> Preset:
    """A preset with other sizes and a name of its own. Raises WeightsError for unknown sizes."""
    return Preset.from_record({**replace(preset, name=name).record(), **sizes})


def _check(key: str, value: Any, kind: Any) -> None:
    whole = _whole(value)
    right = {
        str: isinstance(value, str),
        bool: isinstance(value, bool),
        int: whole and _within(key, value),
        float: (whole or isinstance(value, float)) and _within(key, value),
    }.get(kind)
    if right is None:  # a tuple or a choice
        right = value in (3, 7) if key == "raster_signals" else _numbers(key, value)
    if not right:
        raise WeightsError(f"The size '{key}' of the network is {value!r:.80}; that cannot be.")


def _within(key: str, value: float) -> bool:
    least, most = _RANGES.get(key, (0, math.inf))
    return least <= value <= most


def _numbers(key: str, value: Any) -> bool:
    """Whether these are the widths of five blocks, or steps of the history."""
    if not (isinstance(value, tuple) and all(map(_whole, value))):
        return False
    if key == "vgg_widths":
        return len(value) == 5 and min(value) > 0 and max(value) <= _WIDEST
    return 0 < len(value) <= 11 and all(0 <= step <= 10 for step in value)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
