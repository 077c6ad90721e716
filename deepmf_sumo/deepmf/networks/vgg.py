"""VGG16 (Simonyan, Zisserman 2015) with batch norm, a width a block, an average at the end.

The other vehicle's future enters as additional channels of the feature map after
``condition_stage`` blocks: 0 adds them to the input image, as published; a later stage lets many
futures share the first blocks.
"""

from typing import Final

import torch
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks.config import Preset

CONVOLUTIONS: Final = (2, 2, 3, 3, 3)
"""3 x 3 convolutions of the five blocks; 2 x 2 maximum pooling follows each."""


def _block(inputs: int, width: int, convolutions: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for number in range(convolutions):
        layers += [
            nn.Conv2d(inputs if number == 0 else width, width, 3, padding=1, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
        ]
    return nn.Sequential(*layers, nn.MaxPool2d(2))


class VGG16(nn.Module):
    """Image -> one feature of the scene; with ``conditional`` also of each given future."""

    def __init__(self, preset: Preset, *, conditional: bool = False) -> None:
        super().__init__()
        self.stage = preset.condition_stage if conditional else 0
        extra = preset.condition_channels if conditional else 0
        widths = (preset.raster_channels, *preset.vgg_widths)
        self.blocks = nn.ModuleList(
            _block(widths[row] + (extra if row == self.stage else 0), widths[row + 1], count)
            for row, count in enumerate(CONVOLUTIONS)
        )
        self.out = nn.Linear(widths[-1], preset.hidden)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")
                # a third faster on CPUs
                layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)

    def shared(self, image: Tensor) -> Tensor:
        """(B, C, S, S) -> (B, C', S', S') of the blocks before the condition enters."""
        image = image.contiguous(memory_format=torch.channels_last)
        for block in self.blocks[: self.stage]:
            image = block(image)
        return image

    def forward(self, shared: Tensor, future: Tensor | None = None) -> Tensor:
        """What `shared` gives, and channels of K futures (B*K, D, S', S') -> (B, H) or (B*K, H)."""
        first, *rest = self.blocks[self.stage :]
        assert isinstance(first, nn.Sequential)
        assert isinstance(first[0], nn.Conv2d)
        image = first(shared) if future is None else first[1:](_convolved(first[0], shared, future))
        for block in rest:
            image = block(image)
        return self.out(image.mean((2, 3)))


def _convolved(layer: nn.Conv2d, shared: Tensor, future: Tensor) -> Tensor:
    """The convolution of each future's channels behind those of its scene (B*K, C, S', S').

    It is a sum over channels, so that the scene's part is made once for all K futures.
    """
    width = shared.shape[1]
    scene, other = layer.weight[:, :width], layer.weight[:, width:]
    future = future.contiguous(memory_format=torch.channels_last)
    seen = torch.nn.functional.conv2d(future, other, padding=1)
    own = torch.nn.functional.conv2d(shared, scene, padding=1)
    both = seen.view(len(shared), -1, *seen.shape[1:]) + own.unsqueeze(1)
    return both.flatten(0, 1)


def unpack(bits: Tensor, preset: Preset) -> Tensor:
    """(B, bytes) uint8 -> (B, C, pixels, pixels) float; ONNX graphs get the image itself."""
    if bits.is_floating_point():
        return bits
    places = torch.arange(7, -1, -1, device=bits.device, dtype=torch.uint8)
    flat = (bits.unsqueeze(-1) >> places) & 1
    side = preset.raster_pixels
    count = preset.raster_channels * side * side
    return flat.reshape(len(bits), -1)[:, :count].reshape(len(bits), -1, side, side).float()


def repack(image: Tensor) -> Tensor:
    """(B, C, pixels, pixels) of zeros and ones -> (B, bytes) uint8: undoes `unpack`."""
    flat = image.flatten(1).to(torch.uint8)
    flat = torch.nn.functional.pad(flat, (0, -flat.shape[1] % 8)).view(len(flat), -1, 8)
    places = torch.arange(7, -1, -1, device=image.device, dtype=torch.uint8)
    return (flat << places).sum(-1).to(torch.uint8)


def draw_future(position_m: Tensor, preset: Preset) -> Tensor:
    """A future (B, K, F, 2) in the pose's frame as channels (B*K, C, side, side).

    C intervals of equal length share the 8 s. The image has the resolution of VGG's feature map
    after ``condition_stage`` blocks; each position is spread over the four nearest pixels, so that
    motion below a pixel shows.
    """
    batch, futures, steps, _ = position_m.shape
    side = preset.raster_pixels >> preset.condition_stage
    metres = preset.raster_m * preset.raster_pixels / side
    channels = preset.condition_channels
    place = position_m.reshape(batch * futures, steps, 2) / metres
    place = place + place.new_tensor([side / 4 - 0.5, side / 2 - 0.5])
    base = place.floor()
    part = place - base
    interval = torch.arange(steps, device=place.device) * channels // steps
    image = place.new_zeros(batch * futures, channels * side * side)
    for down in (0, 1):
        for right in (0, 1):
            cell = base.long() + torch.tensor([down, right], device=place.device)
            weight = (part[..., 0] if down else 1 - part[..., 0]) * (
                part[..., 1] if right else 1 - part[..., 1]
            )
            inside = ((cell >= 0) & (cell < side)).all(-1)
            cell = cell.clamp(0, side - 1)
            slot = (interval * side + cell[..., 0]) * side + cell[..., 1]
            image.scatter_add_(1, slot, weight * inside * channels / steps)
    return image.reshape(batch * futures, channels, side, side)
