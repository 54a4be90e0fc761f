"""Compute the probability that a target stands out, in closed form: the prior for bands with few looks.

A target is found if its highlight is brighter than the floor around, and its shadow darker, by more than speckle and
texture make by chance (J. Groen, D. Williams and W. Fox, "A model-based sonar image simulation for performance
prediction", 2011, for the idea; ratios of mean intensities are F distributed). Levels are usual ones of side-scan
sonars near 450 kHz; the texture is fitted to what was found.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtr, fdtrc, fdtri

_BY_CHANCE: Final = 1e-3  # that a highlight, or a shadow, is seen where there is none
_HEIGHT_M: Final = 0.35  # m: of the usual target
_HIGHLIGHT_M2: Final = 0.16  # m²: its highlight
_SHADOW_WIDTH_M: Final = 0.8  # m along the track: its shadow
_SHADOW_M: Final = (0.1, 6.0)  # m across the track: of shadows that are used, minimum and maximum
_AROUND_M2: Final = 14.0  # m² of sea floor that the contrast is taken against
_RANGE_RESOLUTION_M: Final = 0.065  # m, of the usual sonar
_ALONG_RESOLUTION_M: Final = 0.15  # m, of a tile's rows
_BEAM_RAD: Final = math.radians(0.4)
_STRENGTHS_DB: Final = (-22.0, -17.0, -12.0)  # dB of target strength: faint, usual, bright
_FLOOR_DB: Final = -27.0  # at a grazing angle of 10 degrees, falling with its sine
_IN_SHADOW_DB: Final = -12.0  # what surroundings spill into a shadow, against the floor
_NOISE_DB: Final = -22.0  # against the floor at 28 m, growing with the fourth power of range
_NOISE_RANGE_M: Final = 28.0  # m at which the noise is _NOISE_DB
_PATCHES: Final = 10.0  # of texture in the surroundings


def p_found(ground_range_m: ArrayLike, altitude_m: float, texture: float) -> NDArray[np.float64]:
    """Return the probability (n,) float64 that one look finds a target at ground ranges (n,), above 0 m.

    texture: shape of the Gamma distribution of the floor's own brightness over the size of a target; low for a restless
    floor.
    """
    ground = np.asarray(ground_range_m, dtype=np.float64)
    slant = np.hypot(ground, altitude_m)
    cell_m2 = _RANGE_RESOLUTION_M * np.maximum(_ALONG_RESOLUTION_M, _BEAM_RAD * slant)
    shadow_m2 = _SHADOW_WIDTH_M * np.clip(_HEIGHT_M * ground / (altitude_m - _HEIGHT_M), *_SHADOW_M)
    around = 2.0 * _looks(_AROUND_M2 / cell_m2, _PATCHES * texture)
    bright, dark = (2.0 * _looks(area / cell_m2, texture) for area in (np.full(ground.shape, _HIGHLIGHT_M2), shadow_m2))
    noise = 10.0 ** (0.1 * _NOISE_DB) * (slant / _NOISE_RANGE_M) ** 4
    dimmed = 10.0 ** (0.1 * _IN_SHADOW_DB) + noise
    in_shadow = fdtr(dark, around, fdtri(dark, around, _BY_CHANCE) / dimmed)
    min_ratio = fdtri(bright, around, 1.0 - _BY_CHANCE)
    floor_db = _FLOOR_DB + 10.0 * np.log10(altitude_m / slant / math.sin(math.radians(10.0)))
    lit = [
        fdtrc(bright, around, min_ratio / (1.0 + 10.0 ** (0.1 * (strength - floor_db)))) for strength in _STRENGTHS_DB
    ]
    return np.asarray(np.clip(in_shadow * np.mean(lit, axis=0), 0.0, 1.0))


def _looks(n_cells: NDArray[np.float64], texture: float) -> NDArray[np.float64]:
    """Compute the looks that a mean over resolution cells is worth.

    Its relative variance is that of speckle and of texture together.
    """
    return np.asarray(1.0 / (1.0 / n_cells + 1.0 / texture + 1.0 / (n_cells * texture)))
