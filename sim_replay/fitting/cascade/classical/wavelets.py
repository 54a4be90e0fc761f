"""Compute the bi-orthogonal 5/3 wavelet by lifting (Le Gall and Tabatabai, ICASSP 1988; lifting: Sweldens, SIAM J.
Math. Anal. 29(2), 1998). Anal. 29(2), 1998).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Subbands(NamedTuple):
    """Hold one level of images (..., n_rows, n_columns), even rows and columns being smooth.

    Smooth both ways, detail across columns, across rows, across both.
    """

    smooth: Array
    columns: Array
    rows: Array
    both: Array


def analyse(images: Array) -> Subbands:
    """Compute one level.

    Images of 2 rows and columns or more; they go on beyond their edges as in a mirror that stands on the last pixel.
    """
    smooth, detail = _lift(images)
    low, columns = (np.swapaxes(part, -1, -2) for part in _lift(np.swapaxes(smooth, -1, -2)))
    rows, both = (np.swapaxes(part, -1, -2) for part in _lift(np.swapaxes(detail, -1, -2)))
    return Subbands(low, columns, rows, both)


def _lift(images: Array) -> tuple[Array, Array]:
    """Smooth the even rows, and subtract from odd rows the mean of their neighbours."""
    even, odd = images[..., ::2, :], images[..., 1::2, :]
    n_odd = odd.shape[-2]
    # An even row without an odd one after it, or the other way round, has the mirror's image there.
    below = (
        even[..., 1:, :] if even.shape[-2] > n_odd else np.concatenate([even[..., 1:, :], even[..., -1:, :]], axis=-2)
    )
    detail = odd - 0.5 * (even[..., :n_odd, :] + below)
    before = np.concatenate([detail[..., :1, :], detail], axis=-2)[..., : even.shape[-2], :]
    after = detail if n_odd == even.shape[-2] else np.concatenate([detail, detail[..., -1:, :]], axis=-2)
    return even + 0.25 * (before + after), detail
