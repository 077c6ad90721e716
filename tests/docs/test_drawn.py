"""Pictures of README and gallery are newer than the code that draws them."""

from tests.docs import browser, drawn
from tests.docs.pages import DOCS

AGAIN = (
    "make gallery    # the last two pictures need Chromium; or, if the change draws nothing "
    "otherwise: python -m tests.docs.drawn --accept"
)


def test_pictures_are_those_that_the_code_draws():
    assert drawn.stale() == [], AGAIN


def test_every_picture_has_sources():
    names = {one.name for one in drawn.PICTURES.iterdir()}
    assert names == set(drawn.SOURCES)


def test_a_picture_is_stale_when_a_source_of_it_changes(tmp_path, monkeypatch):
    page = tmp_path / "deepmf_sumo" / "report" / "page.py"
    page.parent.mkdir(parents=True)
    page.write_text("draw()\n")
    monkeypatch.setattr(drawn, "ROOT", tmp_path)
    monkeypatch.setattr(drawn, "KEPT", tmp_path / "drawn.json")
    monkeypatch.setattr(drawn, "SOURCES", {"a.webp": ("deepmf_sumo/**/*.py",)})
    assert drawn.stale() == ["a.webp"]
    drawn.keep("a.webp")
    assert drawn.stale() == []
    page.write_text("draw(1)\n")
    assert drawn.stale() == ["a.webp"]


def test_without_a_browser_a_picture_stays(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(browser, "PROGRAMS", ("no-such-browser",))
    assert not browser.photograph(DOCS / "index.md", tmp_path / "a.webp")
    assert "a.webp is not made again: it needs Chromium" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
