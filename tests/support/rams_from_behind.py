"""Of result folders: attacks, hits, rams from behind and avoidable hits; ``python -m`` it.

A ram from behind is a rear-end collision or a cut-in that the AV is hit at the rear in.
"""

import argparse
from pathlib import Path

import pandas as pd

from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.results import planned

_REAR = (3, 4, 5)
_ALONG = [ACCIDENT_TYPES.index("rear_end"), ACCIDENT_TYPES.index("cut_in")]


def rams(hits: pd.DataFrame) -> int:
    """How many hits came from behind."""
    return int((hits["impact_sector"].isin(_REAR) & hits["accident_type"].isin(_ALONG)).sum())


def main() -> None:
    """Print a row of a table for each folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    print("| results | attacks | hits | rams from behind | avoidable hits |")
    print("| --- | --- | --- | --- | --- |")
    for out in parser.parse_args().folders:
        runs = planned.read(out).frame()
        runs = runs[runs["attacked"]]
        hits = runs[runs["hit"]]
        avoidable = int((hits["avoidable"] >= 1).sum())
        print(f"| {out.name} | {len(runs)} | {len(hits)} | {rams(hits)} | {avoidable} |")


if __name__ == "__main__":
    main()
