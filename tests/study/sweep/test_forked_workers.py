"""Workers of the tests, which are copies of a process, have the surroundings of a started one."""

import json
import os
import sys
from pathlib import Path

import pytest

from deepmf_sumo.study.sweep import workers


def look(file):
    """Tell where this is."""
    seen = (os.environ["SEEN"], os.environ["OMP_NUM_THREADS"], sys.path[0], hasattr(os, "patched"))
    file.write_text(json.dumps([*seen, str(Path.cwd()), "torch" in sys.modules]))
    print("said", flush=True)


@pytest.mark.sumo
def test_surroundings_are_those_of_the_test_and_patches_are_not(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(os, "patched", True, raising=False)
    for number in ("1", "2"):
        folder = tmp_path / number
        folder.mkdir()
        monkeypatch.setenv("SEEN", number)
        monkeypatch.setenv("OMP_NUM_THREADS", "7")
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(folder)
        (ending,) = workers.run(look, [folder / "seen"], jobs=1, timeout_s=60)
        assert ending.status == "done", ending.reason
        seen = json.loads((folder / "seen").read_text())
        assert seen == [number, "1", str(folder), False, str(folder), True]
        assert capfd.readouterr().out == "said\n"
