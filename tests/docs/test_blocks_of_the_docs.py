"""All commands and all Python of README and site run: `make test-docs`."""

import pytest

from tests.docs import blocks
from tests.docs.pages import README, SITE

RUN = [page for page in (README, *SITE) if any(block.runnable for block in page.blocks)]


@pytest.mark.slow
@pytest.mark.sumo
@pytest.mark.timeout(1900)
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_the_blocks_of_a_page_run(page, tmp_path):
    ran = blocks.run(page, tmp_path, limit_s=1800)
    assert ran.returncode == 0, ran.log
    assert ran.outputs or ran.left_out


@pytest.mark.sumo
def test_a_page_that_is_wrong_fails(tmp_path):
    page = blocks.Page(tmp_path / "page.md")
    page.path.write_text(
        "```sh\ndeepmf-sumo init a\nls a\n```\n\n```text\nold\n```\n\n```sh\nfalse\n```\n"
    )
    ran = blocks.run(page, tmp_path / "run")
    assert ran.returncode == 1
    assert ran.log.endswith("== block 2\n")
    assert blocks.written(page, ran, tmp_path / "run").count("sumo_nets") == 1
