"""Make blocks of pixels, and sums over cells of blocks that the texture of sea floor is made of.

Sums go down the rows first and then along the few sums of a cell or block. C and numpy agree to the bit.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.records import SATURATED, VALID

Floats = NDArray[np.float32]

MAPS: Final = (
    "valid",
    "echo",
    "first",
    "second",
    "third",
    "dark",
    "bright",
    "grain_along_count",
    "grain_along_second",
    "grain_across_count",
    "grain_across_second",
    "lag_along_count",
    "lag_along_second",
    "lag_across_count",
    "lag_across_second",
    "lag_third",
    "tensor_along",
    "tensor_across",
    "tensor_both",
    "near_count",
    "near_second",
    "near_third",
    "contrast_fine",
    "likeness_fine",
)
"""What is summed over cells, in the order of texture.c."""
LAG: Final = 4
"""Blocks over which the lag's differences reach; equal in C."""
_BEFORE: Final = 1  # block before one that a difference reaches; equal in C


class PixelBlocks(NamedTuple):
    """Lay out blocks of pixels.

    first: row of the first block's first pixel, which may lie outside the picture. shape: blocks down and across, which
    cover all columns. size: rows and columns of a block. lag: columns to the pixel whose product is taken. margin:
    blocks without data added on either side. most: what pixels are bounded by.
    """

    first: int
    shape: tuple[int, int]
    size: tuple[int, int]
    lag: int
    margin: int
    most: float


class CellLimits(NamedTuple):
    """Hold what maps depend on.

    Levels below and above which a block is dark or bright, the dimmest level in ratios, the most that is measured
    inside blocks, and the sides of a block, m.
    """

    dark: float
    bright: float
    dim: float
    most: float
    along_m: float
    across_m: float


def blocks(intensity: Floats, mask: NDArray[np.uint8], layout: PixelBlocks) -> Floats:
    """Average the pixels of blocks that are VALID and not SATURATED.

    Returns (4, blocks down, blocks across + 2 margin): mean, 1 where half of the block is known and else 0, mean
    square, mean product with the pixel `lag` farther out; all 0 where not known.

    Parameters
    ----------
    intensity, mask
        (n_rows, n_columns), intensity finite.
    """
    (down, across), width = layout.shape, layout.shape[1] * layout.size[1]
    sums, echo = np.empty((4, width), dtype=np.float32), np.empty(width + layout.lag, dtype=np.float32)
    planes = np.zeros((4, down, across + 2 * layout.margin), dtype=np.float32)
    numbers = *intensity.shape, layout.first, down, across, *layout.size, layout.lag, layout.margin, layout.most
    if not call("texture_blocks", *numbers, intensity, mask, sums, echo, planes):
        return blocks_numpy(intensity, mask, layout)
    return planes


def blocks_numpy(intensity: Floats, mask: NDArray[np.uint8], layout: PixelBlocks) -> Floats:
    """Do as blocks, in numpy alone."""
    rows, columns = (n * of_block for n, of_block in zip(layout.shape, layout.size, strict=True))
    start, stop = (min(max(row, 0), mask.shape[0]) for row in (layout.first, layout.first + rows))
    source = slice(start, stop)
    place = slice(max(start - layout.first, 0), max(stop - layout.first, 0)), slice(0, mask.shape[1])
    usable, echo, product = (np.zeros((rows, columns), dtype=np.float32) for _ in range(3))
    usable[place] = (mask[source] & (VALID | SATURATED)) == VALID
    np.minimum(intensity[source], np.float32(layout.most), out=echo[place])
    echo[place] *= usable[place]
    with np.errstate(under="ignore"):  # echoes that underflow may count as zero
        np.multiply(echo[:, : -layout.lag], echo[:, layout.lag :], out=product[:, : -layout.lag])
        squared = echo * echo
    beside = (0, 0), (layout.margin, layout.margin)
    total, share, square, likeness = (
        np.pad(summed(part, layout.size) / np.float32(layout.size[0] * layout.size[1]), beside)
        for part in (echo, usable, squared, product)
    )
    known = share >= 0.5
    whole = np.maximum(share, np.float32(0.5))
    mean, square, likeness = (np.where(known, part / whole, np.float32(0.0)) for part in (total, square, likeness))
    return np.stack([mean, known.astype(np.float32), square, likeness])


def cell_sums(planes: Floats, level: Floats, cell: int, limits: CellLimits) -> dict[str, Floats]:
    """Sum MAPS over cells of `cell` by `cell` blocks, which divide the planes: (cells down, cells across) each.

    Parameters
    ----------
    planes
        (4, n_down, n_across) of `blocks`.
    level
        (n_down, n_across), logarithm of the mean, 0 where it is not known.
    """
    n_down, n_across = level.shape
    room = np.zeros((8, _BEFORE + n_across + LAG), dtype=np.float32)
    sums = np.empty((len(MAPS), n_across), dtype=np.float32)
    found = np.empty((len(MAPS), n_down // cell, n_across // cell), dtype=np.float32)
    settings = np.array(limits, dtype=np.float32)
    if not call("texture_cells", n_down, n_across, cell, planes, level, settings, room, sums, found):
        return cell_sums_numpy(planes, level, cell, limits)
    return dict(zip(MAPS, found, strict=True))


def cell_sums_numpy(planes: Floats, level: Floats, cell: int, limits: CellLimits) -> dict[str, Floats]:
    """Do as cell_sums, in numpy alone."""
    echo, known, square, likeness = planes
    squared = level * level
    mean = np.maximum(echo, np.float32(limits.dim)) ** 2
    near, near_count = difference(level, known, 2, 1)
    maps = {
        "valid": known,
        "echo": echo,
        "first": level,
        "second": squared,
        "third": squared * level,
        "dark": (echo < np.float32(limits.dark)) * known,
        "bright": (echo > np.float32(limits.bright)) * known,
        **differences(level, known, 1, "grain", with_third=False),
        **differences(level, known, LAG, "lag", with_third=True),
        **_tensor(level, known, limits),
        "near_count": near_count,
        "near_second": near * near,
        "near_third": near * near * near,
        "contrast_fine": np.clip(square / mean - 1.0, -1.0, limits.most) * known,
        "likeness_fine": np.clip(likeness / mean - 1.0, -1.0, limits.most) * known,
    }
    return {name: summed(maps[name], (cell, cell)) for name in MAPS}


def summed(values: Floats, block: tuple[int, int]) -> Floats:
    """Sum over blocks of both axes, whose lengths they divide."""
    for axis, n in enumerate(block):  # a few long sums, where sums along so short an axis would be slow
        parts = [values[k::n] if axis == 0 else values[:, k::n] for k in range(n)]
        values = parts[0].copy()
        for part in parts[1:]:
            values += part
    return values


def difference(values: Floats, known: Floats, lag: int, axis: int) -> tuple[Floats, Floats]:
    """Subtract what lies `lag` before along an axis, 0 where one of the two is not known; and 1 where both are."""
    here, there = [slice(None), slice(None)], [slice(None), slice(None)]
    here[axis], there[axis] = slice(None, -lag), slice(lag, None)
    both, step = np.zeros_like(values), np.zeros_like(values)
    both[tuple(here)] = known[tuple(here)] * known[tuple(there)]
    step[tuple(here)] = (values[tuple(there)] - values[tuple(here)]) * both[tuple(here)]
    return step, both


def differences(values: Floats, known: Floats, lag: int, name: str, *, with_third: bool) -> dict[str, Floats]:
    """Make maps of squared differences along both axes and of their counts; of cubes across the track."""
    maps: dict[str, Floats] = {}
    for axis, direction in enumerate(("along", "across")):
        step, both = difference(values, known, lag, axis)
        squared = step * step
        maps |= {f"{name}_{direction}_count": both, f"{name}_{direction}_second": squared}
        if with_third and axis == 1:
            maps[f"{name}_third"] = squared * step
    return maps


def _tensor(level: Floats, known: Floats, limits: CellLimits) -> dict[str, Floats]:
    """Multiply differences over two blocks: the structure tensor (J. Bigun and G. Granlund, 1987)."""
    along, across = np.zeros_like(level), np.zeros_like(level)
    along[1:-1] = (level[2:] - level[:-2]) * known[2:] * known[:-2] / np.float32(limits.along_m)
    across[:, 1:-1] = (level[:, 2:] - level[:, :-2]) * known[:, 2:] * known[:, :-2] / np.float32(limits.across_m)
    return {"tensor_along": along * along, "tensor_across": across * across, "tensor_both": along * across}
