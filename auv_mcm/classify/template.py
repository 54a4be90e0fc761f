"""Normalised match of a highlight-and-shadow template with the logarithm of an image, kept for comparison with the likelihood.

After V. Myers and J. Fawcett, "A template matching procedure for automatic target recognition in synthetic aperture sonar imagery", IEEE
Signal Process. Lett. 17, 2010. The template T is 1 in the highlight, -1 in the shadow and 0 elsewhere; with l = ln I less its mean over
the rest of the image the score is

    S = sum T l / sqrt(A_c psi'(L) sum T^2)

psi'(L) being the variance of the logarithm of speckle of L looks and A_c its correlation area, so that S has unit variance over a floor
without an object. Logarithms keep a glint from outvoting a shadow, and row sums make it as fast as the likelihood.
"""

from __future__ import annotations

import math

import numpy as np

from auv_mcm.classify.likelihood import counted_pixels, cumulative, row_sums
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import Array, Solid, intervals, up_to

_DARKEST = 1e-6  # of the median: what an echo of 0 counts as


def template_scores(solid: Solid, hypotheses: Array, region: Region, correlation_area: float, *, looks: float = 1.0) -> Array:
    """Scores (n,) float64 of hypotheses (n, 8) as for shape_costs, which must keep clear of the track; 0 for those that cover nothing.

    For broadside views: a squinted one must be sheared first. Raises ValueError as row_sums does.
    """
    image = row_sums(region, correlation_area, looks=looks)
    if image is None:
        return np.zeros(len(hypotheses))
    counted = counted_pixels(region)
    level = float(np.median(region.intensity[counted & (region.intensity > 0.0)]))
    echoes = np.maximum(np.where(counted, region.intensity, level), np.finfo(np.float64).smallest_subnormal)
    logarithms = np.maximum(np.log(echoes) - math.log(level), math.log(_DARKEST))
    sums = cumulative(np.where(counted, logarithms, 0.0))
    n_all, of_all = float(image.counts[:, -1].sum()), float(sums[:, -1].sum())
    variance = correlation_area * _trigamma(looks)
    scores = np.zeros(len(hypotheses))
    for k, hypothesis in enumerate(hypotheses):
        ends = intervals(solid, hypothesis[np.newaxis], image)[0, :, 0]
        n_highlight, n_shadow = np.diff(up_to(image.counts, ends), axis=1).sum(axis=0)
        highlight, shadow = np.diff(up_to(sums, ends), axis=1).sum(axis=0)
        n_object = n_highlight + n_shadow
        if n_object > 0.0:
            floor = (of_all - highlight - shadow) / max(n_all - n_object, 1.0)
            scores[k] = (highlight - shadow - floor * (n_highlight - n_shadow)) / np.sqrt(variance * n_object)
    return scores


def _trigamma(x: float) -> float:
    """Second derivative of ln Gamma: recurrence up to 6, then its asymptotic series (Abramowitz and Stegun, 6.4.6, 6.4.12)."""
    total = 0.0
    while x < 6.0:
        total += 1.0 / (x * x)
        x += 1.0
    y = 1.0 / (x * x)
    return total + 1.0 / x + 0.5 * y + y / x * (1.0 / 6.0 - y * (1.0 / 30.0 - y * (1.0 / 42.0 - y / 30.0)))
