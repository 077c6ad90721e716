"""Which kind of attack is meant: what a spec stands for where it says nothing.

A profile names a kind of attack. It is resolved here, once, as a spec is read: what it stands for
is written into the spec, so that a run, its record and a copy of it know the same attack whatever
reads them, and a later profile of the same name changes none of them. A setting that the spec
states wins over its profile, which keeps its name. Commands without a spec (`attack`, `attach`,
`serve`) are short for a spec, so that the same words mean the same attack everywhere; live attacks
and attacks in turn have one try.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from pydantic_core import PydanticCustomError

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.scene.geometry.impact import SECTORS

ProfileName = Literal["fair", "any", "lawful", "paper"]
FormName = Literal["extended", "paper"]

LONG_S: Final = 15.0
"""The time of one opponent: in a longer attack several take turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """What a profile stands for; the adversary's settings are those of DeepMF.

    Attributes:
        constraints: of the opponent. form: of the method.
        rule: by which the opponent's plan is chosen; None leaves it to the form.
        in_turn: in an attack of more than `LONG_S` opponents take turns.
        tries: maximum number of episodes of an attack, of which the first finding ends it; 1: one
            episode, whatever it finds.
    """

    constraints: tuple[str, ...] = ()
    form: FormName = "extended"
    rule: str | None = "likeliest"
    in_turn: bool = True
    tries: int = 1


PROFILES: Final[dict[ProfileName, Profile]] = {
    "fair": Profile(constraints=("clean", "fair", "no_rear_end", "with_traffic"), tries=8),
    "any": Profile(),
    "lawful": Profile(constraints=("lawful",)),
    "paper": Profile(form="paper", rule=None, in_turn=False),
}
"""``fair``: a competent driver in the AV's place could avoid the attack (the constraint ``fair``),
and the opponent touches nobody else and stays on the road (``clean``), does not ram it from behind
(``no_rear_end``) and does not drive against the traffic (``with_traffic``); several tries;
``any``: whatever the opponent can drive; ``lawful``: it keeps the rules of traffic; ``paper``: the
method as published."""
DEFAULT: Final[ProfileName] = "fair"

DEFAULT_RULES: Final = {1: "expected", 2: "likeliest", 3: PROFILES["any"].rule or ""}
"""The rule of DeepMF in its form ``extended`` where none is said, by version of the spec."""

GOAL: Final = "finding"
"""What ends the tries of a profile that has several."""
_EARLIER_GOAL: Final = "avoidable"
_SWITCHES: Final = ("fair", "lawful", "no_rear_end")
_IN_FORM: Final = (
    "tried_opponents", "likelihood_weight", "comfort_weight", "candidates", "goal_candidates",
    "shortlist", "reactions", "conditional",
)  # fmt: skip
_GONE: Final = {"keep_tail": False, "av_driver": None, "version": None}
"""How versions 1 and 2 spell DeepMF's settings: constraints that are switched on or off, numbers of
the method beside all others, and what has no other value any more; sectors may be numbers, too.
`in_todays_words` reads them."""
_REAR: Final = "rear"


def wrong(rule: str, key: str = "") -> PydanticCustomError:
    """``key`` is of the model's own, where not the whole value breaks the rule."""
    return PydanticCustomError("rule", "{rule}", {"rule": rule, "key": key})


def applies_to(adversary: str) -> bool:
    """Whether an adversary has the settings that a profile fills in.

    A plug-in that derives from DeepMF's settings has another name, and keeps its own defaults.
    """
    return adversary == "deepmf"


def left_open(names: Iterable[str], settings: Mapping[str, Any]) -> list[str]:
    """Constraints of a profile that fit to DeepMF's settings, where these state none.

    An attack on the rear end is a ram, which hardly any driver could avoid.
    """
    away = {"no_rear_end", "fair"} if settings.get("sector") == _REAR else set()
    return sorted({*names} - away)


def completed(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a spec with what its version and profile stand for where they say nothing.

    Versions 1 and 2 know no profiles: theirs is ``any``, or ``paper`` where the form is. Raises
    PydanticCustomError for what contradicts them.
    """
    found, version = dict(values), values.get("version")
    if type(version) is not int or version not in DEFAULT_RULES:
        return found  # refused where versions are checked
    choice = found.get("adversary", {"name": "deepmf"})
    if not isinstance(choice, dict):
        choice = choice.model_dump() if hasattr(choice, "model_dump") else {}
    if version == max(DEFAULT_RULES):
        return _of_version_3(found, choice)
    if "profile" in found:
        raise wrong(f"is a key of version 3, and this is version {version}", "profile")
    ours = applies_to(str(choice.get("name")))
    found["profile"] = "paper" if ours and published(choice) else "any"
    if ours:
        default = DEFAULT_RULES[version] if version > 1 else None
        found["adversary"] = _ruled(in_todays_words(choice), default, version)
        for key in found["adversary"]:
            if key in _SWITCHES:
                raise wrong("must be true or false", f"adversary.{key}")
            if key in _GONE:
                rule = "is gone; leave it out, or run the spec with deepmf-sumo 0.1"
                raise wrong(rule, f"adversary.{key}")
    return found


def _of_version_3(found: dict[str, Any], choice: dict[str, Any]) -> dict[str, Any]:
    name = found.setdefault("profile", DEFAULT)
    if not (isinstance(name, str) and name in PROFILES):
        return found  # refused where keys are checked
    if applies_to(str(choice.get("name"))):
        if published(choice):
            name = found["profile"] = "paper"
        found["adversary"] = _profiled(choice, name)
    if "source" in found:
        found["source"] = with_moments(found["source"])
    if "opponents" not in found:
        turns = PROFILES[name].in_turn and _is_long(found) and _takes_turns(choice)
        found["opponents"] = "in_turn" if turns else "one"
    if applies_to(str(choice.get("name"))) and found["opponents"] == "one":
        found["adversary"] = _searched(found["adversary"], choice, PROFILES[name])
    return found


def _searched(
    settings: dict[str, Any], stated: Mapping[str, Any], profile: Profile
) -> dict[str, Any]:
    """DeepMF's settings with the tries of the profile, unless the spec means another attack.

    That is one with constraints of its own, with a period between plans (the versions as published
    know of no tries), for any hit, or on the rear end, which cannot become a finding.
    """
    other = {"constraints", "period_s"} & stated.keys() or settings.get("goal", GOAL) != GOAL
    if profile.tries == 1 or other or stated.get("sector") == _REAR:
        return settings
    return {"goal": GOAL, "tries": profile.tries, **settings}


def in_one_try(settings: Mapping[str, Any]) -> dict[str, Any]:
    """An adversary's settings for one episode, where it cannot be tried again."""
    return {key: value for key, value in settings.items() if key not in {"goal", "tries"}}


def _profiled(choice: dict[str, Any], name: ProfileName) -> dict[str, Any]:
    """DeepMF's settings with what the profile stands for."""
    profile = PROFILES[name]
    for key in choice:
        if instead := _instead(choice, key, profile):
            raise wrong(f"is of versions 1 and 2; {instead}", f"adversary.{key}")
    if profile.form == "paper":
        form = with_preset(choice.get("form", "paper"))
        if isinstance(form, dict) and form.setdefault("preset", "paper") != "paper":
            rule = "contradicts the profile paper; leave one of them out"
            raise wrong(rule, "adversary.form")
        return {**choice, "form": "paper" if form == {"preset": "paper"} else form}
    listed = choice.get("constraints", left_open(profile.constraints, choice))
    return _ruled({**choice, "constraints": _in_order(listed)}, profile.rule, 3)


def _instead(choice: Mapping[str, Any], key: str, profile: Profile) -> str:
    """What version 3 has in place of a key of an earlier version; empty of others."""
    value = choice[key]
    listed = choice.get("constraints", left_open(profile.constraints, choice))
    others = {*listed} if _are_names(listed) else set()
    if key in _SWITCHES:
        meant = others | {key} if value is True else others - {key}
        named = f", or profile: {key}" if value is True and key in PROFILES else ""
        return f"version 3 lists all constraints: write {_stated(meant)}{named}"
    if key == "goal" and value == _EARLIER_GOAL:
        return f"write goal: {GOAL} and {_stated(others | {'clean', 'fair'})}"
    if key == "sector" and _is_number(value):
        return f"write adversary.sector: {SECTORS[value]}"
    if key in _GONE:
        return "leave it out: nothing takes its place"
    number = f"{{{key}: {json.dumps(value, default=str)}}}"
    return f"write adversary.form: {number}" if key in _IN_FORM else ""


def _stated(constraints: Iterable[str]) -> str:
    return f"adversary.constraints: [{', '.join(sorted(constraints))}]"


def _is_number(sector: Any) -> bool:
    return type(sector) is int and 0 <= sector < len(SECTORS)


def with_preset(form: Any) -> Any:
    """DeepMF's form as a mapping: ``paper`` is short for ``{preset: paper}``."""
    return {"preset": form} if isinstance(form, str) else form


def published(settings: Mapping[str, Any]) -> bool:
    """Whether DeepMF's settings, of a spec or a result, are of the form as published."""
    form = with_preset(settings.get("form"))
    return isinstance(form, Mapping) and form.get("preset") == "paper"


def in_todays_words(settings: Mapping[str, Any]) -> dict[str, Any]:
    """DeepMF's settings of specs of versions 1 and 2, or of earlier results, as version 3 has them.

    Constraints in one list, each once, in the order of their names: switches that are false switch
    nothing off, and the goal ``avoidable`` had constraints of its own. What has another value than
    it can have today, or is neither true nor false, is left for the settings to refuse.
    """
    found, names = dict(settings), settings.get("constraints", ())
    switched = [one for one in _SWITCHES if isinstance(found.get(one), bool) and found.pop(one)]
    if found.get("goal") == _EARLIER_GOAL:
        found["goal"] = GOAL
        switched += ["clean", "fair"]
    if _are_names(names) and (switched or "constraints" in found):
        found["constraints"] = sorted({*names, *switched})
    if _is_number(found.get("sector")):
        found["sector"] = SECTORS[found["sector"]]
    numbers = {key: found.pop(key) for key in _IN_FORM if key in found}
    form = with_preset(found.get("form", {}))
    if numbers and isinstance(form, Mapping):
        found["form"] = {"preset": "extended", **form, **numbers}
    for key, only in _GONE.items():
        if key in found and found[key] is only:
            del found[key]
    return found


def _in_order(names: Any) -> Any:
    """Names each once; what is no list of names as it is, to be refused."""
    return sorted({*names}) if _are_names(names) else names


def _are_names(names: Any) -> bool:
    return isinstance(names, list | tuple) and all(isinstance(one, str) for one in names)


def _ruled(choice: dict[str, Any], rule: str | None, version: int) -> dict[str, Any]:
    """DeepMF's settings with the rule, where they leave it open."""
    if rule is None or published(choice) or "rule" in choice:
        return choice
    if choice.get("aggressiveness") is not None:
        return choice
    form = choice.get("form")
    if isinstance(form, Mapping) and "likelihood_weight" in form:
        raise wrong(
            f"is for the rules expected and pair, and in version {version} the rule is likeliest"
            " where none is said; add rule: expected, or leave likelihood_weight out",
            "adversary.form.likelihood_weight" if version == 3 else "adversary.likelihood_weight",
        )
    return {**choice, "rule": rule}


def with_moments(source: Any) -> Any:
    """A source of version 3: where moments are chosen, as `attack` chooses them.

    They are spread over the network, and encounters come first at each place; attacks begin once
    the traffic has settled, unless a vehicle, which may leave before, or times are named.
    """
    moments = source.get("moments") if isinstance(source, dict) else None
    if not isinstance(moments, dict) or moments.get("of") is not None:
        return source
    filled = {"prefer": "both", **moments}
    if not any(moments.get(key) for key in ("at_s", "av")):
        filled.setdefault("from_s", "settled")
    return {**source, "moments": filled}


def _is_long(values: Mapping[str, Any]) -> bool:
    """Whether this is a long attack on a network."""
    source, duration_s = values.get("source"), values.get("duration_s")
    on_network = "network" in source if isinstance(source, dict) else hasattr(source, "network")
    return on_network and isinstance(duration_s, int | float) and duration_s > LONG_S


def _takes_turns(choice: Mapping[str, Any]) -> bool:
    """Whether an adversary can choose one opponent after another."""
    settings = {key: value for key, value in choice.items() if key != "name"}
    try:
        made = plugins.settings("adversaries", str(choice.get("name")), settings)
    except PluginError:
        return False  # which is said where plug-ins are checked
    return bool(getattr(made, "takes_turns", False))


def headline(meant: Iterable[str]) -> str:
    """``profile fair`` of runs, each as `described`; of several profiles, how many runs each has.

    Empty runs have an adversary that knows no profiles.
    """
    counts = Counter(filter(None, meant))
    if len(counts) == 1:
        return f"profile {next(iter(counts))}"
    told = (f"{name} ({count} run{'s' * (count > 1)})" for name, count in counts.items())
    return f"profiles {'; '.join(told)}" if counts else ""


def described(profile: str, constraints: Iterable[str]) -> str:
    """The profile of a run and the constraints that held: ``lawful (lawful)``; empty without one.

    A spec may state other constraints than its profile.
    """
    names = sorted(constraints)
    if names and profile:
        return f"{profile} ({', '.join(names)})"
    ours = profile in PROFILES and PROFILES[profile].constraints
    return f"{profile} (no constraints)" if ours else profile
