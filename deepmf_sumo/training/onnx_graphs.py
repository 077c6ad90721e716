"""Writing the networks of a set as ONNX graphs, for installations without torch.

`deepmf.networks.onnx_networks` reads them. Graphs are checked against torch before they are
written, on random inputs of other sizes than those that they were traced with.
"""

import json
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn
from torch.export import Dim

from deepmf_sumo import files
from deepmf_sumo.deepmf.networks import condition, torch_networks, weights
from deepmf_sumo.deepmf.networks import lanes as paths_module
from deepmf_sumo.deepmf.networks.condition import Road
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT, Encoding
from deepmf_sumo.deepmf.networks.encode import (
    AGENTS,
    LANES,
    PATH_AGENTS,
    AgentInfo,
    AgentState,
    LaneInfo,
    OwnMotion,
    PathAgent,
)
from deepmf_sumo.deepmf.networks.lanes import NODES, PathInfo
from deepmf_sumo.deepmf.networks.onnx_networks import DECODE, ENCODE, KERNEL, PATHS, graph_file
from deepmf_sumo.deepmf.networks.opponent import OTHERS, SLOTS, Pair
from deepmf_sumo.deepmf.networks.opponent_net import OpponentNet
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training.fit import checkpoints

_OPSET: Final = 20
_ENCODED: Final = ("along_m", "elements", "there", "goals", "target", "around", "image")
"""Fields of an `Encoding` that the first graph computes; the others are inputs of the network."""


def write(name: str | Path, report: Callable[[str], None]) -> None:
    """Write the graphs of a set into its folder.

    Raises WeightsError where a network is not whole, or a graph differs from torch.
    """
    folder = weights.find(name)
    count = len(weights.members(folder, weights.read_card(folder, "marginal")))
    networks: list[tuple[Network, int]] = [("opponent", 1), ("conditional", 1)]
    networks += [("marginal", number) for number in range(1, count + 1)]
    for network, number in networks:
        net, _ = torch_networks.read_network(folder, network, number)
        stem = weights.member(network, number)
        tensors = files.content(folder / f"{stem}.safetensors")
        digest = weights.digest_of(tensors)
        for part, model in _graphs(net):
            onnx.helper.set_model_props(model, {**_props(model), weights.DIGEST: digest})
            content = model.SerializeToString()
            checkpoints.write(folder / graph_file(stem, part), content)
            report(f"{folder / graph_file(stem, part)}: {len(content) / 1e3:.0f} kB")


def _graphs(net: nn.Module) -> Iterator[tuple[str, onnx.ModelProto]]:
    if isinstance(net, OpponentNet):
        yield "", opponent_graph(net)
    if isinstance(net, DenseTNT):
        if net.dense:
            raise WeightsError(
                "Networks with the head 'dense' have no ONNX graphs; use torch, or networks with"
                " the head 'paths'."
            )
        yield ENCODE, encode_graph(net)
        yield DECODE, decode_graph(net)


def opponent_graph(net: OpponentNet) -> onnx.ModelProto:
    """Features of the vehicles around the AV -> ``logits`` (M, 1, V, 2) of each member."""

    def inputs(seed: int, size: int) -> dict[str, Tensor]:
        scene = _scene(net.preset, OTHERS + 1, seed, size)
        batch = {name: scene[name] for name in scene if name not in (*PATHS, "motion")}
        if net.preset.pairs:
            batch["pair"] = _random(seed + 1, (1, size, len(Pair)))
        return {**batch, "vehicle": torch.ones(1, size)}

    free = {name: {1: Dim("slots", min=2, max=OTHERS)} for name in SLOTS}
    return _exported(_Opponent(net), inputs, free, ("logits",))


def encode_graph(net: DenseTNT) -> onnx.ModelProto:
    """`encode.Features` of a vehicle, without unused paths -> the fields `_ENCODED`."""

    def inputs(seed: int, size: int) -> dict[str, Tensor]:
        return _scene(net.preset, AGENTS, seed, size)

    paths = Dim("paths", min=2, max=paths_module.PATHS)
    free = {name: {1: paths} for name in PATHS}
    return _exported(_Encoder(net), inputs, free, _encoded(net))


def decode_graph(net: DenseTNT) -> onnx.ModelProto:
    """An encoding, and K given futures -> ``logits`` (1, K, P, R), ``knots`` (1, K, P, R, 5, 2).

    Inputs ``position_m`` (1, K, 80, 2), ``heading_rad`` (1, K, 80) and ``given`` (1, K), 0 where
    there is no condition; networks without condition take none of them.
    """

    def inputs(seed: int, size: int) -> dict[str, Tensor]:
        scene = _scene(net.preset, AGENTS, seed, size)
        with torch.no_grad():
            fields = dict(zip(_encoded(net), _Encoder(net)(scene), strict=True))
        batch = {name: scene[name] for name in (*PATHS, "motion")} | fields
        if net.conditional:
            futures = size - 2
            batch["position_m"] = 20.0 * _random(seed + 1, (1, futures, 80, 2))
            batch["heading_rad"] = _random(seed + 2, (1, futures, 80))
            batch["given"] = torch.ones(1, futures)
        return batch

    paths, futures = Dim("paths", min=2, max=paths_module.PATHS), Dim("futures", min=2, max=4096)
    free = {name: {1: paths} for name in (*PATHS, "along_m", "goals")}
    free |= {name: {1: futures} for name in ("position_m", "heading_rad", "given")}
    model = _exported(_Decoder(net), inputs, free, ("logits", "knots"))
    props = {**_props(model), KERNEL: json.dumps(net.kernel_m.tolist())}
    onnx.helper.set_model_props(model, props)
    return model


class _Opponent(nn.Module):
    """`OpponentNet.logits` with a tuple as its result, as graphs have."""

    def __init__(self, net: OpponentNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, ...]:
        return (self.net.logits(batch),)


class _Encoder(nn.Module):
    """`DenseTNT.encode` with the fields as a tuple."""

    def __init__(self, net: DenseTNT) -> None:
        super().__init__()
        self.net = net

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, ...]:
        found = self.net.encode(batch)
        return tuple(getattr(found, name) for name in _encoded(self.net))


class _Decoder(nn.Module):
    """`DenseTNT.decode` of the fields of an encoding."""

    def __init__(self, net: DenseTNT) -> None:
        super().__init__()
        self.net = net

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, ...]:
        fields: dict[str, Any] = {name: batch.get(name) for name in _ENCODED}
        scene = Encoding(
            paths=batch["paths"],
            exists=batch["path_info"][..., PathInfo.THERE] > 0,
            road=Road.of(batch),
            **fields,
        )
        given = None
        if self.net.conditional:
            parts = batch["position_m"], batch["heading_rad"], batch["given"]
            given = condition.Condition.of(*parts, self.net.preset)
        found = self.net.decode(scene, given)
        return found.logits, found.knots


def _encoded(net: DenseTNT) -> tuple[str, ...]:
    return tuple(name for name in _ENCODED if name != "image" or net.preset.raster)


def _scene(preset: Preset, agents: int, seed: int, paths: int) -> dict[str, Tensor]:
    """Random features of the right shapes; everything is there."""
    shapes = {
        "agents": (agents, 11, len(AgentState)),
        "agent_info": (agents, len(AgentInfo)),
        "lanes": (LANES, 10, 2),
        "lane_info": (LANES, len(LaneInfo)),
        "paths": (paths, NODES, 2),
        "path_info": (paths, len(PathInfo)),
        "path_agents": (paths, PATH_AGENTS, len(PathAgent)),
        "motion": (len(OwnMotion),),
    }
    batch = {
        name: _random(seed + 10 * row, (1, *shape)).abs()
        for row, (name, shape) in enumerate(shapes.items())
    }
    batch["paths"] = batch["paths"].cumsum(2)
    if preset.raster:
        side = preset.raster_pixels
        batch["raster"] = (_random(seed, (1, preset.raster_channels, side, side)) > 1.0).float()
    return batch


def _random(seed: int, shape: tuple[int, ...]) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def _exported(
    net: nn.Module,
    inputs: Callable[[int, int], dict[str, Tensor]],
    free: Mapping[str, dict[int, Any]],
    outputs: tuple[str, ...],
) -> onnx.ModelProto:
    """The graph of a network, traced with ``inputs(0, 5)`` and checked with ``inputs(1, 8)``.

    ``free``: axes of inputs that may have other lengths. Raises WeightsError where it differs.
    """
    traced = inputs(0, 5)
    shapes = {name: free.get(name, {}) for name in traced}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it misses torchvision
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            torch.export.export(
                net.eval(), (traced,), dynamic_shapes=(shapes,), strict=False
            ),
            dynamo=True, verbose=False, opset_version=_OPSET,
            input_names=list(traced), output_names=list(outputs),
        )  # fmt: skip
        assert program is not None
        model = _bare(program.model_proto)
        again = inputs(1, 8)
        expected = [one.numpy() for one in net(again)]
    session = onnxruntime.InferenceSession(model.SerializeToString())
    used = {one.name for one in session.get_inputs()}
    feed = {name: each.numpy() for name, each in again.items() if name in used}
    for name, found, one in zip(outputs, session.run(None, feed), expected, strict=True):
        if not np.allclose(found, one, rtol=1e-3, atol=1e-3):
            off = np.nanmax(np.abs(found - one))
            raise WeightsError(f"The graph's {name} differs from torch's by {off:.2g}.")
    return model


def _bare(model: onnx.ModelProto) -> onnx.ModelProto:
    graph = model.graph
    for one in (*graph.node, *graph.input, *graph.output, *graph.initializer, graph, model):
        one.ClearField("metadata_props")
        one.ClearField("doc_string")
    graph.ClearField("value_info")
    return model


def _props(model: onnx.ModelProto) -> dict[str, str]:
    return {one.key: one.value for one in model.metadata_props}
