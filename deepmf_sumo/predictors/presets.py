"""Sizes of the networks: ``light`` runs on a CPU, ``paper`` follows the published sizes."""

from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

from deepmf_sumo.errors import WeightsError
from deepmf_sumo.predictors.road_index import ROAD_CHANNELS

AGENT_CLASSES: Final = ("target", "vehicle", "vru", "av")


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

    @property
    def raster_channels(self) -> int:
        """Channels of the image: agent classes x frames, road, signals."""
        agents = len(AGENT_CLASSES) * len(self.raster_frames)
        return agents + len(ROAD_CHANNELS) + self.raster_signals

    def record(self) -> dict[str, Any]:
        """For the card of a set of weights."""
        return asdict(self)


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
)
"""VGG16 at full width on 60 channels at 1 m, as M2I sizes DenseTNT's encoder; needs a GPU."""

PRESETS: Final = {preset.name: preset for preset in (LIGHT, PAPER)}


def preset_named(name: str) -> Preset:
    """LIGHT or PAPER. Raises WeightsError for other names."""
    if name not in PRESETS:
        raise WeightsError(f"There is no preset '{name}'; choose one of {', '.join(PRESETS)}.")
    return PRESETS[name]
