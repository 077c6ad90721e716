"""Which candidate the opponent drives.

With P_j = P(Y_j^OV), P_jk = P(Y_k^AV | Y_j^OV) and the likelihood weight w:

- ``expected`` (Algorithm 1, Eq. 5): largest P_j^w * sum_k P_jk Coll_jk; w = 1 is the paper's.
- ``pair`` (the paper's text): the colliding pair with the largest P_j^w * P_jk.
- ``likeliest``: among the candidates with at least 95 % of the largest collision mass
  sum_k P_jk Coll_jk, the likeliest.
- no pair collides: the pair with the largest P_j * P_jk (the paper's text), rule ``fallback``.

Equal values: the earlier collision, then the larger P_j, then the lower index.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats

Rule = Literal["expected", "pair", "likeliest"]

_MASS_SHARE = 0.95
_EQUAL = 1e-9  # relative: closer values differ by rounding alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The chosen candidate, the rule that chose it, and (N1) values of the rule and of Eq. 5."""

    index: int
    rule: str
    value: Floats
    product: Floats


def choose(
    probability: Floats,
    reaction_probability: Floats,
    collides: Bools,
    collision_step: Floats,
    rule: Rule,
    likelihood_weight: float = 1.0,
) -> Choice:
    """Choose among N1 candidates with P_j (N1) and P_jk (N1, N2).

    ``collides`` and ``collision_step`` (N1, N2) are as from `collision.collisions`.
    """
    mass = (reaction_probability * collides).sum(axis=1)
    product = probability * mass
    if collides.any():
        weighted = probability**likelihood_weight
        value = _value(rule, probability, weighted, reaction_probability * collides, mass)
        used: str = rule
    else:
        value = probability * reaction_probability.max(axis=1)
        used = "fallback"
    index = _best(value, collision_step.min(axis=1), probability)
    return Choice(index=index, rule=used, value=value, product=product)


def _value(
    rule: Rule, probability: Floats, weighted: Floats, colliding: Floats, mass: Floats
) -> Floats:
    value: Floats
    if rule == "expected":
        value = weighted * mass
    elif rule == "pair":
        value = weighted * colliding.max(axis=1)
    else:
        value = np.where(mass >= _MASS_SHARE * mass.max(), probability, 0.0)
    return value


def _best(value: Floats, first_step: Floats, probability: Floats) -> int:
    equal = np.flatnonzero(value >= value.max() * (1.0 - _EQUAL))
    order = np.lexsort((equal, -probability[equal], first_step[equal]))
    return int(equal[order[0]])
