"""What `evaluate` shows: a table for each predictor."""

from collections.abc import Sequence
from typing import Any, Final

from rich.table import Table

from deepmf_sumo.cli._screen import escape, wide

_SECONDS: Final = ("1.0", "2.0", "3.0", "5.0", "8.0")
_LATE: Final = ("3.0", "5.0", "8.0")
_BASELINES: Final = {
    "constant_velocity": "constant velocity",
    "lane_following": "lane following, constant speed",
    "clusters": "map-blind clusters",
}
_RULES: Final = {
    "corridor": "corridor formula",
    "nearest": "nearest vehicle",
    "nearest_moving": "nearest moving vehicle",
    "constant_velocity": "constant-velocity approach",
}

_CERTAINTY: Final = {
    "ece": "ECE",
    "ece_if_right": "  expected if calibrated",
    "ece_if_right_95": "  at most if calibrated, in 95 %",
    "ece_of_horizon": "  modes chosen for each time",
    "ece_uncalibrated": "ECE at temperature 1",
    "negative_log_likelihood": "negative log likelihood, nats",
    "log_likelihood_standard_error": "  ±",
}


def show(found: dict[str, Any]) -> None:
    """All tables, of the nested figures that `training.evaluation.evaluate` gives."""
    console = wide()
    data, refused = ", ".join(found["data"]), found["refused"]
    console.print(
        escape(f"weights {found['weights']} on {data}: {found['scenes']} scenes, {refused} refused")
    )
    for reason in found["refusals"]:
        console.print(escape(f"  refused: {reason}"), style="yellow", soft_wrap=True)
    if refused > len(found["refusals"]):
        console.print(f"  and {refused - len(found['refusals'])} more", style="yellow")
    parts = [
        *_opponent(found["opponent"]),
        *_marginal(found["marginal"], found["modes"]),
        *_conditional(found["conditional"], found["modes"]),
        *_reactions(found["conditional"]["reactions"]),
    ]
    for part in parts:
        if isinstance(part, str):
            console.print(escape(part), soft_wrap=True)
        else:
            console.print()
            console.print(part)


def _opponent(found: dict[str, Any]) -> list[Table | str]:
    if not found["scenes"]:
        return ["Opponent: all scenes are simulated attacks, which have made their own labels."]
    scenes, partners = found["scenes"], found["scenes_with_partner"]
    table = _table(
        "Opponent", "AUROC", "AP", f"first is a positive /{scenes}",
        "among first 3", f"partner first /{partners}", f"among first 3 /{partners}",
    )  # fmt: skip
    for group, label in ((found, "all"), (found["attackable"], "attackable")):
        table.add_row(f"network, {label} {group['candidates']} candidates", *_ranks(group))
        for name, title in _RULES.items():
            table.add_row(f"  {title}", *_ranks(group["baselines"][name]))
    note = (
        f"{found['positives']} positives in {found['scenes_with_positive']} scenes. The attack "
        f"leaves {found['parked']} parked candidates out ({found['positives_parked']} positives, "
        f"{found['partners_parked']} partners). "
        f"ECE {_number(found['ece'])}, at temperature 1 {_number(found['ece_uncalibrated'])}; "
        f"calibrated scores would show {_number(found['ece_if_right'])}, "
        f"at most {_number(found['ece_if_right_95'])} in 95 %."
    )
    return [table, note]


def _ranks(found: dict[str, Any]) -> list[str]:
    counts = (
        "top1_positive_scenes", "top3_positive_scenes", "partner_top1_scenes",
        "partner_top3_scenes",
    )  # fmt: skip
    return [
        _number(found["auroc"]),
        _number(found["average_precision"]),
        *(_number(found.get(name)) for name in counts),
    ]


def _marginal(found: dict[str, Any], modes: Sequence[int]) -> list[Table | str]:
    ends = _table("Marginal: least error", "modes", *(f"{key} s" for key in _SECONDS), "± at 8.0 s")
    ways = _whole_ways("Marginal: the whole path", "network", found, modes)
    for count in map(str, modes):
        ends.add_row("network", count, *_ends(found, count))
    for count in map(str, modes):
        chosen = (_number(found[key]["min_fde_of_horizon"][count]) for key in _SECONDS)
        ends.add_row("  modes chosen for each time", count, *chosen)
    likeliest = (_number(found[key]["most_probable_fde"]) for key in _SECONDS)
    ends.add_row("  most probable mode", "1", *likeliest)
    for name, title in _BASELINES.items():
        known = {key: found[key]["baselines"].get(name) for key in _SECONDS}
        for count in known["8.0"]["min_fde"] if known["8.0"] else ():
            ends.add_row(f"  {title}", count, *_ends(known, count))
            ways.add_row(f"  {title}", count, *_ways(known, count))
    note = f"{found['targets']} objects; metres. Map-blind clusters: {found['clusters']}."
    return [ends, note, ways, _calibration("Marginal", found)]


def _whole_ways(title: str, name: str, found: dict[str, Any], modes: Sequence[int]) -> Table:
    """Mean errors and misses at three times, and how plausible the modes are, and what happened."""
    table = _table(
        title, "modes", *(f"ADE {key}" for key in _LATE), *(f"miss {key}" for key in _LATE),
        "clear 8.0", "on road 8.0",
    )  # fmt: skip
    shares = [found["8.0"][kind] for kind in ("overlap_free", "on_road")]
    for count in map(str, modes):
        table.add_row(name, count, *_ways(found, count), *(_number(s[count]) for s in shares))
    table.add_row("  recorded", *[""] * 7, *(_number(share["recorded"]) for share in shares))
    return table


def _calibration(title: str, found: dict[str, Any]) -> Table:
    table = _table(f"{title}: certainty of 6 modes", *(f"{key} s" for key in _LATE))
    for name, label in _CERTAINTY.items():
        if name in found["8.0"]:
            table.add_row(label, *(_number(found[key][name]) for key in _LATE))
    return table


def _ends(found: dict[str, Any], count: str) -> list[str]:
    """Cells of one number of modes: minFDE at five times, and its standard error at 8 s."""
    return [
        *(_number(found[key]["min_fde"][count]) for key in _SECONDS),
        _number(found["8.0"]["min_fde_standard_error"][count]),
    ]


def _ways(found: dict[str, Any], count: str) -> list[str]:
    """Cells of one number of modes: minADE and miss rate at three times."""
    cells = [(found[key], name) for name in ("min_ade", "miss_rate") for key in _LATE]
    return [_number(each[name][count]) for each, name in cells]


def _conditional(found: dict[str, Any], modes: Sequence[int]) -> list[Table | str]:
    if not found["targets"]:
        return [
            "Conditional: no vehicles come near each other in these recordings; nothing to measure."
        ]
    names = {
        "marginal": "marginal network",
        "given_nothing": "conditional, given nothing",
        "given_true": "conditional, given the true future",
        "given_shuffled": "conditional, given a shuffled one",
    }
    errors = _table(
        f"Conditional: least error, {found['targets']} objects", "modes",
        *(f"{key} s" for key in _SECONDS), "± at 8.0 s",
    )  # fmt: skip
    for name, title in names.items():
        for count in map(str, modes):
            cells = [_number(found[key][f"min_fde_{name}"][count]) for key in _SECONDS]
            error = found["8.0"][f"min_fde_{name}_standard_error"][count]
            errors.add_row(title, count, *cells, _number(error))
        cells = [_number(found[key]["most_probable_fde"][name]) for key in _SECONDS]
        errors.add_row("  most probable mode", "1", *cells)
    title = "Conditional, given the truth"
    ways = _whole_ways(f"{title}: the whole path", "network", found, modes)
    return [errors, ways, _calibration(title, found), _gains(found)]


def _gains(found: dict[str, Any]) -> Table:
    table = _table(
        "Conditional: gain in log likelihood, nats", "at 8.0 s", *(f"{key} s" for key in _LATE)
    )
    for role, title in (("both", "both"), ("av", "AV"), ("partner", "partner")):
        groups = [found[key] if role == "both" else found[key]["by_role"][role] for key in _LATE]
        if not any(each["objects"] for each in groups):
            continue
        for given in ("true", "shuffled"):
            for suffix, against in (("", "marginal network"), ("_over_nothing", "given nothing")):
                label = f"log_likelihood_gain_{given}{suffix}"
                cells = [
                    f"{_signed(each[label])} ± {_number(each[f'{label}_standard_error'])}"
                    for each in groups
                ]
                name = f"{title}: given {given} - {against}"
                table.add_row(name, str(groups[-1]["log_likelihood_objects"]), *cells)
    return table


def _reactions(found: dict[str, Any]) -> list[Table | str]:
    if not any(each["objects"] for each in found.values()):
        return []
    table = _table(
        "Conditional: AVs attacked in simulation, m", "s", "objects", "given the opponent",
        "given nothing", "marginal network", "gain",
    )  # fmt: skip
    for key, each in found.items():
        for name in ("most_probable", "best_of_6"):
            cells = each[name]
            table.add_row(
                name.replace("_", " "),
                key,
                str(each["objects"]),
                *(_number(cells[label]) for label in ("reactive", "blind", "marginal")),
                f"{_signed(cells['gain'])} ± {_number(cells['gain_standard_error'])}",
            )
    return [table]


def _table(title: str, *headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(title, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3f}"


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.3f}"
