"""Boxes in bands of equal shadow: which band a pixel is in, and which pixels a box holds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.detect.cascade.bands import (
    N_BANDS,
    SHADOW_LIMITS_M,
    WINDOW,
    WINDOW_FAR_M,
    WINDOW_SHADOWS,
    FeatureBox,
    areas,
    band_edges,
    band_shadows_m,
    bands_at,
    box_fault,
    margins_px,
    pixel_boxes,
    shadow_edges_m,
)

spacings = st.floats(0.02, 0.6)


@given(first_return_m=st.floats(0.0, 60.0), column_m=spacings, height_m=st.floats(0.1, 1.0))
def test_every_pixel_is_in_the_band_of_its_shadow(first_return_m: float, column_m: float, height_m: float) -> None:
    n_columns = 400
    edges = band_edges(np.array([first_return_m]), n_columns, column_m, height_m)
    assert edges[0, 0] == 0
    assert edges[0, -1] == n_columns
    assert (np.diff(edges[0]) >= 0).all()
    columns = np.arange(n_columns)
    shadow_m = height_m * (columns + 0.5) * column_m / max(first_return_m - height_m, 0.3)
    band = bands_at(edges, np.zeros(n_columns, dtype=np.intp), columns)
    limits = shadow_edges_m()
    assert (shadow_m[band > 0] >= limits[band[band > 0]] * (1 - 1e-9)).all()
    assert (shadow_m[band < N_BANDS - 1] <= limits[band[band < N_BANDS - 1] + 1] * (1 + 1e-9)).all()


def test_bands_without_a_bottom_are_those_of_the_lowest_sonar() -> None:
    edges = band_edges(np.array([np.nan, 0.0, -5.0, np.inf]), 300, 0.05)
    np.testing.assert_array_equal(edges[0], edges[1])
    np.testing.assert_array_equal(edges[0], edges[2])
    assert (edges[3, 1:] == 300).all()


def test_bands_have_one_ratio_between_the_limits() -> None:
    shadows = band_shadows_m()
    np.testing.assert_allclose(shadows[1:] / shadows[:-1], (SHADOW_LIMITS_M[1] / SHADOW_LIMITS_M[0]) ** (1 / N_BANDS))
    assert SHADOW_LIMITS_M[0] < shadows[0]
    assert shadows[-1] < SHADOW_LIMITS_M[1]


@pytest.mark.parametrize(
    ("box", "pixels"),
    [
        (FeatureBox(-0.5, 0.5, -0.25, 0.0, 0.25, 0.0), (-5, 6, -2, 3)),  # halves lie symmetrically about the pixel
        (FeatureBox(-0.36, 0.36, 0.1, 0.0, 0.3, 0.0), (-3, 4, 2, 4)),
        (FeatureBox(0.0, 0.02, 0.0, 0.0, 0.001, 0.0), (1, 2, 1, 2)),  # never empty
        (FeatureBox(-1.0, -0.98, -0.98, 0.0, -0.97, 0.0), (-10, -9, -9, -8)),
    ],
)
def test_edges_fall_on_the_nearest_edge_between_pixels(box: FeatureBox, pixels: tuple[int, int, int, int]) -> None:
    assert pixel_boxes([box], 0.1, 0.1)[:, 0].tolist() == [list(pixels)] * N_BANDS


def test_parts_in_shadows_grow_with_the_band() -> None:
    box = pixel_boxes([FeatureBox(-0.1, 0.1, 0.2, 0.5, 0.2, 1.0)], 0.1, 0.001)[:, 0]
    np.testing.assert_allclose(box[:, 2], 200 + 500 * band_shadows_m(), atol=1.01)
    np.testing.assert_allclose(box[:, 3], 200 + 1000 * band_shadows_m(), atol=1.01)


@given(row_m=spacings, column_m=spacings)
def test_no_box_reaches_beyond_the_margins(row_m: float, column_m: float) -> None:
    widest = FeatureBox(-1.0, 1.0, -1.0, 0.0, WINDOW_FAR_M, WINDOW_SHADOWS)
    tiny = [FeatureBox(0.999, 1.0, 0.999, 1.2, 1.0, 1.2), FeatureBox(-1.0, -0.999, -1.0, 0.0, -0.999, 0.0)]
    assert all(box_fault(box) is None for box in (widest, WINDOW, *tiny))
    boxes = pixel_boxes([widest, WINDOW, *tiny], row_m, column_m)
    rows, near, far = margins_px(row_m, column_m)
    assert boxes[..., 0].min() >= -rows
    assert boxes[..., 1].max() <= rows - 1, "a row to spare, into which kernels may read on"
    assert boxes[..., 2].min() >= -near
    assert boxes[..., 3].max() <= far
    assert (areas(boxes) >= 1).all()
