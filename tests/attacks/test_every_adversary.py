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
def test_checking_settings_does_not_load_torch():
    program = f"""
import sys
from deepmf_sumo import plugins
needed = {NEEDED!r}
for name in plugins.names("adversaries"):
    plugins.settings("adversaries", name, needed.get(name, {{}}))
    assert "torch" not in sys.modules, name
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
