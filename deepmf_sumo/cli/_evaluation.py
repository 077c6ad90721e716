"""What `evaluate` shows: views of the table of figures."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

from rich.table import Table

from deepmf_sumo.cli._screen import escape, wide
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.scene.road_users import PEOPLE
from deepmf_sumo.training.evaluation import Evaluation, Figure

_SECONDS: Final = (1.0, 2.0, 3.0, 5.0, 8.0)
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
_CONDITIONS: Final = {
    "marginal": "marginal network",
    "given_nothing": "conditional, given nothing",
    "given_true": "conditional, given the true future",
    "given_shuffled": "conditional, given a shuffled one",
}
_KNOTS_S: Final = (1.0, 2.0, 4.0, 6.0, 8.0)
_GROUPS: Final = {"all": "both", "av": "AV", "partner": "partner"}
_GAINS: Final = {
    "log_likelihood_gain": "marginal network",
    "log_likelihood_gain_over_nothing": "given nothing",
}
_PATHS: Final = {
    "min_ade": "mean error up to then, m",
    "miss_rate": "miss rate",
    "overlap_free": "share of modes without overlap",
    "on_road": "share of modes on the road",
}
_CERTAINTY: Final = {
    "ece": "ECE of 6 modes",
    "ece_if_right": "  expected if the probabilities are right",
    "ece_if_right_95": "  at most, in 95 %",
    "ece_of_horizon": "  modes chosen for each time",
    "ece_uncalibrated": "ECE at temperature 1",
    "negative_log_likelihood": "negative log likelihood, nats",
}

_LIKELIEST: Final = "  most probable mode"

Line = tuple[str, str, str, str]
"""Label, quantity, condition and group: a row for each number of modes."""


def show(found: Evaluation) -> None:
    """Print all tables of an evaluation."""
    console = wide()
    data, refused = ", ".join(found.data), found.refused
    console.print(
        escape(f"weights {found.weights} on {data}: {found.scenes} scenes, {refused} refused")
    )
    for reason in found.refusals:
        console.print(escape(f"  refused: {reason}"), style="yellow", soft_wrap=True)
    if refused > len(found.refusals):
        console.print(f"  and {refused - len(found.refusals)} more", style="yellow")
    parts = (_opponent, _marginal, _conditional, _people)
    for part in (one for made in parts for one in made(found)):
        if isinstance(part, str):
            console.print(escape(part), soft_wrap=True)
        else:
            console.print()
            console.print(part)


def _opponent(found: Evaluation) -> Iterator[Table | str]:
    of = partial(found.of, "opponent")
    scenes, partners = of("scenes").value, of("scenes_with_partner").value
    if not scenes:
        yield "Opponent: all scenes are simulated attacks, which have made their own labels."
        return
    quantities = {
        "auroc": "AUROC",
        "average_precision": "AP",
        "top1_positive_scenes": f"first is a positive /{scenes}",
        "top3_positive_scenes": "among first 3",
        "partner_top1_scenes": f"partner first /{partners}",
        "partner_top3_scenes": "among first 3",
    }
    table = _grid("Opponent", *quantities.values())
    for group in ("all", "attackable"):
        network = f"network, {group} {of('candidates', group=group).value} candidates"
        scores = {network: ("label_head", "partner_head")}
        scores |= {f"  {title}": (rule, rule) for rule, title in _RULES.items()}
        for label, (by_label, by_partner) in scores.items():
            conditions = [by_partner if "partner" in name else by_label for name in quantities]
            table.add_row(label, *(
                _cell(of(quantity, condition=condition, group=group))
                for quantity, condition in zip(quantities, conditions, strict=True)
            ))  # fmt: skip
    yield table
    ece = {
        name: _cell(of(name, condition="label_head", group="attackable"))
        for name in ("ece", "ece_uncalibrated", "ece_if_right", "ece_if_right_95")
    }
    yield (
        f"{of('positives').value} positives in {of('scenes_with_positive').value} scenes. The "
        f"attack excludes {of('parked').value} parked candidates "
        f"({of('positives_parked').value} positives, {of('partners_parked').value} partners). "
        f"ECE {ece['ece']}, at temperature 1 {ece['ece_uncalibrated']}; if the scores were right, "
        f"{ece['ece_if_right']} would be expected, and at most {ece['ece_if_right_95']} in 95 %."
    )


def _marginal(found: Evaluation) -> Iterator[Table | str]:
    yield _table(found, "marginal", "Marginal: least final error, m", [
        ("network", "min_fde", "network", "all"),
        ("  modes chosen for each time", "min_fde_of_horizon", "network", "all"),
        (_LIKELIEST, "most_probable_fde", "network", "all"),
        *((f"  {title}", "min_fde", name, "all") for name, title in _BASELINES.items()),
    ])  # fmt: skip
    yield f"{found.of('marginal', 'targets').value} objects. Map-blind clusters: {found.clusters}."
    others = _BASELINES | {"recorded": "recorded"}
    yield _table(
        found, "marginal", "Marginal: whole path and certainty", _shapes("network", others)
    )


def _conditional(found: Evaluation) -> Iterator[Table | str]:
    if not found.of("conditional", "targets").value:
        yield "Conditional: no two vehicles come near each other in these recordings."
        return
    title = "least final error, m"
    yield _table(found, "conditional", f"Conditional: {title}", _errors("all"))
    shapes = _shapes("given_true", {"recorded": "recorded"})
    yield _table(
        found, "conditional", "Conditional, given the true future: whole path and certainty", shapes
    )
    yield _table(found, "conditional", "Conditional: gain in log likelihood, nats", [
        (f"{name}: given {given} - {against}", quantity, f"given_{given}", group)
        for group, name in _GROUPS.items()
        for given in ("true", "shuffled")
        for quantity, against in _GAINS.items()
    ])  # fmt: skip
    if found.pivot("conditional", "min_fde", "given_true", "attacked"):
        gains = [
            ("gain over given nothing", "min_fde_gain_over_nothing", "given_true", "attacked"),
            (_LIKELIEST, "most_probable_fde_gain_over_nothing", "given_true", "attacked"),
        ]
        lines = _errors("attacked") + gains
        title = f"Conditional: AVs attacked in simulation, {title}"
        yield _table(found, "conditional", title, lines, _SECONDS[:3])


def _people(found: Evaluation) -> Iterator[Table | str]:
    of = partial(found.of, "people", "targets")
    kinds = [kind for kind in PEOPLE if of(group=kind).value]
    if not kinds:
        yield "People: there are no pedestrians and no cyclists in these recordings."
        return
    groups = [group for kind in kinds for group in (kind, f"moving {kind}")]
    yield _table(found, "people", "People: least final error, m", [
        line
        for group in groups
        for line in (
            (f"{group}, {of(group=group).value or 0}", "min_fde", "network", group),
            ("  modes chosen for each time", "min_fde_of_horizon", "network", group),
            ("  constant velocity", "min_fde", "constant_velocity", group),
        )
    ])  # fmt: skip
    yield _table(found, "people", "People: mean error up to then, m", [
        line
        for kind in kinds
        for line in (
            (kind, "min_ade", "network", kind),
            ("  constant velocity", "min_ade", "constant_velocity", kind),
        )
    ])  # fmt: skip
    yield _table(found, "people", "People: certainty", [
        line
        for kind in kinds
        for line in (
            (f"{kind}: negative log density, nats", "negative_log_density", "network", kind),
            ("  share of outcomes inside 50 % of the mass", "inside_50", "network", kind),
            ("  share of outcomes inside 90 % of the mass", "inside_90", "network", kind),
        )
    ], _KNOTS_S)  # fmt: skip
    lines = [
        (f"{title if condition else 'constant velocity'}, {group}", "min_fde",
         condition or "constant_velocity", group)
        for group in (f"given {kind}" for kind in kinds)
        if found.pivot("conditional", "min_fde", "given_true", group)
        for condition, title in ({"": ""} | _CONDITIONS).items()
    ]  # fmt: skip
    if lines:
        yield _table(found, "conditional", "The AV near people: least final error, m", lines)


def _errors(group: str) -> list[Line]:
    """Lines of the errors of a group under all conditions."""
    return [
        line
        for condition, title in _CONDITIONS.items()
        for line in (
            (title, "min_fde", condition, group),
            (_LIKELIEST, "most_probable_fde", condition, group),
        )
    ]


def _shapes(condition: str, others: dict[str, str]) -> list[Line]:
    """Lines of a network's paths and certainty, with other conditions below."""
    return [
        *(
            line
            for quantity, title in _PATHS.items()
            for line in (
                (title, quantity, condition, "all"),
                *((f"  {label}", quantity, name, "all") for name, label in others.items()),
            )
        ),
        *((label, quantity, condition, "all") for quantity, label in _CERTAINTY.items()),
    ]


def _table(
    found: Evaluation,
    network: Network,
    title: str,
    lines: list[Line],
    horizons: Sequence[float] = _SECONDS,
) -> Table:
    """Rows by label and number of modes, columns by horizon."""
    last = f"{horizons[-1]} s"
    columns = [f"{seconds} s" for seconds in horizons]
    table = _grid(title, "modes", *columns, f"± at {last}", f"objects at {last}")
    for label, quantity, condition, group in lines:
        for modes, figures in found.pivot(network, quantity, condition, group).items():
            row = [figures.get(seconds, Figure()) for seconds in horizons]
            table.add_row(
                label,
                "" if modes is None else str(modes),
                *(_cell(figure, signed="gain" in quantity) for figure in row),
                _cell(Figure(row[-1].standard_error)),
                _cell(Figure(row[-1].objects)),
            )
    return table


def _grid(title: str, *headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(title, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def _cell(figure: Figure, *, signed: bool = False) -> str:
    """A value; with its standard error if it is ``signed``."""
    value, error = figure.value, figure.standard_error
    if value is None:
        return "-"
    if signed:
        return f"{value:+.3f} ± {'-' if error is None else f'{error:.3f}'}"
    return str(value) if isinstance(value, int) else f"{value:.3f}"
