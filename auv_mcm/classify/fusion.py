"""What all views of one contact say together: is it a mine, of which kind, and would another look change that.

Each view is two sources. Which kind of mine its shadow may be repeats itself from similar and from opposite aspects; that it is a mine at
all, against clutter, is new evidence from the other side. How rare mines are counts once per contact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, cast

import numpy as np

from auv_mcm.classify.beliefs import Array, ViewMass, combine, next_look_value, singleton_belief, vacuous
from auv_mcm.classify.odds import mass_of_ratio, ratio_of_mass, with_ratio
from auv_mcm.detect.belief import odds_of, probability
from auv_mcm.records import NAN, ContactClass, Detection

CONTRADICTION: Final = "views_contradict"
_MINE: Final = 0.5
_ONE_LOOK: Final = 3.0  # nats that another view may well bring
_LOOKS: Final = 2  # directions proposed


class Verdict(NamedTuple):
    """What is known of a contact; the fields are those of `Contact`. reasons: codes beyond those of the views."""

    p_mine: float
    classification: ContactClass
    belief: dict[str, float]
    conflict: float
    next_look_deg: tuple[float, ...]
    reasons: tuple[str, ...]


def fuse(views: Sequence[Detection], prior: float) -> Verdict:
    """Fuse the views of one contact, whose order does not matter.

    prior: log-odds of a mine among detections, which each view's p_mine contains and the contact's contains once. Views that contradict
    each other too much to belong to one object are not fused: the most mine-like one speaks for the contact.
    Raises ValueError if there is no view.
    """
    if not views:
        raise ValueError("fuse needs at least one view")
    # An order of their own makes the result the same to the last bit, whatever order they came in.
    views = sorted(views, key=lambda view: (view.time_s, view.side, view.column))
    strongest = max(views, key=lambda view: (view.p_mine, -view.time_s))
    if len(views) == 1:
        return _verdict(_view_mass(strongest, prior), strongest.p_mine, NAN, views, prior, ())
    fusion = combine([source for number, view in enumerate(views) for source in _sources(view, number, prior)])
    if fusion.rule == "apart":
        return _verdict(_view_mass(strongest, prior), strongest.p_mine, fusion.conflict, views, prior, (CONTRADICTION,))
    return _verdict(fusion.mass, probability(ratio_of_mass(fusion.mass) + prior), fusion.conflict, views, prior, ())


def _log_ratio(view: Detection, prior: float) -> float:
    return odds_of(view.p_mine) - prior if view.confirmation is None else view.confirmation.log_ratio


def _view_mass(view: Detection, prior: float) -> Array:
    return mass_of_ratio(_log_ratio(view, prior)) if view.confirmation is None else view.confirmation.mass


def _sources(view: Detection, number: int, prior: float) -> tuple[ViewMass, ViewMass]:
    found = view.confirmation
    shape = vacuous() if found is None else found.shape_mass
    aspect_rad, name = math.radians(view.aspect_deg), str(number)
    return (
        ViewMass(
            mass=shape,
            aspect_rad=aspect_rad,
            pass_id=name,
            kind="shadow",
            half_turn_symmetric=found is None or found.half_turn_symmetric,
        ),
        ViewMass(
            mass=mass_of_ratio(_log_ratio(view, prior)),
            aspect_rad=aspect_rad,
            pass_id=name,
            kind="presence",
            half_turn_symmetric=False,
        ),
    )


def _verdict(mass: Array, p_mine: float, conflict: float, views: Sequence[Detection], prior: float, reasons: tuple[str, ...]) -> Verdict:
    belief = singleton_belief(with_ratio(mass, prior))
    # Whether it is a mine goes by p_mine, of which kind by belief.
    told = max((name for name in belief if p_mine < _MINE or name != "clutter"), key=lambda name: belief[name])
    next_look_deg: tuple[float, ...] = ()
    aspects_rad = np.radians([view.aspect_deg for view in views])
    if abs(odds_of(p_mine)) < _ONE_LOOK and np.isfinite(aspects_rad).all():
        directions = next_look_value(mass, aspects_rad, _MINE).aspects_rad[:_LOOKS]
        next_look_deg = tuple(np.degrees(directions).tolist())
    return Verdict(p_mine, cast(ContactClass, told), belief, conflict, next_look_deg, reasons)
