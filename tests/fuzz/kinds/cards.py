"""Sets of weights: cards and tensors, loaded as an attack does."""

import json
import random
import shutil
from pathlib import Path

import deepmf_sumo
from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.deepmf.networks import weights

from tests.fuzz import mutators, runner

_OPEN = Path(deepmf_sumo.__file__).parent / "weights" / "open"
_CARDS = (*weights.NETWORKS, *weights.BASELINES)


def _make(folder: Path) -> Path:
    return Path(shutil.copytree(_OPEN, folder / "set"))


def _change(rng: random.Random, folder: Path) -> None:
    network = rng.choice(_CARDS)
    card, tensors = folder / f"{network}.json", folder / f"{network}.safetensors"
    match rng.randrange(5):
        case 0:
            mutators.file(rng, card)
        case 1:
            mutators.file(rng, tensors)
        case 2:  # with the digest of what it is now
            mutators.file(rng, tensors)
            values = json.loads(card.read_text())
            values[weights.DIGEST] = weights.digest_of(tensors.read_bytes())
            card.write_text(json.dumps(values))
        case 3:
            values = json.loads(card.read_text())
            values["sizes"] = mutators.bent(rng, values["sizes"])
            card.write_text(_text(values))
        case _:
            card.write_text(_text(mutators.bent(rng, json.loads(card.read_text()))))


def _text(values: object) -> str:
    try:
        return json.dumps(values)
    except ValueError:  # a number of too many digits to be written in decimals
        return "1" + "0" * 5000


def _use(folder: Path, out: Path) -> None:
    weights.load(folder)
    reading.motion_prior(folder)
    reading.diffusion_prior(folder)
    weights.unchecked(folder)


KINDS = (runner.Kind("cards", _make, _change, _use),)
