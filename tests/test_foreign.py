"""What code of others sets in libraries holds in that code, and outside of it nothing changes."""

import locale
import sys
import warnings

import numpy as np
import pytest

from deepmf_sumo import foreign, plugins


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Nothing that other tests' planners have set."""
    monkeypatch.setattr(foreign, "_theirs", {})


def divided(_=None):
    return np.array([1.0]) / np.array([0.0])


def test_what_numpy_raises_on_is_the_codes_own():
    with np.errstate(divide="ignore"):
        with foreign.code():
            np.seterr(all="raise")
        assert np.isinf(divided())
        with foreign.code(), pytest.raises(FloatingPointError):
            divided()
        with foreign.code():
            np.seterr(divide="ignore")
        with foreign.code():
            assert np.isinf(divided())
        assert np.geterr()["over"] == "warn"


def test_warnings_that_are_errors_are_the_codes_own():
    with warnings.catch_warnings():
        warnings.resetwarnings()
        warnings.simplefilter("ignore")
        with foreign.code():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", "this one")
        warnings.warn("outside", stacklevel=1)
        with foreign.code():
            warnings.warn("this one", stacklevel=1)
            with pytest.raises(UserWarning, match="another one"):
                warnings.warn("another one", stacklevel=1)
        warnings.warn("outside again", stacklevel=1)


def test_filters_that_a_library_adds_stay():
    with warnings.catch_warnings():
        warnings.resetwarnings()
        with foreign.code():
            warnings.filterwarnings("ignore", "of a library")
        assert [one[0] for one in warnings.filters] == ["ignore"]


def test_torchs_settings_are_the_codes_own():
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads(), torch.get_float32_matmul_precision()
    with foreign.code():
        torch.set_default_dtype(torch.float64)
        torch.set_num_threads(before[0] + 1)
        torch.set_default_device("meta")
        torch.set_grad_enabled(False)
        torch.use_deterministic_algorithms(True)
        torch.set_float32_matmul_precision("medium")
    assert torch.ones(1).dtype == torch.float32
    assert torch.ones(1).device.type == "cpu"
    assert (torch.get_num_threads(), torch.get_float32_matmul_precision()) == before
    assert torch.is_grad_enabled()
    assert not torch.are_deterministic_algorithms_enabled()
    with foreign.code():
        assert torch.ones(1).dtype == torch.float64
        assert torch.ones(1).device.type == "meta"
        assert torch.get_num_threads() == before[0] + 1
        assert not torch.is_grad_enabled()
        torch.use_deterministic_algorithms(False)
    torch.set_num_threads(before[0])


def test_the_decimal_point_stays_a_point(monkeypatch):
    """SUMO reads its files with it."""
    points = {"now": "C"}

    def setlocale(category, wanted=None):
        assert category == locale.LC_NUMERIC
        points["now"] = wanted or points["now"]
        return points["now"]

    monkeypatch.setattr(locale, "setlocale", setlocale)
    with foreign.code():
        locale.setlocale(locale.LC_NUMERIC, "de_DE")
    assert points["now"] == "C"
    with foreign.code():
        assert points["now"] == "de_DE"
    assert points["now"] == "C"


def test_a_planner_that_loads_another_one_keeps_its_settings():
    with np.errstate(all="ignore"):
        with foreign.code():
            np.seterr(all="raise")
            with foreign.code():
                np.seterr(divide="ignore")
            assert np.geterr()["divide"] == "ignore"
            assert np.geterr()["over"] == "raise"
        assert np.geterr()["over"] == "ignore"


def test_a_program_that_calls_us_keeps_its_settings():
    with np.errstate(all="raise"):
        with foreign.called():
            assert np.geterr()["under"] == "ignore"
        assert np.geterr()["under"] == "raise"


def test_settings_of_a_block_that_raises_end_with_it():
    with np.errstate(all="ignore"):
        with pytest.raises(FloatingPointError), foreign.code():
            divided(np.seterr(all="raise"))
        assert np.geterr()["over"] == "ignore"


def test_a_plug_in_that_sets_them_when_it_is_imported(tmp_path, monkeypatch):
    (tmp_path / "strict_planner.py").write_text(
        "import numpy, warnings\n"
        "from deepmf_sumo import plugins\n"
        "numpy.seterr(all='raise')\n"
        "class Strict:\n"
        "    class Settings(plugins.Settings): pass\n"
        "    build = classmethod(lambda cls, settings: cls())\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with np.errstate(all="ignore"):
        plugins.load("planners", "strict_planner:Strict")
        assert np.geterr()["over"] == "ignore"
    sys.modules.pop("strict_planner")
