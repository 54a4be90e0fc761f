"""Define the piece of a waterfall around one detection that confirmation and classification use."""

from __future__ import annotations

import math
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

BACKGROUND: Final = 0  # the labels of pixels, also their index in tables of classes
SHADOW: Final = 1  # see BACKGROUND
HIGHLIGHT: Final = 2  # see BACKGROUND

_MIN_LENGTH_M: Final = 1e-6  # m: any real spacing is larger; keeps divisions finite
_FARTHEST: Final = 1e9  # metres or pixels; beyond it, places a centimetre apart are the same number
_MAX_SQUINT_RAD: Final = 0.25 * math.pi


class Region(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold a region. Rows are pings, columns ground range away from the sonar, on either side.

    intensity: (n_rows, n_columns) float64, linear, local mean of the sea floor about 1. valid: (n_rows, n_columns)
    bool, False where no echo was measured; intensity there is undefined. first_ground_range_m: of the near edge of
    column 0. altitude_m: of the array above the floor, as ground range was made with: slant range is hypot(ground
    range, altitude_m). row, column: centre of the highlight found by the detector, fractional pixels. squint_rad: 0 for
    side-scan; angle between the view and broadside for a synthetic aperture's sub-image, positive looking ahead.
    beam_width_rad: horizontal, two-way; 0 where resolution does not depend on range.
    """

    intensity: NDArray[np.float64]
    valid: NDArray[np.bool_]
    row_spacing_m: float
    column_spacing_m: float
    first_ground_range_m: float
    altitude_m: float
    row: float
    column: float
    beam_width_rad: float
    squint_rad: float = 0.0


def require_sound(region: Region) -> None:
    """Check that planes are of one 2-d shape, and the geometry is possible for a sonar. Raises ValueError."""
    if region.intensity.ndim != 2 or region.valid.shape != region.intensity.shape:
        raise ValueError(
            f"intensity and valid must be planes of one shape, not {region.intensity.shape} and {region.valid.shape}"
        )
    lengths = region.row_spacing_m, region.column_spacing_m, region.altitude_m
    if not all(_MIN_LENGTH_M <= length <= _FARTHEST for length in lengths):
        raise ValueError(
            f"row_spacing_m, column_spacing_m and altitude_m must be positive numbers from {_MIN_LENGTH_M:g} to "
            f"{_FARTHEST:g}, not {lengths[0]}, {lengths[1]} and {lengths[2]}: leave out regions without navigation"
        )
    for name, place in (
        ("row", region.row),
        ("column", region.column),
        ("first_ground_range_m", region.first_ground_range_m),
    ):
        if not abs(place) <= _FARTHEST:
            raise ValueError(f"{name} of a region must be a number from -{_FARTHEST:g} to {_FARTHEST:g}, not {place}")
    if not abs(region.squint_rad) < _MAX_SQUINT_RAD:
        raise ValueError(f"squint_rad must be between -pi/4 and pi/4, not {region.squint_rad}")
    if not 0.0 <= region.beam_width_rad < math.pi:
        raise ValueError(f"beam_width_rad must be from 0 to less than pi, not {region.beam_width_rad}")
