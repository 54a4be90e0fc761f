"""Segment as Petillot et al. do, "Target recognition in synthetic aperture and high resolution side-scan sonar".

Amplitudes of single pixels, taken for independent; Gaussian shadow, shifted Rayleigh sea floor; Markov parameter from
the image; iterated conditional modes; highlight followed by shadow, highlight in small clusters. The paper leaves open
the law of the highlight (here uniform up to the brightest pixel), the start (here clusters of amplitude averaged over 5
x 5 pixels, which is kind to it) and the weights of the priors (here those of auv_mcm.confirm.mrf_priors).
"""

from __future__ import annotations

import math
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.markov_estimate import MarkovEstimate, estimate_smoothness
from auv_mcm.confirm.mrf import edge_weights
from auv_mcm.confirm.mrf_priors import pair_prior, without_odd_clusters
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region, require_sound
from auv_mcm.confirm.speckle import Correlation
from auv_mcm.kernels.soft_edges import smeared
from auv_mcm.kernels.trws import icm

Plane = NDArray[np.float64]
Labels = NDArray[np.uint8]

_ROUNDS: Final = 4  # after which labels of drawn regions stay (chosen)
_ICM_SWEEPS: Final = 8  # more than it takes to settle (chosen)
_CLUSTER_ROUNDS: Final = 10  # after which centres stay (chosen)
_WINDOW_PIXELS: Final = 5  # a side, of the average that clusters start from (chosen)
_MIN_PIXELS: Final = 20  # of a class, to take its law's parameters from (chosen)
_MIN_PROBABILITY: Final = 1e-6  # over the range of amplitudes; a shifted Rayleigh law forbids all below its shift
_PRIOR_SMOOTHNESS: Final = 1.0  # where the image gives none: that of the chain's own field
_SMALLEST_SPREAD: Final = 1e-3  # times the range of amplitudes
_SINGLE_PIXELS: Final = Correlation(1.0, 1.0)


class PaperSegmentation(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the labels and the Markov parameter.

    labels: (n_rows, n_columns) uint8 of BACKGROUND, SHADOW, HIGHLIGHT, all background where amplitudes do not differ.
    """

    labels: Labels
    markov: MarkovEstimate


def segment_as_paper(region: Region) -> PaperSegmentation:
    """Label a region by the paper's method.

    Pixels that are not valid, not finite or negative have no data term.

    Raises ValueError as require_sound does.
    """
    require_sound(region)
    usable = region.valid & np.isfinite(region.intensity) & (region.intensity >= 0.0)
    labels = np.full(usable.shape, BACKGROUND, dtype=np.uint8)
    markov = MarkovEstimate(_PRIOR_SMOOTHNESS, math.inf, "prior")
    brightest = float(region.intensity[usable].max(initial=0.0))
    if brightest == 0.0 or region.intensity[usable].min() == brightest:
        return PaperSegmentation(labels=labels, markov=markov)
    amplitude = np.sqrt(np.where(usable, region.intensity, 0.0) / brightest)
    window = np.full(_WINDOW_PIXELS, 1.0 / _WINDOW_PIXELS)
    number = np.maximum(smeared(usable.astype(np.float64), window, window), 1e-9)
    labels[usable] = _clusters((smeared(amplitude, window, window) / number)[usable])
    prior = pair_prior(region, (1, 1), region.intensity.shape[1])
    for _ in range(_ROUNDS):
        markov = estimate_smoothness(labels, _PRIOR_SMOOTHNESS)
        cost = np.where(usable, _data_costs(amplitude, labels, usable), 0.0) + prior.costs(labels)
        labels, _ = icm(
            np.moveaxis(cost, 0, 2), edge_weights(markov.smoothness, (1, 1), _SINGLE_PIXELS), labels, _ICM_SWEEPS
        )
    labels = without_odd_clusters(labels, region.row_spacing_m, region.column_spacing_m)
    return PaperSegmentation(labels=labels, markov=markov)


def _data_costs(amplitude: Plane, labels: Labels, usable: NDArray[np.bool_]) -> Plane:
    """Return minus the logarithms of the three densities, with parameters from the labels; amplitudes run from 0 to
    1."""
    cost = np.zeros((3, *amplitude.shape))  # the highlight's is uniform: 0
    shadow = amplitude[usable & (labels == SHADOW)]
    if len(shadow) < _MIN_PIXELS:
        shadow = np.sort(amplitude[usable])[:_MIN_PIXELS]
    spread = max(float(shadow.std()), _SMALLEST_SPREAD)
    cost[SHADOW] = 0.5 * ((amplitude - shadow.mean()) / spread) ** 2 + math.log(spread * math.sqrt(2.0 * math.pi))
    background = amplitude[usable & (labels == BACKGROUND)]
    if len(background) < _MIN_PIXELS:
        background = amplitude[usable]
    shift = float(background.min()) - _SMALLEST_SPREAD
    scale = max(float(background.std()) / math.sqrt(2.0 - 0.5 * math.pi), _SMALLEST_SPREAD)
    above = np.maximum(amplitude - shift, np.finfo(np.float64).tiny)
    cost[BACKGROUND] = 0.5 * (above / scale) ** 2 - np.log(above) + 2.0 * math.log(scale)
    return np.minimum(cost, -math.log(_MIN_PROBABILITY))


def _clusters(amplitude: Plane) -> Labels:
    """Find three clusters of amplitude (Lloyd's iteration), started where shadow, sea floor and highlight are
    likely."""
    median = float(np.median(amplitude))
    centre = median * np.array([0.4, 1.0, 2.2])
    for _ in range(_CLUSTER_ROUNDS):
        cluster = np.searchsorted(0.5 * (centre[1:] + centre[:-1]), amplitude)
        number = np.bincount(cluster, minlength=3)
        total = np.bincount(cluster, weights=amplitude, minlength=3)
        centre = np.where(number > 0, total / np.maximum(number, 1), centre)
    return np.array([SHADOW, BACKGROUND, HIGHLIGHT], dtype=np.uint8)[cluster]
