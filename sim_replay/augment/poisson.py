"""Integrate heights from slopes: the screened anisotropic Poisson equation on pings by ground-range columns.

    min over Z of  sum w (dZ/dy - slope)^2 + along_weight * sum (dZ/dx)^2 + screen * sum Z^2

with y across and x along the track. Side-scan sonar sees the slope across alone; the second term ties neighbouring
pings together, and the third brings back to 0 what is too long to show in any slope: waves longer than 2 pi /
sqrt(screen). Without weights the cosine transform (type II, whose mirrored ends have no slope) diagonalises the
equation; with weights it is the preconditioner of conjugate gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

_TOLERANCE: Final = 1e-4  # of the residual, relative: far below speckle
_MAX_ITERATIONS: Final = 60  # bounds time

Array = NDArray[np.float64]


class Stiffness(NamedTuple):
    """Weigh the terms. screen_per_m2: of heights, above 0."""

    along_weight: float
    screen_per_m2: float


def integrate_slope(
    slope: Array,
    row_spacing_m: float,
    column_spacing_m: float,
    stiffness: Stiffness,
    weight: Array | None = None,
    start: Array | None = None,
) -> Array:
    """Return heights, m, (n_pings, n_columns) float64, whose slopes across fit best.

    Parameters
    ----------
    slope
        (n_pings, n_columns) float64, rise per metre over the facet that ends at each column; column 0, where none ends,
        does not count.
    weight
        The same shape, 0 to 1, None for 1 everywhere.
    start
        Heights near the solution, of use with weights alone, for which the residual is brought below 1e-4 of the right
        side unless 60 iterations are spent.

    Raises
    ------
    ValueError
        Unless screen_per_m2 is above 0.
    """
    if not stiffness.screen_per_m2 > 0.0:
        raise ValueError(f"screen_per_m2 is {stiffness.screen_per_m2}; flat images need one above 0")
    curvature = _curvature(slope.shape, row_spacing_m, column_spacing_m, stiffness)
    if weight is None:
        return _solve(curvature, _right_side(slope, column_spacing_m))
    right = _right_side(weight * slope, column_spacing_m)
    # Weights that are small everywhere would make a preconditioner for 1 needlessly stiff.
    across = max(float(weight[:, 1:].mean()), 1e-3) if slope.shape[1] > 1 else 1.0
    preconditioner = _curvature(slope.shape, row_spacing_m, column_spacing_m, stiffness, across)

    def apply(heights: Array) -> Array:
        bent = _right_side(weight * np.diff(heights, axis=1, prepend=0.0), column_spacing_m) * (1.0 / column_spacing_m)
        bent += stiffness.screen_per_m2 * heights
        rise = np.diff(heights, axis=0) * (stiffness.along_weight / row_spacing_m**2)
        bent[:-1] -= rise
        bent[1:] += rise
        return bent

    return _conjugate_gradients(apply, preconditioner, right, np.zeros_like(slope) if start is None else start)


def _right_side(slope: Array, column_spacing_m: float) -> Array:
    """Return the negative divergence of slopes across."""
    right = np.zeros_like(slope)
    flow = slope[:, 1:] * (1.0 / column_spacing_m)
    right[:, 1:] += flow
    right[:, :-1] -= flow
    return right


def _curvature(
    shape: tuple[int, ...],
    row_spacing_m: float,
    column_spacing_m: float,
    stiffness: Stiffness,
    across_weight: float = 1.0,
) -> Array:
    """Return eigenvalues of the equation for every pair of cosine waves, 1/m^2."""
    rows, columns = ((2.0 * np.sin(0.5 * np.pi * np.arange(n) / n)) ** 2 for n in shape)
    along = rows * (stiffness.along_weight / row_spacing_m**2)
    across = columns * (across_weight / column_spacing_m**2)
    return np.asarray(along[:, None] + across + stiffness.screen_per_m2)


def _solve(curvature: Array, right: Array) -> Array:
    waves = scipy.fft.dctn(right, type=2, norm="ortho")
    waves /= curvature
    return np.asarray(scipy.fft.idctn(waves, type=2, norm="ortho", overwrite_x=True))


def _conjugate_gradients(apply: Callable[[Array], Array], curvature: Array, right: Array, start: Array) -> Array:
    heights = start.copy()
    residual = right - apply(heights)
    goal = _TOLERANCE * float(np.linalg.norm(right))
    direction, energy = np.zeros_like(right), 1.0
    for iteration in range(_MAX_ITERATIONS):
        if float(np.linalg.norm(residual)) <= goal:
            break
        steepest = _solve(curvature, residual)
        previous, energy = energy, float(np.vdot(residual, steepest))
        direction = steepest if iteration == 0 else steepest + (energy / previous) * direction
        pushed = apply(direction)
        step = energy / float(np.vdot(direction, pushed))
        heights += step * direction
        residual -= step * pushed
    return heights
