"""Measure the texture of sea floor: how uneven it is at several scales, whether it has a direction, how many shadows
and how bright it is.

Variances of logarithms at several scales are the lacunarity of D. P. Williams ("Fast unsupervised seafloor
characterization in sonar imagery using lacunarity", IEEE TGRS 53, 2015), which one glint cannot upset; complexity and
anisotropy together are the axes of M. Geilhufe and O. Midtgaard (FFI, "Quantifying the complexity in sonar images for
MCM performance estimation", 2014). Ripples are a peak of the spectrum. What stands up from the floor is bright first
and dark behind, so that differences along the range are skewed; texture that lies flat is not. Each cell is measured in
windows of three sizes around it: small ones locate borders, large ones identify the kind.
"""

from __future__ import annotations

import functools
import math
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from auv_mcm.kernels.texture import CellLimits, PixelBlocks, blocks, cell_sums, differences, summed
from auv_mcm.records import Tile

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_IN_WINDOW: Final = (
    "spread",
    "skewness",
    "dark",
    "bright",
    "grain_along",
    "grain_across",
    "lag_along",
    "lag_across",
    "rise_near",
    "rise_far",
    "anisotropy",
    "orientation",
    "spread_medium",
    "dark_medium",
    "bright_medium",
    "step_medium_along",
    "step_medium_across",
    "rise_medium",
    "spread_coarse",
    "step_coarse_along",
    "step_coarse_across",
    "rise_coarse",
    "spread_wide",
    "contrast_fine",
    "likeness_fine",
)
_IN_CELL: Final = (
    "spread",
    "skewness",
    "dark",
    "bright",
    "grain_along",
    "grain_across",
    "step_medium_along",
    "step_medium_across",
)
WINDOWS: Final = {"small": 3, "large": 7}
"""Windows around a cell, in cells along each side."""
NAMES: Final = (
    *(f"{name}_cell" for name in _IN_CELL),
    *(f"{name}_{size}" for size in WINDOWS for name in _IN_WINDOW),
    "ripple_peak",
    "low_frequencies",
    "log_wavelength",
    "level_cell",
    "level_small",
    "level_large",
    "level_spread",
)
BLOCK_M: Final = 0.24  # m: averages speckle, and two of them still resolve ripples of half a metre
CELL_BLOCKS: Final = 8  # blocks along a cell's side: about two metres
WINDOW_BLOCKS: Final = 32  # of the spectrum, with two by two cells in its middle
MARGIN_CELLS: Final = 4  # around those measured: half the largest window, and one for differences

_MIN_VALID: Final = 0.5  # of the small window
_DARK: Final = 0.35  # of the local mean, for blocks
_BRIGHT: Final = 2.5  # times the local mean
_DARK_MEDIUM: Final = 0.5  # for two by two blocks, whose speckle is less
_BRIGHT_MEDIUM: Final = 1.8  # times it
_MIN_SHARE: Final = 0.003  # of dark or bright blocks, below which they do not count
_MIN_VARIANCE: Final = 0.003  # of logarithms, below which differences do not count
_FLOOR: Final = 1e-2  # of the local mean, for logarithms
_GLINT: Final = 20.0  # of the local mean, above which a pixel counts as that much
_FINE_LAG_M: Final = 0.18  # half of the shortest ripples
_FINE_LIMIT: Final = 5.0  # of what is measured inside blocks
_DIM: Final = 0.05  # of the local mean; darker blocks count as that bright in ratios
_LONGEST_RIPPLE_M: Final = 4.0  # m from crest to crest; longer ones are relief
_LONG_M: Final = 1.5  # m: structure longer than that is shared by a patch of the sea floor
_SMALLEST: Final = 1e-9  # keeps divisions of empty windows finite
_MIN_ALTITUDE_M: Final = 0.1  # m: keeps divisions finite where the bottom was not seen


class Texture(NamedTuple):
    """Hold features per cell, (n_along, n_across, len(NAMES)) float64.

    NaN where too little is valid, and everywhere without an altitude.

    ripple_rad, wavelength_m (n_along, n_across): of the spectrum's highest peak, whether or not it stands out:
    direction across the crests, 0 along the track and pi / 2 towards far range, [0, pi). cot_grazing (n_across,):
    ground range of the cells' middles over the altitude, which is the cotangent of the grazing angle. cell_m: sides of
    a cell along and across, as the tile's pixels allow.
    """

    features: Array
    ripple_rad: Array
    wavelength_m: Array
    cot_grazing: Array
    cell_m: tuple[float, float]


def measure_texture(tile: Tile) -> Texture:
    """Measure the cells of a tile's core, in windows that reach into the overlap.

    Spreads, grains, lags and steps are natural logarithms of variances, or of half mean squared differences, of
    logarithmic echoes: of blocks of 0.24 m (spread; grain over one block, lag over four), of two by two (medium), four
    by four (coarse) and eight by eight blocks (wide). rises are skewnesses of differences towards far range; dark and
    bright logarithms of the shares of such blocks. ripple_peak is the logarithm of the spectrum's highest value over
    its mean at all wavenumbers of that size; low_frequencies that of the share of wavelengths above 1.5 m. levels are
    nats above the mission's mean at the same grazing angle, 0 where that is not known.
    """
    block = max(1, round(BLOCK_M / tile.row_spacing_m)), max(1, round(BLOCK_M / tile.column_spacing_m))
    block_m = block[0] * tile.row_spacing_m, block[1] * tile.column_spacing_m
    n_along = max(1, math.ceil((tile.core_stop - tile.core_start) / (CELL_BLOCKS * block[0])))
    n_across = max(1, math.ceil(tile.mask.shape[1] / (CELL_BLOCKS * block[1])))
    planes = _blocks(tile, block, n_along, n_across)
    echo, valid = planes[:2]
    log_echo = np.log(np.maximum(echo, np.float32(_FLOOR))) * valid
    sums = _cell_sums(planes, log_echo, block_m)
    shape = n_along, n_across
    stack = np.stack(list(sums.values()))
    windows = {n: dict(zip(sums, _around(stack, n, shape), strict=True)) for n in (1, *WINDOWS.values())}
    columns = [_statistics(windows[1], _IN_CELL), *(_statistics(windows[n], _IN_WINDOW) for n in WINDOWS.values())]
    peak, low, across_crests, wavelength = (_of_cells(part, shape) for part in _spectrum(log_echo, valid, block_m))
    columns.append(np.stack([peak, low, np.log(np.clip(wavelength, BLOCK_M, 2.0 * _LONGEST_RIPPLE_M))], axis=-1))
    columns.append(_levels(tile, block, sums, shape))
    features = np.concatenate(columns, axis=-1).astype(np.float64)
    features[windows[WINDOWS["small"]]["valid"] < _MIN_VALID * (WINDOWS["small"] * CELL_BLOCKS) ** 2] = np.nan
    altitude_m = float(np.median(tile.first_return_m))
    if math.isnan(altitude_m):
        features[:] = np.nan
    cell_m = CELL_BLOCKS * block_m[0], CELL_BLOCKS * block_m[1]
    cot_grazing = (np.arange(n_across) + 0.5) * cell_m[1] / np.fmax(altitude_m, _MIN_ALTITUDE_M)
    return Texture(features, across_crests, wavelength, cot_grazing, cell_m)


def _blocks(tile: Tile, block: tuple[int, int], n_along: int, n_across: int) -> Floats:
    """Average the usable pixels of blocks, of the cells and a margin around; see `kernels.texture.blocks`."""
    margin = MARGIN_CELLS * CELL_BLOCKS
    layout = PixelBlocks(
        first=tile.core_start - margin * block[0],
        shape=(n_along * CELL_BLOCKS + 2 * margin, n_across * CELL_BLOCKS),
        size=block,
        lag=max(1, round(_FINE_LAG_M / tile.column_spacing_m)),
        margin=margin,
        most=_GLINT,
    )
    return blocks(tile.intensity, tile.mask, layout)


def _cell_sums(planes: Floats, log_echo: Floats, block_m: tuple[float, float]) -> dict[str, Floats]:
    """Sum over cells, margin included, what the statistics of any window are made of."""
    sums = cell_sums(planes, log_echo, CELL_BLOCKS, CellLimits(_DARK, _BRIGHT, _DIM, _FINE_LIMIT, *block_m))
    echo, valid = planes[:2]
    for name, n in (("medium", 2), ("coarse", 4)):
        count = summed(valid, (n, n))
        kept = (2.0 * count >= n * n).astype(np.float32)
        mean = summed(echo, (n, n)) / np.maximum(count, np.float32(1.0))
        level = np.log(np.maximum(mean, np.float32(_FLOOR))) * kept
        coarser = {f"{name}_count": kept, f"{name}_first": level, f"{name}_second": level * level}
        coarser |= differences(level, kept, 1, f"step_{name}", with_third=True)
        if name == "medium":
            coarser |= {"dark_medium": (mean < _DARK_MEDIUM) * kept, "bright_medium": (mean > _BRIGHT_MEDIUM) * kept}
        sums |= _all_summed(coarser, CELL_BLOCKS // n)
    kept = (2.0 * sums["valid"] >= CELL_BLOCKS * CELL_BLOCKS).astype(np.float32)
    level = np.log(np.maximum(sums["echo"] / np.maximum(sums["valid"], np.float32(1.0)), np.float32(_FLOOR))) * kept
    return sums | {"wide_count": kept, "wide_first": level, "wide_second": level * level}


def _all_summed(maps: dict[str, Floats], n: int) -> dict[str, Floats]:
    return {name: summed(part.astype(np.float32, copy=False), (n, n)) for name, part in maps.items()}


def _around(values: Floats, n: int, shape: tuple[int, int]) -> Floats:
    """Sum values of cells (..., n_along, n_across), margin included, over n by n cells around each cell; n is odd."""
    margin = MARGIN_CELLS - n // 2
    rows, columns = shape[0] + n - 1, shape[1] + n - 1
    inner = values[..., margin : margin + rows, margin : margin + columns]
    by_row = np.add.reduce([inner[..., k : k + shape[0], :] for k in range(n)])
    return np.asarray(np.add.reduce([by_row[..., k : k + shape[1]] for k in range(n)]))


def _statistics(sums: dict[str, Floats], names: tuple[str, ...]) -> Floats:
    """Make the named statistics of windows, (n_along, n_across, len(names))."""
    count = np.maximum(sums["valid"], np.float32(1.0))
    mean = sums["first"] / count
    variance = np.maximum(sums["second"] / count - mean * mean, np.float32(_MIN_VARIANCE))
    made = {
        "spread": np.log(variance),
        "skewness": (sums["third"] / count - 3.0 * mean * sums["second"] / count + 2.0 * mean**3) / variance**1.5,
        "dark": np.log(sums["dark"] / count + _MIN_SHARE),
        "bright": np.log(sums["bright"] / count + _MIN_SHARE),
        **{
            f"{name}_{way}": _log_half(sums, f"{name}_{way}")
            for name in ("grain", "lag")
            for way in ("along", "across")
        },
        **{
            f"step_{size}_{way}": _log_half(sums, f"step_{size}_{way}")
            for size in ("medium", "coarse")
            for way in ("along", "across")
        },
    }
    if "rise_near" in names:
        total = np.maximum(sums["tensor_along"] + sums["tensor_across"], np.float32(_SMALLEST))
        excess = sums["tensor_along"] - sums["tensor_across"]
        medium = np.maximum(sums["medium_count"], np.float32(1.0))
        made |= {
            "rise_near": _skewness(sums["near_third"], sums["near_second"], sums["near_count"]),
            "rise_far": _skewness(sums["lag_third"], sums["lag_across_second"], sums["lag_across_count"]),
            "anisotropy": np.hypot(excess, 2.0 * sums["tensor_both"]) / total,
            "orientation": excess / total,
            "dark_medium": np.log(sums["dark_medium"] / medium + _MIN_SHARE),
            "bright_medium": np.log(sums["bright_medium"] / medium + _MIN_SHARE),
            **{f"rise_{size}": _step_skewness(sums, size) for size in ("medium", "coarse")},
            "contrast_fine": sums["contrast_fine"] / count,
            "likeness_fine": sums["likeness_fine"] / count,
            **{f"spread_{size}": _log_spread(sums, size) for size in ("medium", "coarse", "wide")},
        }
    return np.stack([made[name] for name in names], axis=-1)


def _log_half(sums: dict[str, Floats], name: str) -> Floats:
    return np.log(0.5 * sums[f"{name}_second"] / np.maximum(sums[f"{name}_count"], np.float32(1.0)) + _MIN_VARIANCE)


def _skewness(third: Floats, second: Floats, count: Floats) -> Floats:
    n = np.maximum(count, np.float32(1.0))
    return np.asarray(third / n / (second / n + np.float32(_MIN_VARIANCE)) ** 1.5)


def _step_skewness(sums: dict[str, Floats], size: str) -> Floats:
    return _skewness(sums[f"step_{size}_third"], sums[f"step_{size}_across_second"], sums[f"step_{size}_across_count"])


def _log_spread(sums: dict[str, Floats], size: str) -> Floats:
    count = np.maximum(sums[f"{size}_count"], np.float32(1.0))
    mean = sums[f"{size}_first"] / count
    return np.log(np.maximum(sums[f"{size}_second"] / count - mean * mean, np.float32(0.0)) + _MIN_VARIANCE)


def _levels(tile: Tile, block: tuple[int, int], sums: dict[str, Floats], shape: tuple[int, int]) -> Floats:
    """Measure how bright cells are against the mission's mean, in the cell, in the windows, and how much that varies in
    the large one."""
    around = np.full((shape[0] + 2 * MARGIN_CELLS, shape[1] + 2 * MARGIN_CELLS), np.nan, dtype=np.float32)
    if tile.level is not None and tile.level.size:
        rows = CELL_BLOCKS * block[0]
        middle = tile.core_start + np.floor((np.arange(len(around)) - MARGIN_CELLS + 0.5) * rows).astype(np.intp)
        across_m = (np.arange(around.shape[1]) - MARGIN_CELLS + 0.5) * CELL_BLOCKS * block[1]
        column = np.floor(across_m * tile.level.shape[1] / tile.mask.shape[1]).astype(np.intp)
        in_rows, in_columns = (middle >= 0) & (middle < len(tile.level)), (column >= 0) & (column < tile.level.shape[1])
        around[np.ix_(in_rows, in_columns)] = tile.level[np.ix_(middle[in_rows], column[in_columns])]
    known = np.isfinite(around) & (sums["wide_count"] > 0.0)
    level = np.where(known, around + sums["wide_first"], np.float32(0.0))
    count = known.astype(np.float32)
    made: list[Floats] = [_around(level, 1, shape)]
    for n in WINDOWS.values():
        n_known = np.maximum(_around(count, n, shape), np.float32(1.0))
        made.append((_around(level, n, shape) / n_known).astype(np.float32))
    variance = _around(level * level, n, shape) / n_known - made[-1] ** 2
    made.append(np.sqrt(np.maximum(variance, np.float32(0.0))).astype(np.float32))
    return np.stack(made, axis=-1)


def _of_cells(values: Array, shape: tuple[int, int]) -> Array:
    """Repeat what was measured for two by two cells."""
    return np.repeat(np.repeat(values, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]]


def _spectrum(level: Floats, valid: Floats, block_m: tuple[float, float]) -> tuple[Array, Array, Array, Array]:
    """Measure peaks and long wavelengths of the spectrum per two by two cells.

    Gives the logarithm of the highest peak over its ring's mean, that of the share of long wavelengths, and the peak's
    direction and wavelength. Peaks are searched between two blocks and four metres. Arrays with their margin.
    """
    step = 2 * CELL_BLOCKS
    margin = MARGIN_CELLS * CELL_BLOCKS - (WINDOW_BLOCKS - step) // 2
    n_along, n_across = (math.ceil((n - 2 * MARGIN_CELLS * CELL_BLOCKS) / step) for n in level.shape)
    inner = tuple(slice(margin, margin + (n - 1) * step + WINDOW_BLOCKS) for n in (n_along, n_across))
    windows, holes = (
        sliding_window_view(part[inner], (WINDOW_BLOCKS, WINDOW_BLOCKS))[::step, ::step] for part in (level, valid)
    )
    mean = windows.sum(axis=(-2, -1)) / np.maximum(holes.sum(axis=(-2, -1)), np.float32(1.0))
    taper = np.hanning(WINDOW_BLOCKS + 2)[1:-1].astype(np.float32)
    level_there = (windows - mean[..., np.newaxis, np.newaxis]) * holes * (taper[:, np.newaxis] * taper)
    transformed = np.fft.rfft2(level_there)
    power = transformed.real**2 + transformed.imag**2
    along, across, ring, ripple, long = _wavenumbers(block_m)
    n_rows, n_columns = power.shape[-2:]
    flat = power.reshape(*power.shape[:2], n_rows * n_columns)
    # A row more on each side and a column of negative wavenumbers, which are those of the opposite direction, for every
    # one's neighbours.
    wide = np.empty((*power.shape[:2], n_rows + 2, n_columns + 2), dtype=power.dtype)
    wide[..., 1:-1, 1:-1] = power
    wide[..., 1:-1, 0] = power[..., -np.arange(n_rows) % n_rows, 1]
    wide[..., 1:-1, -1] = wide[..., 1:-1, -3]
    wide[..., 0, :], wide[..., -1, :] = wide[..., -2, :], wide[..., 1, :]
    beside = wide[..., :, :-2] + wide[..., :, 1:-1] + wide[..., :, 2:]
    # The taper spreads a peak over its neighbours: three by three of them are one peak.
    peaks = (beside[..., :-2, :] + beside[..., 1:-1, :] + beside[..., 2:, :]).reshape(flat.shape)
    members = (ring[:, np.newaxis] == np.arange(int(ring.max()) + 1)).astype(np.float32)
    of_ring = (peaks @ members) / members.sum(axis=0)
    above = np.where(ripple, peaks / np.maximum(of_ring[..., ring], np.float32(_SMALLEST)), np.float32(0.0))
    best = np.argmax(above * peaks, axis=-1)[..., np.newaxis]
    peak = np.take_along_axis(above, best, axis=-1)[..., 0].astype(np.float64)
    share = (flat @ long.astype(np.float32)) / np.maximum(flat.sum(axis=-1), np.float32(_SMALLEST))
    row, column = best // n_columns, best % n_columns
    moved_row = moved_column = total = np.zeros(power.shape[:2])
    at_along, at_across = np.ogrid[: power.shape[0], : power.shape[1]]
    for i in range(3):
        for j in range(3):
            near = wide[at_along, at_across, row[..., 0] + i, column[..., 0] + j].astype(np.float64)
            moved_row, moved_column, total = moved_row + (i - 1) * near, moved_column + (j - 1) * near, total + near
    total = np.maximum(total, _SMALLEST)
    at = best[..., 0]
    k_along = along[at] + moved_row / total / (WINDOW_BLOCKS * block_m[0])
    k_across = across[at] + moved_column / total / (WINDOW_BLOCKS * block_m[1])
    direction = np.mod(np.arctan2(k_across, k_along), math.pi)
    wavelength = 1.0 / np.maximum(np.hypot(k_along, k_across), _SMALLEST)
    return (
        np.log(peak + _FLOOR),
        np.log(share.astype(np.float64) + _FLOOR),
        np.where(direction >= math.pi, 0.0, direction),
        wavelength,
    )


@functools.lru_cache(maxsize=8)
def _wavenumbers(
    block_m: tuple[float, float],
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
    """Compute the wavenumbers of the half plane of the spectrum, flattened.

    Cycles per metre along and across, the ring each belongs to, which may be ripples, which are long. All
    callers share them and leave them as they are.
    """
    along = np.repeat(np.fft.fftfreq(WINDOW_BLOCKS, block_m[0]), WINDOW_BLOCKS // 2 + 1)
    across = np.tile(np.fft.rfftfreq(WINDOW_BLOCKS, block_m[1]), WINDOW_BLOCKS)
    size = np.hypot(along, across)
    ring = np.minimum(np.rint(size * WINDOW_BLOCKS * max(block_m)), WINDOW_BLOCKS // 2).astype(np.intp)
    ripple = (size >= 1.0 / _LONGEST_RIPPLE_M) & (size <= 1.0 / (2.0 * max(block_m)))
    return along, across, ring, ripple, (size > 0.0) & (size < 1.0 / _LONG_M)
