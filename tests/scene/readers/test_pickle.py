import collections
import io
import os
import pickle
import sys
import types

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene.readers import _bounded
from deepmf_sumo.scene.readers._pickle import ForbiddenClassError, load_plain

ARRAYS = [
    np.arange(5.0),
    np.arange(6, dtype="float32").reshape(2, 3).T,
    np.zeros((0, 3)),
    np.array([True, False]),
    np.array(["a", None], dtype=object),
    np.array(["text", "longer text"]),
    np.float32(3.5),
    np.bool_(True),
    np.int64(-7),
]


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("value", ARRAYS, ids=repr)
def test_arrays_and_scalars_come_back(value, protocol):
    back = load_plain(pickle.dumps(value, protocol))
    assert np.array_equal(back, value)
    assert back.dtype == value.dtype


@settings(deadline=None)
@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**63)
        | st.floats(allow_nan=False)
        | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner),
        max_leaves=10,
    ),
    st.integers(2, 5),
)
def test_plain_containers_come_back(value, protocol):
    assert load_plain(pickle.dumps(value, protocol)) == value


def test_other_containers_come_back():
    counts = collections.defaultdict(int, {"a": 1})
    value = {"s": {1, 2}, "f": frozenset([3]), "o": collections.OrderedDict(a=1), "d": counts}
    assert load_plain(pickle.dumps(value)) == value


def test_metadrives_dict_subclass_comes_back_as_a_dict(monkeypatch):
    name = "metadrive.scenario.scenario_description"
    module = types.ModuleType(name)
    module.ScenarioDescription = type("ScenarioDescription", (dict,), {"__module__": name})
    for part in ("metadrive", "metadrive.scenario"):
        monkeypatch.setitem(sys.modules, part, types.ModuleType(part))
    monkeypatch.setitem(sys.modules, name, module)
    content = pickle.dumps(module.ScenarioDescription(id="a", length=3))
    assert dict(load_plain(content)) == {"id": "a", "length": 3}


class Act:
    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize(
    ("harm", "name"),
    [
        (Act(os.system, "touch harmed"), "posix.system"),
        (Act(eval, "1 + 1"), "builtins.eval"),
        (Act(getattr, {}, "keys"), "builtins.getattr"),
        (Act(np.load, "x.npy"), "numpy.load"),
        (Act(bytearray, 10), "builtins.bytearray"),
        (io.BytesIO(), "_io.BytesIO"),
        (types.SimpleNamespace(a=1), "types.SimpleNamespace"),
    ],
)
@pytest.mark.parametrize("protocol", range(2, 6))
def test_what_can_act_is_refused_by_name(harm, name, protocol, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ForbiddenClassError) as caught:
        load_plain(pickle.dumps({"tracks": harm}, protocol))
    spelled = {name, name.replace("builtins.", "__builtin__.")}
    assert any(f"'{one}'" in str(caught.value) for one in spelled)
    assert not (tmp_path / "harmed").exists()


@pytest.mark.parametrize(
    "content",
    [
        b"cnumpy\nndarray\n(I100000000000\ntR.",  # an array of 800 GB
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I99999999999\ntS'b'\ntR",
        b"P123\n.",  # persistent id
        b"\x80\x02c__main__\nx\n.",
        b"",
        b"(" * 10000,
    ],
)
def test_damage_is_one_kind_of_error(content):
    with pytest.raises(pickle.UnpicklingError):
        load_plain(content)


def test_a_forged_dtype_cannot_make_numbers_into_pointers():
    class Forged:
        def __reduce__(self):
            # The last number is the dtype's flags: 1 says that its items are object pointers.
            return np.dtype, ("f8", False, True), (3, "<", None, None, None, -1, -1, 0x3F)

    class Array:
        def __reduce__(self):
            state = (1, (4,), Forged(), False, np.arange(4.0).tobytes())
            return np.arange(1.0).__reduce__()[0], (np.ndarray, (0,), b"b"), state

    back = load_plain(pickle.dumps(Array(), 4))
    assert not back.dtype.hasobject
    assert back.dtype.flags == 0
    assert back.tolist() == [0, 1, 2, 3]


def test_big_endian_arrays_come_back():
    value = np.arange(3, dtype=">f4")
    assert load_plain(pickle.dumps(value)).tolist() == [0, 1, 2]


@pytest.mark.sumo  # in the process that bounds it: damage can ask for any amount of memory
def test_flipped_bytes_give_data_or_an_error_and_no_crash():
    value = {"a": np.arange(20.0), "b": [1, "x", None, 2.5], "c": {"d": np.array([True, "x"], "O")}}
    rng = np.random.default_rng(7)
    refusals = []
    for number in range(60):
        content = bytearray(pickle.dumps(value, 2 + number % 4))
        for where in rng.integers(0, len(content), 1 + number % 4):
            content[where] = rng.integers(0, 256)
        try:
            list(_bounded.each(lambda damaged=bytes(content): iter([bool(read_of(damaged))])))
        except ReaderError as error:
            refusals.append(str(error))
    assert 10 < len(refusals) < 60
    assert not [one for one in refusals if "ended the process" in one]  # by a crash


def read_of(content):
    try:
        return load_plain(content)
    except pickle.UnpicklingError as error:
        raise ReaderError(str(error)) from None


class Filled:
    """An array as pickles write it, with a state of one's own."""

    def __init__(self, shape, code, content, order="|"):
        self.state = (1, shape, Typed(code, order), False, content)

    def __reduce__(self):
        return np.arange(1.0).__reduce__()[0], (np.ndarray, (0,), b"b"), self.state


class Typed:
    def __init__(self, code, order):
        self.code, self.order = code, order

    def __reduce__(self):
        return np.dtype, (self.code, False, True), (3, self.order, None, None, None, -1, -1, 0)


@pytest.mark.parametrize(
    ("shape", "code", "content"),
    [
        ((3,), "O8", []),  # numpy would take what lies behind the list for pointers
        ((1,), "O8", []),
        ((2, 2), "O8", [1, 2, 3]),
        ((1,), "O8", [1, 2]),
        ((1,), "O8", (1,)),
        ((1,), "O8", b"12345678"),
        ((2,), "f8", b"12345678"),
        ((2,), "f8", [1.0, 2.0]),
        ((-1,), "O8", []),
        ((2**62, 2**62, 0), "f8", b""),
        ((2**31,), "S0", b""),
        ([1], "i1", b"1"),
        (1, "i1", b"1"),
    ],
)
def test_an_array_has_exactly_the_items_that_its_shape_says(shape, code, content):
    with pytest.raises(pickle.UnpicklingError, match=r"an array of shape|damaged"):
        load_plain(pickle.dumps({"x": Filled(shape, code, content)}, 4))


def test_a_shape_is_what_its_items_fill():
    """numpy would take -1 for a size."""
    back = load_plain(pickle.dumps(Filled((-1,), "f8", b"12345678" * 3), 4))
    assert back.shape == (3,)


def test_an_array_of_objects_with_all_of_its_items_comes_back():
    content = pickle.dumps(Filled((2, 2), "O8", ["a", None, 1, 2.5]), 4)
    assert load_plain(content).tolist() == [["a", None], [1, 2.5]]


def test_an_array_cannot_be_filled_twice():
    """numpy would free what a view of it may still show."""
    array = Filled((1,), "u1", b"1")
    state = pickle.dumps(array.state, 2)[2:-1]
    with pytest.raises(pickle.UnpicklingError, match="fills an array twice"):
        load_plain(pickle.dumps(array, 2)[:-1] + state + b"b.")


def test_an_array_of_complex_numbers_is_refused():
    with pytest.raises(pickle.UnpicklingError, match="array of type"):
        load_plain(pickle.dumps(np.arange(3) * 1j))


def test_what_stands_in_several_places_comes_back():
    shared = np.arange(3.0)
    assert len(load_plain(pickle.dumps([[shared] * 100] * 100))) == 100


@pytest.mark.parametrize(
    "named",
    [
        b"cnumpy\nndarray\n",
        b"cnumpy\ndtype\n",
        b"c_codecs\nencode\n",
        b"cmetadrive.scenario.scenario_description\nScenarioDescription\n",
    ],
)
def test_a_pickle_cannot_change_what_it_names(named):
    """Else it could change how the next file is read."""
    with pytest.raises(pickle.UnpicklingError):
        load_plain(b"\x80\x02" + named + b"(N}X\x01\x00\x00\x00kK\x01stb.")
