"""A planner's answer, as text, made a command, or a sentence about what is wrong with it."""

import json
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from deepmf_sumo.datatypes import Command, VehicleModel
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.doors.messages import ANSWERS, PROTOCOL, Ready
from deepmf_sumo.plugins import explain

LONGEST_BYTES: Final = 65_536
"""Of an answer; a command has some hundred."""

M = TypeVar("M", bound=BaseModel)


def read_ready(who: str, text: bytes) -> VehicleModel | None:
    """The vehicle model that a planner asks for. Raises PlannerError naming ``who``."""
    values = _object(who, text)
    if values.get("protocol") != PROTOCOL:
        raise PlannerError(
            f"{who} speaks protocol {_short(values.get('protocol'))}, this is {PROTOCOL}: answer"
            f' the reset with {{"type": "ready", "protocol": {PROTOCOL}}}.'
        )
    model = _checked(who, Ready, values).model
    return None if model is None else VehicleModel(**model.model_dump())


def read_command(who: str, text: bytes, step: int) -> Command:
    """The command for a step. Raises PlannerError naming ``who``, key, value and rule."""
    values = _object(who, text)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in ANSWERS:
        raise PlannerError(
            f"{who} answered kind {_short(kind)} at step {step}; known: {', '.join(ANSWERS)}."
        )
    answer = _checked(f"{who} at step {step}", ANSWERS[kind], values)
    if answer.step != step:
        raise PlannerError(f"{who} answered for step {answer.step} when asked for step {step}.")
    return Command(**answer.model_dump(exclude={"type", "step"}))


def _object(who: str, text: bytes) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        raise PlannerError(
            f"{who} answered {_short(text.decode(errors='replace'))}, which is not JSON; what is"
            " not an answer belongs on stderr."
        ) from None
    if not isinstance(values, dict):
        raise PlannerError(f"{who} answered {_short(values)}, which is not a JSON object.")
    return values


def _checked(who: str, model: type[M], values: dict[str, Any]) -> M:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise PlannerError(f"{who} answered wrongly: {_cut(explain(error, model), 300)}") from None


def _short(value: object) -> str:
    return _cut(repr(value), 80)


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
