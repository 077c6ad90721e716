"""Commands and options of the release before, and what to write instead of each.

This is the only place that knows them. The next release drops it.
"""

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
    "--opponents": "--set opponents=one or --set opponents=in_turn",
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
"""By command and option: what to write instead."""


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
