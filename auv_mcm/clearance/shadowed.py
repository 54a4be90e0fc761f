"""Find sea floor in the large shadow of a wreck, a pile or a bank: it cannot be seen, so it was not searched.

The shadows of stones and mines are part of what a look is worth, as its tables were learnt among them; larger ones are
not.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import VALID, Tile

LARGE_M: Final = ((0.75, 6.0), (3.0, 2.5))
"""Along and across the track: longer than hardly a mine or a stone casts its shadow, or as deep as it is wide and wider
than any."""
DARK: Final = 0.1  # of the sea floor's mean
BLOCK_M: Final = 0.25  # pixels within a block are judged together
_MIN_VALID: Final = 0.5  # of a box


def in_large_shadow(tile: Tile) -> NDArray[np.bool_]:
    """Select pixels in a large shadow, (n_rows, n_columns) bool.

    Such a pixel is part of some box of one of the sizes LARGE_M within the tile, of which half is valid, and whose
    valid pixels have a mean below DARK. Boxes are made of whole blocks of BLOCK_M; what is left of a tile beside its
    last whole block is judged as that is.
    """
    block_rows, block_columns = (
        max(1, round(BLOCK_M / spacing_m)) for spacing_m in (tile.row_spacing_m, tile.column_spacing_m)
    )
    n_rows, n_columns = tile.mask.shape[0] // block_rows, tile.mask.shape[1] // block_columns
    if not n_rows or not n_columns:
        return np.zeros(tile.mask.shape, dtype=np.bool_)
    whole = slice(n_rows * block_rows), slice(n_columns * block_columns)
    valid = (tile.mask[whole] & VALID).astype(np.float32)
    echo, share = (
        np.asarray(cv2.resize(part, (n_columns, n_rows), interpolation=cv2.INTER_AREA), dtype=np.float32)
        for part in (tile.intensity[whole], valid)  # 0 where not valid
    )
    shadowed = np.zeros((n_rows, n_columns), dtype=np.uint8)
    for along_m, across_m in LARGE_M:
        size = (
            _odd(along_m / (block_rows * tile.row_spacing_m)),
            _odd(across_m / (block_columns * tile.column_spacing_m)),
        )
        dark = _dark_boxes(echo, share, size)
        if dark.any():
            shadowed |= cv2.dilate(dark, np.ones(size, dtype=np.uint8))
    found = np.zeros(tile.mask.shape, dtype=np.bool_)
    if shadowed.any():
        stop_row, stop_column = n_rows * block_rows, n_columns * block_columns
        found[whole] = cv2.resize(shadowed, (stop_column, stop_row), interpolation=cv2.INTER_NEAREST)
        found[stop_row:] = found[stop_row - 1]
        found[:, stop_column:] = found[:, stop_column - 1 : stop_column]
    return found


def _dark_boxes(echo: NDArray[np.float32], share: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Mark the middle of every dark box of an odd size (rows, columns) within the blocks with 1.

    echo: mean of a block's pixels, 0 for those that are not valid; share: of valid ones.
    """
    level, known = (
        cv2.boxFilter(part, cv2.CV_64F, size[::-1], normalize=True, borderType=cv2.BORDER_CONSTANT)
        for part in (echo, share)
    )
    dark = np.zeros(echo.shape, dtype=np.uint8)
    inside = tuple(slice(of_box // 2, max(n - of_box // 2, 0)) for n, of_box in zip(echo.shape, size, strict=True))
    dark[inside] = ((level < DARK * known) & (known >= _MIN_VALID))[inside]
    return dark


def _odd(blocks: float) -> int:
    """Round to the odd number of blocks nearest to a length."""
    return 2 * max(round((blocks - 1.0) / 2.0), 0) + 1
