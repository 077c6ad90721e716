"""Recordings of each format: listed, their ids read, and each scene read by its id."""

import contextlib
import importlib.util
import io
import json
import pickle
import random
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.cli import data, main  # noqa: F401 - loaded once, not in each process
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import npz, read_by, womd
from deepmf_sumo.scene.readers.protos import scenario_pb2 as pb

from tests.fuzz import mutators, runner
from tests.support import argoverse_by_hand
from tests.support import recordings_by_hand as by_hand

for _name in plugins.names("readers"):
    plugins.load("readers", _name)


def _used(path: Path, out: Path) -> None:
    """As `data list`, `run` and `data record` use a recording."""
    refused = False
    for name in dict.fromkeys(readers.ids(path, out)):
        try:
            scene = readers.scene(path, name, out)
        except DeepmfError:
            refused = True
            continue
        npz.write(scene, out / "scene.npz")
    runner.command("data", "list", path, "--format", "csv")
    if refused:
        raise DeepmfError("a scene was refused")


def _shard(folder: Path) -> Path:
    messages = [by_hand.scenario(name=name) for name in ("one", "two")]
    return by_hand.shard(folder / "scenes.tfrecord", *messages)


def _change_shard(rng: random.Random, path: Path) -> None:
    if rng.random() < 0.3:  # the framing
        mutators.file(rng, path)
        return
    payloads = [one.payload for one in womd.records(path) if isinstance(one, womd.TfRecord)]
    at = rng.randrange(len(payloads))
    if rng.random() < 0.4:
        payloads[at] = mutators.damage(rng, payloads[at])
    else:
        message = pb.Scenario.FromString(payloads[at])
        for _ in range(rng.randint(1, 3)):
            _bend_message(rng, message)
        payloads[at] = message.SerializeToString()
    path.write_bytes(b"".join(map(womd.framed, payloads)))


def _bend_message(rng: random.Random, message: Any) -> None:
    """One field of a message at any depth."""
    fields = message.ListFields()
    while fields:
        field, value = rng.choice(fields)
        if field.message_type is None:
            break
        message = rng.choice(value) if hasattr(value, "append") else value
        fields = message.ListFields()
    if not fields or rng.random() < 0.1:
        message.Clear()
        return
    field, value = rng.choice(fields)
    if field.message_type is not None or rng.random() < 0.2:
        message.ClearField(field.name)
        return
    new = rng.choice(mutators.TEXTS if field.type == field.TYPE_STRING else mutators.NUMBERS)
    try:
        if hasattr(value, "append"):
            value[rng.randrange(len(value))] = new
        else:
            setattr(message, field.name, new)
    except (TypeError, ValueError, OverflowError, UnicodeEncodeError):
        message.ClearField(field.name)


def _pickle(folder: Path) -> Path:
    path = folder / "scene.pkl"
    path.write_bytes(pickle.dumps(by_hand.scenarionet(by_hand.scenario()), 4))
    return path


def _change_pickle(rng: random.Random, path: Path) -> None:
    if rng.random() < 0.5:
        mutators.file(rng, path)
        return
    tree = mutators.bent(rng, pickle.loads(path.read_bytes()))
    if isinstance(tree, dict) and rng.random() < 0.5:
        _bend_array(rng, tree)
    path.write_bytes(pickle.dumps(tree, rng.randint(2, 5)))


def _bend_array(rng: random.Random, tree: Any) -> None:
    """One array of nested dicts, of another type or shape."""
    holders: list[tuple[Any, Any]] = []
    stack = [tree]
    while stack:
        one = stack.pop()
        for key, value in one.items():
            if isinstance(value, dict):
                stack.append(value)
            elif isinstance(value, np.ndarray):
                holders.append((one, key))
    if holders:
        holder, key = rng.choice(holders)
        holder[key] = _bent_array(rng, holder[key])


def _bent_array(rng: random.Random, array: np.ndarray) -> np.ndarray:
    match rng.randrange(7):
        case 0:
            return array.astype("O")
        case 1:
            return array.astype("S4")
        case 2:
            return array[: len(array) // 2] if array.ndim else array[None]
        case 3:
            return array[..., None]
        case 4:
            return array.reshape(-1)
        case 5:
            return array.astype("c16")
        case _:
            bent = array.astype(float).copy()
            bent.flat[rng.randrange(max(bent.size, 1)) if bent.size else slice(0)] = float(
                rng.choice((np.nan, np.inf, 1e300, -1))
            )
            return bent


def _json(folder: Path) -> Path:
    path = folder / "scene.json"
    path.write_text(json.dumps(by_hand.gpudrive(by_hand.scenario())))
    return path


def _early_json(folder: Path) -> Path:
    path = folder / "scene.json"
    described = by_hand.gpudrive(by_hand.scenario())
    path.write_text(json.dumps(by_hand.nocturne_early(described)))
    return path


def _change_json(rng: random.Random, path: Path) -> None:
    if rng.random() < 0.4:
        mutators.file(rng, path)
    else:
        path.write_text(json.dumps(mutators.bent(rng, json.loads(path.read_bytes()))))


def _npz(folder: Path) -> Path:
    (scene,) = read_by(womd, by_hand.shard(folder / "one.tfrecord", by_hand.scenario()))
    npz.write(scene, folder / "scene.npz")
    (folder / "one.tfrecord").unlink()
    return folder / "scene.npz"


def _change_npz(rng: random.Random, path: Path) -> None:
    if rng.random() < 0.25:
        mutators.file(rng, path)
        return
    with np.load(path) as stored:
        arrays = dict(stored)
    if rng.random() < 0.6:
        described = mutators.bent(rng, json.loads(arrays["description"].tobytes()))
        text = json.dumps(described).encode()
        if rng.random() < 0.1:
            text = mutators.damage(rng, text)
        arrays["description"] = np.frombuffer(text, "uint8")
    else:
        name = rng.choice(sorted(arrays))
        arrays[name] = _bent_array(rng, arrays[name])
        if rng.random() < 0.2:
            del arrays[name]
    members = {name: _member(array) for name, array in arrays.items()}
    if rng.random() < 0.2:
        name = rng.choice(sorted(members))
        members[name] = mutators.damage(rng, members[name])
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)


def _member(array: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array(content, array, allow_pickle=True)
    return content.getvalue()


def _scenario(folder: Path) -> Path:
    return argoverse_by_hand.scenario(folder / "abc")


def _change_scenario(rng: random.Random, folder: Path) -> None:
    """The map, a column, or bytes of either file."""
    (table,), (described,) = folder.glob("*.parquet"), folder.glob("*.json")
    if rng.random() < 0.3:
        mutators.file(rng, rng.choice([table, described]))
    elif rng.random() < 0.6:
        described.write_text(json.dumps(mutators.bent(rng, json.loads(described.read_text()))))
    else:
        with contextlib.suppress(Exception):  # pandas and pyarrow refuse some values
            _bend_column(rng, table)


def _bend_column(rng: random.Random, table: Path) -> None:
    import pandas as pd

    rows = pd.read_parquet(table)
    column = rng.choice(list(rows.columns))
    change = rng.choice(["all", "one", "drop"])
    values = rows.pop(column)
    if change != "drop":
        value = rng.choice([*mutators.NUMBERS, *mutators.TEXTS, None])
        values = values.astype(object)
        values.iloc[slice(None) if change == "all" else rng.randrange(len(rows))] = value
        rows[column] = values.map(str) if isinstance(value, str) else values
    rows.to_parquet(table)


KINDS = (
    runner.Kind("womd", _shard, _change_shard, _used),
    runner.Kind("scenarionet", _pickle, _change_pickle, _used),
    runner.Kind("gpudrive", _json, _change_json, _used),
    runner.Kind("nocturne", _early_json, _change_json, _used),
    runner.Kind("npz", _npz, _change_npz, _used),
)
if importlib.util.find_spec("pyarrow"):
    KINDS = (*KINDS, runner.Kind("argoverse2", _scenario, _change_scenario, _used))
