"""Estimate class means in context: expectation maximisation with the mean-field approximation of the label field.

After Celeux, Forbes and Peyrard, Pattern Recognition 36 (2003) 131-144. A mixture fitted without context moves its rare
classes into the tails of the common one; from a physical start, with neighbours weighed, they stay where they are.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.likelihoods import BackgroundLaw, background_cost, gamma_cost
from auv_mcm.confirm.mrf_priors import PairPrior
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.kernels.mean_field import softmin, sweep
from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float64]

SHADOW_START: Final = 0.15  # times the background
HIGHLIGHT_START: Final = 5.0  # times the background: where the estimate of the highlight's mean starts; 7 dB
_ROUNDS: Final = 3  # of means and labels in turn; chosen, not measured
_SWEEPS: Final = 2  # of the mean field per round; it continues from the round before
_SHADOW_RANGE: Final = (1e-3, 0.5)  # times the background; a lighter shadow is sea floor
_HIGHLIGHT_RANGE: Final = (2.0, 1e3)  # times the background: a highlight's mean stays inside of it, 3 to 30 dB
_GLINT: Final = 3.0  # times the highlight's mean
SPIKE: Final = 10.0  # times a mean: speckle is hardly ever brighter, and one pixel that is must not make a class's mean
_ABSENT_BELOW: Final = 8.0  # independent samples
# probability below which a pixel adds nothing to a class's mean: see fit_means; chosen, not measured
_OWN_SHARE: Final = 0.2
_OWN_WEIGHT: Final = 12.0  # independent samples: weight of the start


class ClassMeans(NamedTuple):
    """Hold the mean intensity of each class, and the independent samples it rests on.

    Few samples mean that the class is absent and its mean a guess.
    """

    background: float
    shadow: float
    highlight: float
    n_shadow: float
    n_highlight: float

    @property
    def has_shadow(self) -> bool:
        """Find whether enough samples are shadow."""
        return self.n_shadow >= _ABSENT_BELOW

    @property
    def has_highlight(self) -> bool:
        """Find whether enough samples are highlight."""
        return self.n_highlight >= _ABSENT_BELOW


def data_costs(intensity: Plane, information: Plane, means: ClassMeans, law: BackgroundLaw) -> Plane:
    """Compute the cost of each label of each cell, nats per independent sample, (3, n_rows, n_columns) float64.

    Cells without data cost 0.

    information: independent samples per cell over the looks of its mean. A cell's costs are cut at 50 above the
    minimum, so that one outlier does not outweigh the rest of the image.
    """
    # A glint counts as highlight, no more: under a K law it would be sea floor again, whose tail falls slower.
    intensity = np.minimum(intensity, _GLINT * means.highlight)
    cost = np.empty((3, *intensity.shape))
    cost[BACKGROUND] = background_cost(intensity, means.background, law)
    cost[SHADOW] = gamma_cost(intensity, means.shadow, law.looks)
    cost[HIGHLIGHT] = gamma_cost(intensity, means.highlight, law.looks)
    cost -= cost.min(axis=0)
    return np.asarray(np.minimum(cost * information, 50.0))


def start_means(background: float) -> ClassMeans:
    """Give the means that physics leads to expect around a sea floor of this mean."""
    return ClassMeans(background, SHADOW_START * background, HIGHLIGHT_START * background, 0.0, 0.0)


def fit_means(
    intensity: Plane,
    samples: Plane,
    information: Plane,
    start: ClassMeans,
    law: BackgroundLaw,
    weight: Plane,
    prior: PairPrior,
) -> tuple[ClassMeans, Plane]:
    """Fit means in three rounds from `start`; give them and each label's probability, (3, n_rows, n_columns).

    intensity, samples (independent ones per cell), information: (n_rows, n_columns) float64.

    A class with hardly any samples keeps its start. In C where floor has no texture and rows no squint; it and numpy
    agree to 1e-9.

    Parameters
    ----------
    weight
        (4,), the smoothness of the edges right, down-left, down, down-right.
    prior
        By which highlights and shadows support each other; counts in full from one sample per cell.
    """
    if math.isinf(law.nu) and prior.slope == 0.0:
        probability, label = np.empty((3, *intensity.shape)), np.empty(intensity.shape, dtype=np.uint8)
        room, found = np.empty(8 * intensity.size + 2 * intensity.shape[1] + 2), np.empty(5)
        rules = [law.looks, *start[:3], _GLINT, SPIKE, _OWN_SHARE, _OWN_WEIGHT, _ABSENT_BELOW]
        numbers = np.array([*rules, *_SHADOW_RANGE, *_HIGHLIGHT_RANGE])
        cells = *intensity.shape, _ROUNDS, _SWEEPS, intensity, samples, information, weight
        pairs = prior.reach, prior.attached, np.array([*prior.highlight, *prior.shadow])
        if call("field_means", *cells, *pairs, numbers, probability, label, room, found):
            return ClassMeans(*found.tolist()), probability
    return fit_means_numpy(intensity, samples, information, start, law, weight, prior)


def fit_means_numpy(
    intensity: Plane,
    samples: Plane,
    information: Plane,
    start: ClassMeans,
    law: BackgroundLaw,
    weight: Plane,
    prior: PairPrior,
) -> tuple[ClassMeans, Plane]:
    """Do as fit_means, in numpy but for the mean field."""
    counted = np.minimum(samples, 1.0)
    means = start
    data = data_costs(intensity, information, means, law)
    probability = softmin(data)
    for number_of_round in range(_ROUNDS):
        if number_of_round > 0:
            data = data_costs(intensity, information, means, law)
        cost = data + prior.costs(probability.argmax(axis=0).astype(np.uint8)) * counted
        probability = sweep(cost, weight, _SWEEPS, probability)
        share = probability * samples
        if number_of_round < _ROUNDS - 1:
            # A few hundredths of every cell of sea floor would outweigh a small shadow and draw its mean to theirs,
            # round by round.
            share[probability < _OWN_SHARE] = 0.0
        number = share.sum(axis=(1, 2))
        brightest = SPIKE * np.array([means.background, means.shadow, means.highlight])
        total = (share * np.minimum(intensity, brightest[:, None, None])).sum(axis=(1, 2))
        first = (start.background, start.shadow, start.highlight)
        level = [float((total[k] + _OWN_WEIGHT * first[k]) / (number[k] + _OWN_WEIGHT)) for k in range(3)]
        background = level[BACKGROUND]
        n_shadow, n_highlight = float(number[SHADOW]), float(number[HIGHLIGHT])
        means = ClassMeans(
            background,
            _within(level[SHADOW] if n_shadow >= _ABSENT_BELOW else start.shadow, _SHADOW_RANGE, background),
            _within(
                level[HIGHLIGHT] if n_highlight >= _ABSENT_BELOW else start.highlight, _HIGHLIGHT_RANGE, background
            ),
            n_shadow,
            n_highlight,
        )
    return means, probability


def _within(level: float, limits: tuple[float, float], background: float) -> float:
    return min(max(level, limits[0] * background), limits[1] * background)
