"""Pages of README and site: links, limits, pictures, and blocks that say how they are run."""

import importlib.util
import re

import pytest

from deepmf_sumo import plugins, spec
from deepmf_sumo.results.gate import thresholds
from deepmf_sumo.study import plans

from tests.docs import blocks, counts
from tests.docs.pages import DOCS, NOTEBOOK, README, ROOT, SITE, Block, Page, nav

named = pytest.mark.parametrize("page", SITE, ids=lambda page: page.name)
MADE = {"deepmf-sumo-attach", "deepmf"}
"""Headings that mkdocs makes of the code; `make docs` checks links to them."""


def broken_links(page):
    for link in page.links:
        target, _, anchor = link.partition("#")
        file = (page.path.parent / target).resolve() if target else page.path
        read = anchor and file.is_file() and file.suffix == ".md"
        if not file.exists() or (read and anchor not in {*Page(file).anchors, *MADE}):
            yield link


@pytest.mark.parametrize("page", [README, *SITE, *NOTEBOOK], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    assert list(broken_links(page)) == []


def test_a_broken_link_is_found(tmp_path):
    page = Page(tmp_path / "page.md")
    page.path.write_text("# A page\n[a](none.md) [b](#a-page) [c](#none) [d](https://x.org/none)\n")
    assert list(broken_links(page)) == ["none.md", "#none"]


def test_the_navigation_lists_every_page_once():
    assert sorted(nav()) == [str(page.path.relative_to(DOCS)) for page in SITE]


def test_the_limits_hold():
    assert list(counts.broken()) == []


@named
def test_a_page_has_a_picture_or_an_output_near_its_top(page):
    if not counts.limited(page):
        pytest.skip("the reference, tables of results, or for developers")
    above = "\n".join(page.text.splitlines()[:90])
    assert re.search(r"!\[|^```(text|json)$", above, re.MULTILINE)
    assert "@@" not in page.text


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    """What `init` lays out, and folders of recordings that commands of the pages make."""
    folder = tmp_path_factory.mktemp("starter")
    blocks.lay_out(folder)
    for name in ("scenes", "reactions"):
        (folder / name).mkdir()
    return folder


@named
def test_files_that_a_page_shows_are_valid(page, starter):
    for block in page.blocks:
        if block.title.endswith(".yaml"):
            file = starter / block.title
            file.write_text(block.code)
            if block.title == "thresholds.yaml":
                thresholds.load(file)
            elif "\nmethods:" in block.code:
                assert plans.is_plan(file)
                plans.load(file, [])
            elif "\nsource:" in block.code:
                spec.load(file, [])
        elif block.title:
            compile(block.code, block.title, "exec")
        elif block.language == "python" and not block.mark.startswith("not run"):
            compile(block.code, page.name, "exec")


def test_blocks_are_read_with_their_marks(tmp_path):
    page = Page(tmp_path / "page.md")
    page.path.write_text(
        "```sh\ndeepmf-sumo run a\n```\n\n<!-- exit code 1 -->\n```sh\nfalse\n```\n\n"
        '<!-- not run: no -->\n```python\n1/0\n```\n\n```yaml title="a.yaml"\na: 1\n```\n\n'
        "```text\nout\n```\n\n```\nmake run\n```\n"
    )
    found = page.blocks
    assert [block.runnable for block in found] == [True, True, False, False, False, True]
    assert [block.exit_code for block in found] == [0, 1, 0, 0, 0, 0]
    assert found[3] == Block("yaml", "a.yaml", "", "a: 1\n", found[3].start, found[3].end)
    assert page.outputs == 1
    text, left_out = blocks.script(page, tmp_path)
    assert left_out == ["make run"]
    assert "cat > a.yaml" in text
    assert "1/0" not in text


def test_words_and_numbers_are_those_for_readers(tmp_path):
    page = Page(tmp_path / "page.md")
    page.path.write_text(
        "# 1. Two words\n\n```sh\nnot 5 these\n```\nS1 has 3 of `7`, 4.5 <!-- 8 -->\n"
    )
    assert (page.words, page.numbers) == (10, 2)


@pytest.fixture
def generate():
    """The hook of mkdocs."""
    pytest.importorskip("griffe", reason="needs the group docs")
    place = importlib.util.spec_from_file_location("generate", DOCS / "_generate.py")
    module = importlib.util.module_from_spec(place)
    place.loader.exec_module(module)
    return module


def test_the_first_use_of_a_word_leads_to_the_glossary(generate):
    text = (
        "# A finding\n`finding` [a finding](x.md) <!-- finding -->\n\nFindings, a finding, hits.\n"
    )
    made = generate.explained(text, "glossary.md")
    assert made.startswith(
        "# A finding\n`finding` [a finding](x.md) <!-- finding -->\n\n[Findings]("
    )
    assert made.count("glossary.md#finding ") == 1
    assert made.count("glossary.md#hit ") == 1
    assert "](" not in generate.explained("```text\na hit\n```\nwhite, fairly\n", "glossary.md")


def test_old_addresses_lead_to_pages(generate, tmp_path):
    generate.on_post_build({"site_dir": tmp_path})
    pages = {page.name.removeprefix("docs/").removesuffix(".md"): page for page in SITE}
    for old, new in generate.MOVED.items():
        name, _, mark = new.partition("#")
        assert old not in pages
        assert not mark or mark in pages[name].anchors
        assert f"{name.rpartition('/')[2]}/" in (tmp_path / old / "index.html").read_text()


def test_tables_of_the_reference_are_generated(generate):
    for page in SITE:
        made = generate.on_page_markdown(page.text)
        assert "<!-- generate" not in made
        if page.name.endswith("metrics.md"):
            rows = re.findall(r"^\| `(\w+)` \|", made, re.MULTILINE)
            assert set(plugins.names("metrics")) <= set(rows)
        if page.name.endswith("specs.md"):
            assert all(f"`{name}`" in made for name in spec.Spec.model_fields)
            assert "| `comfort_weight` | number or null, ≥ 0 | `null` | P(OV) falls" in made


def test_every_plugin_and_metric_module_is_in_a_generated_page():
    """So that the pages are the generated ones even where the group docs is not installed."""
    text = "".join(page.text for page in SITE)
    for place in ("settings planners", "settings adversaries", "settings exporters", "metrics"):
        assert f"<!-- generate: {place} -->" in text
    assert ":module: deepmf_sumo.cli.main" in text
    assert (ROOT / "docs" / "_generate.py").is_file()


def test_an_output_of_another_page_is_copied(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("<!-- as in howto/network.md -->\n```text\nold\n```\nmore\n")
    expected = blocks.first_output(Page(DOCS / "howto" / "network.md"))
    assert blocks.copied(Page(page)).splitlines()[2:-2] == expected.splitlines()


def test_an_output_that_two_pages_show_is_the_same():
    shown = [page for page in SITE if any(one.mark.startswith("as in") for one in page.blocks)]
    assert shown
    other = [page.name for page in shown if blocks.copied(page) != page.text]
    assert other == [], "python -m tests.docs.blocks --write PAGE"
