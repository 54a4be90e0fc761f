"""Weigh how mine-like a measured candidate is, from its score, its size and its surroundings; hold the words for it.

Log-odds add: evidence of highlight and shadow (the score), plausibility of size and height, crowding by equals nearby.
The constants are set on simple simulated missions; `auv-mcm score` prints per tenth of the result how many contacts are
targets.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:  # measuring needs OpenCV, which the process that serves never loads
    from auv_mcm.detect.measure import Measurement

_EVEN_SCORE: Final = 5.2  # standard deviations of highlight and shadow that make a mine as likely as not
_PER_DEVIATION: Final = 1.6  # nats of log-odds per standard deviation
_BOUND: Final = 6.0  # nats: contrasts alone say at most p 0.9975, or at least 0.0025
_CROWD_FREE: Final = 2  # neighbours alike that do not count against a detection
_PER_NEIGHBOUR: Final = 0.25  # nats of log-odds that each further neighbour takes
_CROWD_BOUND: Final = 2.5  # nats that neighbours take at most: a mine may lie among boulders

MIN_OBJECT_M: Final = 0.2  # m: shorter than any mine sought
# m above the sea floor: no mine sought is measured lower or higher; chosen, not measured
HEIGHT_RANGE_M: Final = (0.08, 1.2)

REASONS: Final[dict[str, str]] = {
    "highlight_and_shadow": "a bright echo with a shadow right behind it",
    "no_highlight": "a shadow without a bright echo before it: a weak reflector, a pit, or a dark patch",
    "no_shadow": "a bright echo without a shadow: flat, buried, or a patch of rougher bottom",
    "too_large": "longer than any mine sought",
    "too_small": "smaller than any mine sought, or a few bright speckles",
    "implausible_height": "the shadow's length implies a height that no mine sought has",
    "crowded": "one of many alike nearby, as in boulder fields",
    "extended": "part of a structure many metres long, such as a wreck or an outcrop",
    "in_turn": "seen in a turn: shape and position are distorted",
    "bottom_not_seen": "the first bottom return was not seen: range across track and height are uncertain",
    "stale_navigation": "navigation was missing, old, or contradicted itself: the position is uncertain",
    "saturated": "the echo was clipped: its strength is a lower bound",
}


def contrast_odds(score: float) -> float:
    """Compute the log-odds of a mine-like object from contrasts alone. score: in standard deviations."""
    return min(max(_PER_DEVIATION * (score - _EVEN_SCORE), -_BOUND), _BOUND)


def with_measurement(odds: float, measured: Measurement, max_object_m: float) -> tuple[float, tuple[str, ...]]:
    """Add what was measured to the log-odds of a mine-like object.

    Returns the log-odds, nats, and the codes of what spoke for or against it (keys of REASONS).
    """
    reasons: list[str] = []
    if measured.has_highlight and measured.has_shadow:
        reasons.append("highlight_and_shadow")
    elif measured.has_shadow:
        reasons.append("no_highlight")
        odds -= 0.5
    else:
        reasons.append("no_shadow")
        odds -= 1.5
    longest = max(measured.along_m, measured.across_m)
    if longest > max_object_m or measured.touches_border:
        reasons.append("too_large")
        odds = min(odds, 0.0) - 3.0
    elif longest < MIN_OBJECT_M:
        reasons.append("too_small")
        odds -= 1.0
    if math.isfinite(measured.height_m) and not HEIGHT_RANGE_M[0] <= measured.height_m <= HEIGHT_RANGE_M[1]:
        reasons.append("implausible_height")
        odds -= 1.0
    if measured.in_turn:
        reasons.append("in_turn")
        odds -= 0.5
    if measured.saturated:
        reasons.append("saturated")
    return odds, tuple(reasons)


def crowding(n_neighbours: int) -> float:
    """Compute the log-odds taken off for other candidates about as strong or stronger within a few metres."""
    return min(_PER_NEIGHBOUR * max(n_neighbours - _CROWD_FREE, 0), _CROWD_BOUND)


def probability(odds: float) -> float:
    """Convert log-odds, nats, to a probability."""
    return 1.0 / (1.0 + math.exp(-odds))


def odds_of(p: float) -> float:
    """Convert a probability, kept 1e-6 away from 0 and 1, to log-odds, nats."""
    bounded = min(max(p, 1e-6), 1.0 - 1e-6)
    return math.log(bounded / (1.0 - bounded))
