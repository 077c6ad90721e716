"""Which candidate the opponent drives.

With P_j = P(Y_j^OV), P_jk = P(Y_k^AV | Y_j^OV) and the likelihood weight w:

- ``expected`` (Algorithm 1, Eq. 5): largest P_j^w * sum_k P_jk Coll_jk; w = 1 is the paper's.
- ``pair`` (the paper's text): the colliding pair with the largest P_j^w * P_jk.
- ``likeliest``: among the candidates with at least 95 % of the largest collision mass
  sum_k P_jk Coll_jk, the likeliest.
- ``drawn``: any candidate, drawn with a chance that grows with its collision mass; no attack to
  report, but attacks of all kinds to learn the AV's reactions from.
- a `Balance` (``aggressiveness``) in place of a rule: see there.
- no pair collides: the pair with the largest P_j * P_jk (the paper's text), rule ``fallback``.
- steering leaves only some of the colliding pairs: sums and maxima run over these alone.

Equal values: the earlier collision, then the larger P_j, then the lower index.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal, Self

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints

Rule = Literal["expected", "pair", "likeliest", "drawn"]

MASS_SHARE: Final = 0.95
"""Of the largest collision mass: what has at least so much is as good."""
_DRAWN_ANYWAY = 0.05  # added to the collision mass: candidates that miss are of use, too
_EQUAL = 1e-9  # relative: closer values differ by rounding alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """Between likely and dangerous.

    Among the candidates with at least ``mass_share`` of the largest collision mass, the largest
    P_j^(1 - severity_share) * severity_j^severity_share, with the severity expected over the
    counted reactions. For given candidates P_j of the chosen one never rises with either share;
    its mass never falls with ``mass_share``, its severity never falls with ``severity_share``.
    """

    mass_share: float
    severity_share: float = 0.0

    @classmethod
    def at(cls, aggressiveness: float) -> Self:
        """0: the likeliest, whatever comes of it; 0.5: the rule ``likeliest``; 1: the severest."""
        return cls(
            mass_share=MASS_SHARE * min(1.0, 2 * aggressiveness),
            severity_share=max(0.0, 2 * aggressiveness - 1.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The chosen candidate, the rule that chose it, and (N1) values of the rule and of Eq. 5."""

    index: int
    rule: str
    value: Floats
    product: Floats

    def among(self, rows: Ints, count: int) -> "Choice":
        """Of all ``count`` candidates, where it was made among those in ``rows`` (K)."""
        value, product = np.zeros(count), np.zeros(count)
        value[rows], product[rows] = self.value, self.product
        return replace(self, index=int(rows[self.index]), value=value, product=product)


def choose(
    probability: Floats,
    reaction_probability: Floats,
    collides: Bools,
    collision_step: Floats,
    rule: Rule | Balance,
    likelihood_weight: float = 1.0,
    *,
    counted: Bools | None = None,
    barred: Bools | None = None,
    severity: Floats | None = None,
    rng: np.random.Generator | None = None,
) -> Choice:
    """Choose among N1 candidates with P_j (N1) and P_jk (N1, N2).

    ``collides`` and ``collision_step`` (N1, N2) are as from `candidates.collisions`; of the
    colliding pairs those ``counted`` (N1, N2) are wanted, by default all; candidates ``barred``
    (N1) are not taken. A `Balance` needs the ``severity`` (N1, N2) of collisions, ``drawn`` a
    generator.
    """
    counted = collides if counted is None else counted
    colliding = reaction_probability * counted
    mass = colliding.sum(axis=1)
    product = probability * (reaction_probability * collides).sum(axis=1)
    if rule == "drawn":
        assert rng is not None
        value, used = _drawn(mass, barred, rng), "drawn"
    elif counted.any():
        used = "aggressiveness" if isinstance(rule, Balance) else str(rule)
        if isinstance(rule, Balance):
            value = _balanced(rule, probability, colliding, mass, severity)
        else:
            value = _value(rule, probability, probability**likelihood_weight, colliding, mass)
    else:
        value = probability * reaction_probability.max(axis=1)
        used = "fallback"
    if barred is not None:
        value = np.where(barred, 0.0, value)
    first_step = (
        collision_step if counted is collides else np.where(counted, collision_step, np.inf)
    )
    index = _best(value, first_step.min(axis=1), probability)
    return Choice(index=index, rule=used, value=value, product=product)


def harmless(
    probability: Floats, reaction_probability: Floats, collides: Bools, collision_step: Floats
) -> Choice:
    """The likeliest candidate that meets the AV in no reaction; else the one that does least."""
    mass = (reaction_probability * collides).sum(axis=1)
    value = np.where(mass <= mass.min() + _EQUAL, probability, 0.0)
    index = _best(value, -collision_step.min(axis=1), probability)
    return Choice(index=index, rule="nothing fair", value=value, product=probability * mass)


def _drawn(mass: Floats, barred: Bools | None, rng: np.random.Generator) -> Floats:
    """(N1) 1 for the candidate that was drawn among those that are not barred, else 0."""
    chance = mass + _DRAWN_ANYWAY
    if barred is not None:
        chance = np.where(barred, 0.0, chance)
    value = np.zeros(len(mass))
    value[rng.choice(len(mass), p=chance / chance.sum())] = 1.0
    return value


def _value(
    rule: Rule, probability: Floats, weighted: Floats, colliding: Floats, mass: Floats
) -> Floats:
    value: Floats
    if rule == "expected":
        value = weighted * mass
    elif rule == "pair":
        value = weighted * colliding.max(axis=1)
    else:
        value = np.where(mass >= MASS_SHARE * mass.max(), probability, 0.0)
    return value


def _balanced(
    balance: Balance, probability: Floats, colliding: Floats, mass: Floats, severity: Floats | None
) -> Floats:
    value = probability ** (1.0 - balance.severity_share)
    if balance.severity_share > 0.0:
        assert severity is not None
        expected = (colliding * severity).sum(axis=1) / np.maximum(mass, _EQUAL)
        value = value * expected**balance.severity_share
    chosen: Floats = np.where(mass >= balance.mass_share * mass.max(), value, 0.0)
    return chosen


def _best(value: Floats, first_step: Floats, probability: Floats) -> int:
    equal = np.flatnonzero(value >= value.max() * (1.0 - _EQUAL))
    order = np.lexsort((equal, -probability[equal], first_step[equal]))
    return int(equal[order[0]])
