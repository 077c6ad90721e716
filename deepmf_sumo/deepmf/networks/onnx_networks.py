"""The networks as ONNX graphs: the runtime that needs no torch.

`training.onnx_graphs` writes them beside the tensors of a set: ``opponent.onnx``, and for each
trajectory network, or member of it, ``NAME.encode.onnx`` and ``NAME.decode.onnx``. Each graph
contains the digest of the tensors that it was made of, so that graphs of another training are
refused.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.deepmf.networks import encode, weights
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.decode import GoalSet, Singles
from deepmf_sumo.deepmf.networks.encode import Features
from deepmf_sumo.deepmf.networks.opponent import OTHERS, SLOTS, OpponentNetwork
from deepmf_sumo.deepmf.networks.predict import TrajectoryNetwork
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import FUTURE_STEPS, Floats

# onnxruntime 1.32 sends telemetry unless told not to. Its thread would also keep workers from being
# copied (`study.sweep.fork`), and without copies runs on a network depend on the runs before them.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime

ENCODE, DECODE = "encode", "decode"
KERNEL: Final = "kernel_m"
"""Key of a graph's metadata: `predict.TrajectoryNetwork.kernel_m`."""
PATHS: Final = ("paths", "path_info", "path_agents")
"""Arrays with a row for each path, whose unused rows are left out."""
_LARGEST_GRAPH: Final = 2**30


class OnnxRuntime:
    """See `weights.Runtime`."""

    def opponent(self, folder: Path) -> tuple[OpponentNetwork, dict[str, Any]]:
        """The opponent network."""
        card, preset = weights.network_card(folder, "opponent", "opponent")
        return OnnxOpponent(preset, Graph(folder, "opponent", "", card)), card

    def trajectory(
        self, folder: Path, network: Network, number: int = 1
    ) -> tuple[TrajectoryNetwork, dict[str, Any]]:
        """The marginal or conditional network, or one member of it."""
        stem = weights.member(network, number)
        card, preset = weights.network_card(folder, network, stem)
        encode, decode = (Graph(folder, stem, part, card) for part in (ENCODE, DECODE))
        kernel_m = np.array(json.loads(decode.metadata[KERNEL]), np.float32)
        return OnnxTrajectory(preset, kernel_m, encode, decode), card


class Graph:
    """One graph, computed with one thread.

    Raises WeightsError where its file is missing, damaged, or not of the card's tensors.
    """

    def __init__(self, folder: Path, stem: str, part: str, card: Mapping[str, Any]) -> None:
        file = folder / graph_file(stem, part)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            content = files.content(file, _LARGEST_GRAPH)
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except FileNotFoundError:
            raise _unusable(file, "is missing") from None
        except OSError as error:
            raise _unusable(file, f"cannot be read ({files.reason(error)})") from None
        except Exception as error:  # noqa: BLE001 - ONNX Runtime has a dozen, of no common kind
            raise _unusable(file, f"is damaged ({str(error)[:120]})") from None
        self.metadata = self._session.get_modelmeta().custom_metadata_map
        digest = card.get(weights.DIGEST)
        if digest is not None and self.metadata.get(weights.DIGEST) != digest:
            raise _unusable(file, f"was made of other tensors than {stem}.safetensors")
        self.inputs = [one.name for one in self._session.get_inputs()]
        self.outputs = [one.name for one in self._session.get_outputs()]

    def run(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Outputs by name, of arrays by name; those that are not inputs are left out."""
        found = self._session.run(None, {name: values[name] for name in self.inputs})
        return dict(zip(self.outputs, found, strict=True))


def graph_file(stem: str, part: str) -> str:
    """Name of a graph's file: of a network or member, and `ENCODE`, `DECODE` or nothing."""
    return ".".join(filter(None, (stem, part, "onnx")))


def _unusable(file: Path, what: str) -> WeightsError:
    name = file.parent.name
    return WeightsError(
        f"{file} {what}; where torch is installed, write it with `deepmf-sumo train onnx --name"
        f" {name}`."
    )


@dataclass(frozen=True, slots=True, eq=False)
class OnnxTrajectory:
    """See `predict.TrajectoryNetwork`."""

    preset: Preset
    kernel_m: Singles
    encode: Graph
    decode: Graph

    def scene_of(self, arrays: Features) -> dict[str, Any]:
        """See `predict.TrajectoryNetwork`."""
        used = max(int((arrays["path_info"][:, 0] > 0).sum()), 1)
        scene = _batch(arrays, PATHS, used, self.preset)
        return scene | self.encode.run(scene)

    def goals_of(
        self,
        encoding: dict[str, Any],
        position_m: Singles | None = None,
        heading_rad: Singles | None = None,
    ) -> GoalSet:
        """See `predict.TrajectoryNetwork`."""
        there = position_m is not None and heading_rad is not None
        if position_m is None or heading_rad is None:
            position_m = np.zeros((1, FUTURE_STEPS, 2), np.float32)
            heading_rad = np.zeros((1, FUTURE_STEPS), np.float32)
        given = {
            "position_m": position_m[None],
            "heading_rad": heading_rad[None],
            "given": np.full((1, len(position_m)), there, np.float32),
        }
        found = self.decode.run(encoding | given)
        return GoalSet(
            logits=found["logits"][0],
            along_m=encoding["along_m"][0],
            knots=found["knots"][0],
            paths=encoding["paths"][0],
        )


@dataclass(frozen=True, slots=True, eq=False)
class OnnxOpponent:
    """See `opponent.OpponentNetwork`."""

    preset: Preset
    graph: Graph

    def scored(self, arrays: Features) -> Floats:
        """See `opponent.OpponentNetwork`."""
        used = max(int((arrays["vehicle"] > 0).sum()), 1)
        values = _batch(arrays, SLOTS, used, self.preset)
        logits = np.zeros((OTHERS, 2))
        logits[:used] = self.graph.run(values)["logits"][:, 0].astype(np.float64).mean(0)
        return logits


def _batch(arrays: Features, rows: Sequence[str], used: int, preset: Preset) -> dict[str, Any]:
    """A batch of one scene with the image, and with the used ones of certain arrays' rows."""
    cut: dict[str, Any] = {name: arrays[name][:used] for name in rows if name in arrays}
    if preset.raster:
        cut["raster"] = encode.unpacked(arrays["raster"].astype(np.uint8), preset)
    return {name: each[None] for name, each in {**arrays, **cut}.items()}
