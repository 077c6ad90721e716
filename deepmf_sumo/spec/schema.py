"""The JSON Schema of specs, for editors: completion and checks while typing."""

from typing import Any

from pydantic import BaseModel

from deepmf_sumo import plugins
from deepmf_sumo.spec.loading import VERSIONS
from deepmf_sumo.spec.model import Spec
from deepmf_sumo.spec.profiles import DEFAULT_RULES

_CUSTOM = {
    "type": "object",
    "description": "a class of an installed package",
    "properties": {"name": {"type": "string", "pattern": "^[\\w.]+:\\w+$"}},
    "required": ["name"],
}


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12), with the settings of every plug-in."""
    document = Spec.model_json_schema()
    document["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    document["required"] = ["version", "name", "source"]
    document["properties"]["traffic"]["default"] = "log for recordings, sumo for networks"
    definitions = document["$defs"]
    del definitions["Plugin"]
    for chosen in ("start_s", "av"):
        del definitions["FromMoments"]["properties"][chosen]
    planner = _choices("planners", "planner", definitions)
    adversary = _choices("adversaries", "adversary", definitions)
    versions = {"enum": list(VERSIONS)}
    definitions["adversary.deepmf"]["required"] = []
    definitions["adversary.deepmf"]["properties"]["rule"]["default"] = ", ".join(
        f"{rule} in version {version}" for version, rule in DEFAULT_RULES.items()
    )
    document["properties"]["planner"] = planner
    document["properties"]["adversary"] = {
        "anyOf": [versions, *adversary["anyOf"]],
        "description": "what attacks; a version of the paper is DeepMF with that period",
    }
    return document


def _choices(kind: plugins.Kind, prefix: str, definitions: dict[str, Any]) -> dict[str, Any]:
    """A plug-in by its bare name, or a mapping with its settings; each goes into definitions."""
    choices = []
    for name in plugins.names(kind):
        model: type[BaseModel] = plugins.load(kind, name).Settings
        settings = model.model_json_schema(ref_template=f"#/$defs/{prefix}.{name}.{{model}}")
        for inner, definition in settings.pop("$defs", {}).items():
            definitions[f"{prefix}.{name}.{inner}"] = definition
        settings["properties"] = {"name": {"const": name}, **settings.get("properties", {})}
        settings["required"] = ["name", *settings.get("required", [])]
        settings["title"] = f"{prefix} {name}"
        definitions[f"{prefix}.{name}"] = settings
        choices.append({"$ref": f"#/$defs/{prefix}.{name}"})
    return {"anyOf": [{"enum": plugins.names(kind)}, *choices, _CUSTOM]}
