import sys
import types
from pathlib import Path

import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError, SpecError
from deepmf_sumo.spec import FromRecording, load


class IdmSettings(plugins.Settings):
    perception: str = "corridor"
    headway_s: float = 1.5


class DeepmfSettings(plugins.Settings):
    period_s: float | None = 1.0
    tries: int = 1


@pytest.fixture(autouse=True)
def few_plugins(monkeypatch):
    """Specs are about form: the real plug-ins and their settings have tests of their own."""
    fakes = {
        ("planners", "idm"): types.SimpleNamespace(Settings=IdmSettings),
        ("adversaries", "deepmf"): types.SimpleNamespace(Settings=DeepmfSettings),
    }
    real_load = plugins.load
    monkeypatch.setattr(plugins, "load", lambda k, n: fakes.get((k, n)) or real_load(k, n))
    monkeypatch.setattr(plugins, "names", lambda k: [n for kind, n in fakes if kind == k])


@pytest.fixture
def write(tmp_path):
    (tmp_path / "town.sumocfg").write_text("<configuration/>")
    (tmp_path / "val").mkdir()

    def write(text: str) -> Path:
        path = tmp_path / "spec.yaml"
        path.write_text(text)
        return path

    return write


GOOD = """\
# yaml-language-server: $schema=spec.schema.json
version: 1
name: cut-in
source: {network: town.sumocfg, start_s: 42.0, av: {vehicle: av}}
planner: {name: idm, headway_s: 1}
adversary: {name: deepmf, period_s: 2.0}
seed: 3
expect: {av_collision: no}
"""


def test_paths_are_relative_to_the_spec(write, tmp_path, monkeypatch):
    path = write(GOOD)
    monkeypatch.chdir("/")
    spec = load(path)
    assert spec.source.network == tmp_path.resolve() / "town.sumocfg"
    assert spec.planner.settings == {"headway_s": 1}
    assert spec.traffic == "sumo"
    assert spec.expect.av_collision is False
    assert spec.weights == "open"


def test_resolved_spec_loads_again_as_the_same(write, tmp_path):
    import yaml

    spec = load(write(GOOD))
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(spec.resolved(), sort_keys=False))
    assert load(again) == spec


@pytest.mark.parametrize(
    ("scenes", "expected"),
    [("all", "all"), ("[ab, cd]", ("ab", "cd")), ("{first: 2}", 2)],
)
def test_recording(write, scenes, expected):
    spec = load(write(f"version: 1\nname: a\nsource: {{recording: val, scenes: {scenes}}}\n"))
    assert isinstance(spec.source, FromRecording)
    assert getattr(spec.source.scenes, "first", spec.source.scenes) == expected
    assert spec.traffic == "log"


@pytest.mark.parametrize(
    ("adversary", "settings"),
    [
        ("S1", {"period_s": 1.0}),
        ("G", {"period_s": None}),
        ("{version: S4, tries: 8}", {"period_s": 4.0, "tries": 8}),
        ("{name: S2}", {"period_s": 2.0}),
        ("deepmf", {}),
    ],
)
def test_short_forms_of_the_adversary(write, adversary, settings):
    text = GOOD.replace("{name: deepmf, period_s: 2.0}", adversary)
    spec = load(write(text))
    assert spec.adversary.name == "deepmf"
    assert spec.adversary.settings == settings


def test_set_overrides_and_checks(write):
    path = write(GOOD)
    spec = load(path, ["seed=7", "adversary.version=S4", "expect.av_collision=true"])
    assert (spec.seed, spec.adversary.settings["period_s"]) == (7, 4.0)
    assert spec.expect.av_collision is True
    assert load(path, ["adversary=G"]).adversary.settings == {"period_s": None}
    assert load(path, ["planner.perception=ideal"]).planner.settings["perception"] == "ideal"


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seed=x", "--set seed=x: key 'seed': 'x'"),
        ("sed=1", "Did you mean 'seed'?"),
        ("seed", "must be key=value"),
        ("=1", "must be key=value"),
        ("name.x=1", "'name' holds no keys"),
        ("seed=[", "is not YAML"),
        ("seed=010", "--set seed=010: key 'seed': '010' is not a plain decimal number"),
        ("planner.headway=1", "Did you mean 'headway_s'?"),
    ],
)
def test_wrong_set(write, assignment, message):
    with pytest.raises(SpecError) as error:
        load(write(GOOD), [assignment])
    assert message in str(error.value)


BAD = {
    "unknown key": (("seed: 3", "sed: 3"), ":7: key 'sed': unknown key. Did you mean 'seed'?"),
    "unknown inner key": (
        ("start_s", "start"),
        ":4: key 'source.start': unknown key. Did you mean",
    ),
    "unknown in av": (("vehicle: av", "vehicel: av"), "Did you mean 'vehicle'?"),
    "twice": (("seed: 3", "seed: 3\nseed: 4"), ":8: key 'seed' is given twice, first at"),
    "twice inside": (
        ("headway_s: 1", "headway_s: 1, headway_s: 2"),
        "'planner.headway_s' is given twice",
    ),
    "text for a number": (("42.0", "soon"), ":4: key 'source.start_s': 'soon'"),
    "exponent": (("42.0", "1e-3"), "YAML wants 1.0e-3"),
    "boolean for text": (("cut-in", "no"), ":3: key 'name': False"),
    "boolean for a number": (("seed: 3", "seed: yes"), ":7: key 'seed': True"),
    "float for an integer": (("seed: 3", "seed: 3.0"), ":7: key 'seed': 3.0"),
    "number for text": (("vehicle: av", "vehicle: 7"), "'source.av.vehicle': 7"),
    "octal": (("seed: 3", "seed: 010"), ":7: key 'seed': '010' is not a plain decimal number"),
    "hexadecimal": (("seed: 3", "seed: 0x10"), "'0x10' is not a plain decimal number"),
    "sexagesimal": (("seed: 3", "seed: 1:30"), "'1:30' is not a plain decimal number"),
    "negative": (("seed: 3", "seed: -1"), "greater than or equal to 0"),
    "infinite": (("42.0", ".inf"), "finite number"),
    "version": (("version: 1", "version: 4"), ":2: key 'version': 4"),
    "missing": (("name: cut-in\n", ""), "key 'name': Field required"),
    "no such file": (("town.sumocfg", "twon.sumocfg"), ":4: key 'source.network': 'twon.sumocfg'"),
    "source kind": (("network", "netwrok"), ":4: key 'source'"),
    "source is text": (
        ("{network: town.sumocfg, start_s: 42.0, av: {vehicle: av}}", "x"),
        "'source'",
    ),
    "planner": (("name: idm", "name: imd"), ":5: key 'planner.name': No plug-in 'imd'"),
    "planner nearest": (("name: idm", "name: imd"), "Did you mean 'idm'?"),
    "custom planner": (("name: idm", "name: 'no.such:Class'"), "cannot be imported"),
    "custom planner without settings": (
        ("name: idm", "name: 'os:PathLike'"),
        "no class 'Settings'",
    ),
    "settings": (("headway_s: 1", "headway: 1"), ":5: key 'planner.headway': unknown key. Did you"),
    "settings type": (("headway_s: 1", "headway_s: far"), ":5: key 'planner.headway_s': 'far'"),
    "version of deepmf": (("period_s: 2.0", "version: S3"), ":6: key 'adversary.version': 'S3'"),
    "version and period": (("period_s: 2.0", "period_s: 2.0, version: S1"), "sets it already"),
    "log of a network": (("seed: 3", "seed: 3\ntraffic: log"), ":8: key 'traffic'"),
    "expect": (("av_collision", "collision"), ":8: key 'expect.collision': unknown key"),
    "weights folder": (("seed: 3", "weights: ./no"), "no such file or folder"),
    "alias": (
        ("seed: 3", "seed: &a 3\nduration_s: *a"),
        ":8: is not YAML: aliases (*a) are refused",
    ),
    "tag": (("seed: 3", "seed: !!python/name:os.system 3"), ":7: is not YAML"),
    "syntax": (("seed: 3", "seed: [3"), "is not YAML"),
    "key of numbers": (("seed: 3", "3: 3"), ":7: key '3' is not text"),
    "date": (("cut-in", "2026-13-45"), "is not YAML"),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD)
def test_bad_specs_are_refused_in_one_line(write, change, message):
    path = write(GOOD.replace(*change))
    with pytest.raises(SpecError) as error:
        load(path)
    text = str(error.value)
    assert text.startswith(str(path))
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize(
    "content", [b"", b"- 1\n", b"\xff\xfe\x00", b"[" * 5000, b"a: b: c", b"\0"]
)
def test_files_that_are_no_specs(tmp_path, content):
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    with pytest.raises(SpecError, match=r"x\.yaml"):
        load(path)


def test_folder_and_missing_file(tmp_path):
    with pytest.raises(SpecError, match="cannot be read"):
        load(tmp_path)
    with pytest.raises(SpecError, match="cannot be read"):
        load(tmp_path / "missing.yaml")


def test_custom_planner(write, monkeypatch):
    module = types.ModuleType("my_planner_module")
    module.Mine = type("Mine", (), {"Settings": IdmSettings, "build": print})
    monkeypatch.setitem(sys.modules, "my_planner_module", module)
    spec = load(write(GOOD.replace("name: idm", "name: 'my_planner_module:Mine'")))
    assert spec.planner.name == "my_planner_module:Mine"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
        ("class Mine(:", "SyntaxError: invalid syntax"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
    ],
)
def test_a_planner_that_fails_as_it_is_loaded(tmp_path, monkeypatch, text, told):
    (tmp_path / "bad_on_import.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match=f"'bad_on_import:Mine' cannot be imported: {told}"):
        plugins.load("planners", "bad_on_import:Mine")
