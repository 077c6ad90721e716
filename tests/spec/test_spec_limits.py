"""Specs that are files of another kind, or YAML that takes long or holds what it should not."""

import os
import time

import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import SpecError
from deepmf_sumo.spec import document

SLOW = {
    "deep": ("a: " + "[" * 300_000, "nested more than 50 deep"),
    "dashes": ("- " * 400_000, "nested more than 50 deep"),
    "many keys": ("\n".join(f"k{i}: 1" for i in range(60_000)), "more than 20000 values"),
    "many values": ("a: [" + "{}," * 300_000 + "]", "more than 20000 values"),
    "sexagesimal": ("version: " + "1:" * 400_000 + "1", "more than 100 characters"),
    "hexadecimal": ("version: 0x" + "f" * 900_000, "more than 100 characters"),
    "long text": ("name: " + "x" * 900_000, "more than 10000 characters"),
}
WRONG = {
    'planner: !!int ""': "'' is not a plain decimal number",
    "planner: !!float _": "'_' is not of the type 'float'",
    "planner: !!bool x": "'x' is not of the type 'bool'",
    "planner: !!timestamp x": "'x' is not of the type 'timestamp'",
    "planner: 2020-99-99": "'2020-99-99' is not of the type 'timestamp'",
    'name: "\\ud800"': "a character that no text may have",
    'name: "\\0"': "a character that no text may have",
    "a: !!python/object:os.system {}": "could not determine a constructor",
}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "one.yaml"


@pytest.mark.slow_unit
@pytest.mark.parametrize(("text", "said"), SLOW.values(), ids=list(SLOW))
def test_yaml_without_bounds_is_refused_soon(file, text, said):
    file.write_text(text)
    begin = time.process_time()
    with pytest.raises(SpecError, match=said) as caught:
        document.read(file)
    assert time.process_time() - begin < 4.0
    assert len(str(caught.value)) < 300 + len(str(file))


@pytest.mark.parametrize(("text", "said"), WRONG.items(), ids=list(WRONG))
def test_a_wrong_scalar_is_named_with_its_line(file, text, said):
    file.write_text(f"version: 1\n{text}\n")
    with pytest.raises(SpecError, match=said) as caught:
        spec.load(file)
    assert f"{file}:2: " in str(caught.value)
    file.write_text("version: 1\n")
    with pytest.raises(SpecError, match=said):
        spec.load(file, [text.replace(": ", "=", 1)])


def test_assignments_are_bounded_too(file):
    file.write_text("version: 1\n")
    with pytest.raises(SpecError, match="must be key=value"):
        spec.load(file, [".".join("a" * 1000) + "=1"])


@pytest.mark.timeout(20)
def test_a_spec_that_is_a_device_or_a_pipe(file):
    file.symlink_to("/dev/zero")
    with pytest.raises(SpecError, match="cannot be read: it is a device, not a regular file"):
        spec.load(file)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(SpecError, match="cannot be read: it is a pipe, not a regular file"):
        spec.load(file)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", ["network", "recording"])
@pytest.mark.parametrize("name", ["/dev/zero", "pipe", "~nobody/x", "x" * 5000, "loop"])
def test_what_a_spec_names_is_a_file_or_a_folder(file, kind, name):
    os.mkfifo(file.with_name("pipe"))
    file.with_name("loop").symlink_to("loop")
    av = ", av: {vehicle: a}" if kind == "network" else ""
    file.write_text(f"version: 1\nname: x\nsource: {{{kind}: '{name}'{av}}}\nadversary: none\n")
    with pytest.raises(SpecError, match=r"a device, a pipe or a socket|no such file or folder"):
        spec.load(file)
