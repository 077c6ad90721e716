"""Specs: what to run, in strict YAML; and the tasks that specs are.

A wrong spec stops the run before it starts, in one line with file, line, key, value, rule and the
nearest name. Paths are relative to the spec. `schema` describes specs to editors.

Why so: the same words mean the same attack at every door. What a spec means where it says nothing
is data in `profiles`: the profile (constraints, form, rule, turns), and what the versions differ
in. `Spec` writes it into the spec as it is read, so that runs, records and copies of a spec know no
defaults. Commands without a file (`attack`, `attach`, `serve`) make the document of a spec; only a
live attack adds something: it has one try. Settings of plug-ins know of no versions.

A task (`tasks`) is one run: scene, seed, key. The room lies below all that runs or counts, because
a result is labelled with the task that it came from. Random numbers of a run depend on scene and
seed, not on its name: methods are compared under the same ones.
"""

from deepmf_sumo.spec.loading import VERSIONS, load, of_document, takes_turns
from deepmf_sumo.spec.model import (
    PERSON_PLACES,
    Av,
    Bound,
    Expect,
    First,
    FromMoments,
    FromNetwork,
    FromRecording,
    GivenPerson,
    Moments,
    Plugin,
    SearchBudget,
    Spec,
    WantedPeople,
    Who,
)
from deepmf_sumo.spec.profiles import DEFAULT_RULES, PROFILES, Profile, ProfileName
from deepmf_sumo.spec.schema import schema

__all__ = [
    "DEFAULT_RULES",
    "PERSON_PLACES",
    "PROFILES",
    "VERSIONS",
    "Av",
    "Bound",
    "Expect",
    "First",
    "FromMoments",
    "FromNetwork",
    "FromRecording",
    "GivenPerson",
    "Moments",
    "Plugin",
    "Profile",
    "ProfileName",
    "SearchBudget",
    "Spec",
    "WantedPeople",
    "Who",
    "load",
    "of_document",
    "schema",
    "takes_turns",
]
