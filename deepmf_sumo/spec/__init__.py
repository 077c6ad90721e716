"""Specs: what to run, in strict YAML.

A wrong spec stops the run before it starts, in one line with file, line, key, value, rule and the
nearest name. Paths are relative to the spec. `schema` describes specs to editors.
"""

from deepmf_sumo.spec.loading import VERSIONS, load, of_document, takes_turns
from deepmf_sumo.spec.model import (
    Av,
    Bound,
    Expect,
    First,
    FromMoments,
    FromNetwork,
    FromRecording,
    Moments,
    Plugin,
    SearchBudget,
    Spec,
)
from deepmf_sumo.spec.profiles import DEFAULT_RULES, PROFILES, Profile, ProfileName
from deepmf_sumo.spec.schema import schema

__all__ = [
    "DEFAULT_RULES",
    "PROFILES",
    "VERSIONS",
    "Av",
    "Bound",
    "Expect",
    "First",
    "FromMoments",
    "FromNetwork",
    "FromRecording",
    "Moments",
    "Plugin",
    "Profile",
    "ProfileName",
    "SearchBudget",
    "Spec",
    "load",
    "of_document",
    "schema",
    "takes_turns",
]
