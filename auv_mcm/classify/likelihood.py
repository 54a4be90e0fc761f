"""Turn regions into the row sums and beams that solids are weighed against."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region, require_sound
from auv_mcm.kernels.order import median
from auv_mcm.kernels.shape import MIN_MEAN, PENCIL, Array, Beam, ImageRowSums

_MEAN_OVER_MEDIAN: Final = (1.0 - 1.0 / 9.0) ** -3.0  # of the intensity of single looks
_CAP: Final = 3.0  # times the floor's mean; one echo of the floor in twenty is that strong
# Gauss-Hermite of three points: widths off, share
_QUADRATURE: Final = (0.5 * math.sqrt(1.5 / math.log(2.0)), 1.0 / 6.0)
_NARROW: Final = 0.3  # rows that a beam must cover before its width counts


def image_row_sums(region: Region, correlation_area: float) -> ImageRowSums | None:
    """Sum along the slices of a region cumulatively; None if it holds no measured pixel.

    correlation_area: pixels over which speckle is correlated, at least 1. Pixels that are not valid, not finite or
    negative have no part. Echoes are cut off at three times the floor: the brightness of a highlight depends little on
    the shape, and one glint would outvote a shadow. The floor is taken from the median, as of a single look. What makes
    speckle correlated smears highlights too: by the pixels that, added in squares to the pixel itself, make up the
    correlation area. In the image of a squinted sub-aperture a slice is a line sheared by tan(squint): a point at
    ground range y is drawn in the row where it was closest, y tan(squint) ahead of where its slice started. Columns are
    shifted by whole rows so that slices become rows again, the one of the region's middle column staying where it was;
    distances are then those along and across the slices. Raises ValueError as require_sound does, and for a correlation
    area below 1.
    """
    require_sound(region)
    if not 1.0 <= correlation_area < math.inf:
        raise ValueError(f"correlation_area must be at least 1 and finite, not {correlation_area}")
    counted = counted_pixels(region)
    if not (region.intensity[counted] > 0.0).any():
        return None
    floor = median(region.intensity[counted]) * _MEAN_OVER_MEDIAN
    if floor == 0.0:
        positive = region.intensity[counted]
        floor = median(positive[positive > 0.0])
    # The quotient of a spike and a faint floor has no number: cut first.
    capped = np.minimum(np.where(counted, region.intensity, 0.0), _CAP * floor)
    intensity = np.minimum(capped / floor, _CAP)
    if region.squint_rad != 0.0:
        intensity, counted = _deskewed(region, intensity), _deskewed(region, counted.astype(np.float64)) > 0.0
    cosine = math.cos(region.squint_rad)
    mean = float(intensity.sum() / counted.sum())
    return ImageRowSums(
        echoes=cumulative(intensity / mean),
        counts=cumulative(counted.astype(np.float64)),
        row_spacing_m=region.row_spacing_m * cosine,
        column_spacing_m=region.column_spacing_m / cosine,
        first_ground_range_m=region.first_ground_range_m / cosine,
        altitude_m=region.altitude_m,
        samples_per_pixel=1.0 / correlation_area,
        smear_m=region.column_spacing_m * math.sqrt(correlation_area - 1.0),
        shear=math.tan(region.squint_rad),
    )


def labels_cost(region: Region, labels: NDArray[np.uint8], correlation_area: float) -> float:
    """Weigh what labels of pixels explain, in nats against a floor without an object; 0 if nothing was measured.

    The scale is that of the costs of solids.

    labels: (n_rows, n_columns) uint8 of BACKGROUND, SHADOW and HIGHLIGHT. With the code length of its contours added,
    this is what a free contour costs. Raises ValueError as image_row_sums does, and for labels of another shape.
    """
    return labels_cost_of(image_row_sums(region, correlation_area), region, labels)


def labels_cost_of(image: ImageRowSums | None, region: Region, labels: NDArray[np.uint8]) -> float:
    """Weigh labels in a region whose `image_row_sums` are known; see `labels_cost`."""
    if labels.shape != region.intensity.shape:
        raise ValueError(f"labels must have the region's shape {region.intensity.shape}, not {labels.shape}")
    if image is None:
        return 0.0
    if region.squint_rad != 0.0:
        labels = _deskewed(region, labels)
    cost = 0.0
    per_pixel = [np.diff(sums, axis=1) for sums in (image.counts, image.echoes)]
    for label in (BACKGROUND, SHADOW, HIGHLIGHT):
        is_label = labels == label
        count, total = (float(each[is_label].sum()) for each in per_pixel)
        if count > 0.0:
            mean = max(total / count, MIN_MEAN)
            cost += count * math.log(mean) + total / mean - count
    return image.samples_per_pixel * cost


def counted_pixels(region: Region) -> NDArray[np.bool_]:
    """Select pixels that were measured: valid, finite, not negative."""
    with np.errstate(invalid="ignore"):
        return np.asarray(region.valid & (region.intensity >= 0.0) & (region.intensity < np.inf), dtype=np.bool_)


def beam_of(region: Region) -> Beam:
    """Give the slices that a region's beam sees at once, with Gaussian weights of its width.

    A single slice where the beam is narrower than the rows resolve.
    """
    slant_range_m = math.hypot(region.first_ground_range_m + region.column * region.column_spacing_m, region.altitude_m)
    if region.beam_width_rad * slant_range_m < _NARROW * region.row_spacing_m:
        return PENCIL
    off, share = _QUADRATURE
    return Beam(region.beam_width_rad * off * np.array([-1.0, 0.0, 1.0]), np.array([share, 1.0 - 2.0 * share, share]))


def parameter_cost(n_parameters: int, image: ImageRowSums) -> float:
    """Compute the cost of stating the parameters, nats.

    Half of ln n each, n independent samples (J. Rissanen, Automatica 14, 1978).
    """
    n = image.samples_per_pixel * float(image.counts[:, -1].sum())
    return 0.5 * n_parameters * math.log(max(n, 1.0))


def _deskewed(region: Region, plane: NDArray[Any]) -> NDArray[Any]:
    n_rows, n_columns = plane.shape
    ahead_m = (np.arange(n_columns) + 0.5 - region.column) * region.column_spacing_m * math.tan(region.squint_rad)
    rows = np.arange(n_rows)[:, np.newaxis] + np.rint(ahead_m / region.row_spacing_m).astype(np.intp)
    inside = (rows >= 0) & (rows < n_rows)
    return np.where(inside, np.take_along_axis(plane, np.clip(rows, 0, n_rows - 1), axis=0), plane.dtype.type(0))


def cumulative(plane: Array) -> Array:
    """Sum along rows from the left, (n_rows, n_columns + 1), starting with 0."""
    sums = np.zeros((plane.shape[0], plane.shape[1] + 1))
    np.cumsum(plane, axis=1, out=sums[:, 1:])
    return sums
