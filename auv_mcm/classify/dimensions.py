"""Compute length, width and height of the solid that explains a view, as the size of a mine is usually given."""

from __future__ import annotations

import math
from typing import NamedTuple

from auv_mcm.records import NAN, ShapeModel


class Dimensions(NamedTuple):
    """Hold the size of an object in m, with 1-sigma; NaN where not known.

    Length is the longer side on the floor, height what stands above it.
    """

    length_m: float
    width_m: float
    height_m: float
    length_sigma_m: float = NAN
    width_sigma_m: float = NAN
    height_sigma_m: float = NAN


def dimensions(model: ShapeModel) -> Dimensions:
    """Compute the size of a model's solid; buried parts do not count as height.

    Raises ValueError for a classification that is not a solid with a size.
    """
    size, sigma = model.sizes, model.sigma
    burial_m, burial_sigma_m = size.get("burial_m", 0.0), sigma.get("burial_m", 0.0)
    match model.classification:
        case "sphere" | "cylinder":
            across_m, across_sigma_m = 2.0 * size["radius_m"], 2.0 * sigma.get("radius_m", NAN)
            length_m, length_sigma_m = size.get("length_m", across_m), sigma.get("length_m", across_sigma_m)
            sides = (length_m, length_sigma_m), (across_m, across_sigma_m)
            height_m, height_sigma_m = across_m, across_sigma_m
        case "truncated_cone":
            base = 2.0 * size["base_radius_m"], 2.0 * sigma.get("base_radius_m", NAN)
            sides = base, base
            height_m, height_sigma_m = size["height_m"], sigma.get("height_m", NAN)
        case "wedge":
            sides = (size["length_m"], sigma.get("length_m", NAN)), (size["width_m"], sigma.get("width_m", NAN))
            height_m, height_sigma_m = size["height_m"], sigma.get("height_m", NAN)
        case _:
            raise ValueError(f"{model.classification} is not a solid with a size")
    (long_m, long_sigma_m), (short_m, short_sigma_m) = sorted(sides, reverse=True)
    return Dimensions(
        long_m, short_m, height_m - burial_m, long_sigma_m, short_sigma_m, math.hypot(height_sigma_m, burial_sigma_m)
    )
