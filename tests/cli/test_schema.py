import json
from pathlib import Path

import deepmf_sumo
from deepmf_sumo import plugins, spec
from deepmf_sumo.cli import main

COMMITTED = Path(deepmf_sumo.__file__).parent / "data" / "spec.schema.json"


def test_the_committed_schema_is_current():
    """If not: deepmf-sumo schema > deepmf_sumo/data/spec.schema.json."""
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


def test_is_printed(capsys):
    assert main.run(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(COMMITTED.read_text())
