"""Combine belief functions over the classes of a contact from several views (Dempster-Shafer theory).

A mass function is a float64 array (..., 32): entry number A is the mass of the subset of FRAME whose classes are the
set bits of A. Entry 0 is the empty set, the mass of contradiction; entry 31 is the whole frame, the mass of ignorance.
Masses sum to 1.

All rules are sums of products of masses, never differences, so nothing cancels: a chain of 60 views is exact to some
1e-15.

Shafer, "A Mathematical Theory of Evidence", 1976; Smets and Kennes, "The transferable belief model", Artificial
Intelligence 66, 1994.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Final, NamedTuple, TypeAlias, cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.records import ContactClass

Array: TypeAlias = NDArray[np.float64]

FRAME: Final[tuple[ContactClass, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge", "clutter")
N_CLASSES: Final = len(FRAME)
N_SUBSETS: Final = 1 << N_CLASSES
EVERYTHING: Final = N_SUBSETS - 1
MINE_LIKE_P: Final = 0.2  # threshold of p_mine for calling a contact a mine: a miss costs more than four false alarms


def subset(*names: ContactClass) -> int:
    """Give the index of the subset of FRAME that holds the classes named.

    Raises ValueError for a name that is not in FRAME.
    """
    if not set(names) <= set(FRAME):
        raise ValueError(f"{sorted(set(names) - set(FRAME))} are not classes of {FRAME}")
    return sum(1 << FRAME.index(name) for name in set(names))


MINES: Final = EVERYTHING & ~subset("clutter")

MAX_RELIABILITY: Final = 0.95  # upper bound on the reliability of a single statement about a class
# What five statements of that reliability leave to ignorance; it bounds every source, so that none can veto all others.
MIN_IGNORANCE: Final = (1.0 - MAX_RELIABILITY) ** N_CLASSES
# below it the agreement of two sources is rounding, and dividing by it would make certainty of it
MIN_AGREEMENT: Final = 1e-12

DEMPSTER_BELOW: Final = 0.6  # conflict K up to which Dempster's rule combines views; chosen, not measured
# conflict K from which nothing is combined: two opposite views of reliability 0.95 stay just below
APART_FROM: Final = 0.9
ASPECT_SPREAD_RAD: Final = math.radians(15.0)  # shadows from aspects closer than this mostly repeat each other

_SUBSETS: Final = np.arange(N_SUBSETS)
_CLUTTER: Final = EVERYTHING & ~MINES
_ONLY_MINES: Final = _SUBSETS[1:][(_SUBSETS[1:] & _CLUTTER) == 0]
_A_MINE: Final = (_SUBSETS == MINES).astype(np.float64)
_TIE: Final = 1e-9  # of probabilities, well above rounding
_IS_IN: Final = (_SUBSETS >> np.arange(N_CLASSES)[:, np.newaxis]) & 1  # (5, 32)
_SIZE: Final = _IS_IN.sum(axis=0)
_LOG2_SIZE: Final = np.log2(np.maximum(_SIZE, 1))

# All pairs of subsets, ordered by what they have in common, and where each intersection starts.
_PAIRS: Final = np.argsort((_SUBSETS[:, np.newaxis] & _SUBSETS).ravel(), kind="stable")
_FIRST, _SECOND = np.divmod(_PAIRS, N_SUBSETS)
_STARTS: Final = np.searchsorted(_FIRST & _SECOND, _SUBSETS)


def vacuous() -> Array:
    """Give the (32,) mass of total ignorance."""
    mass = np.zeros(N_SUBSETS)
    mass[EVERYTHING] = 1.0
    return mass


def discount(mass: Array, reliability: ArrayLike) -> Array:
    """Discount `mass` (..., 32) by a source's reliability (...), a probability.

    The rest goes to ignorance (Shafer 1976).
    """
    share = np.asarray(reliability, dtype=np.float64)[..., np.newaxis]
    return share * mass + (1.0 - share) * vacuous()


def belief(mass: Array) -> Array:
    """Compute Bel(A), (..., 32): the mass of the subsets of A but the empty one, which imply A."""
    consistent = mass.copy()
    consistent[..., 0] = 0.0
    return _subset_sum(consistent)


def pignistic(mass: Array) -> Array:
    """Share each set's mass evenly among its classes: (..., 5) probabilities of FRAME for a decision (Smets).

    The empty set's mass is left out and the rest scaled to 1, so `mass` must have some mass elsewhere.
    """
    shares = mass[..., 1:] / _SIZE[1:]
    by_class = (shares[..., np.newaxis, :] * _IS_IN[:, 1:]).sum(axis=-1)
    return np.asarray(by_class / by_class.sum(axis=-1, keepdims=True))


def singleton_belief(mass: Array) -> dict[str, float]:
    """Give the belief that a mass (32,) commits to each class of FRAME alone, and the rest as `unknown`; sums to 1."""
    beliefs: dict[str, float] = {name: float(mass[1 << i]) for i, name in enumerate(FRAME)}
    beliefs["unknown"] = max(1.0 - sum(beliefs.values()), 0.0)
    return beliefs


def most_believed(beliefs: Mapping[str, float]) -> ContactClass:
    """Choose the class, or "unknown", with the highest belief, the first of equal ones."""
    return cast(ContactClass, max(beliefs, key=lambda name: beliefs[name]))


def bounded_by(mass: Array, p_mine: float) -> Array:
    """Turn what a mass (32,) commits to mines, or to clutter, beyond a probability of a mine into ignorance.

    So Bel(mine) <= p_mine <= Pl(mine) holds: a source may commit less than the probability, never more.
    """
    to_mines = float(mass[_ONLY_MINES].sum())
    to_clutter = float(mass[_CLUTTER])
    bounded = mass.copy()
    if to_mines > p_mine:
        bounded[_ONLY_MINES] *= p_mine / to_mines
    if to_clutter > 1.0 - p_mine:
        bounded[_CLUTTER] = 1.0 - p_mine
    bounded[EVERYTHING] += max(1.0 - float(bounded.sum()), 0.0)
    return bounded


def likeliest_mine(mass: Array) -> ContactClass:
    """Choose the kind of mine with the highest pignistic probability, given that it is a mine.

    "unknown" where kinds tie.
    """
    as_mine, _ = conjunctive(mass, _A_MINE)
    as_mine[0] = 0.0
    if not as_mine.sum() >= MIN_AGREEMENT:
        return "unknown"
    by_class = pignistic(as_mine)
    best = int(by_class.argmax())
    return FRAME[best] if np.count_nonzero(by_class >= by_class[best] - _TIE) == 1 else "unknown"


def nonspecificity(mass: Array) -> Array:
    """Measure how little a mass function states, (...) bits.

    The mean log2 of its sets' sizes (Dubois and Prade 1985).
    """
    return np.asarray((mass * _LOG2_SIZE).sum(axis=-1))


def conflict(first: Array, second: Array) -> Array:
    """Compute K, (...): the mass that independent sources (..., 32) together give to the empty set."""
    return np.asarray((first * _subset_sum(second)[..., ::-1]).sum(axis=-1))


def conjunctive(first: Array, second: Array) -> tuple[Array, Array]:
    """Combine two independent reliable sources, and measure how much they contradict each other.

    Both (..., 32), broadcast. Returns the mass (..., 32), not normalised, m(C) = sum of first(A) second(B) over A and B
    = C, and the mass K (...) of the empty set.
    """
    mass = np.add.reduceat(first.take(_FIRST, axis=-1) * second.take(_SECOND, axis=-1), _STARTS, axis=-1)
    return mass, mass[..., 0]


class Combined(NamedTuple):
    """Hold a combination of sources.

    mass: (..., 32), without mass of contradiction. log_agreement: (...) ln(1 - K) of all sources, -inf for total
    contradiction.
    """

    mass: Array
    log_agreement: Array


def dempster(masses: Array) -> Combined:
    """Combine sources (n, ..., 32) by Dempster's rule: conjunctive, scaled so that the empty set has no mass.

    Scaled after every source, so that any number may follow. Where sources have less than 1e-12 in common the result is
    vacuous.
    """
    mass, agreement = _normalised(masses[0])
    log_agreement = _log(agreement)
    for source in masses[1:]:
        mass, agreement = _normalised(conjunctive(mass, source)[0])
        log_agreement = log_agreement + _log(agreement)
    return Combined(np.where(np.isneginf(log_agreement)[..., np.newaxis], vacuous(), mass), log_agreement)


def yager(masses: Array) -> Array:
    """Combine sources (n, ..., 32) by Yager's rule into (..., 32).

    What contradicts all sources together becomes ignorance (Information Sciences 41, 1987).
    """
    mass: Array = reduce(lambda fused, source: conjunctive(fused, source)[0], masses[1:], masses[0]).copy()
    mass[..., EVERYTHING] += mass[..., 0]
    mass[..., 0] = 0.0
    return mass


class ViewMass(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold what one view states about a contact.

    mass: (32,) float64, 0 on the empty set. aspect_rad: compass direction from sonar to object. half_turn_symmetric:
    the shape that fits best looks the same from the opposite side (cylinder, sphere, cone; not a wedge).

    Raises ValueError if the mass is not a mass function or the aspect is not finite.
    """

    mass: Array
    aspect_rad: float
    half_turn_symmetric: bool = True

    def __post_init__(self) -> None:
        mass = self.mass
        if mass.shape != (N_SUBSETS,) or not (mass >= 0.0).all() or mass[0] != 0.0 or not abs(mass.sum() - 1.0) <= 1e-9:
            raise ValueError(f"mass of a view must be {N_SUBSETS} numbers >= 0 that sum to 1, the first 0; got {mass}")
        if not math.isfinite(self.aspect_rad):
            raise ValueError(f"aspect_rad of a view must be finite, got {self.aspect_rad}")


class Fusion(NamedTuple):
    """Hold what all views of a contact state together.

    mass: (32,) float64, vacuous if they contradict each other too much to belong to one object. conflict: the greatest
    K of one view with all others combined.
    """

    mass: Array
    conflict: float


def combine(views: Sequence[ViewMass]) -> Fusion:
    """Fuse the views of one contact; their order does not matter.

    Views from similar aspects repeat each other: the most specific one counts in full, the others are discounted by the
    product of 1 - rho over all that are more specific, with rho = exp(-angle^2 / (2 spread^2)).

    K, how far the views contradict each other, is the greatest conflict of any with all others together (for two, their
    conflict; the conflict of all at once would near 1 for any long row of views that waver between two classes). Below
    0.6 they are combined by Dempster's rule, below 0.9 by Yager's, else not. Two opposite views of reliability 0.95
    stay just below 0.9, as neither is known to be the odd one; a third view decides. Discounts do not enter K:
    contradiction from the same aspect is the surest sign of two objects.

    Raises ValueError if there is no view.
    """
    if not views:
        raise ValueError("combine needs at least one view")
    # An order given by the views themselves makes the result the same to the last bit, whatever order they came in.
    ordered = sorted(views, key=lambda v: (v.aspect_rad, v.half_turn_symmetric, v.mass.tolist()))
    masses = _undogmatic(np.stack([view.mass for view in ordered]))
    worst = float(_conflict_with_others(masses).max())
    by_information = np.argsort(nonspecificity(masses), kind="stable")
    likeness = _likeness(ordered)[np.ix_(by_information, by_information)]
    discounted = discount(masses[by_information], np.prod(1.0 - np.tril(likeness, -1), axis=1))
    if worst < DEMPSTER_BELOW:
        return Fusion(dempster(discounted).mass, worst)
    return Fusion(yager(discounted) if worst < APART_FROM else vacuous(), worst)


def next_look_aspects(aspects_rad: ArrayLike) -> Array:
    """Propose (k,) directions in [0, pi) to view from next, farthest from the views so far first.

    Each direction stands for its opposite as well. They are the middles of the gaps between `aspects_rad` (n,), the
    aspects viewed so far, on the half circle; the widest gap comes first, of equal ones that of the lower angle.
    """
    # A rounding error below pi is pi to the remainder; as zero it must not open a gap of its own.
    taken = np.unique(np.remainder(np.remainder(np.asarray(aspects_rad, dtype=np.float64), np.pi), np.pi))
    gaps = np.diff(taken, append=taken[:1] + np.pi)
    middles = np.remainder(taken + 0.5 * gaps, np.pi)
    # Rounded, so that gaps meant to be equal are and those between equal aspects are none.
    gaps = np.round(gaps, 9)
    order = np.lexsort((middles, -gaps))
    return np.asarray(middles[order[gaps[order] > 0.0]])


def _subset_sum(values: Array) -> Array:
    """Sum over the subsets of each set, (..., 32), along each class in turn.

    Axis -1 - i of (..., 2, 2, 2, 2, 2) is class i out or in.
    """
    cube = values.reshape(*values.shape[:-1], *(2,) * N_CLASSES)
    for axis in range(-N_CLASSES, 0):
        cube = cube.cumsum(axis)
    return cube.reshape(values.shape)


def _log(agreement: Array) -> Array:
    return np.log(agreement, out=np.full_like(agreement, -np.inf), where=agreement >= MIN_AGREEMENT)


def _normalised(mass: Array) -> tuple[Array, Array]:
    """Scale `mass` (..., 32) without its empty set to sum 1, and give the mass that was left (...).

    The result is vacuous where too little is left.
    """
    consistent = mass.copy()
    consistent[..., 0] = 0.0
    agreement = consistent.sum(axis=-1, keepdims=True)
    some = agreement >= MIN_AGREEMENT
    return np.where(some, consistent / np.where(some, agreement, 1.0), vacuous()), agreement[..., 0]


def _undogmatic(mass: Array) -> Array:
    known = 1.0 - mass[..., EVERYTHING]
    return discount(mass, (1.0 - MIN_IGNORANCE) / np.maximum(known, 1.0 - MIN_IGNORANCE))


def _conflict_with_others(sources: Array) -> Array:
    """Compute the conflict of each source (n, 32) with Dempster's combination of all others, (n,)."""
    # Row k: all before source k, forward, and all after source n - 1 - k.
    both_ways = np.stack((sources, sources[::-1]), axis=1)
    passed = [np.stack((vacuous(), vacuous()))]
    for source in both_ways[:-1]:
        passed.append(_normalised(conjunctive(passed[-1], source)[0])[0])
    before, after = np.stack(passed, axis=1)
    return conflict(sources, _normalised(conjunctive(before, after[::-1])[0])[0])


def _likeness(views: Sequence[ViewMass]) -> Array:
    """Compute rho of views, (n, n)."""
    aspect = np.array([view.aspect_rad for view in views])
    symmetric = np.array([view.half_turn_symmetric for view in views])
    turn = np.where(symmetric[:, np.newaxis] & symmetric, np.pi, 2.0 * np.pi)
    apart = aspect[:, np.newaxis] - aspect
    apart -= turn * np.round(apart / turn)
    return np.asarray(np.exp(-0.5 * (apart / ASPECT_SPREAD_RAD) ** 2))
