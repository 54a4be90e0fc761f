"""Model the recorder's effect on mean echoes: correlated speckle, noise, and the mixing of new echoes with recorded
ones.

A recorded sample is the interference of what the floor and a target send back and of noise. The floor's part is kept as
recorded and takes a random phase, so that what is mixed fades as one field does, and a sample to which nothing is added
comes back as it was. Noise follows the distribution that was measured where the sonar heard nothing else: in real
shadows and in the water column.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter, uniform_filter1d
from scipy.special import polygamma

from auv_mcm.records import Side, Transfer
from sim_replay.augment.background_log import Stretch, window_intensity
from sim_replay.augment.shadows import shadow_runs
from sim_replay.simulator.speckle import WHITE, Float32s, band_limited_rows, gaussian_taps

_BLOCK_PINGS: Final = 64  # pings measured together
_MAX_BLOCKS: Final = 24  # of a line; bounds time
_BOX_M: Final = 0.4  # m of range averaged to find shadows
_LEVEL_M: Final = 4.0  # m of range that the level is averaged over
_BIN_M: Final = 4.0  # m: range bins of the noise
_MIN_SHADOW_SAMPLES: Final = 100  # of a bin, for its noise
_WHOLE_SHADOW: Final = 0.15  # quantile
_SURE_SHARE: Final = 0.25  # quantile over range
_DARKEST_OF_SPECKLE: Final = 0.65  # of the mean: one box in twenty of speckle alone
_WATER_SHARE: Final = 0.85  # of the first return: nearer there is water only
_MIN_SPAN: Final = 0.5  # of ln r in the water column, from which a gain can be estimated
_STEEPEST_GAIN: Final = 4.0  # 40 log r
_MIN_GAIN: Final = 1.5  # a gain that makes up for spreading
_LOG_WINDOW: Final = 64  # samples whose logarithms give the looks
_FAR_LAGS: Final = (9, 13)  # correlation left there is texture, not speckle
_N_QUANTILES: Final = 513  # of the distribution of samples
_MIN_QUANTILE_SAMPLES: Final = 2000  # for that distribution
_MAX_LOOKS: Final = 16  # looks that a recorder may have averaged, maximum
_MAX_WIDTH: Final = 12.0  # samples: of correlated speckle, maximum

Floats: TypeAlias = NDArray[np.float64]


class SampleScatter(NamedTuple):
    """Describe how one side's samples scatter around their means.

    range_taps, ping_taps: point-spread function along range and from ping to ping, sums of squares 1. looks: averaged
    per sample. noise: (n_samples,) float64 mean intensity of noise, near to far. noise_quantiles: (n,) float64, its
    distribution at even probabilities from 0 to 1, mean 1. floor: (n_samples,) float64 typical intensity of the floor.
    """

    range_taps: Float32s
    ping_taps: Float32s
    looks: int
    noise: Floats
    noise_quantiles: Floats
    floor: Floats


def measure_line(
    stretch: Stretch, side: Side, transfer: Transfer, blank_m: float, absorption_per_m: float
) -> SampleScatter:
    """Measure the statistics of one side of a stretch, from up to 24 blocks of 64 pings spread over it.

    absorption_per_m: two-way, nepers of power, that a recorder whose gain makes up for spreading makes up for as well;
    0 if not known.
    """
    trace = next(trace for k in range(stretch.n_pings) if (trace := stretch.trace(k, side)) is not None)
    spacing_m = trace.spacing_m
    range_m = np.asarray(trace.first_range_m + spacing_m * np.arange(trace.samples.shape[0]), dtype=np.float64)
    n_blocks = max(1, min(_MAX_BLOCKS, stretch.n_pings // _BLOCK_PINGS))
    starts = np.linspace(0, max(stretch.n_pings - _BLOCK_PINGS, 0), n_blocks).astype(int).tolist()
    blocks = []
    for start in starts:
        pings = slice(start, min(start + _BLOCK_PINGS, stretch.n_pings))
        intensity, valid = window_intensity(stretch, pings, side, transfer)
        way_m = float(stretch.along_m[pings.stop - 1] - stretch.along_m[start]) / max(pings.stop - start - 1, 1)
        blocks.append(
            _Block(np.where(valid, intensity, 0.0).astype(np.float64), stretch.first_return_m[pings], max(way_m, 1e-3))
        )
    sea_floor = [block.intensity[:, _floor_from(block, range_m) :] for block in blocks]
    level = _floor_level(blocks, range_m, spacing_m)
    noise, quantiles = _noise(blocks, range_m, spacing_m, level, blank_m, absorption_per_m)
    return SampleScatter(
        range_taps=gaussian_taps(_speckle_width(sea_floor, axis=1)),
        ping_taps=gaussian_taps(_speckle_width(sea_floor, axis=0)),
        looks=_looks(sea_floor),
        noise=noise,
        noise_quantiles=quantiles,
        floor=level,
    )


class _Block(NamedTuple):
    intensity: Floats
    first_return_m: Floats
    ping_spacing_m: float


def _floor_from(block: _Block, range_m: Floats) -> int:
    """Return the first column that lies on the sea floor in every ping."""
    return min(int(np.searchsorted(range_m, 1.2 * float(block.first_return_m.max()))), len(range_m) - 1)


def _boxes(intensity: Floats, spacing_m: float) -> Floats:
    return np.asarray(uniform_filter(intensity, (3, max(3, round(_BOX_M / spacing_m))), mode="nearest"))


def _floor_level(blocks: Sequence[_Block], range_m: Floats, spacing_m: float) -> Floats:
    """Estimate the typical intensity over range: the median over all pings of small boxes, smoothed; before the floor
    begins, its first value.
    """
    per_block = []
    for block in blocks:
        typical = np.median(_boxes(block.intensity, spacing_m), axis=0)
        first = _floor_from(block, range_m)
        typical[:first] = np.nan
        per_block.append(typical)
    stack = np.array(per_block)
    known = np.flatnonzero(np.isfinite(stack).any(axis=0))
    if known.size == 0:
        return np.asarray(np.maximum(np.mean([block.intensity.mean(axis=0) for block in blocks], axis=0), 1e-30))
    level = np.interp(np.arange(len(range_m)), known, np.nanmedian(stack[:, known], axis=0))
    return np.asarray(np.maximum(uniform_filter1d(level, max(3, round(_LEVEL_M / spacing_m)), mode="nearest"), 1e-30))


def _noise(
    blocks: Sequence[_Block], range_m: Floats, spacing_m: float, level: Floats, blank_m: float, absorption_per_m: float
) -> tuple[Floats, Floats]:
    """Return the mean intensity of noise over range and the quantiles of its unit distribution.

    What is heard in a shadow is the recorder's noise, which the water column shows, and a share of the floor's level:
    side lobes, other paths. The share is measured in real shadows and 0 where the log has none.
    """
    water, water_samples = _water_column(blocks, range_m, blank_m, absorption_per_m)
    water = np.minimum(water, _darkest(blocks, range_m, spacing_m))
    which = (range_m / _BIN_M).astype(np.int64)
    n_bins = int(which[-1]) + 1
    found: list[tuple[Floats, Floats, NDArray[np.int64]]] = []
    for block in blocks:
        first = _floor_from(block, range_m)
        image = block.intensity[:, first:]
        runs = shadow_runs(image, None, block.ping_spacing_m, spacing_m)
        inside = runs.mask(image.shape, trim=max(1, round(0.5 * _BOX_M / spacing_m)))
        bins = np.broadcast_to(which[first:], image.shape)[inside]
        found.append((image[inside], _boxes(image, spacing_m)[inside], bins))
    samples, boxes, bins = (np.concatenate(parts) for parts in zip(*found, strict=True))
    enough = np.flatnonzero(np.bincount(bins, minlength=n_bins) >= _MIN_SHADOW_SAMPLES)
    if not enough.size:
        return np.clip(water, 1e-6 * level, 0.9 * level), _quantiles(water_samples)
    # Edges of shadows, and dark floor taken for one, are brighter than whole shadow: what is darkest is believed.
    heard = np.array([np.quantile(boxes[bins == one], _WHOLE_SHADOW) for one in enough])
    centre = np.minimum(np.searchsorted(which, enough) + int(0.5 * _BIN_M / spacing_m), level.size - 1)
    share = float(np.quantile(np.maximum(heard - water[centre], 0.0) / level[centre], _SURE_SHARE))
    noise = np.clip(water + share * level, 1e-6 * level, 0.9 * level)
    means = noise[centre]
    chosen = [samples[(bins == one) & (boxes < 2.0 * mean)] for one, mean in zip(enough, means, strict=True)]
    return noise, _quantiles([some / max(float(some.mean()), 1e-30) for some in chosen if some.size], water_samples)


def _darkest(blocks: Sequence[_Block], range_m: Floats, spacing_m: float) -> Floats:
    """Return the mean intensity that noise cannot exceed: near that of the darkest boxes on the floor, over range."""
    stacked = []
    for block in blocks:
        boxes = _boxes(block.intensity, spacing_m)
        boxes[:, : _floor_from(block, range_m)] = np.nan
        stacked.append(boxes)
    joined = np.concatenate(stacked)[:: len(stacked)]
    known = np.flatnonzero(np.isfinite(joined).any(axis=0))
    if not known.size:
        return np.full(range_m.size, np.inf)
    return np.interp(
        np.arange(range_m.size), known, np.nanquantile(joined[:, known], 0.05, axis=0) / _DARKEST_OF_SPECKLE
    )


def _water_column(
    blocks: Sequence[_Block], range_m: Floats, blank_m: float, absorption_per_m: float
) -> tuple[Floats, list[Floats]]:
    """Estimate the noise that the water column shows, ln N = a + b ln r + c r as a recorder's gain makes of it, and its
    samples over their mean.

    A water column of a few metres does not determine c: it is the absorption where b is that of a gain that makes up
    for spreading.
    """
    places: list[float] = []
    levels: list[float] = []
    samples: list[Floats] = []
    for block in blocks:
        last_m = _WATER_SHARE * float(block.first_return_m.min())
        columns = np.flatnonzero(
            (range_m > max(blank_m, 0.5 * last_m)) & (range_m < last_m)
        )  # nearer, ring-down dies away
        if columns.size < 8:
            continue
        heard = block.intensity[:, columns]
        samples.append((heard / np.maximum(heard.mean(axis=0), 1e-30)).ravel())
        for part in np.array_split(np.arange(columns.size), max(1, round((last_m - blank_m) / 0.5))):
            places.append(float(range_m[columns[part]].mean()))
            levels.append(math.log(max(float(heard[:, part].mean()), 1e-30)))
    if not places:
        return np.zeros(range_m.size), samples
    at_m = np.maximum(range_m, min(places))
    for made_up_per_m in (absorption_per_m, 0.0):
        level, slope = _gain_law(np.array(places), np.array(levels), made_up_per_m)
        if slope > _MIN_GAIN:
            break
    return np.asarray(np.exp(level + slope * np.log(at_m) + made_up_per_m * at_m)), samples


def _gain_law(range_m: Floats, log_level: Floats, absorption_per_m: float) -> tuple[float, float]:
    """Fit a and b of ln N = a + b ln r + absorption r; b is 0 where the ranges are too narrow to determine it."""
    log_range, rest = np.log(range_m), log_level - absorption_per_m * range_m
    slope = 0.0
    if log_range.max() - log_range.min() > _MIN_SPAN:
        centred = log_range - log_range.mean()
        slope = float(np.clip(centred @ rest / (centred @ centred), 0.0, _STEEPEST_GAIN))
    return float(rest.mean() - slope * log_range.mean()), slope


def _quantiles(*sources: Sequence[Floats]) -> Floats:
    """Return quantiles of the first source with enough non-zero samples; an exponential law if there is none."""
    probability = np.linspace(0.0, 1.0, _N_QUANTILES)
    for samples in sources:
        joined = np.concatenate(samples) if samples else np.empty(0)
        if joined.size >= _MIN_QUANTILE_SAMPLES and joined.any():
            quantiles = np.quantile(joined, probability)
            return np.asarray(quantiles / float(np.trapezoid(quantiles, probability)))
    quantiles = -np.log1p(-np.minimum(probability, 1.0 - 0.25 / _N_QUANTILES))
    return np.asarray(quantiles / float(np.trapezoid(quantiles, probability)))


def _speckle_width(sea_floor: Sequence[Floats], axis: int) -> float:
    """Fit the width of a Gaussian point-spread function to the recorded speckle's correlation between neighbours."""
    covariance = np.zeros(_FAR_LAGS[1] + 1)
    for intensity in sea_floor:
        n = intensity.shape[axis]
        if n <= 2 * _FAR_LAGS[1]:
            continue
        x = intensity / np.maximum(uniform_filter1d(intensity, 4 * _FAR_LAGS[1] + 1, axis=axis, mode="nearest"), 1e-30)
        x = np.minimum(np.moveaxis(x, axis, 0), 6.0)
        x -= x.mean()
        covariance += [float((x[: n - lag] * x[lag:]).mean()) for lag in range(_FAR_LAGS[1] + 1)]
    left = covariance[_FAR_LAGS[0] :].mean()
    if covariance[0] - left <= 0.0:
        return 0.0
    correlation = (covariance[1] - left) / (covariance[0] - left)
    if correlation < 0.03:
        return 0.0
    return min(_MAX_WIDTH, math.sqrt(math.log(4.0) / -math.log(min(correlation, 0.99))))


def _looks(sea_floor: Sequence[Floats]) -> int:
    """Estimate the looks whose ln I varies as the recorded one does within short windows: var ln I = psi'(L).

    The windows' trend is taken off.
    """
    ramp = np.arange(_LOG_WINDOW) - 0.5 * (_LOG_WINDOW - 1)
    variances = []
    for intensity in sea_floor:
        n = intensity.shape[1] // _LOG_WINDOW
        windows = intensity[:, : n * _LOG_WINDOW].reshape(-1, _LOG_WINDOW)
        windows = np.log(windows[(windows > 0.0).all(axis=1)])
        residual = windows - windows.mean(axis=1, keepdims=True)
        residual -= ramp * (residual @ ramp / (ramp @ ramp))[:, None]
        variances.append((residual**2).sum(axis=1) / (_LOG_WINDOW - 2))
    joined = np.concatenate(variances) if variances else np.empty(0)
    if joined.size == 0:
        return 1
    expected = polygamma(1, np.arange(1, _MAX_LOOKS + 1))
    return int(np.argmin(np.abs(np.log(expected / max(float(np.median(joined)), 1e-6))))) + 1


class Change(NamedTuple):
    """Hold a target's effect on the mean echoes of a window, (n_pings, n_samples) float64 each.

    kept: factor on the floor's recorded echo, exactly 1 where nothing changes. added: mean intensity that the target
    sends back, exactly 0 outside of it, before the point-spread function.
    """

    kept: Floats
    added: Floats


def spread_over_taps(energy: Floats, taps: Float32s) -> Floats:
    """Spread mean intensities along range (axis 1) by the point-spread function, whose power is the squared taps."""
    if taps.size == 1:
        return energy
    power = taps.astype(np.float64) ** 2
    half = taps.size // 2
    padded = np.pad(energy, ((0, 0), (half, half)), mode="edge")
    total = np.zeros_like(energy)
    for k, weight in enumerate(power):
        total += weight * padded[:, k : k + energy.shape[1]]
    return total


def mixed(
    recorded: Floats, change: Change, line: SampleScatter, noise: Floats, seed: int, stream: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the intensity with the change made, and a mask of the change; elsewhere the recorded value is restored.

    Parameters
    ----------
    recorded
        (n_pings, n_samples) linear intensity.
    noise
        (n_samples,) of these samples. seed and stream (below 2^56) choose the speckle.
    """
    changed = (change.kept != 1.0) | (spread_over_taps(change.added, line.range_taps) > 0.0)
    n_pings, n_samples = recorded.shape

    def field(kind: int, energy: Floats | None = None) -> NDArray[np.complex128]:
        taps, half = line.range_taps, line.range_taps.size // 2
        white = band_limited_rows(seed, (stream << 8) + kind, 0, n_pings, n_samples + 2 * half, line.ping_taps, WHITE)
        if energy is not None:
            white = white * np.sqrt(np.pad(energy, ((0, 0), (half, half)), mode="edge"))
        total = np.zeros((n_pings, n_samples), dtype=np.complex128)
        for k, weight in enumerate(taps.astype(np.float64)):
            total += weight * white[:, k : k + n_samples]
        return total

    lost = np.maximum(1.0 - change.kept, 0.0)
    phase, hiss = field(0), field(1)
    hiss_power = np.abs(hiss) ** 2
    of_one = np.interp(-np.expm1(-hiss_power), np.linspace(0.0, 1.0, line.noise_quantiles.size), line.noise_quantiles)
    hiss *= np.sqrt(lost * noise * of_one / np.maximum(hiss_power, 1e-30))
    rest = np.sqrt(recorded * change.kept) * np.exp(1j * np.angle(phase)) + hiss
    intensity = np.abs(rest) ** 2
    bright = change.added.any(axis=1)
    if bright.any():
        total = np.zeros_like(intensity)
        for look in range(line.looks):
            echo = field(2 + 2 * look, change.added)
            turn = np.exp(1j * np.angle(field(3 + 2 * look))) if line.looks > 1 else 1.0
            total += np.abs(rest * turn + echo) ** 2
        intensity = total / line.looks
    return np.where(changed, intensity, recorded), changed
