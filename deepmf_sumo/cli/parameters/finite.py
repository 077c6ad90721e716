"""Numbers on the command line: click takes nan for a number of any range."""

import math
from typing import Any

import click


class FiniteRange(click.FloatRange):
    """A float within bounds; neither nan nor infinite."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As click's, else the option is refused (exit code 2)."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number.", param, ctx)
        return number
