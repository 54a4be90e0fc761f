"""Contour distances against a search over all pairs of contour pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.solids.shapes import Cylinder
from sim_replay.studies.hausdorff import contour_distance_m, shadow_mask
from tests.auv_mcm.classify.closed_forms import closed_form_region

Mask = NDArray[np.bool_]
ROW_M, COLUMN_M = 0.12, 0.06


def contour(mask: Mask) -> list[tuple[float, float]]:
    """Places of pixels of the mask beside one that is not, metres."""
    places = []
    for row, column in zip(*np.nonzero(mask), strict=True):
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            r, c = row + down, column + right
            if not (0 <= r < mask.shape[0] and 0 <= c < mask.shape[1]) or not mask[r, c]:
                places.append((row * ROW_M, column * COLUMN_M))
                break
    return places


def patches(seed: int) -> tuple[Mask, Mask]:
    random = np.random.Generator(np.random.PCG64(seed))
    masks = []
    for _ in range(2):
        mask = np.zeros((14, 18), dtype=np.bool_)
        top, left = random.integers(0, 8, 2)
        mask[top : top + random.integers(1, 7), left : left + random.integers(1, 10)] = True
        masks.append(mask ^ ((random.uniform(size=mask.shape) < 0.03) & ~mask))
    return masks[0], masks[1]


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_distances_are_those_of_all_pairs(seed: int) -> None:
    first, second = patches(seed)
    gaps = [
        [min(math.dist(a, b) for b in contour(other)) for a in contour(one)]
        for one, other in ((first, second), (second, first))
    ]
    for quantile in (0.95, 1.0):
        distance_m = contour_distance_m(first, second, ROW_M, COLUMN_M, quantile=quantile)
        assert distance_m == pytest.approx(max(np.quantile(gap, quantile) for gap in gaps))


def test_a_shadow_is_at_no_distance_from_itself_and_at_any_from_none() -> None:
    mask, _ = patches(1)
    nothing = np.zeros_like(mask)
    assert contour_distance_m(mask, mask, ROW_M, COLUMN_M, quantile=0.95) == 0.0
    assert contour_distance_m(nothing, nothing, ROW_M, COLUMN_M, quantile=0.95) == 0.0
    assert contour_distance_m(mask, nothing, ROW_M, COLUMN_M, quantile=0.95) == math.inf


def test_one_grain_moves_the_hausdorff_distance_but_not_the_partial_one() -> None:
    mask = np.zeros((40, 60), dtype=np.bool_)
    mask[10:20, 10:40] = True
    grain = mask.copy()
    grain[38, 55] = True
    assert contour_distance_m(grain, mask, ROW_M, COLUMN_M, quantile=1.0) > 2.0
    assert contour_distance_m(grain, mask, ROW_M, COLUMN_M, quantile=0.95) == 0.0


def test_the_shadow_of_the_true_solid_is_nearer_than_that_of_a_turned_one() -> None:
    region = closed_form_region(Cylinder(radius_m=0.265, length_m=2.0, azimuth_rad=0.4), 20.0)
    image = image_row_sums(region, 1.0)
    assert image is not None
    observed = region.intensity < 0.3
    hypotheses = np.tile([3.66, 20.0, 1.0, 0.265, 2.0, 0.4, 0.0, 0.0], (2, 1))
    hypotheses[1, 5] = -0.4
    right, turned = (
        contour_distance_m(observed, shadow_mask("cylinder", one, image), 0.12, 0.06, quantile=0.95)
        for one in hypotheses
    )
    assert right <= 0.13
    assert turned > 3.0 * right


def test_masks_that_do_not_fit_are_refused() -> None:
    mask, _ = patches(1)
    with pytest.raises(ValueError, match="one shape"):
        contour_distance_m(mask, mask[1:], ROW_M, COLUMN_M, quantile=0.95)
    with pytest.raises(ValueError, match="quantile"):
        contour_distance_m(mask, mask, ROW_M, COLUMN_M, quantile=1.5)
    with pytest.raises(ValueError, match="spacings"):
        contour_distance_m(mask, mask, 0.0, COLUMN_M, quantile=0.95)
