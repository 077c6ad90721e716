"""What has to be known of a .sumocfg before SUMO is started with it."""

import pytest
from tiny_network import build

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.simulation.configuration import read_configuration


def test_the_mesoscopic_model_is_refused_and_can_be_switched_off(tmp_path):
    config = build(tmp_path)
    meso = '<mesoscopic><mesosim value="true"/></mesoscopic></configuration>'
    config.write_text(config.read_text().replace("</configuration>", meso))
    with pytest.raises(SimulationError, match=r"mesoscopic model \(mesosim\).*--mesosim false"):
        read_configuration(config)
    assert read_configuration(config, ["--mesosim", "false"]).net.name == "tiny.net.xml"
    with pytest.raises(SimulationError, match="mesoscopic"):
        read_configuration(build(tmp_path), ["--mesosim"])
