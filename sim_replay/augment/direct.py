"""Recover relief, reflectivity and beam pattern of a side-scan image, in closed form along the ground range.

In the forward model an echo over its level Phi R is the cosine of incidence, which gives the slope across the track:
sin(depression + arctan(slope)). Speckle makes that a poor estimate one pixel at a time, and a biased one, as the
arcsine bends. So an echo is read as the mean slope of all that could have given it: those of a sea floor whose slopes
are normally distributed, seen through speckle of as many looks as the image shows. What slope is left on average at one
depression is bias, and taken off. Shadows read as the slope of the line of sight, which is what the floor falls by from
their beginning to their end. Slopes are integrated by the screened Poisson equation. Beam pattern, reflectivity and
angles are then taken anew with the relief found, three times.

An image cannot separate slope from reflectivity in slow changes of intensity; here they count as reflectivity from a
few metres on.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import msgspec
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from auv_mcm.detect.ftest import equivalent_looks
from sim_replay.augment.forward import BeamPattern, SeafloorScene, beam_gain, cast_shadow, cos_incidence, depression_rad
from sim_replay.augment.poisson import Stiffness, integrate_slope

STIFFNESS: Final = Stiffness(along_weight=0.1, screen_per_m2=0.3)
REFLECTIVITY_M: Final = 1.0  # standard deviation of the mean that reflectivity is

_ITERATIONS: Final = 3  # of levels and slopes in turn; chosen, not measured
_BRIDGE_WEIGHT: Final = 0.05  # of level slopes where nothing was recorded, against those that were seen
_MIN_LOOKS: Final = 4.0  # looks that an image is averaged to: fewer are too noisy for a slope
_SMOOTHING_PX: Final = (
    (0.5, 2),
    (0.8, 3),
    (1.1, 4),
    (1.5, 5),
)  # standard deviation, and a lag farther than that and speckle reach
_LOOKS_BLOCK: Final = 16  # pixels along and across, whose variance gives the looks
_MAX_LOOKS: Final = 50.0  # beyond which speckle no longer matters

_N_ANGLES: Final = 180  # bins of depression over 90°: half a degree each
_MIN_BIN_PIXELS: Final = 48  # of a bin, for its beam pattern to be fitted
_MIN_FACING: Final = 0.02  # sine of the angle to the surface, below which it gives no echo to speak of
_NO_ECHO: Final = 1e-12  # keeps divisions finite

SLOPE_SIGMA: Final = 0.3  # 1-sigma of the prior of slopes, rise over run
_STEEPEST: Final = 1.5  # rise over run, at the ends of the table
_FLOOR: Final = 0.01  # an echo from where none can come, over that of level floor
_TABLE_ECHOES: Final = 161  # entries over the root of the echo
_MAX_ROOT_ECHO: Final = 4.0  # square root of an echo over that of level floor

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class SmoothedImage(NamedTuple):
    """Hold intensity: (n_pings, n_columns) float64, 0 where not valid. looks: that a pixel has."""

    intensity: Array
    looks: float


def invert(intensity: Array, valid: Bools, altitude_m: Array, along_m: Array, column_spacing_m: float) -> SeafloorScene:
    """Recover the scene that one side of a line shows; rendered, it gives the image without speckle.

    Column j is around (j + 0.5) * column_spacing_m. Heights are relative: waves longer than 11 m or so are not seen,
    and shorter ones come out lower the weaker they are against speckle.

    Parameters
    ----------
    intensity, valid
        (n_pings, n_columns), linear, of any gain; what is not valid does not count.
    altitude_m
        (n_pings,) float64, slant range of the first bottom return.
    along_m
        (n_pings,) float64, increasing.
    """
    level = float(intensity[valid].mean()) if valid.any() else 0.0
    if not level > 0.0:
        level = 1.0
    image = multi_look(intensity / level, valid)
    row_spacing_m = mean_spacing_m(along_m)
    table = _slope_table(image.looks)
    elevation = np.zeros(intensity.shape)
    scene = fit_levels(
        image.intensity, valid, elevation, np.ones_like(elevation), altitude_m, along_m, column_spacing_m
    )
    weight = None if valid.all() else np.where(valid, 1.0, _BRIDGE_WEIGHT)
    for _ in range(_ITERATIONS):
        slope = _expected_slope(table, image.intensity, scene)
        elevation = integrate_slope(slope, row_spacing_m, column_spacing_m, STIFFNESS, weight, elevation)
        scene = fit_levels(image.intensity, valid, elevation, scene.reflectivity, altitude_m, along_m, column_spacing_m)
    return msgspec.structs.replace(scene, beam=msgspec.structs.replace(scene.beam, gain=scene.beam.gain * level))


def mean_spacing_m(along_m: Array) -> float:
    """Return the mean distance from ping to ping."""
    return float(along_m[-1] - along_m[0]) / (len(along_m) - 1) if len(along_m) > 1 else 1.0


def multi_look(intensity: Array, valid: Bools) -> SmoothedImage:
    """Smooth the image as little as gives at least four looks, but at most with a standard deviation of 1.5 pixels."""
    weight = valid.astype(np.float64)
    smooth, looks = np.where(valid, intensity, 0.0), 1.0
    for sigma_px, lag in _SMOOTHING_PX:
        smooth = _masked_mean(intensity, weight, (sigma_px, sigma_px))
        looks = _measured_looks(smooth, valid, lag)
        if looks >= _MIN_LOOKS:
            break
    return SmoothedImage(np.where(valid, smooth, 0.0), looks)


def _measured_looks(smooth: Array, valid: Bools, lag: int) -> float:
    """Estimate looks by the nugget of the logarithm's variogram across the track: what is left at lag 0 when the sea
    floor's own share, quadratic in the lag, is taken off by help of twice the lag. The lower quartile over blocks, as
    all else adds to it; 4 if nothing can be measured.
    """
    level = np.log(np.where(valid & (smooth > 0.0), smooth, 1.0))
    usable = valid & (smooth > 0.0)
    near, far = (_block_variogram(level, usable, step) for step in (lag, 2 * lag))
    n_rows, n_columns = (min(n) for n in zip(near.shape, far.shape, strict=True))
    near, far = near[:n_rows, :n_columns], far[:n_rows, :n_columns]
    nugget = (near - (far - near) * (1.0 / 3.0))[np.isfinite(near) & np.isfinite(far)]
    if not nugget.size:
        return _MIN_LOOKS
    variance = np.maximum(np.quantile(nugget, [0.25]), 1e-3).astype(np.float32)
    return float(np.minimum(equivalent_looks(variance)[0], _MAX_LOOKS))


def _block_variogram(level: Array, usable: Bools, lag: int) -> Array:
    """Return half the mean square difference over `lag` columns in each block, NaN where less than half a block is
    usable.
    """
    both = usable[:, lag:] & usable[:, :-lag]
    energy = np.where(both, 0.5 * (level[:, lag:] - level[:, :-lag]) ** 2, 0.0)
    rows, columns = (np.arange(0, n, _LOOKS_BLOCK) for n in both.shape)
    if not len(rows) or not len(columns):
        return np.full((0, 0), np.nan)
    total, count = (
        np.add.reduceat(np.add.reduceat(plane, rows, axis=0), columns, axis=1)
        for plane in (energy, both.astype(np.float64))
    )
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count >= 0.5 * _LOOKS_BLOCK**2)


def fit_levels(
    intensity: Array,
    valid: Bools,
    elevation_m: Array,
    reflectivity: Array,
    altitude_m: Array,
    along_m: Array,
    column_spacing_m: float,
) -> SeafloorScene:
    """Fit the beam pattern and then the reflectivity of a scene of known relief to a smoothed image.

    Mean reflectivity is 1.

    Beam pattern: mean echo over what the relief facing the sonar and the reflectivity so far account for, in half
    degrees of depression. Reflectivity: the same over a few metres. What the relief shadows or turns away counts in
    neither.
    """
    facing = cos_incidence(elevation_m, altitude_m, along_m, column_spacing_m)
    lit = valid & ~cast_shadow(elevation_m, altitude_m, column_spacing_m) & (facing > _MIN_FACING)
    depression = depression_rad(elevation_m, altitude_m, column_spacing_m)
    beam = _fit_beam(depression[lit], intensity[lit], (facing * reflectivity)[lit])
    weight = lit.astype(np.float64)
    expected = beam_gain(beam, elevation_m, altitude_m, column_spacing_m) * facing
    sigma_px = (REFLECTIVITY_M / mean_spacing_m(along_m), REFLECTIVITY_M / column_spacing_m)
    found = _masked_mean(intensity, weight, sigma_px) / np.maximum(_masked_mean(expected, weight, sigma_px), _NO_ECHO)
    mean = float(found[lit].mean()) if lit.any() else 1.0
    scale = mean if mean > 0.0 else 1.0
    return SeafloorScene(
        elevation_m=elevation_m,
        reflectivity=np.where(found > 0.0, found, mean) * (1.0 / scale),
        beam=BeamPattern(depression_rad=beam.depression_rad, gain=beam.gain * scale),
        altitude_m=altitude_m,
        along_m=along_m,
        column_spacing_m=column_spacing_m,
        valid=valid,
    )


def _fit_beam(depression: Array, intensity: Array, accounted: Array) -> BeamPattern:
    """Return the mean echo over the other factors, per half degree; each mean belongs to the mean angle of its
    pixels."""
    which = _angle_bins(depression)
    count, echo, share = (np.bincount(which, weights, minlength=_N_ANGLES) for weights in (None, intensity, accounted))
    known = np.flatnonzero((count >= _MIN_BIN_PIXELS) & (share > 0.0))
    if not known.size:
        gain = float(intensity.sum() / accounted.sum()) if accounted.sum() > 0.0 else 1.0
        return BeamPattern(depression_rad=np.array([0.0]), gain=np.array([gain]))
    angle = np.bincount(which, depression, minlength=_N_ANGLES)
    return BeamPattern(depression_rad=angle[known] / count[known], gain=echo[known] / share[known])


def _slope_table(looks: float) -> Array:
    """Tabulate mean slope, (180, 161) float64.

    Given the square root of the echo over level floor's, even from 0 to 4, per half degree of depression.

    Prior of the slope: normal. Likelihood of the echo: Gamma of mean sin(depression + arctan(slope)) and shape `looks`.
    """
    slope = np.linspace(-_STEEPEST, _STEEPEST, 301)
    angle = (np.arange(_N_ANGLES) + 0.5) * (0.5 * math.pi / _N_ANGLES)
    expected = np.maximum(np.sin(angle[:, None] + np.arctan(slope)) / np.sin(angle)[:, None], _FLOOR)
    echo = np.linspace(0.0, _MAX_ROOT_ECHO, _TABLE_ECHOES) ** 2
    fixed = -looks * np.log(expected) - 0.5 * (slope / SLOPE_SIGMA) ** 2
    table = np.empty((_N_ANGLES, _TABLE_ECHOES))
    for k in range(_N_ANGLES):
        log_density = fixed[k] - looks * echo[:, None] / expected[k]
        density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        table[k] = density @ slope / density.sum(axis=1)
    return table


def _expected_slope(table: Array, intensity: Array, scene: SeafloorScene) -> Array:
    """Rise per metre across the track, with mean 0 over all pings at each half degree of depression; 0 where not
    valid."""
    depression = depression_rad(scene.elevation_m, scene.altitude_m, scene.column_spacing_m)
    level = (
        beam_gain(scene.beam, scene.elevation_m, scene.altitude_m, scene.column_spacing_m)
        * scene.reflectivity
        * np.sin(depression)
    )
    root = np.sqrt(intensity / np.maximum(level, _NO_ECHO))
    place = np.stack([depression * (_N_ANGLES / (0.5 * math.pi)) - 0.5, root * ((_TABLE_ECHOES - 1) / _MAX_ROOT_ECHO)])
    slope = scipy.ndimage.map_coordinates(table, place, order=1, mode="nearest")
    which = _angle_bins(depression)[scene.valid]
    bias = np.bincount(which, slope[scene.valid], minlength=_N_ANGLES) / np.maximum(
        np.bincount(which, minlength=_N_ANGLES), 1
    )
    return np.where(scene.valid, slope - bias[_angle_bins(depression)], 0.0)


def _angle_bins(depression: Array) -> NDArray[np.intp]:
    return np.clip((depression * (_N_ANGLES / (0.5 * math.pi))).astype(np.intp), 0, _N_ANGLES - 1)


def _masked_mean(values: Array, weight: Array, sigma_px: tuple[float, float]) -> Array:
    """Return the Gaussian mean over weighted pixels, 0 where nothing near has weight."""
    total = scipy.ndimage.gaussian_filter(np.where(weight > 0.0, values, 0.0) * weight, sigma_px, mode="nearest")
    known = scipy.ndimage.gaussian_filter(weight, sigma_px, mode="nearest")
    return np.asarray(np.divide(total, known, out=np.zeros_like(total), where=known > 1e-6))
