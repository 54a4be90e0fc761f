"""Objects drawn in images of a synthetic aperture: where their truth lies, and what each part of it says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.kernels.shape import Solid
from sim_replay.scoring.overlap import overlap
from sim_replay.studies.sas_objects import METHODS, draw, part_costs

COARSE_M = 0.1  # the fastest to draw


@pytest.mark.parametrize(("solid", "half_length_m"), [("sphere", 0.0), ("cylinder", 1.2)])
def test_the_shadow_of_the_truth_is_dark_and_as_long_as_the_object_is_high(solid: Solid, half_length_m: float) -> None:
    drawn = draw(solid, COARSE_M, 300.0, 3)
    region, truth = drawn.region, drawn.truth
    floor = region.intensity[truth == 0].mean()
    assert floor == pytest.approx(1.0, abs=0.2)
    assert region.intensity[truth == SHADOW].mean() < 0.3
    assert region.intensity[truth == HIGHLIGHT].mean() > 2.0
    column = np.nonzero(truth == SHADOW)[1].max() + 0.5
    end_m = region.first_ground_range_m + column * region.column_spacing_m
    top_m = end_m * (1.0 - 2.0 * drawn.sizes_m[0] / region.altitude_m)
    assert top_m == pytest.approx(drawn.ground_range_m, abs=0.5 + half_length_m)


def test_the_solid_that_is_there_is_likelier_than_one_beside_it_by_either_part() -> None:
    drawn = draw("sphere", COARSE_M, 300.0, 5)
    image = image_row_sums(drawn.region, 1.0)
    assert image is not None
    there = [drawn.along_m, drawn.ground_range_m, drawn.sizes_m[0], 0.0]
    beside = [drawn.along_m + 1.5, drawn.ground_range_m, drawn.sizes_m[0], 0.0]
    costs = part_costs("sphere", np.array([there, beside]), image)
    assert (costs[0] < costs[1] - 3.0).all()
    assert costs[:, 2] == pytest.approx(costs[:, 0] + costs[:, 1])


def test_chain_and_paper_find_most_of_the_shadow() -> None:
    drawn = draw("cylinder", 0.05, 300.0, 11)
    for method in METHODS.values():
        assert overlap(method(drawn.region) == SHADOW, drawn.truth == SHADOW) > 0.6


def test_the_same_seed_draws_the_same_object_at_another_resolution() -> None:
    one, other = (draw("wedge", resolution_m, 300.0, 7) for resolution_m in (COARSE_M, 0.05))
    assert one.sizes_m.tolist() == other.sizes_m.tolist()
    assert math.isclose(one.ground_range_m, other.ground_range_m)


def test_averaged_looks_show_the_same_object_with_less_speckle() -> None:
    one, four = (draw("sphere", COARSE_M, 300.0, 7, n_looks) for n_looks in (1, 4))
    assert np.array_equal(one.truth, four.truth)
    floor = one.truth == BACKGROUND
    # Speckle of n looks has the variance of single looks over n; relief of the floor adds the same to both.
    assert four.region.intensity[floor].var() < 0.4 * one.region.intensity[floor].var()
