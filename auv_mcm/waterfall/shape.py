"""Describe how samples are spread about their local mean."""

from __future__ import annotations

import math
from typing import NamedTuple


class Shape(NamedTuple):
    """Hold the standard deviation and skewness of samples over some part of a record.

    log_std_sigma, skewness_sigma: 1-sigma of ln std and of skewness, from how parts of it differ. mean: counts above
    the lowest that the recorder can store, infinite where nothing is cut off from below.
    """

    std: float
    skewness: float
    log_std_sigma: float
    skewness_sigma: float
    mean: float = math.inf
