"""Find what stands out of single pings: pulses of other sonars, which the pings around do not show.

C and numpy agree to the bit: all in numpy's order of operations.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Values = NDArray[np.float64]

PINGS: Final = 5  # the ping and the four nearest; equal in C
_REACH: Final = 12  # columns to either side; equal in C
_STEP: Final = 5  # columns added up first, a fifth of the window; equal in C


def lone_echoes(intensity: Values, weak: float, strong: float) -> tuple[NDArray[np.uint8], Values]:
    """Rate every pixel: 1 if it stands out of the pings around by the factor `weak`, 2 by `strong`, else 0.

    Compared is `here` with the mean of `middle_two` over 25 columns or over 5, whichever is higher: a narrow highlight
    of three pings does not stand out of them. Returns the ratings and that mean, times fifty.

    Parameters
    ----------
    intensity
        (n_pings, n_columns) float64, none negative, of five pings or more.
    """
    found, around = np.empty(intensity.shape, dtype=np.uint8), np.empty(intensity.shape)
    scratch = np.empty((3, intensity.shape[1] + 2 * _REACH))
    if call("interference", *intensity.shape, intensity, weak, strong, scratch, around, found):
        return found, around
    return lone_echoes_numpy(intensity, weak, strong)


def lone_echoes_numpy(intensity: Values, weak: float, strong: float) -> tuple[NDArray[np.uint8], Values]:
    """Do as lone_echoes, in numpy alone."""
    n_columns = intensity.shape[1]
    padded = np.pad(2.0 * middle_two(intensity), ((0, 0), (_REACH, _REACH)), mode="edge")
    n_windows = padded.shape[1] - _STEP + 1
    few = padded[:, :n_windows].copy()
    for k in range(1, _STEP):
        few += padded[:, k : k + n_windows]
    around = few[:, :n_columns].copy()
    for k in range(1, _STEP):
        around += few[:, k * _STEP : k * _STEP + n_columns]
    np.maximum(around, _STEP * few[:, 2 * _STEP : 2 * _STEP + n_columns], out=around)
    echoes = here(intensity)
    stands = (echoes > weak * around) & (around > 0.0)
    return stands.astype(np.uint8) + (stands & (echoes > strong * around)), around


def here(intensity: Values) -> Values:
    """Average every pixel and its two neighbours in range, (n_pings, n_columns) float64, times fifty."""
    own = np.pad(intensity, ((0, 0), (1, 1)), mode="edge")
    return np.asarray(2.0 * (2 * _REACH + 1) / 3.0 * (own[:, :-2] + own[:, 1:-1] + own[:, 2:]))


def middle_two(intensity: Values) -> Values:
    """Average the middle two of the four pings nearest to each, (n_pings, n_columns) float64."""
    n_pings = len(intensity)
    first = np.clip(np.arange(n_pings) - PINGS // 2, 0, n_pings - PINGS)
    others = np.arange(PINGS - 1) + first[:, np.newaxis]
    others += others >= np.arange(n_pings)[:, np.newaxis]
    a, b, c, d = (intensity[others[:, k]] for k in range(PINGS - 1))
    high = np.maximum(np.minimum(a, b), np.minimum(c, d))
    return np.asarray(0.5 * (high + np.minimum(np.maximum(a, b), np.maximum(c, d))))
