"""Fuse all views of one contact: is it a mine, of which kind, and would another view change that.

Whether it is a mine and of which kind are weighed apart. Views that show different kinds, as the end and the side of a
cylinder do, must not undo that both show a mine. The prior, how rare mines are, counts once per contact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.classify.beliefs import (
    APART_FROM,
    MINE_LIKE_P,
    Array,
    ViewMass,
    bounded_by,
    combine,
    likeliest_mine,
    most_believed,
    next_look_aspects,
    singleton_belief,
    vacuous,
)
from auv_mcm.classify.odds import mass_of_ratio, share_of_ratio, with_ratio
from auv_mcm.detect.belief import odds_of, probability
from auv_mcm.records import NAN, ContactClass, Detection

CONTRADICTION: Final = "views_contradict"
_NAMED_NATS: Final = 0.3  # of agreement from which the reasons name it: a third of the odds
AGREEMENT_NATS: Final = (0.43, 0.49)
"""Evidence of a view from another direction, nats: the first, and the second times ln of the probability that both
show the same kind of mine. Half the weights of a logistic regression on contacts of 18 drawn missions flown both ways
with 540 mines, since sea floors have fewer rocks. On eight others with 240 mines, on which half was chosen among four
shares, Pd at 100 false alarms per km² rises from 0.77 to 0.82 where the 240 rocks count, and falls from 0.94 to 0.92
where they do not; on boulders fewer rocks are called (`tests/sim_replay/benches/test_views_bench.py`)."""
_MOST_NEWS: Final = 3.0  # views from other directions that agreement counts for, maximum: as many as it was fitted on
_SPREAD_DEG: Final = 15.0  # views from directions closer than this mostly repeat each other
_ONE_LOOK: Final = 3.0  # nats that another view may bring
_LOOKS: Final = 2  # directions proposed, maximum
_LEAST: Final = 1e-3  # probability that views show the same kind, minimum; chosen, since it rests on two pictures


class FusedViews(NamedTuple):
    """Hold what is known of a contact; the fields are those of `Contact`.

    mine_kind: the likeliest kind if it is a mine. reasons: codes beyond those of the views.
    """

    p_mine: float
    classification: ContactClass
    mine_kind: ContactClass
    belief: dict[str, float]
    conflict: float
    next_look_deg: tuple[float, ...]
    reasons: tuple[str, ...]


def fuse(views: Sequence[Detection], prior: float) -> FusedViews:
    """Fuse the views of one contact, whose order does not matter.

    prior: log-odds of a mine among detections, which each view's p_mine contains and the contact's contains once. Views
    that contradict each other too much to belong to one object are not fused: the most mine-like one stands for the
    contact. Raises ValueError if there is no view.
    """
    if not views:
        raise ValueError("fuse needs at least one view")
    # An order of their own makes the result the same to the last bit, whatever order they came in.
    views = sorted(views, key=lambda view: (view.time_s, view.side, view.column))
    strongest = max(views, key=lambda view: (view.p_mine, -view.time_s))
    if len(views) == 1:
        return _verdict(_view_mass(strongest, prior), strongest.p_mine, NAN, views, prior, ())
    ratios = [_log_ratio(view, prior) for view in views]
    conflict = share_of_ratio(max(ratios)) * share_of_ratio(-min(ratios))
    if conflict >= APART_FROM:
        return _verdict(_view_mass(strongest, prior), strongest.p_mine, conflict, views, prior, (CONTRADICTION,))
    kinds = combine([_shape_source(view) for view in views])
    agreement = agreement_nats(views, ratios)
    named = "kinds_agree" if agreement > 0.0 else "kinds_differ"
    reasons = (named,) if abs(agreement) >= _NAMED_NATS else ()
    ratio = max(ratios) + agreement
    mass = with_ratio(kinds.mass, ratio)
    return _verdict(mass, probability(ratio + prior), max(conflict, kinds.conflict), views, prior, reasons)


def agreement_nats(views: Sequence[Detection], log_ratios: Sequence[float]) -> float:
    """Weigh whether the views of a contact show one kind of mine, nats for a mine.

    A mine that one view shows badly is a mine, so the most mine-like view speaks, and further views add nothing by
    being mine-like. But a mine shows the same kind from every direction, where a stone looks like another one from
    each. A view counts against the most mine-like one by AGREEMENT_NATS, times the product of 1 - rho over all views
    with more evidence for a mine, with rho = exp(-angle^2 / (2 * 15^2 degrees)). A view whose direction or kinds are
    not known counts nothing. views, log_ratios: (n,) each, n >= 1; the ratios in nats.
    """
    order = sorted(range(len(views)), key=lambda index: (-log_ratios[index], index))
    best = views[order[0]].kind_nats
    first, slope = AGREEMENT_NATS
    total = 0.0
    for place, index in enumerate(order[1:], start=1):
        news = 1.0
        for before in order[:place]:
            apart_deg = math.remainder(views[index].aspect_deg - views[before].aspect_deg, 360.0)
            news *= 1.0 - math.exp(-0.5 * (apart_deg / _SPREAD_DEG) ** 2) if math.isfinite(apart_deg) else 0.0
        if best and views[index].kind_nats:
            total += news * (first + slope * _same_kind_nats(best, views[index].kind_nats))
    return min(total, _MOST_NEWS * first)


def _same_kind_nats(one: Sequence[float], other: Sequence[float]) -> float:
    """Compute the logarithm of the probability that two views show the same kind."""
    p_one, p_other = (np.exp(np.asarray(nats) - max(nats)) for nats in (one, other))
    return math.log(max(float(p_one @ p_other) / float(p_one.sum() * p_other.sum()), _LEAST))


def _log_ratio(view: Detection, prior: float) -> float:
    return odds_of(view.p_mine) - prior if view.confirmation is None else view.confirmation.log_ratio


def _view_mass(view: Detection, prior: float) -> Array:
    return mass_of_ratio(_log_ratio(view, prior)) if view.confirmation is None else view.confirmation.mass


def _shape_source(view: Detection) -> ViewMass:
    found = view.confirmation
    known = found is not None and math.isfinite(view.aspect_deg)
    return ViewMass(
        mass=found.shape_mass if found is not None and known else vacuous(),
        aspect_rad=math.radians(view.aspect_deg) if known else 0.0,
        half_turn_symmetric=found is None or found.half_turn_symmetric,
    )


def _verdict(
    mass: Array, p_mine: float, conflict: float, views: Sequence[Detection], prior: float, reasons: tuple[str, ...]
) -> FusedViews:
    known = bounded_by(with_ratio(mass, prior), p_mine)
    belief = singleton_belief(known)
    # Whether it is a mine goes by p_mine, of which kind by belief.
    mine_kind = likeliest_mine(known)
    classification = mine_kind if p_mine >= MINE_LIKE_P else most_believed(belief)
    next_look_deg: tuple[float, ...] = ()
    aspects_rad = np.radians([view.aspect_deg for view in views])
    if abs(odds_of(p_mine) - odds_of(MINE_LIKE_P)) < _ONE_LOOK and np.isfinite(aspects_rad).all():
        looks_rad = next_look_aspects(aspects_rad)[:_LOOKS]
        apart_deg = np.degrees(np.abs(np.arcsin(np.sin(looks_rad[:, np.newaxis] - aspects_rad)))).min(axis=1)
        apart_deg[0] = 90.0  # into the widest gap, however narrow
        next_look_deg = tuple(np.degrees(looks_rad[apart_deg.round(6) >= _SPREAD_DEG]).tolist())
    return FusedViews(p_mine, classification, mine_kind, belief, conflict, next_look_deg, reasons)
