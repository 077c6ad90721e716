"""Words by hand, numbers and pictures of each page: ``python -m tests.docs.counts``.

Words and numbers in code blocks and generated tables do not count. Reference pages and
pages for developers are listed, and have no limit. The exit code is 1 where a limit is broken.
"""

import sys
from collections.abc import Iterator

from tests.docs.pages import SITE, Page

MOST_WORDS = 11_000
MOST_NUMBERS = 60
UNLIMITED = ("docs/reference/", "docs/developers/", "docs/results.md")
"""Generated for the most part, written for contributors, or tables of results."""


def limited(page: Page) -> bool:
    """Whether the limits are for this page."""
    return not page.name.startswith(UNLIMITED)


def broken() -> Iterator[str]:
    """A sentence for each limit that does not hold."""
    words = sum(page.words for page in SITE if limited(page))
    if words > MOST_WORDS:
        yield f"{words} words by hand, and at most {MOST_WORDS} are allowed"
    for page in filter(limited, SITE):
        if page.numbers > MOST_NUMBERS:
            yield f"{page.name} has {page.numbers} numbers, and at most {MOST_NUMBERS} are allowed"


def main() -> int:
    """Print the table; 1 where a limit is broken."""
    headings = f"{'words':>7}{'numbers':>9}{'pictures':>10}{'outputs':>9}{'run':>5}{'not run':>9}"
    print(f"{'page':36}{headings}")
    for page in SITE:
        run = sum(block.runnable for block in page.blocks)
        left = sum(block.mark.startswith("not run") for block in page.blocks)
        name = page.name if limited(page) else f"{page.name} *"
        counts = f"{page.words:7}{page.numbers:9}{page.pictures:10}{page.outputs:9}{run:5}{left:9}"
        print(f"{name:36}{counts}")
    print(f"{'without *':36}{sum(page.words for page in SITE if limited(page)):7}")
    wrong = list(broken())
    print(*wrong, sep="\n", end="\n" if wrong else "")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
