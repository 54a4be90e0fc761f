"""Where places of a snippet lie in its picture: exactly on what is drawn there, on both sides and for pixels of any
shape."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.contacts.contact_picture import SOFT, TURNED, coloured_levels, in_picture, snippet_picture
from auv_mcm.records import Detection, Side
from auv_mcm.snippet import pack_snippet
from tests.auv_mcm.classify import drawn_looks


def detection(side: Side, shape: tuple[int, int], bright: tuple[int, int], row_m: float, column_m: float) -> Detection:
    """One bright pixel on a dark floor."""
    intensity = np.full(shape, 0.05)
    intensity[bright] = 30.0
    return drawn_looks.detection(
        side=side,
        snippet=pack_snippet(intensity),
        snippet_row=bright[0] + 0.5,
        snippet_column=bright[1] + 0.5,
        row_spacing_m=row_m,
        column_spacing_m=column_m,
    )


@pytest.mark.parametrize("side", ["port", "starboard"])
@pytest.mark.parametrize(("row_m", "column_m"), [(0.06, 0.06), (0.12, 0.04), (0.03, 0.09), (0.11, 0.05)])
@pytest.mark.parametrize("bright", [(2, 3), (6, 3), (3, 15), (7, 16)])
def test_a_contour_around_a_bright_pixel_is_drawn_around_it(
    side: Side, row_m: float, column_m: float, bright: tuple[int, int]
) -> None:
    view = detection(side, (10, 20), bright, row_m, column_m)
    picture = snippet_picture(view).astype(np.int64).sum(axis=2)
    row, column = bright
    contour = np.array([(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)], dtype=np.float64)
    placed = in_picture(view, contour) * picture.shape[::-1]
    (left, top), (right, bottom) = placed.min(axis=0), placed.max(axis=0)
    assert right - left == pytest.approx(picture.shape[1] / 20.0)
    assert bottom - top == pytest.approx(picture.shape[0] / 10.0)
    down, across = np.argwhere(picture > 0.7 * picture.max()).T
    # Drawn pixel (i, j) covers [i, i + 1) x [j, j + 1); smooth enlargement may spill over by one.
    assert top - 1.0 <= down.min() <= down.max() + 1 <= bottom + 1.0
    assert left - 1.0 <= across.min() <= across.max() + 1 <= right + 1.0
    assert (down + 0.5).mean() == pytest.approx(0.5 * (top + bottom), abs=0.26)
    assert (across + 0.5).mean() == pytest.approx(0.5 * (left + right), abs=0.26)


@given(st.sampled_from(["port", "starboard"]), st.integers(1, 12), st.integers(1, 12), st.data())
def test_with_square_pixels_the_middle_of_a_pixel_lies_in_the_pixel_drawn_for_it(
    side: Side, n_rows: int, n_columns: int, data: st.DataObject
) -> None:
    row, column = data.draw(st.integers(0, n_rows - 1)), data.draw(st.integers(0, n_columns - 1))
    view = detection(side, (n_rows, n_columns), (row, column), 0.1, 0.1)
    picture = snippet_picture(view).astype(np.int64).sum(axis=2)
    right, down = in_picture(view, np.array([[row + 0.5, column + 0.5]]))[0].tolist()
    assert picture[math.floor(down * n_rows), math.floor(right * n_columns)] == picture.max()
    assert (picture == picture.max()).sum() == 1


@pytest.mark.parametrize("condition", [0, SOFT, TURNED, SOFT | TURNED])
def test_brighter_echoes_are_drawn_brighter_and_turns_bluer(condition: int) -> None:
    drawn, plain = (
        coloured_levels(np.arange(1, 64, dtype=np.uint8)[np.newaxis] + np.uint8(64 * which))[0].astype(int)
        for which in (condition, condition & SOFT)
    )
    assert (np.diff(drawn.sum(axis=1)) > 0).all()
    if condition & TURNED:
        assert (drawn[:, 0] - drawn[:, 2] > plain[:, 0] - plain[:, 2]).all()


def test_a_snippet_without_pixels_has_a_place_for_everything() -> None:
    view = detection("port", (4, 4), (1, 1), 0.1, 0.1)
    empty = Detection(
        **{name: getattr(view, name) for name in view.__struct_fields__} | {"snippet": np.empty((0, 0), dtype=np.uint8)}
    )
    assert np.isfinite(in_picture(empty, np.array([[0.0, 0.0]]))).all()
