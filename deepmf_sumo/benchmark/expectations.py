"""What a spec expects, against what a run gave."""

from collections.abc import Iterator

from deepmf_sumo.benchmark.result import Result, first_contact
from deepmf_sumo.spec import Expect


def broken(expect: Expect, result: Result) -> list[str]:
    """A sentence for each expectation that does not hold; a run without a result is not judged."""
    return list(_broken(expect, result)) if result["status"] == "ok" else []


def _broken(expect: Expect, result: Result) -> Iterator[str]:
    outcome = result["outcome"]
    hit = any(contact["kind"] in {"av_opponent", "av_other"} for contact in result["contacts"])
    if expect.av_collision is not None and hit != expect.av_collision:
        yield f"av_collision is {_yaml(hit)}, expected {_yaml(expect.av_collision)}"
    if expect.outcome is not None and outcome != expect.outcome:
        yield f"outcome is {outcome}, expected {expect.outcome}"
    contact = first_contact(result)
    fastest = expect.max_contact_speed_mps
    if fastest is not None and contact and contact["relative_mps"] > fastest:
        yield f"contact speed is {contact['relative_mps']:.2f} m/s, expected at most {fastest:g}"
    for name, bound in expect.metrics.items():
        found = result["metrics"].get(name, {"reason": "no such metric"})
        value = found.get("value")
        if value is None:
            yield f"{name} has no value ({found['reason']})"
        elif bound.min is not None and value < bound.min:
            yield f"{name} is {value:.4g}, expected at least {bound.min:g}"
        elif bound.max is not None and value > bound.max:
            yield f"{name} is {value:.4g}, expected at most {bound.max:g}"


def _yaml(value: bool) -> str:
    return "true" if value else "false"
