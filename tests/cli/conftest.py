import pytest
import tiny_network


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """Folder of a tiny network."""
    folder = tmp_path_factory.mktemp("tiny")
    tiny_network.build(folder)
    return folder


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path_factory.mktemp("home")))
