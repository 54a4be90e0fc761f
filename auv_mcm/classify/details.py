"""Measure details of a confirmation that only trees weigh: unbounded, in their units, each with its own name.

A linear sum of them would let one outlier decide. Questions whether a measure is above a threshold take no harm from
it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.features import Features, known
from auv_mcm.classify.fit import SOLIDS, ShapeFits
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Contours
from auv_mcm.records import Detection

_NOT_MEASURED: Final = -1.0  # of lengths and heights, which are positive
_NO_SOLID: Final = 30.0  # nats, of a solid that cannot be seen in the region at all
_NO_GAIN: Final = -50.0  # nats; stands for no contours
_NO_REPETITION: Final = 5.0  # ratio; stands for no contours
_FAR_BEHIND: Final = 20.0  # nats, for a missing second solution
_OF_THE_BEST: Final = (
    "solid_highlight_contrast",
    "solid_shadow_contrast",
    "solid_highlight_across_m",
    "observed_highlight_across_m",
    "solid_highlight_samples",
    "solid_along_off_m",
    "solid_across_off_m",
    "second_solid_behind_nats",
)


def detection_details(detection: Detection) -> Features:
    """Give the place of the detection and its size as the detector measured it."""
    return {
        "altitude_m": known(detection.altitude_m, _NOT_MEASURED),
        "ground_range_m": known(detection.ground_range_m, _NOT_MEASURED),
        "detected_length_m": known(detection.length_m, 0.0),
        "detected_width_m": known(detection.width_m, 0.0),
        "detected_height_m": known(detection.height_m, _NOT_MEASURED),
        "detected_shadow_m": known(detection.shadow_length_m, 0.0),
    }


def contour_details(contours: Contours, region: Region) -> Features:
    """Measure levels and sizes of the contours, and the beam's image of a point at their range."""
    ground_range_m = region.first_ground_range_m + region.column * region.column_spacing_m
    return {
        "beam_footprint_m": region.beam_width_rad * math.hypot(ground_range_m, region.altitude_m),
        "contour_highlight_mean": known(contours.highlight_mean, 0.0),
        "contour_shadow_mean": known(contours.shadow_mean, 1.0),
        "contour_background_mean": known(contours.background_mean, 1.0),
        "contour_highlight_m2": known(contours.highlight_area_m2, 0.0),
        "contour_length_m": known(contours.length_m, 0.0),
        "contour_gain_nats": known(contours.gain, _NO_GAIN),
        "contour_repeats": known(contours.repetition, _NO_REPETITION),
        "contour_rejected": float(contours.rejected),
    }


def solid_details(fits: ShapeFits, labels: NDArray[np.uint8], region: Region) -> Features:
    """Measure the cost of each solid, the fit of the best one, and the label shares.

    labels: (n_rows, n_columns).
    """
    costs_nats = {fit.solid: known(fit.best.cost, _NO_SOLID) for fit in fits.fits}
    best = fits.fits[0] if fits.fits else None
    best_nats = _NO_SOLID if best is None else known(best.best.cost, _NO_SOLID)
    contour_nats = 0.0 if fits.contour_cost is None else known(fits.contour_cost, 0.0)
    values = {
        **{f"{solid}_nats": costs_nats.get(solid, _NO_SOLID) for solid in SOLIDS},
        "contour_nats": contour_nats,
        "solid_nats": best_nats,
        "contour_over_solid_nats": contour_nats - best_nats,
        "labelled_highlight_share": float((labels == HIGHLIGHT).mean()) if labels.size else 0.0,
        "labelled_shadow_share": float((labels == SHADOW).mean()) if labels.size else 0.0,
    }
    if best is None:
        return values | dict.fromkeys(_OF_THE_BEST, 0.0)
    ground_range_m = region.first_ground_range_m + region.column * region.column_spacing_m
    second_nats = _FAR_BEHIND if best.second is None else known(best.second.cost - best_nats, _FAR_BEHIND)
    measured = (
        *best.contrast,
        best.highlight.model_across_m,
        best.highlight.observed_across_m,
        best.highlight.n_samples,
        (best.best.row - region.row) * region.row_spacing_m,
        best.best.ground_range_m - ground_range_m,
        second_nats,
    )
    return values | {name: known(value, 0.0) for name, value in zip(_OF_THE_BEST, measured, strict=True)}
