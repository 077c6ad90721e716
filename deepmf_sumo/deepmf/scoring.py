"""Scoring of candidates, and the choice of the best.

With P_j = P(Y_j^OV), P_jk = P(Y_k^AV | Y_j^OV) and the likelihood weight w:

- ``expected`` (Algorithm 1, Eq. 5): largest P_j^w * sum_k P_jk Coll_jk; w = 1 is the paper's.
- ``pair`` (text of the paper): the colliding pair with the largest P_j^w * P_jk.
- ``likeliest``: among the candidates with at least 95 % of the largest collision mass
  sum_k P_jk Coll_jk, the likeliest.
- ``drawn``: a random candidate, with a probability that grows with its collision mass. It is meant
  for training data: attacks of all kinds, from which the AV's reactions can be learned.
- ``aggressiveness``: see `Balance`, which replaces the rule.
- If no pair collides: the pair with the largest P_j * P_jk (text of the paper), rule ``fallback``.
- If constraints exclude some colliding pairs: sums and maxima run over the remaining pairs.

Ties go to the earlier collision, then the larger P_j, then the lower index.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, Self

import numpy as np

from deepmf_sumo.scene import FUTURE_STEPS, Bools, Floats, Ints

Rule = Literal["expected", "pair", "likeliest", "drawn"]

MASS_SHARE: Final = 0.95
"""Candidates with at least this share of the largest collision mass are equally good."""
Scope = Literal["driven", "attack", "preferred"]
_REFUSALS = 12  # verifying a candidate takes some milliseconds
_DRAWN_ANYWAY = 0.05  # added to the collision mass: candidates that miss are drawn, too
_EQUAL = 1e-9  # relative: smaller differences are rounding errors


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """A balance of likelihood and severity.

    It chooses, among the candidates with at least ``mass_share`` of the largest collision mass, the
    largest P_j^(1 - severity_share) * severity_j^severity_share, where the severity is the expected
    one over the reactions that count. For given candidates, a larger share never raises P_j of the
    chosen candidate; a larger ``mass_share`` never lowers its mass, a larger ``severity_share``
    never its severity.
    """

    mass_share: float
    severity_share: float = 0.0

    @classmethod
    def at(cls, aggressiveness: float) -> Self:
        """0: the likeliest, even if it misses; 0.5: as rule ``likeliest``; 1: the most severe."""
        return cls(
            mass_share=MASS_SHARE * min(1.0, 2 * aggressiveness),
            severity_share=max(0.0, 2 * aggressiveness - 1.0),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """The rule of the choice; ``drawn`` needs ``rng``."""

    rule: Rule | Balance = "expected"
    likelihood_weight: float = 1.0
    rng: np.random.Generator | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """N1 candidates with P_j, N2 reactions to each of them with P_jk, and their collisions.

    Attributes:
        probability: (N1). reaction_probability, collides, collision_step: (N1, N2), the last two as
            from `candidates.collisions`.
        sector: (N1, N2) of the AV that is hit; None if it is not needed.
        severity: (N1, N2) delta-v of the AV; None if it is not needed.
    """

    probability: Floats
    reaction_probability: Floats
    collides: Bools
    collision_step: Floats
    sector: Ints | None = None
    severity: Floats | None = None

    def among(self, rows: Ints) -> "Pairs":
        """Only these candidates (K)."""
        return Pairs(
            probability=self.probability[rows],
            reaction_probability=self.reaction_probability[rows],
            collides=self.collides[rows],
            collision_step=self.collision_step[rows],
            sector=None if self.sector is None else self.sector[rows],
            severity=None if self.severity is None else self.severity[rows],
        )

    def counting(self, counts: Bools) -> "Pairs":
        """Only collisions of some pairs (N1, N2)."""
        collides = self.collides & counts
        step = np.where(self.collides & ~counts, FUTURE_STEPS, self.collision_step)
        return replace(self, collides=collides, collision_step=step)

    @property
    def mass(self) -> Floats:
        """(N1) probability that the AV collides with each candidate."""
        return (self.reaction_probability * self.collides).sum(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Mask:
    """Candidates (N1) or pairs (N1, N2) that a constraint allows."""

    name: str
    scope: Scope
    allowed: Bools

    def among(self, rows: Ints) -> "Mask":
        """Only these candidates (K)."""
        return replace(self, allowed=self.allowed[rows])


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The index of the chosen candidate, the rule used, and (N1) its values and those of Eq. 5.

    ``unmet``: names of the constraints that were dropped.
    """

    index: int
    rule: str
    value: Floats
    product: Floats
    unmet: tuple[str, ...] = ()

    def of_all(self, rows: Ints, count: int) -> "Choice":
        """This choice, which was made among ``rows``, in terms of all ``count`` candidates."""
        value, product = np.zeros(count), np.zeros(count)
        value[rows], product[rows] = self.value, self.product
        return replace(self, index=int(rows[self.index]), value=value, product=product)


def decide(
    pairs: Pairs,
    masks: Sequence[Mask],
    objective: Objective,
    confirmed: Callable[[int, int], bool],
) -> tuple[Choice, list[Mask]]:
    """`choose_allowed`, until all constraints confirm the choice.

    ``confirmed(number of the mask, row)`` says so of the row that is chosen.

    A refused candidate is no longer allowed; after 12 refusals none is. The returned masks are
    without the refused candidates.
    """
    masks, refusals = list(masks), 0
    while True:
        choice = choose_allowed(pairs, masks, objective)
        refused = next((n for n in _binding(masks, choice) if not confirmed(n, choice.index)), None)
        if refused is None:
            return choice, masks
        refusals += 1
        left = np.arange(len(pairs.probability)) != choice.index
        allowed = masks[refused].allowed & left & (refusals < _REFUSALS)
        masks[refused] = replace(masks[refused], allowed=allowed)


def _binding(masks: Sequence[Mask], choice: Choice) -> list[int]:
    """Masks that a choice has to obey; none if the attack was dropped."""
    required = [number for number, mask in enumerate(masks) if mask.scope != "preferred"]
    given_up = {masks[number].name for number in required} & {*choice.unmet}
    return [] if given_up else required


def choose_allowed(pairs: Pairs, masks: Sequence[Mask], objective: Objective) -> Choice:
    """The choice by the pairs that count; ``unmet`` names the constraints that are dropped.

    - ``driven``: the choice is among the allowed candidates, or among all if there are none.
    - ``attack``: pairs of forbidden candidates do not count, and such candidates are not chosen if
      they collide.
    - If pairs collide, but none that these two allow: no attack (`harmless`), rule
      ``nothing <name>``.
    - ``preferred``: allowed pairs count, first those of candidates that collide mostly in allowed
      pairs, because any contact ends the attack. If there are none, the constraint is dropped; the
      rule then ends with ``, any <name>``.
    """
    for number, mask in enumerate(masks):
        if mask.scope == "driven":
            return _among_allowed(pairs, mask, [*masks[:number], *masks[number + 1 :]], objective)
    counted, barred, unmet = pairs.collides, None, []
    for mask in masks:
        if mask.scope == "attack":
            counted = counted & mask.allowed[:, None]
            bars = pairs.collides.any(axis=1) & ~mask.allowed
            barred = bars if barred is None else barred | bars
            if pairs.collides.any() and not counted.any():
                return _given_up(pairs, mask)
    for mask in masks:
        if mask.scope == "preferred":
            there = counted & mask.allowed
            if there.any():
                counted = _mostly(there, pairs)
            else:
                unmet.append(mask.name)
    choice = choose(pairs, objective, counted=counted, barred=barred)
    suffix = "".join(f", any {name}" for name in unmet) if counted.any() else ""
    return replace(choice, rule=choice.rule + suffix, unmet=tuple(unmet))


def _among_allowed(pairs: Pairs, mask: Mask, rest: list[Mask], objective: Objective) -> Choice:
    """The choice among the allowed candidates only."""
    rows, count = np.flatnonzero(mask.allowed), len(mask.allowed)
    if not len(rows):
        none = pairs.collides.any()
        return _given_up(pairs, mask) if none else choose_allowed(pairs, rest, objective)
    left = pairs.among(rows)
    if pairs.collides.any() and not left.collides.any():
        return _given_up(left, mask).of_all(rows, count)
    return choose_allowed(left, [one.among(rows) for one in rest], objective).of_all(rows, count)


def _given_up(pairs: Pairs, mask: Mask) -> Choice:
    return replace(harmless(pairs, f"nothing {mask.name}"), unmet=(mask.name,))


def _mostly(there: Bools, pairs: Pairs) -> Bools:
    """Pairs ``there`` of candidates that collide mostly in them; all of ``there`` if none does."""
    rather = 2 * (pairs.reaction_probability * there).sum(axis=1) > pairs.mass
    narrowed = there & rather[:, None]
    return narrowed if narrowed.any() else there


def choose(
    pairs: Pairs,
    objective: Objective,
    *,
    counted: Bools | None = None,
    barred: Bools | None = None,
) -> Choice:
    """Choose among N1 candidates.

    ``counted`` (N1, N2): colliding pairs that count, by default all. ``barred`` (N1): candidates
    that are not chosen. A `Balance` needs ``pairs.severity``.
    """
    rule, probability = objective.rule, pairs.probability
    counted = pairs.collides if counted is None else counted
    colliding = pairs.reaction_probability * counted
    mass = colliding.sum(axis=1)
    if rule == "drawn":
        assert objective.rng is not None
        value, used = _drawn(mass, barred, objective.rng), "drawn"
    elif not counted.any():
        value, used = probability * pairs.reaction_probability.max(axis=1), "fallback"
    elif isinstance(rule, Balance):
        value = _balanced(rule, probability, colliding, mass, pairs.severity)
        used = "aggressiveness"
    else:
        weighted = probability**objective.likelihood_weight
        value, used = _value(rule, probability, weighted, colliding, mass), str(rule)
    if barred is not None:
        value = np.where(barred, 0.0, value)
    step = pairs.collision_step
    first_step = step if counted is pairs.collides else np.where(counted, step, np.inf)
    index = _best(value, first_step.min(axis=1), probability)
    return Choice(index=index, rule=used, value=value, product=probability * pairs.mass)


def harmless(pairs: Pairs, rule: str) -> Choice:
    """The likeliest candidate of those with the least collision mass: no attack."""
    mass = pairs.mass
    value = np.where(mass <= mass.min() + _EQUAL, pairs.probability, 0.0)
    index = _best(value, -pairs.collision_step.min(axis=1), pairs.probability)
    return Choice(index=index, rule=rule, value=value, product=pairs.probability * mass)


def _drawn(mass: Floats, barred: Bools | None, rng: np.random.Generator) -> Floats:
    """(N1) 1 for the drawn candidate, which is not barred; else 0."""
    chance = mass + _DRAWN_ANYWAY
    if barred is not None:
        chance = np.where(barred, 0.0, chance)
    value = np.zeros(len(mass))
    value[rng.choice(len(mass), p=chance / chance.sum())] = 1.0
    return value


def _value(
    rule: Rule, probability: Floats, weighted: Floats, colliding: Floats, mass: Floats
) -> Floats:
    if rule == "expected":
        return weighted * mass
    if rule == "pair":
        return weighted * colliding.max(axis=1)
    return np.where(mass >= MASS_SHARE * mass.max(), probability, 0.0)


def _balanced(
    balance: Balance, probability: Floats, colliding: Floats, mass: Floats, severity: Floats | None
) -> Floats:
    value = probability ** (1.0 - balance.severity_share)
    if balance.severity_share > 0.0:
        assert severity is not None
        expected = (colliding * severity).sum(axis=1) / np.maximum(mass, _EQUAL)
        value = value * expected**balance.severity_share
    return np.where(mass >= balance.mass_share * mass.max(), value, 0.0)


def _best(value: Floats, first_step: Floats, probability: Floats) -> int:
    equal = np.flatnonzero(value >= value.max() * (1.0 - _EQUAL))
    order = np.lexsort((equal, -probability[equal], first_step[equal]))
    return int(equal[order[0]])
