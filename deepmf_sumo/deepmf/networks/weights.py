"""Sets of weights: a folder with a tensor file and a card for each network.

Every set contains the three networks of the paper. The motion priors of STRIVE and DiffScene are
optional, and loaded only by these baselines. The marginal network may have several members, each in
its own files (``marginal``, ``marginal-2``, ...): the card of the first one lists them under
``members``, with the temperature of their mixture.

Torch computes networks from their tensors, ONNX Runtime from graphs that are made of these
(`onnx_networks`); `runtime_name` says which, and ``$DEEPMF_SUMO_DEVICE`` where torch does.

A card contains the digest of its tensor file: a file that was changed, or belongs to another card,
is refused. Cards of earlier versions have none; `load` warns of them (`unchecked`).

``open`` is part of the package. Other names are looked up in ``$DEEPMF_SUMO_HOME/weights`` and in
``.weights`` of the working directory; a path to a folder works as well.
"""

import hashlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from deepmf_sumo import files as files_module
from deepmf_sumo.deepmf.networks import people_net
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.opponent import Opponent, OpponentNetwork
from deepmf_sumo.deepmf.networks.people import People
from deepmf_sumo.deepmf.networks.people_net import PeopleNet
from deepmf_sumo.deepmf.networks.predict import Conditional, Marginal, TrajectoryNetwork
from deepmf_sumo.errors import WeightsError

Network = Literal["opponent", "marginal", "conditional", "people", "strive", "diffscene"]
NETWORKS: Final[tuple[Network, ...]] = ("opponent", "marginal", "conditional")
"""Networks of the paper, which every set contains."""
PEOPLE: Final[Network] = "people"
"""The network of people, which a set may lack: then `people` predicts them without it."""
BASELINES: Final[tuple[Network, ...]] = ("strive", "diffscene")
"""Networks of single baselines, which a set may lack."""
RUNTIME: Final = "DEEPMF_SUMO_RUNTIME"
RUNTIMES: Final = ("torch", "onnx")
_PACKAGES: Final = {"torch": "torch", "onnx": "onnxruntime"}
DEVICE: Final = "DEEPMF_SUMO_DEVICE"
DEVICES: Final = ("cpu", "cuda", "auto")
FORMAT_VERSION: Final = 1
DIGEST: Final = "tensors_sha256"
"""Key of a card: the digest of its tensor file."""
_LARGEST_CARD: Final = 2**20
LARGEST_TENSORS: Final = 2**30
_MOST_MEMBERS: Final = 64
_LARGEST_NUMBER: Final = 1e6
"""Of a temperature or offset; fitted ones are within 0.1 to 10."""
_TEMPERATURES: Final[dict[Network, tuple[str, ...]]] = {
    "opponent": ("temperature", "partner_temperature"),
    "marginal": ("temperature",),
    "conditional": ("temperature",),
    "people": (),
    "strive": (),
    "diffscene": (),
}
"""Keys of a network's card whose values are numbers above 0, at most 1e6."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictors:
    """The three predictors of one set of weights, and that of people.

    Attributes:
        name: as given to `load`. folder: None for random weights.
    """

    name: str
    folder: Path | None
    opponent: Opponent
    marginal: Marginal
    conditional: Conditional
    people: People = field(default_factory=People)


def load(name: str | Path, computed_by: str | None = None) -> Predictors:
    """The predictors of a name or folder; ``computed_by`` another runtime than `runtime_name`.

    Raises WeightsError where they cannot be used.
    """
    folder = find(name)
    lacking = unchecked(folder)
    if lacking:
        sys.stderr.write(
            f"weights {name}: {len(lacking)} cards without a digest of the tensors, which an"
            f" earlier version wrote ({', '.join(lacking)}): whether files were changed is not"
            " known\n"
        )
    read = runtime(computed_by or runtime_name())
    opponent, opponent_card = read.opponent(folder)
    marginal, marginal_card = _members(folder, read)
    conditional, conditional_card = read.trajectory(folder, "conditional")
    alone = Marginal(marginal, marginal_card["temperature"])
    return Predictors(
        name=str(name),
        folder=folder,
        opponent=Opponent(
            opponent,
            opponent_card["temperature"],
            opponent_card["partner_temperature"],
            opponent_card.get("offset", 0.0),
        ),
        marginal=alone,
        conditional=Conditional(
            conditional,
            conditional_card["temperature"],
            marginal=alone if _same_paths(alone.net, conditional) else None,
        ),
        people=People(people_net_of(folder)),
    )


def people_net_of(folder: Path) -> PeopleNet | None:
    """The network of people of a set; None of a set without one.

    Raises WeightsError where it is not whole.
    """
    if not (folder / f"{PEOPLE}.json").is_file():
        return None
    card = read_card(folder, PEOPLE)
    tensors = content(folder, PEOPLE, card.get(DIGEST, ""))
    why = f": it reads inputs {card.get('inputs')!r:.20}, not {people_net.INPUTS_VERSION}"
    if card.get("inputs") == people_net.INPUTS_VERSION:
        try:
            return PeopleNet.read(tensors)
        except ValueError as error:
            why = f" ({error})"
    raise broken(folder, PEOPLE, f"{PEOPLE}.safetensors is damaged{why}")


def without_people(folder: Path) -> str:
    """A sentence on a set that has no network of people; empty of a set with one."""
    if (folder / f"{PEOPLE}.json").is_file():
        return ""
    return "pedestrians and cyclists are predicted by published speeds, without trained weights"


def check(name: str | Path) -> None:
    """Raise WeightsError where a set is not whole, as far as that shows without what computes it.

    That takes milliseconds; `load` takes seconds with torch. ONNX graphs are loaded, for later.
    """
    folder = find(name)
    runtime_and_device()  # raises where the environment asks for what is not there
    need(_PACKAGES[runtime_name()], f"{RUNTIME}={runtime_name()}")
    if runtime_name() != "torch":
        cached_predictors(name)
        return
    for network in NETWORKS:
        first = read_card(folder, network)
        count = len(members(folder, first)) if network == "marginal" else 1
        for number in range(1, count + 1):
            stem = member(network, number)
            card, _ = network_card(folder, network, stem)
            content(folder, stem, card.get(DIGEST))
    people_net_of(folder)


def content(folder: Path, network: str, digest: object = None) -> bytes:
    """The file with the tensors of one network or `member`.

    Raises WeightsError where it cannot be read, or has another digest than the one given.
    """
    file = folder / f"{network}.safetensors"
    try:
        found = files_module.content(file, LARGEST_TENSORS)
    except FileNotFoundError:
        raise missing(folder, file) from None
    except OSError as error:
        why = f" ({files_module.reason(error)})"
        raise broken(folder, network, f"{file.name} is damaged{why}") from None
    if digest is not None and digest != digest_of(found):
        why = f", or of another training than its card: its digest is not the card's {DIGEST}"
        raise broken(folder, network, f"{file.name} is damaged{why}")
    return found


def _same_paths(*nets: TrajectoryNetwork) -> bool:
    """Whether all networks have goals on all paths; of dense goals each chooses paths itself."""
    return all(net.preset.head == "paths" for net in nets)


class Runtime(Protocol):
    """What computes the networks: reads them, with their cards.

    The methods raise WeightsError where a network is not whole.
    """

    def opponent(self, folder: Path) -> tuple[OpponentNetwork, dict[str, Any]]:
        """The opponent network."""
        ...

    def trajectory(
        self, folder: Path, network: Network, number: int = 1
    ) -> tuple[TrajectoryNetwork, dict[str, Any]]:
        """The marginal or conditional network, or one member of it."""
        ...


def _members(folder: Path, read: Runtime) -> tuple[list[TrajectoryNetwork], dict[str, Any]]:
    """The members of the marginal network, and the first one's card.

    Raises WeightsError where one is missing, of other sizes, or not the one that the card lists.
    """
    first, card = read.trajectory(folder, "marginal")
    nets = [first]
    sizes = replace(first.preset, name="", dropout=0.0)  # all that features and tensors depend on
    for number, digest in enumerate(members(folder, card)[1:], start=2):
        stem = member("marginal", number)
        net, own = read.trajectory(folder, "marginal", number)
        if replace(net.preset, name="", dropout=0.0) != sizes:
            raise broken(folder, stem, f"{stem}.json has other sizes than marginal.json")
        if own.get("training_digest") != digest:
            what = f"{stem}.safetensors is not the member that marginal.json lists, with which its"
            raise broken(folder, stem, f"{what} temperature was fitted")
        nets.append(net)
    return nets, card


def runtime_name() -> str:
    """``torch`` or ``onnx``: what `load` computes networks with.

    ``$DEEPMF_SUMO_RUNTIME`` if it is set, else torch where it is installed. Raises WeightsError for
    other names.
    """
    name = os.environ.get(RUNTIME) or ("torch" if find_spec("torch") else "onnx")
    if name not in RUNTIMES:
        raise WeightsError(f"{RUNTIME} is {name!r:.80}; set it to {' or '.join(RUNTIMES)}.")
    return name


def runtime_and_device() -> str:
    """What computes networks here, for the manifest: ``torch``, ``onnx``, or ``torch on cuda``."""
    name = runtime_name()
    if name != "torch" or os.environ.get(DEVICE, "cpu") == "cpu":
        return name
    from deepmf_sumo.deepmf.networks.torch_networks import device

    return name if device() == "cpu" else f"{name} on {device()}"


def need(package: str, what: str) -> None:
    """Raise WeightsError where a package is not installed, which ``what`` needs."""
    if find_spec(package) is None:
        raise WeightsError(
            f"{what} needs {package}, which is not installed; run `pip install {package}`."
        )


def runtime(name: str) -> Runtime:
    """One of `RUNTIMES`. Raises WeightsError where it is not installed."""
    need(_PACKAGES[name], f"{RUNTIME}={name}")
    if name == "torch":
        from deepmf_sumo.deepmf.networks.torch_networks import TorchRuntime

        return TorchRuntime()
    from deepmf_sumo.deepmf.networks.onnx_networks import OnnxRuntime

    return OnnxRuntime()


def members(folder: Path, card: dict[str, Any]) -> list[str | None]:
    """Digest of the training of each member; a card without a list is that of a single network."""
    if "members" not in card:
        return [card.get("training_digest")]
    listed = card["members"]
    right = isinstance(listed, list) and all(isinstance(one, dict) for one in listed)
    if not (right and 0 < len(listed) <= _MOST_MEMBERS):
        what = f"marginal.json has members {str(listed)[:80]!r}; it must be a list of"
        raise broken(folder, "marginal", f"{what} 1 to {_MOST_MEMBERS} trained networks")
    return [one.get("training_digest") for one in listed]


def member(network: Network, number: int) -> str:
    """Name of a member's files, without suffix; members count from 1."""
    return network if number == 1 else f"{network}-{number}"


def listed(folder: Path) -> list[str]:
    """Names of all networks and members that have a card in a folder, in a fixed order.

    Raises WeightsError where the marginal network's card cannot be read.
    """
    names: list[str] = [*NETWORKS, PEOPLE, *BASELINES]
    if (folder / "marginal.json").is_file():
        count = len(members(folder, read_card(folder, "marginal")))
        after = names.index("marginal") + 1
        names[after:after] = [member("marginal", number) for number in range(2, count + 1)]
    return [name for name in names if (folder / f"{name}.json").is_file()]


def unchecked(folder: Path) -> list[str]:
    """The networks and members of a folder whose cards have no digest of their tensors.

    Raises WeightsError where a card cannot be read.
    """
    return [name for name in listed(folder) if DIGEST not in read_card(folder, name)]


def digest_of(content: bytes) -> str:
    """Of a tensor file, for its card."""
    return hashlib.sha256(content).hexdigest()


def find(name: str | Path) -> Path:
    """The folder of a set of weights. Raises WeightsError, with all places that were tried."""
    places = list(dict.fromkeys(_places(name)))
    for place in places:
        with suppress(OSError, ValueError):  # a name that no folder can have
            if place.is_dir():
                return place
    tried = ", ".join(str(place)[:200] for place in places)
    raise WeightsError(
        f"There are no weights '{name!s:.80}': none of these folders exists: {tried}. Use 'open',"
        " or make them with `deepmf-sumo train all --data RECORDINGS --name"
        f" {Path(name).name[:80]}`."
    )


def place(name: str) -> Path:
    """Folder that a new set of a name is written to: the package's own for ``open``, else home."""
    return _places("open")[0] if name == "open" else home() / name


def home() -> Path:
    """Where new sets of weights are kept: ``$DEEPMF_SUMO_HOME/weights``, else ``.weights``."""
    root = os.environ.get("DEEPMF_SUMO_HOME")
    return Path(root) / "weights" if root else Path(".weights")


def read_card(folder: Path, network: str) -> dict[str, Any]:
    """The card of one network or `member`. Raises WeightsError where it is missing or no card."""
    file = folder / f"{network}.json"
    try:
        card: Any = json.loads(files_module.content(file, _LARGEST_CARD))
        why = "" if isinstance(card, dict) else "no mapping"
    except FileNotFoundError:
        raise missing(folder, file) from None
    except OSError as error:
        why = files_module.reason(error)
    except ValueError as error:
        why = f"{error}"[:200]
    except RecursionError:
        why = "nested too deeply"
    if why:
        raise broken(folder, network, f"{file.name} is not a card ({why})")
    version = card.get("format_version")
    if version != FORMAT_VERSION:
        what = f"{file.name} has format_version {version!r:.80}, not {FORMAT_VERSION}"
        raise broken(folder, network, what)
    return card


def network_card(folder: Path, network: Network, stem: str) -> tuple[dict[str, Any], Preset]:
    """The card of a network's files ``stem``, and its sizes. Raises WeightsError for bad values."""
    card = read_card(folder, stem)
    for key in _TEMPERATURES[network]:
        value = card.get(key)
        if not (isinstance(value, int | float) and 0.0 < value <= _LARGEST_NUMBER):
            what = f"{stem}.json has {key} {value!r:.80}; it must be a number above 0, at most"
            raise broken(folder, stem, f"{what} {_LARGEST_NUMBER:g}")
    offset = card.get("offset", 0.0)
    if not (isinstance(offset, int | float) and abs(offset) <= _LARGEST_NUMBER):
        what = f"{stem}.json has offset {offset!r:.80}; it must be a number, at most"
        raise broken(folder, stem, f"{what} {_LARGEST_NUMBER:g}")
    try:
        return card, Preset.from_record(card.get("sizes"))
    except WeightsError as error:
        raise WeightsError(f"{folder / stem}.json: {error} {_again(folder, stem)}.") from None


def _places(name: str | Path) -> tuple[Path, ...]:
    if str(name) == "open":
        return (Path(__file__).resolve().parents[2] / "weights" / "open",)
    if isinstance(name, Path) or len(Path(name).parts) > 1:
        return (Path(name),)
    return (home() / name, Path(".weights") / name, Path(name))


def missing(folder: Path, file: Path) -> WeightsError:
    """The error for a file that a set lacks."""
    what = f"The weights in {folder} are incomplete: {file.name} is missing"
    return WeightsError(f"{what}; {_again(folder, file.stem)}.")


def broken(folder: Path, stem: str, what: str) -> WeightsError:
    """The error for a file of a folder; ``what`` starts with the file's name."""
    return WeightsError(f"{folder}{os.sep}{what}; {_again(folder, stem)}.")


def _again(folder: Path, stem: str) -> str:
    network, _, number = stem.partition("-")
    members = f" --set members={number}" if number else ""
    return (
        f"make it with `deepmf-sumo train {network}{members} --data RECORDINGS"
        f" --name {folder.name}`"
    )


def cached_predictors(name: str | Path, computed_by: str | None = None) -> Predictors:
    """As `load`; read again where a file of its networks has changed since.

    Raises WeightsError where they cannot be used.
    """
    folder = find(name).resolve()
    files = [
        file  # members of a network have names that begin like its own
        for network in (*NETWORKS, PEOPLE)
        for suffix in ("safetensors", "onnx", "json")
        for file in sorted(folder.glob(f"{network}*.{suffix}"))
    ]
    changed = tuple((file.name, file.stat().st_mtime_ns) for file in files)
    place = os.environ.get(DEVICE, "cpu")
    return _loaded(folder, computed_by or runtime_name(), place, changed)


@lru_cache(maxsize=4)
def _loaded(
    folder: Path,
    computed_by: str,
    place: str,  # noqa: ARG001 - part of the key
    changed: tuple[tuple[str, int], ...],  # noqa: ARG001 - part of the key
) -> Predictors:
    return load(folder, computed_by)


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch, if it computes, and afterwards as many as before.

    The networks are small: on cores that SUMO and others use as well, several threads wait for one
    another most of the time. The number is the whole process's, which may be a user's script.
    """
    if runtime_name() != "torch":
        yield
        return
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
