"""``python -m tests.fuzz [kind ...]``: how inputs changed at random are handled, as a table.

Ends with 1 where one was not handled well; ``--keep FOLDER`` keeps those inputs.
"""

import argparse
import sys
from pathlib import Path

from tests.fuzz import kinds, runner


def main() -> None:
    """Run all kinds, or those named."""
    known = {kind.name: kind for kind in kinds.all_kinds()}
    parser = argparse.ArgumentParser()
    parser.add_argument("kinds", nargs="*", choices=[[], *known], default=[])
    parser.add_argument("--count", type=int, default=2000, help="inputs of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    found = []
    for name in options.kinds or known:
        found += runner.run(known[name], options.count, options.seed, options.keep)
        print(f"{name} done", file=sys.stderr, flush=True)
    print(runner.table(found))
    sys.exit(any(one.result in runner.BAD for one in found))


if __name__ == "__main__":
    main()
