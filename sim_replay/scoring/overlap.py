"""Measure how far two masks agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def overlap(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Compute the intersection over union of two masks of one shape, 0 to 1 (P. Jaccard, 1901); 1 if both are empty."""
    union = int((one | other).sum())
    return int((one & other).sum()) / union if union else 1.0
