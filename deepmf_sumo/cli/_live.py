"""What `attach` and `serve` have in common on the screen and over HTTP."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from deepmf_sumo.live.session import Session

Watch = Callable[["Session"], None]
Tell = Callable[[dict[str, Any]], None]


@contextmanager
def watched(http: int | None, av: str) -> Iterator[tuple[Watch, Tell]]:
    """What is called with the session, and with each attack; ``http``: a port that shows both."""
    from deepmf_sumo.cli._screen import tell_attack
    from deepmf_sumo.live import StatusServer

    if http is None:
        yield lambda _: None, tell_attack
        return
    with StatusServer(http, av) as status:
        click.echo(f"status on http://localhost:{status.port}/", err=True)

        def tell(row: dict[str, Any]) -> None:
            status.hits += row["contact"] is not None
            tell_attack(row)

        yield status.watch, tell
