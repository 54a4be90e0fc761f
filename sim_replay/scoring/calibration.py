"""Whether probabilities hold: events promised with probability p should come true in p of the cases."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def calibration_error(probability: ArrayLike, came_true: ArrayLike, n_bins: int = 10) -> float:
    """Expected calibration error: |mean probability - share that came true| per bin of [0, 1], weighted by the bin's count.

    probability: (n,) float64. came_true: (n,) bool. After M. Naeini, G. Cooper and M. Hauskrecht, AAAI 2015. Raises ValueError if there
    are none, not as many of one as of the other, or a probability is not in [0, 1].
    """
    p, true = np.asarray(probability, dtype=np.float64), np.asarray(came_true, dtype=np.bool_)
    if p.ndim != 1 or p.shape != true.shape or not p.size:
        raise ValueError(f"there must be as many probabilities as outcomes, one or more of each, got shapes {p.shape} and {true.shape}")
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise ValueError(f"probabilities must lie in [0, 1], got {p[~((p >= 0.0) & (p <= 1.0))][0]}")
    bins = np.minimum((p * n_bins).astype(np.intp), n_bins - 1)
    excess = np.bincount(bins, weights=p - true, minlength=n_bins)
    return float(np.abs(excess).sum() / p.size)
