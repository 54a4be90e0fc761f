"""Pack snippets of sonar picture small enough to keep one with every contact: a byte per pixel, logarithmic.

Code 0 is no echo; code n >= 1 is -40 dB + (n - 1) / 4 dB about the local seabed mean, up to +23.5 dB.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_FLOOR_DB: Final = -40.0  # dB over the sea floor that code 1 stands for
_PER_DB: Final = 4.0  # codes per dB: the 8 bits reach 23.5 dB


def pack_snippet(intensity: NDArray[Any]) -> NDArray[np.uint8]:
    """Pack linear intensity (n, m) in units of the seabed mean into codes, rounded to an eighth of a decibel.

    Not positive or NaN is no echo.
    """
    values = np.asarray(intensity, dtype=np.float32)
    echo = values > 0.0
    level_db = np.fmax(values, np.float32(1e-5))  # far below code 1, where there is no echo
    np.log10(level_db, out=level_db)
    level_db *= 10.0
    level_db -= _FLOOR_DB
    level_db *= _PER_DB
    np.rint(level_db, out=level_db)
    level_db += 1.0
    return np.clip(level_db, 1.0, 255.0, out=level_db).astype(np.uint8) * echo


def unpack_snippet(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Unpack codes to linear intensity (n, m) float32; 0 where there was no echo."""
    return np.asarray(_INTENSITY[codes])


_INTENSITY: Final = np.concatenate([[0.0], 10.0 ** ((_FLOOR_DB + np.arange(255) / _PER_DB) / 10.0)]).astype(np.float32)
