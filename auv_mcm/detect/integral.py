"""Sum boxes of any size with four look-ups a pixel, on integral images (Crow 1984).

Sums are float64 with the origin at the tile's corner, so they stay exact to 1e-10 however long the mission; float32
sums lose percents within one tile.
"""

from __future__ import annotations

import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


class PaddedIntegral:
    """Integrate one tile plane, padded so that boxes reaching out of the tile are clipped at its edge.

    Boxes are given by half-open offsets from each pixel: rows [row_start, row_stop), columns [column_start,
    column_stop).
    """

    def __init__(self, plane: NDArray[Any], pad_rows: int, pad_columns: int) -> None:
        """Integrate a plane, (n_rows, n_columns) float32, float64 or uint8.

        pad_*: the farthest a box may reach, pixels.
        """
        self._shape = (plane.shape[0], plane.shape[1])
        self._pad = (pad_rows, pad_columns)
        total = np.asarray(cv2.integral(np.ascontiguousarray(plane), sdepth=cv2.CV_64F), dtype=np.float64)
        self._sum: NDArray[np.float64] = np.asarray(
            cv2.copyMakeBorder(total, pad_rows, pad_rows, pad_columns, pad_columns, cv2.BORDER_REPLICATE),
            dtype=np.float64,
        )

    def band(self, start: int, stop: int) -> PaddedIntegral:
        """Give the same sums for rows [start, stop) of the tile alone, counted from 0; boxes still reach beyond them.

        Work on a few dozen rows at a time stays in the processor's cache; whole planes do not.
        """
        part = copy.copy(self)
        part._shape = (stop - start, self._shape[1])
        part._sum = self._sum[start : stop + 2 * self._pad[0] + 1]
        return part

    def box(self, row_start: int, row_stop: int, column_start: int, column_stop: int) -> NDArray[np.float64]:
        """Sum over the box around every pixel, (n_rows, n_columns) float64."""
        band = self.rows(row_start, row_stop)
        n_columns, pad = self._shape[1], self._pad[1]
        return (
            band[:, pad + column_stop : pad + column_stop + n_columns]
            - band[:, pad + column_start : pad + column_start + n_columns]
        )

    def rows(self, row_start: int, row_stop: int) -> NDArray[np.float64]:
        """Sum over rows [i + row_start, i + row_stop) and all columns before each padded column edge.

        Returns (n_rows, n_columns + 1 + 2 pad) float64.
        """
        n_rows, pad = self._shape[0], self._pad[0]
        return (
            self._sum[pad + row_stop : pad + row_stop + n_rows] - self._sum[pad + row_start : pad + row_start + n_rows]
        )

    def box_varying(
        self, row_start: int, row_stop: int, column_start: int, lengths: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Sum over rows [row_start, row_stop) and columns from column_start on, with a length per pixel.

        lengths: (n_rows, n_columns) intp, at most the column pad minus column_start.
        """
        band = self.rows(row_start, row_stop)
        n_rows, n_columns = self._shape
        pad = self._pad[1]
        start = pad + column_start + np.arange(n_columns, dtype=np.intp)
        flat_stop = (np.arange(n_rows, dtype=np.intp) * band.shape[1])[:, None] + start[None, :] + lengths
        stop_sum: NDArray[np.float64] = band.ravel().take(flat_stop)
        stop_sum -= band[:, pad + column_start : pad + column_start + n_columns]
        return stop_sum
