"""Explain why each leg of a plan is sailed, for the person who watches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from auv_mcm.plan.contact_legs import ContactLegs
from auv_mcm.records import SEABED_TYPES

_ACROSS_RAD = math.radians(30.0)
_ALONG_RAD = math.radians(60.0)
_NAMES = {
    "flat": "flat floor",
    "ripple": "ripple",
    "rough": "rough floor",
    "vegetation": "vegetation",
    "unknown": "floor of unknown kind",
}


def area_words(m2: float) -> str:
    """Write square metres with thin spaces between thousands."""
    return f"{m2:,.0f} m²".replace(",", "\u2009")


def course_words(heading_rad: float) -> str:
    """Write a heading as three digits of degrees."""
    return f"{round(math.degrees(heading_rad)) % 360:03d}°"


def survey_words(
    heading_rad: float,
    gain_m2: NDArray[np.float64],
    seabed: NDArray[np.uint8],
    ripple_rad: NDArray[np.float32],
    looked: NDArray[np.bool_],
) -> str:
    """Explain a survey leg.

    Arrays (n,) hold for the cells that it adds to the area each gains in full clearance, and what is known of the cell.
    Of cells not looked at, sea floor and ripples are expected and not stated.
    """
    total = float(gain_m2.sum())
    seabed = np.where(looked, seabed, np.uint8(SEABED_TYPES.index("unknown")))
    ripple_rad = np.where(looked, ripple_rad, np.float32(np.nan))
    by_kind = np.bincount(seabed, gain_m2, len(SEABED_TYPES))
    commonest = int(np.argmax(by_kind))
    share = f"{area_words(by_kind[commonest])} of {_NAMES[SEABED_TYPES[commonest]]}"
    if by_kind[commonest] < 0.95 * total:
        share += f" and {area_words(total - by_kind[commonest])} of other kinds"
    words = [f"clears {share} at {course_words(heading_rad)}"]
    crests = np.isfinite(ripple_rad) & (seabed == commonest)
    if crests.any():
        # of the look from the crests' succession
        apart = np.abs(np.mod(ripple_rad[crests] - heading_rad, math.pi) - math.pi / 2.0)
        typical = float(np.average(apart, weights=np.maximum(gain_m2[crests], 1e-9)))
        words[0] += (
            " across the crests"
            if typical < _ACROSS_RAD
            else " along the crests"
            if typical > _ALONG_RAD
            else " oblique to the crests"
        )
    again = float(gain_m2[looked].sum())
    if again > 0.05 * total:
        words.append(f"{area_words(again)} of it were searched before and not well enough")
    return "; ".join(words)


def contact_words(legs: ContactLegs) -> str:
    """Explain a leg past a contact."""
    contact = legs.contact
    looks = "one view" if len(contact.aspects_deg) == 1 else f"{len(contact.aspects_deg)} views"
    towards = round(legs.look_deg) % 360
    return (
        f"second view of {contact.id} towards {towards:03d}° or {(towards + 180) % 360:03d}°, {legs.stand_off_m:.0f} m "
        f"to the side: p_mine {contact.p_mine:.2f} is undecided after {looks}"
    )
