"""Decide in which order a recorder stores its port channel.

Seen from the sonar, every ping starts with transmitter ring-down (bright), then open water (dark), then the sea floor
in one step. Three cues look for that at either end of the port samples. They use ranks of the median ping, so that
amplitude, intensity and logarithm give the same answer:

* water column: everything before some range is darker than the metre after it;
* ring-down: the first 0.3 m stand out from the next;
* starboard, if there, is stored near to far and its profile over range resembles that of port.

Each is the difference between both readings of the port channel, near-end last minus near-end first.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

DECISIVE: Final = 0.3  # less decides nothing: pings of pure noise reach it in one of ten recordings

_RING_DOWN_M: Final = 0.3  # m of range that the transmitted pulse rings on
_STEP_M: Final = 0.5  # the bottom return may take this long to rise
_SEABED_M: Final = 1.0  # m of range behind the step whose level is compared


class PortOrderEvidence(NamedTuple):
    """Weigh evidence. Positive: stored far to near; negative: near to far. Each cue lies within about [-2, 2]."""

    water_column: float
    ring_down: float
    starboard: float

    @property
    def total(self) -> float:
        """Sum the evidence, nats."""
        return self.water_column + self.ring_down + self.starboard


def port_order_evidence(
    port: NDArray[Any], starboard: NDArray[Any] | None, spacing_m: float, blank_m: float
) -> PortOrderEvidence:
    """Return evidence from some pings.

    Parameters
    ----------
    port, starboard
        (n_pings, n_samples) as stored, any real dtype; starboard may be None or have another number of samples (its cue
        is 0).
    spacing_m
        Slant range between samples.
    blank_m
        Slant range of ring-down.
    """
    stored = _rank(np.median(port, axis=0))
    turned = stored[::-1]
    n_samples = stored.shape[0]
    blank = min(round(blank_m / spacing_m), n_samples // 4)
    water_column = _darkness_before_step(turned, spacing_m, blank) - _darkness_before_step(stored, spacing_m, blank)
    ring_down = _ring_down(turned, spacing_m) - _ring_down(stored, spacing_m)
    likeness = 0.0
    if starboard is not None and starboard.shape[1] == n_samples:
        other = _rank(np.median(starboard, axis=0))
        inner = slice(blank, n_samples - blank)
        likeness = _correlation(turned[inner], other[inner]) - _correlation(stored[inner], other[inner])
    return PortOrderEvidence(water_column, ring_down, likeness)


def _rank(profile: NDArray[Any]) -> NDArray[np.float64]:
    """Rank in (0, 1), equal values sharing their mean rank: a constant profile carries no evidence."""
    _, inverse, counts = np.unique(profile, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    mean_rank = (last - 0.5 * (counts + 1) + 0.5) / profile.shape[0]
    ranks: NDArray[np.float64] = mean_rank[inverse]
    return ranks


def _darkness_before_step(profile: NDArray[np.float64], spacing_m: float, blank: int) -> float:
    """Return the largest margin by which a metre's darkest part outshines all between blank and the step before it."""
    width = max(3, round(_RING_DOWN_M / spacing_m))
    step = max(1, round(_STEP_M / spacing_m))
    seabed = max(2, round(_SEABED_M / spacing_m))
    if profile.shape[0] < blank + 2 * width + step + seabed:
        return 0.0
    sums = np.concatenate(([0.0], np.cumsum(profile)))
    smooth = (sums[width:] - sums[:-width]) / width
    brightest_before = np.maximum.accumulate(smooth[blank:])
    darkest_after = sliding_window_view(smooth[blank + step + width :], seabed).min(axis=1)
    return float(np.max(darkest_after - brightest_before[: darkest_after.shape[0]]))


def _ring_down(profile: NDArray[np.float64], spacing_m: float) -> float:
    n_ring = max(1, round(_RING_DOWN_M / spacing_m))
    after = profile[n_ring : max(n_ring + 1, round(2.0 / spacing_m))]
    return float(np.mean(profile[:n_ring]) - np.median(after)) if after.size else 0.0


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    a = a - a.mean()
    b = b - b.mean()
    norm = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    return float(np.dot(a, b)) / norm if norm > 0.0 else 0.0
