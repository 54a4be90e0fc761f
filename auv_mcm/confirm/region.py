"""The piece of a waterfall around one detection that confirmation and classification look at."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

BACKGROUND: Final = 0
SHADOW: Final = 1
HIGHLIGHT: Final = 2


class Region(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Rows are pings, columns ground range away from the sonar, on either side.

    intensity: (n_rows, n_columns) float64, linear, local mean of the sea floor about 1. valid: (n_rows, n_columns) bool, False where
    nothing was measured; intensity there means nothing. first_ground_range_m: of the near edge of column 0. altitude_m: of the array
    above the floor, as ground range was made with: slant range is hypot(ground range, altitude_m). row, column: centre of the highlight
    found by the detector, fractional pixels. squint_rad: 0 for side-scan; angle between the view and broadside for a synthetic
    aperture's sub-image, positive looking ahead. beam_width_rad: horizontal, two-way; 0 where resolution does not depend on range.
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
