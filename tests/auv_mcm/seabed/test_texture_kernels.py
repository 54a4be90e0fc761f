"""The kernels of textures: small ones against definitions block by block, and C against numpy to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.kernels import texture as kernel
from auv_mcm.kernels.texture import CellLimits, PixelBlocks
from auv_mcm.records import VALID

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")

seeds = st.integers(0, 2**32 - 1)
LIMITS = CellLimits(0.35, 2.5, 0.05, 5.0, 0.24, 0.25)


def drawn(seed: int, shape: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Speckle with glints and holes, and masks."""
    random = np.random.Generator(np.random.PCG64(seed))
    intensity = random.exponential(size=shape).astype(np.float32)
    intensity[random.random(shape) < 0.05] *= np.float32(100.0)
    return intensity, np.where(random.random(shape) < 0.2, random.integers(0, 16, shape), VALID).astype(np.uint8)


def layout_of(shape: tuple[int, int], first: int, size: tuple[int, int], lag: int) -> PixelBlocks:
    """Blocks over a picture of that shape, one more than it holds on either axis."""
    return PixelBlocks(first, (shape[0] // size[0] + 1, shape[1] // size[1] + 1), size, lag, margin=3, most=20.0)


pictures = st.tuples(st.integers(1, 20), st.integers(1, 70))
sizes = st.tuples(st.integers(1, 3), st.integers(1, 5))


@given(seed=seeds, shape=pictures, first=st.integers(-30, 30), size=sizes, lag=st.integers(1, 4))
@settings(deadline=None, max_examples=25)
def test_blocks_are_means_of_their_usable_pixels(
    seed: int, shape: tuple[int, int], first: int, size: tuple[int, int], lag: int
) -> None:
    intensity, mask = drawn(seed, shape)
    layout = layout_of(shape, first, size, lag)
    found = kernel.blocks(intensity, mask, layout)

    def pixel(row: int, column: int) -> float | None:
        inside = 0 <= row < shape[0] and 0 <= column < shape[1]
        return min(float(intensity[row, column]), 20.0) if inside and mask[row, column] & 3 == 1 else None

    assert not found[:, :, :3].any()
    assert not found[:, :, -3:].any()
    for down, across in np.ndindex(layout.shape):
        at = [(first + down * size[0] + i, across * size[1] + j) for i in range(size[0]) for j in range(size[1])]
        values = [value for place in at if (value := pixel(*place)) is not None]
        products = [(pixel(row, column) or 0.0) * (pixel(row, column + lag) or 0.0) for row, column in at]
        expected = [0.0] * 4
        if 2 * len(values) >= len(at):
            n = len(values)
            expected = [sum(values) / n, 1.0, sum(value**2 for value in values) / n, sum(products) / n]
        np.testing.assert_allclose(found[:, down, across + 3], expected, rtol=1e-5)


@needs_c
@given(seed=seeds, shape=pictures, first=st.integers(-30, 30), size=sizes, lag=st.integers(1, 4))
@settings(deadline=None)
def test_c_makes_the_blocks_that_numpy_makes(
    seed: int, shape: tuple[int, int], first: int, size: tuple[int, int], lag: int
) -> None:
    picture, layout = drawn(seed, shape), layout_of(shape, first, size, lag)
    np.testing.assert_array_equal(kernel.blocks(*picture, layout), kernel.blocks_numpy(*picture, layout), strict=True)


@needs_c
@given(seed=seeds, cells=st.tuples(st.integers(1, 3), st.integers(1, 5)), cell=st.sampled_from([5, 8]))
@settings(deadline=None)
def test_c_sums_over_cells_as_numpy_does(seed: int, cells: tuple[int, int], cell: int) -> None:
    shape = cells[0] * cell, cells[1] * cell
    planes = kernel.blocks(*drawn(seed, shape), PixelBlocks(0, shape, (1, 1), 1, margin=0, most=20.0))
    level = np.log(np.maximum(planes[0], np.float32(0.01))) * planes[1]
    one, other = (of(planes, level, cell, LIMITS) for of in (kernel.cell_sums, kernel.cell_sums_numpy))
    assert list(one) == list(other) == list(kernel.MAPS)
    for name, sums in one.items():
        np.testing.assert_array_equal(sums, other[name], err_msg=name, strict=True)
