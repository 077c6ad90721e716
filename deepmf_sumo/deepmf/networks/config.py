"""Sizes of the networks: presets of `PRESETS`, from ``light`` for a CPU to ``paper`` in full."""

from dataclasses import asdict, replace
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from deepmf_sumo.deepmf.networks.lanes import ROAD_CHANNELS
from deepmf_sumo.errors import WeightsError

AGENT_CLASSES: Final = ("target", "vehicle", "vru", "av")
Width = Annotated[int, Field(ge=1, le=1024)]
HistoryStep = Annotated[int, Field(ge=0, le=10)]


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    config=ConfigDict(strict=True, extra="forbid", allow_inf_nan=False),
)
class Preset:
    """Sizes of all three networks. They are bounded, so that no card asks for all memory.

    Attributes:
        hidden: width of VectorNet and of the heads.
        heads: attention heads.
        raster_pixels, raster_m: image side in pixels (VGG16 halves it five times), and metres a
            pixel.
        raster_frames: history steps (0..10) that are drawn, one channel each and agent class.
        raster_signals: 3 (red, yellow, green) or 7 (all states) signal channels.
        vgg_widths: channels of VGG16's five blocks.
        condition_stage: pooled blocks before the other vehicle's future enters the image; 0 is the
            input image itself.
        condition_channels: channels of that future; 80 is one a step.
        dropout: of the heads.
        raster, vectors: False leaves the VGG16 or the VectorNet branch out (ablations).
        pairs, mixing: False leaves out the opponent network's relations of each pair of vehicles,
            or the attention among the vehicles in its head.
        reactive: a conditional network is told what a car-following driver would do, and for
            how long a planner has driven.
        profiles: speed profiles a path that are fitted on data; a conditional network has those of
            `anchors.BRAKING` in addition. At least 7: `evaluate` asks for 32 modes, and a vehicle
            has at least five paths.
        head: goals of the trajectory networks: ``paths`` (paths and speed profiles), or ``dense``
            as published (see `anchors`), without profiles.
    """

    name: str
    hidden: Width
    heads: Annotated[int, Field(ge=1, le=64)]
    raster_pixels: Annotated[int, Field(ge=32, le=1024)]
    raster_m: Annotated[float, Field(ge=0, le=100)]
    raster_frames: Annotated[tuple[HistoryStep, ...], Field(min_length=1, max_length=11)]
    raster_signals: Literal[3, 7]
    vgg_widths: tuple[Width, Width, Width, Width, Width]
    condition_stage: Annotated[int, Field(ge=0, le=5)]
    condition_channels: Annotated[int, Field(ge=0, le=1024)]
    dropout: Annotated[float, Field(ge=0, le=1)] = 0.1
    raster: bool = True
    vectors: bool = True
    pairs: bool = True
    mixing: bool = True
    reactive: bool = False
    profiles: Annotated[int, Field(ge=7, le=1024)] = 24
    head: Literal["paths", "dense"] = "paths"

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
        if not isinstance(record, dict):
            raise WeightsError(
                f"The sizes of the network are {record!r:.80}, which is not a mapping."
            )
        sizes: dict[str, Any] = {
            str(key): tuple(value) if isinstance(value, list) else value
            for key, value in record.items()
        }
        try:
            return cls(**sizes)
        except ValidationError as error:
            first = error.errors()[0]
        key = str(first["loc"][0])
        if key not in sizes:
            raise WeightsError(f"The size '{key}' of the network is missing.")
        if first["type"] == "unexpected_keyword_argument":
            raise WeightsError(f"'{key:.80}' is not a size of a network.")
        raise WeightsError(f"The size '{key}' is {sizes[key]!r:.80}: {first['msg']}.")


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
    head="dense",
)
"""VGG16 at full width on 60 channels at 1 m, as M2I sizes DenseTNT's encoder; needs a GPU."""

VECTOR: Final = replace(LIGHT, name="vector", raster=False)
"""Without images: as good as `LIGHT` where few scenes are to learn from."""

DENSE: Final = replace(VECTOR, name="dense", head="dense")
"""`VECTOR` with DenseTNT's goals."""

UNPAIRED: Final = replace(LIGHT, name="unpaired", pairs=False, mixing=False)
"""`LIGHT` with the published inputs of the opponent network: VectorNet and VGG16 alone."""

PRESETS: Final = {preset.name: preset for preset in (LIGHT, PAPER, VECTOR, DENSE, UNPAIRED)}


def preset_named(name: str) -> Preset:
    """A preset. Raises WeightsError for other names."""
    if name not in PRESETS:
        raise WeightsError(f"There is no preset '{name}'; choose one of {', '.join(PRESETS)}.")
    return PRESETS[name]


def changed(preset: Preset, name: str, sizes: dict[str, Any]) -> Preset:
    """A preset with other sizes and a name of its own. Raises WeightsError for unknown sizes."""
    return Preset.from_record({**replace(preset, name=name).record(), **sizes})
