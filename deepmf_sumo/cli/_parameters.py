"""Options, types of options, and a group of commands, that several commands share."""

import math
import re
from pathlib import Path
from typing import Any, Final

import click

from deepmf_sumo.errors import nearest

format_option: Final = click.option(
    "--format", "form", type=click.Choice(["table", "json", "csv", "md"]), default="table",
    show_default=True, help="Print the result in this format.",
)  # fmt: skip
RESULTS: Final = click.Path(exists=True, file_okay=False, path_type=Path)
"""A result folder, or a folder that contains result folders, e.g. one for each seed."""
results_argument: Final = click.argument(
    "folders", metavar="OUT...", nargs=-1, required=True, type=RESULTS
)
AFTER: Final = "after --"
"""Where a context keeps SUMO's options."""
MOST: Final = 100_000
_LARGEST: Final = 2**32 - 1
"""As in specs."""
_PART: Final = re.compile(r"([0-9]{1,10})(?:-([0-9]{1,10}))?")


class CommandGroup(click.Group):
    """A group of commands that suggests the nearest one for an unknown name."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's, with the suggestion."""
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            ctx.fail(f"No such command '{name}'.{nearest(name, self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)


class WithSumoOptions(click.Command):
    """A command line of which all after ``--`` is SUMO's: click itself drops the two dashes."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what comes before ``--``, and keep the rest."""
        end = args.index("--") if "--" in args else len(args)
        ctx.meta[AFTER] = tuple(args[end + 1 :])
        return super().parse_args(ctx, args[:end])

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """As in the line that shows how the command is used."""
        return [*super().collect_usage_pieces(ctx), "[-- SUMO OPTIONS]"]


class FiniteRange(click.FloatRange):
    """A float within bounds; neither nan nor infinite."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As click's, else the option is refused (exit code 2)."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class Place(click.ParamType):  # type: ignore[type-arg]
    """A port, of this machine or of another: ``PORT`` or ``HOST:PORT``."""

    name = "place"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int]:
        """Host and port; a mistake is refused (exit code 2)."""
        host, colon, number = str(value).rpartition(":")
        if colon and not host:
            self.fail(f"{value!r} names no host: write PORT or HOST:PORT.", param, ctx)
        port: int = click.IntRange(1, 65535)(number, param, ctx)
        return host.strip("[]") or "localhost", port


class Seeds(click.ParamType):  # type: ignore[type-arg]
    """Plain decimals and ranges of them, both ends included, separated by commas."""

    name = "seeds"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """The seeds in the order given; a mistake is refused (exit code 2)."""
        found: dict[int, None] = {}
        for part in str(value).split(","):
            match = _PART.fullmatch(part.strip())
            if match is None:
                self.fail(
                    f"{part.strip()!r} is not a seed or a range of seeds: write plain decimals,"
                    " e.g. 1-20 or 1,5,9-12.",
                    param,
                    ctx,
                )
            first, last = int(match[1]), int(match[2] or match[1])
            if last > _LARGEST:
                self.fail(f"{last} is too large: a seed is at most {_LARGEST}.", param, ctx)
            if last < first:
                self.fail(f"{part.strip()} ends before it begins.", param, ctx)
            if last - first >= MOST:
                self.fail(f"{part.strip()} holds more than {MOST} seeds.", param, ctx)
            repeated = [seed for seed in range(first, last + 1) if seed in found]
            if repeated:
                self.fail(f"the seed {repeated[0]} is given twice.", param, ctx)
            found.update(dict.fromkeys(range(first, last + 1)))
        return tuple(found)
