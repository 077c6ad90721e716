"""The invariant of every rollout: the docs explain each event that it notes."""

import re
from functools import cache

from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord

from tests.docs.pages import DOCS


def use(patch) -> None:
    """Check each rollout that a test makes."""
    rollout = EpisodeRecord.rollout

    def checked(*given, **more):
        made = rollout(*given, **more)
        unknown = {one.kind for one in made.events} - explained()
        assert not unknown, f"docs/reference/results-folder.md does not explain {unknown}"
        return made

    patch.setattr(EpisodeRecord, "rollout", checked)


@cache
def explained() -> frozenset[str]:
    """The kinds in the first column of the table of events."""
    text = (DOCS / "reference/results-folder.md").read_text("utf-8")
    table = text.partition("\n## Events\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return frozenset(kind for row in rows for kind in re.findall(r"`(\w+)`", row))
