"""Draw regions from closed forms, with the true label of every pixel: a highlight, its shadow, speckle of a known point
spread.

The mean intensity is set before the sonar looks at it: a complex Gaussian field with that mean is smeared by the
point-spread function and detected, so that speckle is correlated and edges are soft, as an image of finite resolution
has them (Goodman, Speckle Phenomena in Optics, ch. 3). Truth is the sharp outline.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, gaussian_filter

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region


class Drawing(msgspec.Struct, frozen=True, kw_only=True):
    """Specify what to draw.

    Object: object_rows x highlight_columns pixels, its shadow object_rows x shadow_columns behind it.

    lean: columns the shadow's far end moves per row (a parallelogram). shadow_level, highlight_level: mean intensity
    over that of the sea floor. spread_rows, spread_columns: 1-sigma of the Gaussian point-spread function of the
    complex field, pixels. texture_nu: shape of the Gamma-distributed texture of the sea floor, 0 for none;
    texture_pixels: 1-sigma of what smooths it.
    """

    n_rows: int = 128
    n_columns: int = 128
    row_spacing_m: float = 0.04
    column_spacing_m: float = 0.04
    object_rows: int = 24
    highlight_columns: int = 7
    shadow_columns: int = 44
    lean: float = 0.0
    shadow_level: float = 10.0**-0.9
    highlight_level: float = 8.0
    spread_rows: float = 1.2
    spread_columns: float = 1.2
    texture_nu: float = 0.0
    texture_pixels: float = 0.0
    seed: int = 0


def aperture_drawings(n: int, spread: float, seed: int) -> Iterator[Drawing]:
    """Draw n objects of 0.5 to 2 m with shadows of 0.9 to 2.7 m on the 3 cm pixels of a synthetic aperture.

    Parameters
    ----------
    n
        Number of objects.
    spread
        1-sigma of the point-spread function, pixels.
    seed
        Of sizes; speckle has seeds from 0.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    for number in range(n):
        yield Drawing(
            n_rows=144,
            n_columns=160,
            row_spacing_m=0.03,
            column_spacing_m=0.03,
            object_rows=int(random.integers(17, 67)),
            shadow_columns=int(random.integers(30, 90)),
            lean=float(random.uniform(-0.4, 0.4)),
            spread_rows=spread,
            spread_columns=spread,
            seed=number,
        )


def draw_region(drawing: Drawing) -> tuple[Region, NDArray[np.uint8]]:
    """Draw the region and its labels, (n_rows, n_columns) uint8.

    The highlight lies at the centre row and at a third of the columns.
    """
    random = np.random.Generator(np.random.PCG64(drawing.seed))
    labels = true_labels(drawing)
    mean = np.choose(labels, (1.0, drawing.shadow_level, drawing.highlight_level))
    if drawing.texture_nu:
        mean = np.where(labels == BACKGROUND, mean * _texture(random, drawing), mean)
    field = random.standard_normal((2, *labels.shape)) * np.sqrt(0.5 * mean)
    for axis, spread in ((1, drawing.spread_rows), (2, drawing.spread_columns)):
        field = _smeared(field, spread, axis)
    region = Region(
        intensity=(field**2).sum(axis=0),
        valid=np.ones(labels.shape, dtype=np.bool_),
        row_spacing_m=drawing.row_spacing_m,
        column_spacing_m=drawing.column_spacing_m,
        first_ground_range_m=25.0,
        altitude_m=6.0,
        row=_first_row(drawing) + 0.5 * (drawing.object_rows - 1),
        column=_first_column(drawing) + 0.5 * (drawing.highlight_columns - 1),
        beam_width_rad=0.0,
    )
    return region, labels


def true_labels(drawing: Drawing) -> NDArray[np.uint8]:
    """Return the sharp outline that draw_region starts from, (n_rows, n_columns) uint8."""
    labels = np.full((drawing.n_rows, drawing.n_columns), BACKGROUND, dtype=np.uint8)
    first, start = _first_row(drawing), _first_column(drawing)
    foot = start + drawing.highlight_columns
    for step in range(drawing.object_rows):
        end = foot + drawing.shadow_columns + round(drawing.lean * (step - 0.5 * drawing.object_rows))
        labels[first + step, start:foot] = HIGHLIGHT
        labels[first + step, foot : max(end, foot)] = SHADOW
    return labels


def _first_row(drawing: Drawing) -> int:
    return (drawing.n_rows - drawing.object_rows) // 2


def _first_column(drawing: Drawing) -> int:
    return drawing.n_columns // 3 - drawing.highlight_columns // 2


def _texture(random: np.random.Generator, drawing: Drawing) -> NDArray[np.float64]:
    shape = (drawing.n_rows, drawing.n_columns)
    if drawing.texture_pixels == 0.0:
        return random.gamma(drawing.texture_nu, 1.0 / drawing.texture_nu, shape)
    # Smoothing sums samples: each needs less shape for their sum to have what is asked.
    sigma = drawing.texture_pixels
    area = 4.0 * np.pi * sigma**2
    shape_each = drawing.texture_nu / area
    return np.asarray(gaussian_filter(random.gamma(shape_each, 1.0 / shape_each, shape), sigma, mode="wrap"))


def _smeared(field: NDArray[np.float64], sigma: float, axis: int) -> NDArray[np.float64]:
    if sigma == 0.0:
        return field
    reach = int(np.ceil(4.0 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(convolve1d(field, kernel / np.sqrt((kernel**2).sum()), axis=axis, mode="wrap"))
