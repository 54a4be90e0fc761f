"""Compute heights from shadows by similar triangles over a flat bottom."""

from __future__ import annotations

import math


def shadow_height_m(altitude_m: float, top_m: float, end_m: float) -> float:
    """Compute the height of what throws a shadow, m.

    The ray that grazes the last lit point goes on to the shadow's end; both slant ranges and the sonar's altitude give
    the height: altitude * (1 - range of the lit point / range of the end). NaN where a number is; negative if the end
    is nearer than the lit point.

    Parameters
    ----------
    altitude_m
        Of the sonar over the bottom there, above 0.
    top_m
        Ground range at which the last lit point appears.
    end_m
        Ground range of the shadow's end.
    """
    top_slant_m, end_slant_m = math.hypot(top_m, altitude_m), math.hypot(end_m, altitude_m)
    # The difference of squared ranges by its factors: that of the ranges themselves would cancel in short shadows.
    return altitude_m * ((end_m - top_m) / end_slant_m) * ((end_m + top_m) / (end_slant_m + top_slant_m))
