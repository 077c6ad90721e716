"""Runs that are kept are written again in a format whose exporter has changed."""

import sys

import pytest

from deepmf_sumo import spec
from deepmf_sumo.results.exports import Format
from deepmf_sumo.study.sweep import batch

from tests.support import tiny_network

EXPORTER = """from deepmf_sumo import files, plugins
class Mine:
    FILE = "mine.txt"
    class Settings(plugins.Settings):
        pass
    @staticmethod
    def build(settings):
        return settings
    @staticmethod
    def write(run, path, settings):
        files.write(path, "TEXT")
"""


@pytest.mark.sumo
def test_code_of_an_exporter_counts_for_what_it_wrote(tiny, tmp_path, monkeypatch):
    code, out = tmp_path / "my_exporter.py", tmp_path / "out"
    monkeypatch.syspath_prepend(tmp_path)

    def run(text):
        code.write_text(EXPORTER.replace("TEXT", text))
        sys.modules.pop("my_exporter", None)
        formats = (Format.named("my_exporter:Mine"),)
        seen = []
        options = batch.Options(out=out, formats=formats, resume=True)
        batch.run([spec.load(tiny_network.spec(tiny, "exported"))], options, seen.append)
        (file,) = out.glob("runs/*/mine.txt")
        return seen[0].kept, file

    kept, file = run("first")
    assert (kept, file.read_text()) == (0, "first")
    file.write_text("untouched")
    kept, file = run("first")
    assert (kept, file.read_text()) == (1, "untouched")
    kept, file = run("second one")
    assert (kept, file.read_text()) == (1, "second one")
    file.write_text("untouched")
    kept, file = run("second one")
    assert (kept, file.read_text()) == (1, "untouched")
