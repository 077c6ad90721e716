"""Of result folders: attacks, hits, rams from behind and avoidable hits; ``python -m`` it.

A ram from behind is a rear-end collision or a cut-in that the AV is hit at the rear in.
"""

import argparse
from pathlib import Path

from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.results import quantities
from deepmf_sumo.results.reader import planned
from deepmf_sumo.results.result import Result, attacked

_REAR = (3, 4, 5)


def is_ram(result: Result) -> bool:
    """Whether a hit came from behind."""
    accident = quantities.accident(result)
    kind = "" if accident is None else ACCIDENT_TYPES[accident]
    return quantities.sector(result) in _REAR and kind in {"rear_end", "cut_in"}


def main() -> None:
    """Print a row of a table for each folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    print("| results | attacks | hits | rams from behind | avoidable hits |")
    print("| --- | --- | --- | --- | --- |")
    for out in parser.parse_args().folders:
        done = [one for one in planned(out).values() if one and one["status"] == "ok"]
        runs = [one for one in done if attacked(one)]
        hits = [one for one in runs if quantities.hit(one)]
        avoidable = sum((quantities.metric(one, "avoidable") or 0) >= 1 for one in hits)
        print(
            f"| {out.name} | {len(runs)} | {len(hits)} | {sum(map(is_ram, hits))} | {avoidable} |"
        )


if __name__ == "__main__":
    main()
