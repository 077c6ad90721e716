"""The exam that every adversary found must pass."""

import subprocess
import sys

import pytest

from deepmf_sumo import plugins

NEEDED = {"trajectory": {"agent": "b", "poses": [[0.0, 0.0, 0.0]]}}


@pytest.mark.parametrize("name", plugins.names("adversaries"))
def test_adversary(name):
    module = plugins.load("adversaries", name)
    assert issubclass(module.Settings, plugins.Settings)
    made = module.build(plugins.settings("adversaries", name, NEEDED.get(name, {})), "open")
    assert callable(made.attack)
    with pytest.raises(plugins.PluginError, match="no_such_key"):
        plugins.settings("adversaries", name, {**NEEDED.get(name, {}), "no_such_key": 1})


@pytest.mark.sumo
@pytest.mark.parametrize("name", plugins.names("adversaries"))
def test_checking_settings_does_not_load_torch(name):
    program = f"""
import sys
from deepmf_sumo import plugins
plugins.settings("adversaries", {name!r}, {NEEDED.get(name, {})!r})
assert "torch" not in sys.modules
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
