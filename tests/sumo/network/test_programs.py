import pytest

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.sumo.network import sumo_tools


def test_sumos_programs_are_there_and_know_their_home():
    assert sumo_tools.program("netconvert").is_file()
    assert sumo_tools.environment()["SUMO_HOME"] == str(sumo_tools.home())
    assert sumo_tools.version().count(".") == 2


def test_an_unknown_program_is_an_error_that_names_it():
    with pytest.raises(ConversionError, match="'netrevert' is missing"):
        sumo_tools.program("netrevert")


@pytest.mark.sumo
def test_what_a_program_complains_about_is_in_the_error(tmp_path):
    with pytest.raises(ConversionError, match=r"netconvert failed: Error: .*nothing\.net\.xml"):
        sumo_tools.run("netconvert", "-s", str(tmp_path / "nothing.net.xml"), "-o", "/dev/null")


@pytest.mark.sumo
def test_a_program_that_takes_too_long_is_ended(tmp_path):
    with pytest.raises(ConversionError, match="did not end within"):
        sumo_tools.run(
            *("netgenerate", "--grid", "--grid.number", "40", "-o", str(tmp_path / "big.net.xml")),
            timeout_s=0.05,
        )
