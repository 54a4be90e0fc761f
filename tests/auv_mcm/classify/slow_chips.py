"""Mean levels of pixels by loops over what each of them covers: an oracle."""

import math

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import Region


def slow_levels_db(seen: Region, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (len(rows) - 1, len(columns) - 1) dB for edges in pixels; NaN where nothing was measured."""
    found = np.full((len(rows) - 1, len(columns) - 1), math.nan)
    n_rows, n_columns = seen.intensity.shape
    for i in range(len(rows) - 1):
        for j in range(len(columns) - 1):
            total, area = 0.0, 0.0
            for row in range(max(math.floor(rows[i]), 0), min(math.ceil(rows[i + 1]), n_rows)):
                for column in range(max(math.floor(columns[j]), 0), min(math.ceil(columns[j + 1]), n_columns)):
                    if seen.valid[row, column]:
                        share = min(rows[i + 1], row + 1.0) - max(rows[i], row)
                        share *= min(columns[j + 1], column + 1.0) - max(columns[j], column)
                        total, area = total + share * seen.intensity[row, column], area + share
            if area > 1e-6:
                found[i, j] = 10.0 * math.log10(max(total / area, 1e-4))
    return found
