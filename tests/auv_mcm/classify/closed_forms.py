"""Regions drawn from the closed forms of solids."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from auv_mcm.confirm.region import Region
from auv_mcm.solids.shapes import Shape, flat_ground_range_m, view_shape

_ALTITUDE_M: Final = 6.0
_BEFORE_M: Final = 3.0
_COLUMN_M: Final = 0.06
_N_ROWS: Final = 61


def closed_form_region(
    shape: Shape,
    ground_range_m: float,
    *,
    random: np.random.Generator | None = None,
    altitude_m: float = _ALTITUDE_M,
    beam_width_rad: float = 0.0,
    squint_rad: float = 0.0,
    row_spacing_m: float = 0.12,
    along_track_m: float = 3.66,
    levels: tuple[float, float, float] = (8.0, 0.1, 1.0),
) -> Region:
    """The picture that the closed forms make of an object: every pixel the mean of the levels of highlight, shadow and
    floor over the pixel's width and a fine fan of slices across the beam, times exponential speckle if there are random
    numbers for it.

    along_track_m: of the object's place from the near edge of row 0. A squinted picture is drawn as a sub-aperture's,
    in sheared slices.
    """
    n_columns = round((_BEFORE_M + 4.0 + 0.13 * ground_range_m) / _COLUMN_M)
    first_m = ground_range_m - _BEFORE_M
    n_fan = 31 if beam_width_rad > 0.0 else 1
    off = np.linspace(-1.2, 1.2, n_fan) if n_fan > 1 else np.zeros(1)
    share = np.exp(-4.0 * math.log(2.0) * off * off)
    bearing = off * beam_width_rad * math.hypot(ground_range_m, altitude_m)
    seen_from_m = (np.arange(_N_ROWS) + 0.5) * row_spacing_m
    edges = first_m + _COLUMN_M * np.arange(n_columns + 1)
    # of where the slice that a column shows left the track
    ahead_m = 0.5 * (edges[1:] + edges[:-1]) * math.tan(squint_rad)
    offset = (seen_from_m[:, np.newaxis] - ahead_m - along_track_m)[:, :, np.newaxis] + bearing
    view = view_shape(shape, offset, ground_range_m, altitude_m, squint_rad=squint_rad)
    front, tangent = (
        flat_ground_range_m(r, altitude_m) for r in (view.front_slant_range_m, view.tangent_slant_range_m)
    )
    begun = [
        np.clip((edges[1:, np.newaxis] - end * math.cos(squint_rad)) / _COLUMN_M, 0.0, 1.0)
        for end in (front, tangent, view.shadow_end_m)
    ]
    highlight, shadow = np.nan_to_num(begun[0] - begun[1]), np.nan_to_num(begun[1] - begun[2])
    level = levels[0] * highlight + levels[1] * shadow + levels[2] * (1.0 - highlight - shadow)
    intensity = np.average(level, axis=2, weights=share)
    if random is not None:
        intensity = intensity * random.exponential(size=intensity.shape)
    return Region(
        intensity=intensity,
        valid=np.ones(intensity.shape, dtype=np.bool_),
        row_spacing_m=row_spacing_m,
        column_spacing_m=_COLUMN_M,
        first_ground_range_m=first_m,
        altitude_m=altitude_m,
        row=along_track_m / row_spacing_m,
        column=(_BEFORE_M - 0.2) / _COLUMN_M,
        beam_width_rad=beam_width_rad,
        squint_rad=squint_rad,
    )
