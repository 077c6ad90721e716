"""Policies that attack with one vehicle."""


def plan_of(policy, view):
    """The plan of the only vehicle."""
    (plan,) = policy.plan(view).values()
    return plan
