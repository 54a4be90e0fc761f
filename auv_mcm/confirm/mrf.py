"""Label every pixel of a region as highlight, shadow or sea floor, at the minimum cost of a Markov random field.

1. Speckle's grain is measured and blocks of about one grain are averaged, so that cells are independent as the
   likelihood has them.
2. Class means come from mean-field expectation maximisation in context; the sea floor's law (Gamma or K) from
   log-cumulants.
3. TRW-S minimises the cost with priors for highlight followed by shadow, and bounds how far from the minimum its labels
   can be.
4. Borders move, pixel by pixel, to where the point-spread function, known from the grain, puts them.

Costs are in nats per independent sample: a field on larger blocks is the same field with fewer labels to choose.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.likelihoods import BackgroundLaw, choose_background_law
from auv_mcm.confirm.mean_field import SPIKE, ClassMeans, data_costs, fit_means, start_means
from auv_mcm.confirm.mrf_priors import pair_prior, without_odd_clusters
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region, require_sound
from auv_mcm.confirm.speckle import Correlation, block_means, looks_of_blocks, measure_correlation, nyquist_factors
from auv_mcm.kernels.order import median
from auv_mcm.kernels.soft_edges import point_spread, smeared, soft_edges
from auv_mcm.kernels.trws import trws

Plane = NDArray[np.float64]
Labels = NDArray[np.uint8]
Flag = Literal["too_little_data", "no_speckle", "no_shadow", "no_highlight"]

DEFAULT_SWEEPS: Final = 5  # of TRW-S, unless the bound shows earlier that the labels are nearly best (_CLOSE_ENOUGH)

_MIN_USABLE: Final = 0.25  # share of a region that has to be measured for a sea-floor level; chosen, not measured
_MIN_CELLS: Final = 64  # pixels that a level and its spread need, about 12 % of error for single looks
_FLATTEST: Final = 1e-4  # variance of the logarithm; 10 000 looks
_RANGE: Final = (1e-6, 1e6)  # of intensity over the sea floor's
_BACKGROUND_LIKE: Final = (0.35, 3.0)  # local mean over the region's
_LOCAL_MEAN_PIXELS: Final = 9  # pixels along and across, averaged to leave speckle out
_PRIOR_ROUNDS: Final = 2  # of class means and labels while the prior is built; chosen, not measured
_CLOSE_ENOUGH: Final = 0.1  # nats from the minimum energy
_AROUND_CELLS: Final = 5  # pixels along and across: the neighbourhood that has to be background
_MOSTLY: Final = 0.7  # mean probability of background around a pixel, from which it counts as background
_EDGE_SWEEPS: Final = 8  # of the soft edges between labels; chosen, not measured
_CORE: Final = 0.9  # share of a pixel's own label under the point spread
_MIN_CORE: Final = 12.0  # independent samples
_SMALLEST_SHADOW_M: Final = (0.4, 0.8)  # along and across track
_DESIGN_CONTRAST: Final = 10.0**-0.9  # -9 dB
_MARGIN: Final = 0.75  # of the smoothness at which the smallest shadow would vanish; chosen, not measured
_SMOOTHEST: Final = 1.0  # nats, maximum; chosen, not measured
_ROUGHEST: Final = 0.5  # minimum smoothness, nats: below it speckle casts shadows of its own


class Segmentation(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the labels of a region, and how far they can be trusted.

    labels: (n_rows, n_columns) uint8 of BACKGROUND, SHADOW, HIGHLIGHT; where nothing was measured, what the neighbours
    suggest. energy, lower_bound: nats, of the field on blocks of `factors` (rows, columns) pixels that TRW-S solved in
    n_sweeps sweeps. law: of the sea floor on blocks. Class means are of pixels well inside
    their labels, in the region's units. flags: what the region lacks; with `too_little_data`
    or `no_speckle` no segmentation was made, every pixel is background and all numbers are 0 or 1.
    """

    labels: Labels
    energy: float
    lower_bound: float
    n_sweeps: int
    factors: tuple[int, int]
    correlation: Correlation
    law: BackgroundLaw
    background_mean: float
    shadow_mean: float
    highlight_mean: float
    smoothness: float
    flags: tuple[Flag, ...]

    @property
    def gap(self) -> float:
        """Bound how much lower the energy of another labelling can be, nats."""
        return max(0.0, self.energy - self.lower_bound)


def segment(region: Region, *, n_sweeps: int = DEFAULT_SWEEPS, smoothness: float | None = None) -> Segmentation:
    """Label a region.

    Pixels that are not valid, not finite or negative count as not measured.

    Parameters
    ----------
    n_sweeps
        Maximum of TRW-S, 1 or more, in each of two rounds of the priors.
    smoothness
        Cost of an edge between unlike blocks of one speckle grain, nats; without it what the shadow of the smallest
        mine survives.

    Raises
    ------
    ValueError
        As require_sound does, or if n_sweeps is not positive.
    """
    require_sound(region)
    usable = region.valid & np.isfinite(region.intensity) & (region.intensity >= 0.0)
    unit = _sea_floor_level(region.intensity, usable)
    if unit is None:
        return _nothing_done(region, "too_little_data")
    # The quotient of a spike and a faint sea floor has no number: cut first.
    intensity = np.clip(np.minimum(np.where(usable, region.intensity, unit), _RANGE[1] * unit) / unit, *_RANGE)
    if float(np.log(intensity[usable]).var()) < _FLATTEST:
        return _nothing_done(region, "no_speckle")

    correlation = measure_correlation(intensity, usable & _background_like(intensity, usable))
    factors = nyquist_factors(correlation, region.row_spacing_m, region.column_spacing_m)
    blocks, coverage = block_means(intensity, usable, factors)
    per_block = factors[0] * factors[1] / (correlation.rows * correlation.columns)
    samples = coverage * per_block
    nominal_looks = looks_of_blocks(correlation, factors)
    information = samples / nominal_looks
    if smoothness is None:
        smoothness = _design_smoothness(region, factors, correlation)
    weight = edge_weights(smoothness, factors, correlation)

    prior = pair_prior(region, factors, blocks.shape[1])
    first_law = BackgroundLaw(nominal_looks, math.inf)
    means, probability = fit_means(blocks, samples, information, start_means(1.0), first_law, weight, prior)
    law = _law(blocks, samples * _mostly_background(probability), nominal_looks)
    if law != first_law:
        means, probability = fit_means(blocks, samples, information, start_means(means.background), law, weight, prior)

    unary = data_costs(blocks, information, means, law)
    labels = probability.argmax(axis=0).astype(np.uint8)
    minimum = None
    for _ in range(_PRIOR_ROUNDS):
        start = None if minimum is None else minimum.messages
        minimum = trws(
            np.moveaxis(unary + prior.costs(labels) * np.minimum(samples, 1.0), 0, 2),
            weight,
            n_sweeps,
            tolerance=_CLOSE_ENOUGH,
            messages=start,
        )
        labels = minimum.labels
    assert minimum is not None
    labels = without_odd_clusters(labels, region.row_spacing_m * factors[0], region.column_spacing_m * factors[1])
    labels = labels.repeat(factors[0], axis=0).repeat(factors[1], axis=1)[: usable.shape[0], : usable.shape[1]]
    level = _core_means(labels, intensity, usable, means, correlation)
    labels = soft_edges(
        np.minimum(intensity, SPIKE * level.max()),
        usable,
        _with_grown_shadow(labels, correlation),
        level=level,
        spread_rows=point_spread(correlation.spread_rows),
        spread_columns=point_spread(correlation.spread_columns),
        weight=edge_weights(smoothness, (1, 1), correlation),
        information=1.0 / (correlation.rows * correlation.columns),
        n_sweeps=_EDGE_SWEEPS,
    )
    flags: list[Flag] = []
    if not (labels == SHADOW).any():
        flags.append("no_shadow")
    if not (labels == HIGHLIGHT).any():
        flags.append("no_highlight")
    return Segmentation(
        labels=labels,
        energy=minimum.energy,
        lower_bound=minimum.lower_bound,
        n_sweeps=len(minimum.trace),
        factors=factors,
        correlation=correlation,
        law=law,
        background_mean=float(level[BACKGROUND]) * unit,
        shadow_mean=float(level[SHADOW]) * unit,
        highlight_mean=float(level[HIGHLIGHT]) * unit,
        smoothness=smoothness,
        flags=tuple(flags),
    )


def edge_weights(smoothness: float, factors: tuple[int, int], correlation: Correlation) -> Plane:
    """Compute the cost of unlike neighbours right, down-left, down, down-right, (4,) float64.

    For blocks of `factors` pixels.

    A border costs `smoothness` per grain it passes whatever the blocks; diagonals by 1/sqrt(2) (Boykov and Kolmogorov
    2003).
    """
    high, wide = factors[0] / correlation.rows, factors[1] / correlation.columns
    diagonal = math.sqrt(0.5 * high * wide)
    return smoothness * np.array([high, diagonal, wide, diagonal])


def _sea_floor_level(intensity: Plane, usable: NDArray[np.bool_]) -> float | None:
    """Estimate the level of the sea floor.

    Median of single-look speckle over ln 2; the mean where more than half is zero; None where no pixel can be used.
    """
    number = int(usable.sum())
    if number < max(_MIN_CELLS, _MIN_USABLE * usable.size) or min(usable.shape) < 3:
        return None
    values = intensity[usable]
    level = median(values) / math.log(2.0)
    if level <= 0.0:
        peak = float(values.max())
        level = peak * float((values / peak).mean()) if peak > 0.0 else 0.0
    return level if 0.0 < level < math.inf else None


def _background_like(intensity: Plane, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    box = np.full(_LOCAL_MEAN_PIXELS, 1.0 / _LOCAL_MEAN_PIXELS)
    number = smeared(usable.astype(np.float64), box, box)
    local = smeared(np.where(usable, np.minimum(intensity, 10.0), 0.0), box, box) / np.maximum(number, 1e-9)
    return np.asarray((local > _BACKGROUND_LIKE[0]) & (local < _BACKGROUND_LIKE[1]))


def _design_smoothness(region: Region, factors: tuple[int, int], correlation: Correlation) -> float:
    """Compute the design smoothness.

    Three quarters of the smoothness at which the shadow of the smallest mine, at -9 dB, costs as much as its border,
    within 0.5 to 1.
    """
    n_rows = max(1.0, _SMALLEST_SHADOW_M[0] / (region.row_spacing_m * factors[0]))
    n_columns = max(1.0, _SMALLEST_SHADOW_M[1] / (region.column_spacing_m * factors[1]))
    high, diagonal, wide, _ = edge_weights(1.0, factors, correlation)
    per_sample = _DESIGN_CONTRAST - 1.0 - math.log(_DESIGN_CONTRAST)
    gain = n_rows * n_columns * factors[0] * factors[1] / (correlation.rows * correlation.columns) * per_sample
    border = 2.0 * (n_rows * high + n_columns * wide) + 4.0 * (n_rows + n_columns - 1.0) * diagonal
    return float(min(max(_MARGIN * gain / border, _ROUGHEST), _SMOOTHEST))


def _law(blocks: Plane, samples: Plane, nominal_looks: float) -> BackgroundLaw:
    number = float(samples.sum())
    if number < _MIN_CELLS:
        return BackgroundLaw(nominal_looks, math.inf)
    log_intensity = np.log(blocks)
    mean = float((samples * log_intensity).sum()) / number
    return choose_background_law(float((samples * (log_intensity - mean) ** 2).sum()) / number, nominal_looks, number)


def _mostly_background(probability: Plane) -> NDArray[np.bool_]:
    """Select cells among background.

    One cell's own label does not count: leaving out the brightest and darkest would bias the law.
    """
    box = np.full(_AROUND_CELLS, 1.0 / _AROUND_CELLS)
    return np.asarray(smeared(probability[BACKGROUND], box, box) > _MOSTLY)


def _with_grown_shadow(labels: Labels, correlation: Correlation) -> Labels:
    """Grow shadow by a pixel where edges are soft.

    Blocks put its border inside the true one, and from there speckle stops it early.
    """
    box = [
        np.ones(3) if spread > 0.0 else np.ones(1) for spread in (correlation.spread_rows, correlation.spread_columns)
    ]
    grown = smeared((labels == SHADOW).astype(np.float64), *box) > 0.0
    return np.where(grown & (labels == BACKGROUND), np.uint8(SHADOW), labels)


def _core_means(
    labels: Labels, intensity: Plane, usable: NDArray[np.bool_], means: ClassMeans, correlation: Correlation
) -> Plane:
    """Average each label over pixels with hardly any of another label, (3,) float64.

    Where they are few, over blocks, which mixes labels.
    """
    spread = point_spread(correlation.spread_rows), point_spread(correlation.spread_columns)
    min_samples = _MIN_CORE * correlation.rows * correlation.columns
    level = np.array([means.background, means.shadow, means.highlight])
    for label in (BACKGROUND, SHADOW, HIGHLIGHT):
        core = usable & (smeared((labels == label).astype(np.float64), *spread) > _CORE)
        if core.sum() >= min_samples:
            level[label] = np.minimum(intensity[core], SPIKE * level[label]).mean()
    return np.asarray(np.clip(level, level[BACKGROUND] * 1e-3, level[BACKGROUND] * 1e3))


def _nothing_done(region: Region, flag: Flag) -> Segmentation:
    return Segmentation(
        labels=np.full(region.intensity.shape, BACKGROUND, dtype=np.uint8),
        energy=0.0,
        lower_bound=0.0,
        n_sweeps=0,
        factors=(1, 1),
        correlation=Correlation(1.0, 1.0),
        law=BackgroundLaw(1.0, math.inf),
        background_mean=0.0,
        shadow_mean=0.0,
        highlight_mean=0.0,
        smoothness=0.0,
        flags=(flag,),
    )
