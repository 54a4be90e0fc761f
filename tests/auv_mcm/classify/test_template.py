"""Template scores against sums over pixels, and their variance over a floor without an object."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import polygamma

from auv_mcm.classify.likelihood import row_sums
from auv_mcm.classify.shapes import Sphere
from auv_mcm.classify.template import template_scores
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import intervals
from sim_replay.benches.shapes import closed_form_region

TRUTH = np.array([[3.66, 20.0, 1.0, 0.4, 0.0, 0.0, 0.0, 0.0]])


def region_of(seed: int, *, looks: int = 1, flat: bool = False) -> Region:
    region = closed_form_region(Sphere(radius_m=0.4), 20.0)
    speckle = np.random.Generator(np.random.PCG64(seed)).gamma(looks, 1.0 / looks, region.intensity.shape)
    return msgspec.structs.replace(region, intensity=speckle if flat else region.intensity * speckle)


def test_score_is_the_sum_over_pixels() -> None:
    region = region_of(1)
    image = row_sums(region, 1.0)
    assert image is not None
    ends = intervals("sphere", TRUTH, image)[0, :, 0]
    columns = np.arange(region.intensity.shape[1])

    def share(near: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
        overlap = np.minimum(columns + 1.0, far[:, np.newaxis]) - np.maximum(columns, near[:, np.newaxis])
        return np.asarray(np.maximum(overlap, 0.0))

    highlight, shadow = share(ends[:, 0], ends[:, 1]), share(ends[:, 1], ends[:, 2])
    logarithm, rest = np.log(region.intensity), 1.0 - highlight - shadow
    floor = (rest * logarithm).sum() / rest.sum()
    score = ((highlight - shadow) * (logarithm - floor)).sum() / math.sqrt(math.pi**2 / 6.0 * (highlight + shadow).sum())
    assert template_scores("sphere", TRUTH, region, 1.0)[0] == pytest.approx(score, rel=1e-9)


@pytest.mark.parametrize("looks", [1, 4])
def test_scores_over_a_bare_floor_have_unit_variance(looks: int) -> None:
    scores = [template_scores("sphere", TRUTH, region_of(seed, looks=looks, flat=True), 1.0, looks=looks)[0] for seed in range(200)]
    assert np.mean(scores) == pytest.approx(0.0, abs=0.3)
    assert np.std(scores) == pytest.approx(1.0, abs=0.2)


def test_the_true_solid_scores_highest() -> None:
    hypotheses = np.repeat(TRUTH, 4, axis=0)
    hypotheses[1, 0] += 0.5
    hypotheses[2, 1] += 0.6
    hypotheses[3, 3] = 0.6
    scores = template_scores("sphere", hypotheses, region_of(3), 1.0)
    assert scores.argmax() == 0
    assert scores[0] > 10.0


def test_gain_and_masked_pixels_change_no_score_and_correlation_lowers_it() -> None:
    region = region_of(4)
    (score,) = template_scores("sphere", TRUTH, region, 1.0)
    (louder,) = template_scores("sphere", TRUTH, msgspec.structs.replace(region, intensity=1e6 * region.intensity), 1.0)
    assert louder == pytest.approx(score, rel=1e-9)
    (correlated,) = template_scores("sphere", TRUTH, region, 4.0)
    assert correlated == pytest.approx(0.5 * score, rel=0.1)  # smeared highlights are a little longer
    valid = region.valid.copy()
    valid[::3] = False
    masked = [
        template_scores(
            "sphere", TRUTH, msgspec.structs.replace(region, valid=valid, intensity=np.where(valid, region.intensity, fill)), 1.0
        )
        for fill in (0.0, math.nan, 1e9)
    ]
    assert masked[0] == masked[1] == masked[2]


def test_what_covers_nothing_scores_nothing() -> None:
    away = TRUTH.copy()
    away[0, 0] = 50.0
    region = region_of(5)
    assert template_scores("sphere", away, region, 1.0)[0] == 0.0
    empty = msgspec.structs.replace(region, valid=np.zeros_like(region.valid))
    assert template_scores("sphere", TRUTH, empty, 1.0)[0] == 0.0


def test_variance_of_logarithms_is_the_trigamma_function() -> None:
    """By the ratio of scores of one region for two numbers of looks."""
    region = region_of(6)
    one, several = (template_scores("sphere", TRUTH, region, 1.0, looks=looks)[0] for looks in (1.0, 7.5))
    assert (several / one) ** 2 == pytest.approx(polygamma(1, 1.0) / polygamma(1, 7.5), rel=1e-9)
