import json
from pathlib import Path

import deepmf_sumo
from deepmf_sumo import plugins, spec
from deepmf_sumo.cli import main

COMMITTED = Path(deepmf_sumo.__file__).parent / "data" / "spec.schema.json"


def test_the_committed_schema_is_current():
    """If not: deepmf-sumo schema --out deepmf_sumo/data/spec.schema.json."""
    assert json.loads(COMMITTED.read_text()) == json.loads(json.dumps(spec.schema()))


def test_names_every_plugin_and_resolves_its_references():
    schema = spec.schema()
    text = json.dumps(schema)
    for kind, prefix in (("planners", "planner"), ("adversaries", "adversary")):
        for name in plugins.names(kind):
            settings = schema["$defs"][f"{prefix}.{name}"]["properties"]
            assert set(settings) == {"name", *plugins.load(kind, name).Settings.model_fields}
    references = {part.split('"')[0] for part in text.split('"#/$defs/')[1:]}
    assert references <= set(schema["$defs"])


def test_is_written_or_printed(tmp_path, capsys):
    assert main.run(["schema"]) == 0
    printed = capsys.readouterr().out
    assert main.run(["schema", "--out", str(tmp_path / "s.json")]) == 0
    assert (tmp_path / "s.json").read_text() == printed
    assert main.run(["schema", "--out", str(tmp_path / "no" / "s.json")]) == 2
