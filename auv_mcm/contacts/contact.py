"""Answer questions about one contact: which view stands for it, how mine-like it is, how well it is placed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.contacts.geojson import PROBABILITY_DIGITS
from auv_mcm.records import NAN, Contact, Detection

ELLIPSE_SIGMAS: Final = 2.0  # drawn error ellipses: 86 % of the probability of two normal axes lies inside


def is_mine_like(contact: Contact) -> bool:
    """Decide whether `p_mine`, as files round it, reaches the threshold for mines."""
    return round(contact.p_mine, PROBABILITY_DIGITS) >= MINE_LIKE_P


def best_view(contact: Contact) -> Detection | None:
    """Find the view with the highest score, the earliest of equals; None without views."""
    return max(
        contact.views,
        key=lambda view: (-math.inf if math.isnan(view.score) else view.score, -view.time_s),
        default=None,
    )


def depth_m(contact: Contact) -> float:
    """Return the depth of the sea floor at a contact below the surface, m, by its best view; NaN where not known."""
    view = best_view(contact)
    return NAN if view is None else view.depth_m


def call_words(contact: Contact) -> str:
    """Word the call and the density of false alarms that stands behind it; empty before it was decided."""
    if contact.called is None:
        return ""
    called = "yes" if contact.called else "no"
    if not math.isfinite(contact.false_alarms_per_km2):
        return called
    low, high = contact.false_alarms_95_per_km2
    return (
        f"{called}; {_two_digits(contact.false_alarms_per_km2)} false alarms per km² as mine-like are expected "
        f"({_two_digits(low)} to {_two_digits(high)})"
    )


def _two_digits(value: float) -> str:
    """Write a number with two significant digits, never as a power of ten."""
    return f"{float(f'{value:.2g}'):.4f}".rstrip("0").rstrip(".") if math.isfinite(value) else "?"


def view_reasons(view: Detection) -> tuple[str, ...]:
    """List the codes of detection and of confirmation, each once."""
    return tuple(dict.fromkeys((*view.reasons, *(view.confirmation.reasons if view.confirmation else ()))))


def sigma_m(contact: Contact) -> float:
    """Compute the 1-sigma horizontal position error, m.

    The semi-major axis of the error ellipse, NaN where it is unknown.
    """
    (east2, both), (_, north2) = np.asarray(contact.covariance_m2, dtype=np.float64).tolist()
    if not all(map(math.isfinite, (east2, both, north2))):
        return NAN
    return math.sqrt(max((east2 + north2) / 2.0 + math.hypot((east2 - north2) / 2.0, both), 0.0))


def error_ellipse(contact: Contact) -> tuple[float, float, float]:
    """Compute the 1-sigma semi-axes, m, major first, and the direction of the major axis.

    The direction is in degrees clockwise from north, in [0, 180). All are NaN where the covariance is unknown.
    """
    covariance = np.asarray(contact.covariance_m2, dtype=np.float64)
    if not np.isfinite(covariance).all():
        return NAN, NAN, NAN
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
    minor_m, major_m = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return major_m, minor_m, math.degrees(math.atan2(axes[0, 1], axes[1, 1])) % 180.0


def error_ellipse_ring_m(contact: Contact, sigmas: float = ELLIPSE_SIGMAS) -> NDArray[np.float64]:
    """Draw the error ellipse around a contact.

    (37, 2) float64 east and north, m, closed and counter-clockwise. All are NaN where the covariance is
    unknown.
    """
    major_m, minor_m, direction_deg = error_ellipse(contact)
    angle = np.linspace(0.0, 2.0 * np.pi, 37)
    along, across = sigmas * major_m * np.cos(angle), -sigmas * minor_m * np.sin(angle)
    sine, cosine = math.sin(math.radians(direction_deg)), math.cos(math.radians(direction_deg))
    ring = np.column_stack([along * sine + across * cosine, along * cosine - across * sine])
    ring[-1] = ring[0]
    return ring
