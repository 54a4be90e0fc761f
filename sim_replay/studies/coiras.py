"""Relief, reflectivity and beam pattern of a side-scan image by iteration from coarse to fine, as a reference for
`direct`.

After Coiras, Petillot and Lane, "Multiresolution 3-D reconstruction from side-scan sonar images", IEEE Trans. Image
Processing 16(2), 2007: at every level of a pyramid, expectation renders the image from what is known so far, and
maximisation takes gradient steps on the relief and fits reflectivity and beam pattern anew; shadows stay out. Two
points differ. Residuals are relative to the echo of level floor, as speckle is. And the relief is held by the same
prior of slopes as in `direct`, in place of smoothing of no stated strength.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from sim_replay.augment.direct import SLOPE_SIGMA, STIFFNESS, fit_levels, mean_spacing_m, multi_look
from sim_replay.augment.forward import (
    SeafloorScene,
    across_slope,
    along_slope,
    beam_gain,
    cast_shadow,
    depression_rad,
    ground_range_m,
)

_LEVELS: Final = 4
_MIN_SIZE: Final = 12  # of the coarsest level, pixels
_ROUNDS: Final = 4  # of expectation and maximisation per level
_STEPS: Final = 20  # on the relief per round
_GROWTH, _SHRINKAGE = 1.3, 0.5  # of the step, after one that helped and one that did not
_NO_ECHO: Final = 1e-12

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Expected(NamedTuple):
    """Hold the data that the relief is fitted to.

    cosine: (n_pings, n_columns) float64, echo over beam pattern and reflectivity. lit: the same shape, bool. prior:
    weight of slopes. screen_per_m2: of heights, against slopes. Other arrays are (n_pings,) float64.
    """

    cosine: Array
    lit: Bools
    altitude_m: Array
    along_m: Array
    column_spacing_m: float
    prior: float
    screen_per_m2: float


class Misfit(NamedTuple):
    """Hold value: of the whole image. gradient: over heights, (n_pings, n_columns) float64. curvature: bound for each
    height, the same shape.
    """

    value: float
    gradient: Array
    curvature: Array


class _Level(NamedTuple):
    intensity: Array
    valid: Bools
    altitude_m: Array
    along_m: Array
    column_spacing_m: float


def invert_multiresolution(
    intensity: Array, valid: Bools, altitude_m: Array, along_m: Array, column_spacing_m: float
) -> SeafloorScene:
    """Recover the scene that one side of a line shows; arguments and result are those of
    `sim_replay.augment.direct.invert`.
    """
    level = float(intensity[valid].mean()) if valid.any() else 0.0
    if not level > 0.0:
        level = 1.0
    image = multi_look(intensity / level, valid)
    pyramid = [_Level(image.intensity, valid, altitude_m, along_m, column_spacing_m)]
    while len(pyramid) < _LEVELS and min(pyramid[-1].intensity.shape) >= 2 * _MIN_SIZE:
        pyramid.append(_halved(pyramid[-1]))
    elevation = np.zeros(pyramid[-1].intensity.shape)
    reflectivity = np.ones_like(elevation)
    scene: SeafloorScene | None = None
    for k in range(len(pyramid) - 1, -1, -1):
        if scene is not None:
            elevation, reflectivity = (
                _doubled(plane, pyramid[k].intensity.shape) for plane in (scene.elevation_m, scene.reflectivity)
            )
        scene = _refine(pyramid[k], elevation, reflectivity, image.looks * 4.0**k)
    assert scene is not None
    return msgspec.structs.replace(scene, beam=msgspec.structs.replace(scene.beam, gain=scene.beam.gain * level))


def _refine(level: _Level, elevation: Array, reflectivity: Array, looks: float) -> SeafloorScene:
    """Run rounds of expectation and maximisation at one level of the pyramid."""
    image, valid, altitude_m, along_m, column_spacing_m = level
    scene = fit_levels(image, valid, elevation, reflectivity, altitude_m, along_m, column_spacing_m)
    for _ in range(_ROUNDS):
        illumination = scene.reflectivity * beam_gain(scene.beam, scene.elevation_m, altitude_m, column_spacing_m)
        expected = Expected(
            cosine=image / np.maximum(illumination, _NO_ECHO),
            lit=valid & ~cast_shadow(scene.elevation_m, altitude_m, column_spacing_m),
            altitude_m=altitude_m,
            along_m=along_m,
            column_spacing_m=column_spacing_m,
            prior=1.0 / (looks * SLOPE_SIGMA**2),
            screen_per_m2=STIFFNESS.screen_per_m2,
        )
        elevation = _descend(scene.elevation_m, expected)
        scene = fit_levels(image, valid, elevation, scene.reflectivity, altitude_m, along_m, column_spacing_m)
    return scene


def _descend(elevation: Array, expected: Expected) -> Array:
    """Take gradient steps, each height's scaled by its curvature; the step grows while it helps."""
    here, step = misfit(elevation, expected), 0.5
    for _ in range(_STEPS):
        moved = elevation - step * here.gradient / here.curvature
        there = misfit(moved, expected)
        if there.value <= here.value:
            elevation, here, step = moved, there, step * _GROWTH
        else:
            step *= _SHRINKAGE
    return elevation


def misfit(elevation: Array, expected: Expected) -> Misfit:
    """Sum the squares of the cosine of incidence against the expected one, and of the prior, over lit pixels.

    Relative to level floor's.

    Beam pattern and shadows are those of the round's beginning, so the gradient holds them fixed.
    """
    altitude_m, along_m, spacing_m = expected.altitude_m, expected.along_m, expected.column_spacing_m
    across, along = across_slope(elevation, spacing_m), along_slope(elevation, along_m)
    ground_m, depth = ground_range_m(elevation.shape[1], spacing_m), altitude_m[:, None] - elevation
    per_view = 1.0 / (ground_m**2 + depth**2)
    per_normal = 1.0 / (1.0 + across**2 + along**2)
    facing = depth + ground_m * across
    per = np.sqrt(per_view * per_normal)
    counts = (expected.lit & (facing > 0.0)).astype(np.float64)
    level = np.sin(depression_rad(np.zeros_like(elevation), altitude_m, spacing_m))
    cosine = np.maximum(facing, 0.0) * per
    residual = np.where(expected.lit, (cosine - expected.cosine) / level, 0.0)

    cosine_per_across = (ground_m * per - cosine * across * per_normal) * counts / level
    cosine_per_along = -cosine * along * per_normal * counts / level
    cosine_per_depth = (per - cosine * depth * per_view) * counts / level
    ahead_m = mean_spacing_m(along_m)
    step = np.diff(elevation, axis=0) / ahead_m
    tied, held = expected.prior * STIFFNESS.along_weight, expected.prior * expected.screen_per_m2
    steep = across.copy()
    steep[:, 0] = 0.0  # where no facet ends
    value = float(
        (residual**2).sum() + expected.prior * (steep**2).sum() + tied * (step**2).sum() + held * (elevation**2).sum()
    )

    gradient = -2.0 * residual * cosine_per_depth + 2.0 * held * elevation
    gradient += _across_adjoint(2.0 * residual * cosine_per_across, spacing_m)
    gradient += _across_adjoint(2.0 * expected.prior * steep, spacing_m)
    gradient += _along_adjoint(2.0 * residual * cosine_per_along, along_m)
    gradient[:-1] -= (2.0 * tied / ahead_m) * step
    gradient[1:] += (2.0 * tied / ahead_m) * step

    stiff = cosine_per_across**2 + expected.prior
    curvature = np.full(elevation.shape, 2.0 * held + 8.0 * tied / ahead_m**2)
    curvature += (4.0 / spacing_m**2) * stiff
    curvature[:, :-1] += (4.0 / spacing_m**2) * stiff[:, 1:]
    return Misfit(value, gradient, curvature)


def _across_adjoint(weight: Array, spacing_m: float) -> Array:
    """Apply the transpose of `across_slope`."""
    out = np.zeros_like(weight)
    if weight.shape[1] < 2:
        return out
    flow = weight[:, 1:] * (1.0 / spacing_m)
    flow[:, 0] += weight[:, 0] * (1.0 / spacing_m)
    out[:, 1:] += flow
    out[:, :-1] -= flow
    return out


def _along_adjoint(weight: Array, along_m: Array) -> Array:
    """Apply the transpose of `along_slope`."""
    out = np.zeros_like(weight)
    if len(along_m) < 2:
        return out
    inner = weight[1:-1] / (along_m[2:] - along_m[:-2])[:, None]
    out[2:] += inner
    out[:-2] -= inner
    for low, high, end in ((0, 1, 0), (-2, -1, -1)):
        one_sided = weight[end] / (along_m[high] - along_m[low])
        out[high] += one_sided
        out[low] -= one_sided
    return out


def _halved(level: _Level) -> _Level:
    """Average over two pings by two columns; an odd last one is left out."""
    n_pings, n_columns = (2 * (n // 2) for n in level.intensity.shape)

    def fours(plane: Array) -> Array:
        return np.asarray(plane[:n_pings, :n_columns].reshape(n_pings // 2, 2, n_columns // 2, 2).sum(axis=(1, 3)))

    count = fours(level.valid.astype(np.float64))
    total = fours(np.where(level.valid, level.intensity, 0.0))
    return _Level(
        np.divide(total, count, out=np.zeros_like(total), where=count > 0.0),
        count >= 2.0,
        level.altitude_m[:n_pings].reshape(-1, 2).mean(axis=1),
        level.along_m[:n_pings].reshape(-1, 2).mean(axis=1),
        2.0 * level.column_spacing_m,
    )


def _doubled(plane: Array, shape: tuple[int, ...]) -> Array:
    """Interpolate between the centres of pixels twice as large, bilinear."""
    places = [np.clip((np.arange(n) - 0.5) / 2.0, 0.0, m - 1.0) for n, m in zip(shape, plane.shape, strict=True)]
    return np.asarray(
        scipy.ndimage.map_coordinates(plane, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest")
    )
