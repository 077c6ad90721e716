"""Commands and options of the release before, and what to write instead of each.

An option that is a key now still works: it is read as the key, and a line says so. All others are
refused with what to write. This is the only place that knows them; the next release drops it.
"""

import json
import re
import shlex
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import click

COMMANDS: Final = {
    "ablate": "python -m studies.ablation PLAN --out OUT",
    "benchmark": "deepmf-sumo run PLAN",
    "convert": "deepmf-sumo data convert",
    "record": "deepmf-sumo data record",
    "reproduce": "deepmf-sumo run paper --set source.recording=DIR",
    "scenes": "deepmf-sumo data list",
    "table": "deepmf-sumo show",
}
"""The ablation is in a clone of the repository alone."""

_DEVICE: Final = "DEEPMF_SUMO_DEVICE=cuda before the command, in the environment"
_THREADS: Final = "OMP_NUM_THREADS=N before the command, in the environment"
_SWEEP: Final = {
    "--executor": "--set sweep.executor=WHERE",
    "--device": _DEVICE,
    "--max-minutes": "--set sweep.max_minutes=M",
    "--timeout": "--set sweep.timeout_s=S",
    "--memory": "--set sweep.memory_mb=MB",
    "--gui": "--set sweep.gui=true",
    "--junit": "--set sweep.junit=true",
    "--thresholds": "--set sweep.thresholds=FILE, or deepmf-sumo check OUT --thresholds FILE",
    "--baseline": "--set sweep.baseline=RESULTS, or deepmf-sumo check OUT --baseline RESULTS",
}
_FIGURES: Final = {
    "--figures": "--set sweep.figures=true",
    "--no-figures": "--set sweep.figures=false",
}
_MOMENTS: Final = {
    "--polygon": "--set source.moments.polygon=FILE",
    "--prefer": "--set source.moments.prefer=HOW",
    "--draw": "--set source.moments.draw=HOW",
    "--duration": "--set duration_s=S",
    "--opponents": "--set opponents=HOW",
    "--tries": "--set adversary.tries=N",
    "--all-conflicts": '--set profile=any --set "adversary.constraints=[on_road]"',
}
_LIVE: Final = {
    "--pause": "--set live.pause_s=S",
    "--attacks": "--set live.attacks=N",
    "--http": "--set live.http=PORT",
}
_CHOSEN: Final = {
    "--av": "--set source.moments.av=ID",
    "--av-type": "--set source.moments.av_type=TYPE",
    "--at": "--set source.moments.at_s=[S]",
    "--from": "--set source.moments.from_s=S",
    "--until": "--set source.moments.until_s=S",
}

OPTIONS: Final[dict[str, dict[str, str]]] = {
    "attack": _SWEEP | {key: told for key, told in _MOMENTS.items() if key != "--tries"} | {
        "--av-type": _CHOSEN["--av-type"],
        "--risk": "--set sweep.risk=true", "--no-risk": "--set sweep.risk=false",
    },
    "run": _SWEEP | _FIGURES | {"--sumo": "--export fcd"},
    "try": _SWEEP | _MOMENTS | _CHOSEN,
    "attach": _LIVE | {
        "--host": "--port HOST:PORT",
        "--order": "--set live.order=N",
        "--wait": "--set live.wait_s=S",
        "--patience": "--set live.patience_s=S",
        "--net": "--set live.net=FILE",
    },
    "serve": _LIVE,
    "merge": dict.fromkeys(_FIGURES, "nothing: figures of a plan are drawn"),
    "risk": {"--top": "nothing: all places are in the tables of OUT/risk"},
    "export": {"--without-av": "--set without_av=true"},
    "conflicts": {"--ttc": "--set ttc_s=S", "--pet": "--set pet_s=S"},
    "schema": {"--out": "deepmf-sumo schema > FILE"},
    "show": {"--csv": "--format csv > FILE"},
    "data list": {"--csv": "--format csv > FILE"},
    "data record": {
        "--start": "--set start_s=S",
        "--every": "--set every_s=S",
        "--avs": "--set avs=N",
        "--diverse": "--set diverse=true",
        "--as-it-is": "--set diverse=false",
    },
    "evaluate": {
        "--json": "--format json > FILE",
        "--candidates": "nothing: 6, 16 and 32 modes are measured",
        "--threads": _THREADS,
        "--device": _DEVICE,
    },
    "train": {
        "--from": "--set begin_from=NAME",
        "--device": _DEVICE,
        "--threads": _THREADS,
    } | {
        f"--{key.replace('_', '-')}": f"--set {key}=VALUE"
        for key in (
            "preset", "members", "steps", "batch", "rate", "weight_decay", "clip", "ema",
            "precision", "evaluate_every", "patience", "seed", "licence",
        )
    },
}  # fmt: skip
"""By command and option: what to write instead; capitals stand for the option's value."""
_KEYS: Final = re.compile(r"--(?:set|export) ")
_VALUE: Final = re.compile(r"(?<==)(\[?)([A-Z]+)(\]?)$")
_TEXTS: Final = {"ID", "TYPE", "NAME", "FILE", "RESULTS"}
"""Values that are texts even if they look like numbers."""


def command(name: str) -> str:
    """The sentence of a command that is gone."""
    return f"There is no command '{name}' any more; write `{COMMANDS[name]}`."


def explained(error: click.NoSuchOption) -> click.UsageError:
    """The error; where its option is gone, one that says what to write instead."""
    path = error.ctx.command_path.partition(" ")[2] if error.ctx else ""
    instead = OPTIONS.get(path, {}).get(error.option_name)
    if instead is None:
        return error
    return click.UsageError(
        f"{path} has no {error.option_name} any more; write {instead}.", error.ctx
    )


def in_todays_words(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """A command line with its gone options as keys, and the lines that say what was read as what.

    ``arguments`` are without the program's name and without SUMO's options. Options that cannot be
    written as keys are left, and so are refused where the command line is parsed.
    """
    names = [one for before, one in pairwise(("", *arguments))
             if not one.startswith("-") and before != "--sumo-home"]  # fmt: skip
    path = next((one for one in (" ".join(names[:2]), *names[:1]) if one in OPTIONS), "")
    known = {key: told for key, told in OPTIONS.get(path, {}).items() if _KEYS.match(told)}
    found: list[str] = []
    told: dict[str, list[str]] = {}
    rest = list(arguments)
    while rest:
        one = rest.pop(0)
        option, equals, value = one.partition("=")
        if option not in known:
            found.append(one)
            continue
        instead = shlex.split(known[option].partition(", or ")[0])
        if any(_VALUE.search(part) for part in instead):
            if not equals and not rest:
                return list(arguments), []
            value = value if equals else rest.pop(0)
        elif equals:
            return list(arguments), []
        for flag, key in zip(instead[::2], instead[1::2], strict=True):
            told.setdefault(option, []).append(f"{flag} {_put(found, flag, key, value)}")
    lines = (f"{path}: {option} is gone; it is read as {' '.join(dict.fromkeys(keys[-2:]))}"
             for option, keys in told.items())  # fmt: skip
    return found, list(lines)


def _put(found: list[str], flag: str, key: str, value: str) -> str:
    """The key with the value, put into the command line; a list grows where it is given again."""
    stands = _VALUE.search(key)
    if stands is None:
        found += [flag, key]
        return key
    opens, name, _ = stands.groups()
    text = json.dumps(value, ensure_ascii=False) if name in _TEXTS else value
    head = key[: stands.start()] + opens
    before = next((at for at, one in enumerate(found) if opens and one.startswith(head)), None)
    if before is not None:
        found[before] = f"{found[before][:-1]}, {text}]"
        return found[before]
    found += [flag, f"{head}{text}{']' * bool(opens)}"]
    return found[-1]
