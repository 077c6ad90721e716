"""What has to be known of a .sumocfg before SUMO is started with it."""

import libsumo
import pytest

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.roadcheck.screening import roads
from deepmf_sumo.sumo.network.sumo_net import truth
from deepmf_sumo.sumo.simulation.sumo_config import SUMO_SEED, read_configuration

from tests.support.tiny_network import build


def test_the_mesoscopic_model_is_refused_and_can_be_switched_off(tmp_path):
    config = build(tmp_path)
    meso = '<mesoscopic><mesosim value="true"/></mesoscopic></configuration>'
    config.write_text(config.read_text().replace("</configuration>", meso))
    with pytest.raises(SimulationError, match=r"mesoscopic model \(mesosim\).*--mesosim false"):
        read_configuration(config)
    assert read_configuration(config, ["--mesosim", "false"]).net.name == "tiny.net.xml"
    assert roads.opened(config).file.name == "tiny.net.xml"  # screened, and not simulated
    with pytest.raises(SimulationError, match="mesoscopic"):
        read_configuration(build(tmp_path), ["--mesosim"])


def seeded(folder, text):
    config = build(folder)
    seed = f'<random_number><seed value="{text}"/></random_number></configuration>'
    config.write_text(config.read_text().replace("</configuration>", seed))
    return read_configuration(config)


@pytest.mark.parametrize(("text", "seed"), [("5", 5), ("+5", 5), ("007", 7)])
def test_a_seed_is_what_sumo_reads(tmp_path, text, seed):
    assert seeded(tmp_path, text).seed == seed
    assert read_configuration(build(tmp_path)).seed == SUMO_SEED


@pytest.mark.parametrize("text", ["-5", "0x10", "1e3", "3.0", "1_0", "\u0663", "", "2147483648"])
def test_a_seed_that_cannot_be_used_is_refused_not_replaced(tmp_path, text):
    configuration = seeded(tmp_path, text)
    with pytest.raises(SimulationError) as error:
        _ = configuration.seed
    assert f"tiny.sumocfg' has seed '{text}', which is not a whole number" in str(error.value)


def test_true_and_false_are_what_sumo_reads(tmp_path):
    build(tmp_path)
    texts = ["1", "Yes", "TRUE", "on", "X", "t", "0", "No", "False", "off", "F", "-"]
    drawn = "".join(f'<poly id="{one}" fill="{one}" shape="0,0 1,0 1,1"/>' for one in texts)
    (tmp_path / "drawn.add.xml").write_text(f"<additional>{drawn}</additional>")
    files = ["-n", str(tmp_path / "tiny.net.xml"), "-a", str(tmp_path / "drawn.add.xml")]
    libsumo.start(["sumo", *files])
    try:
        filled = {one: bool(libsumo.polygon.getFilled(one)) for one in texts}
    finally:
        libsumo.close()
    assert filled == {one: truth(one) for one in texts}
    assert set(filled.values()) == {True, False}
