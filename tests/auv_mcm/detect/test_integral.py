"""Box sums against sums taken box by box."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.detect.integral import PaddedIntegral


def brute_force(
    plane: NDArray[Any], rows: tuple[int, int], columns: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> NDArray[np.float64]:
    """Sum over the part of each pixel's box that lies in the plane; columns: start and stop offset per pixel."""
    n_rows, n_columns = plane.shape
    total = np.zeros(plane.shape)
    for i in range(n_rows):
        for j in range(n_columns):
            for row in range(max(i + rows[0], 0), min(i + rows[1], n_rows)):
                for column in range(max(j + int(columns[0][i, j]), 0), min(j + int(columns[1][i, j]), n_columns)):
                    total[i, j] += float(plane[row, column])
    return total


PAD_ROWS, PAD_COLUMNS = 3, 9
planes = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 5), st.integers(1, 7)), elements=st.integers(0, 1000).map(float)
) | hnp.arrays(np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 7)))
row_ends = st.tuples(st.integers(-PAD_ROWS, PAD_ROWS), st.integers(-PAD_ROWS, PAD_ROWS)).map(
    lambda ends: (min(ends), max(ends))
)
column_ends = st.tuples(st.integers(-PAD_COLUMNS, PAD_COLUMNS), st.integers(-PAD_COLUMNS, PAD_COLUMNS)).map(
    lambda ends: (min(ends), max(ends))
)


@given(plane=planes, rows=row_ends, columns=column_ends)
def test_box_sums_are_clipped_at_the_edges(
    plane: NDArray[Any], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    """Whole numbers, so that the order of summation does not matter."""
    integral = PaddedIntegral(plane, PAD_ROWS, PAD_COLUMNS)
    every = np.ones(plane.shape, dtype=np.intp)
    expected = brute_force(plane, rows, (columns[0] * every, columns[1] * every))
    np.testing.assert_array_equal(integral.box(*rows, *columns), expected)


@given(plane=planes, rows=row_ends, start=st.integers(-PAD_COLUMNS, PAD_COLUMNS), data=st.data())
def test_boxes_of_varying_length_are_clipped_at_the_edges(
    plane: NDArray[Any], rows: tuple[int, int], start: int, data: st.DataObject
) -> None:
    lengths = data.draw(hnp.arrays(np.intp, plane.shape, elements=st.integers(0, PAD_COLUMNS - start)))
    integral = PaddedIntegral(plane, PAD_ROWS, PAD_COLUMNS)
    expected = brute_force(plane, rows, (np.full(plane.shape, start), start + lengths))
    np.testing.assert_array_equal(integral.box_varying(*rows, start, lengths), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint8])
def test_planes_of_any_layout_are_taken(dtype: type) -> None:
    whole: NDArray[Any] = np.arange(200).reshape(10, 20).astype(dtype)
    for plane in (whole[::2, ::3], np.asfortranarray(whole), whole[:, 5:9], whole.T):
        np.testing.assert_array_equal(PaddedIntegral(plane, 1, 1).box(0, 1, 0, 1), plane)
        assert PaddedIntegral(plane, 1, 1).box(0, 1, 0, 1).dtype == np.float64


def test_sums_of_whole_tiles_do_not_overflow() -> None:
    plane = np.full((600, 700), 255, dtype=np.uint8)
    integral = PaddedIntegral(plane, 600, 700)
    assert (integral.box(-600, 600, -700, 700) == 255.0 * plane.size).all()
