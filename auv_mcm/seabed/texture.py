"""Measures of texture in windows of sea floor: how uneven it is at several scales, whether it has a direction, and how many shadows.

Lacunarity, the spread of box means at a scale, is what D. P. Williams ("Fast unsupervised seafloor characterization in sonar imagery using
lacunarity", IEEE TGRS 53, 2015) tells sea floors by; complexity and anisotropy together are the axes of M. Geilhufe and O. Midtgaard
(FFI, "Quantifying the complexity in sonar images for MCM performance estimation", 2014). Ripples are a peak of the spectrum.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from auv_mcm.records import SATURATED, VALID, Tile

Array = NDArray[np.float64]

NAMES: Final = (
    "lacunarity_fine",
    "lacunarity_medium",
    "lacunarity_coarse",
    "ripple_peak",
    "low_frequencies",
    "anisotropy",
    "dark",
    "bright",
    "skewness",
    "grain_along",
    "grain_across",
)
BLOCK_M: Final = 0.24
CELL_BLOCKS: Final = 16
WINDOW_BLOCKS: Final = 2 * CELL_BLOCKS  # with the cell in its middle

_LEAST_VALID: Final = 0.6  # of a window
_PIECE: Final = 8  # blocks; sums are kept in such pieces, of which a window has four by four
_DARK: Final = 0.35  # of the local mean
_BRIGHT: Final = 2.5
_LEAST_SHARE: Final = 0.003  # of dark or bright blocks, below which they do not count
_FLOOR: Final = 1e-2  # of the local mean, for logarithms
_LONGEST_RIPPLE_M: Final = 4.0
_LONG_M: Final = 1.5
_SMALLEST: Final = 1e-9
_LEAST_ALTITUDE_M: Final = 0.1


class Texture(NamedTuple):
    """Per cell: features (n_along, n_across, len(NAMES)) float64, NaN where too little is valid, and everywhere without an altitude.

    ripple_rad, wavelength_m (n_along, n_across): of the spectrum's highest peak, whether or not it stands out: direction across the
    crests, 0 along the track and pi / 2 towards far range, [0, pi). cot_grazing (n_across,): ground range of the cells' middles over the
    altitude, which is the cotangent of the grazing angle. cell_m: sides of a cell along and across, as the tile's pixels allow.
    """

    features: Array
    ripple_rad: Array
    wavelength_m: Array
    cot_grazing: Array
    cell_m: tuple[float, float]


def measure_texture(tile: Tile) -> Texture:
    """Textures of the cells of a tile's core, whose windows reach into the overlap; its local mean is 1.

    Lacunarities are natural logarithms of the variance over the squared mean of box means of 0.24, 0.48 and 0.96 m; ripple_peak of the
    spectrum's highest value over its mean at all wavenumbers of that size; low_frequencies of the share of wavelengths above 1.5 m; dark
    and bright of the shares of boxes; grains of the squared difference of neighbouring boxes over the squared mean, which tell the speckle
    that all else stands on.
    """
    block = max(1, round(BLOCK_M / tile.row_spacing_m)), max(1, round(BLOCK_M / tile.column_spacing_m))
    block_m = block[0] * tile.row_spacing_m, block[1] * tile.column_spacing_m
    n_along = max(1, math.ceil((tile.core_stop - tile.core_start) / (CELL_BLOCKS * block[0])))
    n_across = max(1, math.ceil(tile.mask.shape[1] / (CELL_BLOCKS * block[1])))
    wide_echo, wide_valid = _blocks(tile, block, n_along, n_across)
    wide_level = np.log(np.maximum(wide_echo, _FLOOR)) * wide_valid
    inner = slice(_PIECE, -_PIECE), slice(_PIECE, -_PIECE)  # what lies around serves differences alone
    echo, valid, level = wide_echo[inner], wide_valid[inner], wide_level[inner]
    n_valid = _in_windows(valid)
    count = np.maximum(n_valid, 1.0)
    mean = _in_windows(level) / count
    squared = level * level
    second, third = _in_windows(squared) / count, _in_windows(squared * level) / count
    variance = np.maximum(second - mean * mean, _SMALLEST)
    peak, low, across_crests, wavelength = _spectrum(level, valid, mean, block_m)
    features = np.stack(
        [
            *(_lacunarity(echo, valid, n) for n in (1, 2, 4)),
            peak,
            low,
            _anisotropy(wide_level, wide_valid, block_m),
            np.log(_in_windows((echo < _DARK) * valid) / count + _LEAST_SHARE),
            np.log(_in_windows((echo > _BRIGHT) * valid) / count + _LEAST_SHARE),
            (third - 3.0 * mean * second + 2.0 * mean**3) / variance**1.5,
            *_grain(echo, valid),
        ],
        axis=-1,
    )
    features[n_valid < _LEAST_VALID * WINDOW_BLOCKS * WINDOW_BLOCKS] = np.nan
    cell_m = CELL_BLOCKS * block_m[0], CELL_BLOCKS * block_m[1]
    altitude_m = float(np.median(tile.first_return_m))
    if math.isnan(altitude_m):
        features[:] = np.nan
    cot_grazing = (np.arange(n_across) + 0.5) * cell_m[1] / np.fmax(altitude_m, _LEAST_ALTITUDE_M)
    return Texture(features, across_crests, wavelength, cot_grazing, cell_m)


def _blocks(tile: Tile, block: tuple[int, int], n_along: int, n_across: int) -> tuple[Array, Array]:
    """Means of the usable pixels of blocks, and 1 where half of them are usable, else 0: of the core's windows, and a piece around."""
    margin = (WINDOW_BLOCKS - CELL_BLOCKS) // 2 + _PIECE
    rows, columns = (n_along * CELL_BLOCKS + 2 * margin) * block[0], (n_across * CELL_BLOCKS + 2 * margin) * block[1]
    first = tile.core_start - margin * block[0]
    source = slice(max(first, 0), min(first + rows, tile.mask.shape[0]))
    place = slice(source.start - first, source.stop - first), slice(margin * block[1], margin * block[1] + tile.mask.shape[1])
    usable = np.zeros((rows, columns), dtype=np.float32)
    echo = np.zeros((rows, columns), dtype=np.float32)
    usable[place] = (tile.mask[source] & (VALID | SATURATED)) == VALID
    np.multiply(tile.intensity[source], usable[place], out=echo[place])  # 0 where nothing is valid
    total, share = (_summed(part, block) / (block[0] * block[1]) for part in (echo, usable))
    kept = share >= 0.5
    return np.where(kept, total / np.maximum(share, 0.5), 0.0), kept.astype(np.float64)


def _summed(values: NDArray[np.float32] | Array, block: tuple[int, int]) -> Array:
    """Sums over blocks of an array whose sides they divide."""
    rows, columns = values.shape[0] // block[0], values.shape[1] // block[1]
    by_column = values[:, :: block[1]].astype(np.float64)
    for k in range(1, block[1]):  # a few long sums, where a sum along so short an axis would be slow
        by_column += values[:, k :: block[1]]
    return np.asarray(np.add.reduce(by_column.reshape(rows, block[0], columns), axis=1))


def _in_windows(values: Array, n: int = 1) -> Array:
    """(n_along, n_across) sums over windows of an array with a value per n by n blocks."""
    piece = _summed(values, (_PIECE // n, _PIECE // n))
    per_cell, per_window = CELL_BLOCKS // _PIECE, WINDOW_BLOCKS // _PIECE
    return np.asarray(sliding_window_view(piece, (per_window, per_window))[::per_cell, ::per_cell].sum(axis=(-2, -1)))


def _lacunarity(echo: Array, valid: Array, n: int) -> Array:
    """Of means over n by n blocks, of which half must be valid."""
    count = _summed(valid, (n, n))
    kept = (2.0 * count >= n * n).astype(np.float64)
    box = _summed(echo, (n, n)) / np.maximum(count, 1.0) * kept - kept  # about the local mean of 1, which keeps digits
    n_boxes = np.maximum(_in_windows(kept, n), 1.0)
    mean = _in_windows(box, n) / n_boxes
    variance = np.maximum(_in_windows(box * box, n) / n_boxes - mean * mean, 0.0)
    return np.asarray(np.log(variance / np.maximum(mean + 1.0, _FLOOR) ** 2 + _LEAST_SHARE))


def _grain(echo: Array, valid: Array) -> tuple[Array, Array]:
    """Half the mean squared difference of neighbours along and across, over the squared mean, as logarithms."""
    level = _in_windows(echo) / np.maximum(_in_windows(valid), 1.0)
    told = []
    for here, there in (((slice(None, -1),), (slice(1, None),)), ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))):
        both, difference = np.zeros_like(echo), np.zeros_like(echo)
        both[here] = valid[here] * valid[there]
        difference[here] = (echo[there] - echo[here]) ** 2 * both[here]
        half = 0.5 * _in_windows(difference) / np.maximum(_in_windows(both), 1.0)
        told.append(np.asarray(np.log(half / np.maximum(level, _FLOOR) ** 2 + _LEAST_SHARE)))
    return told[0], told[1]


def _anisotropy(level: Array, valid: Array, block_m: tuple[float, float]) -> Array:
    """Of the structure tensor, 0 for none to 1 for stripes (J. Bigun and G. Granlund, 1987), over differences of two blocks. Arrays with a
    piece around the windows."""
    rows, columns = slice(_PIECE, -_PIECE), slice(_PIECE, -_PIECE)
    before, after = slice(_PIECE - 1, -_PIECE - 1), slice(_PIECE + 1, 1 - _PIECE)
    along = (level[after, columns] - level[before, columns]) * valid[after, columns] * valid[before, columns] / block_m[0]
    across = (level[rows, after] - level[rows, before]) * valid[rows, after] * valid[rows, before] / block_m[1]
    j_aa, j_cc, j_ac = (_in_windows(part) for part in (along * along, across * across, along * across))
    return np.asarray(np.hypot(j_aa - j_cc, 2.0 * j_ac) / np.maximum(j_aa + j_cc, _SMALLEST))


def _spectrum(level: Array, valid: Array, mean: Array, block_m: tuple[float, float]) -> tuple[Array, Array, Array, Array]:
    """Per window the logarithm of the highest peak over its ring's mean, that of the share of long wavelengths, and the peak's direction
    and wavelength. Peaks are looked for between two blocks and four metres."""
    windows, holes = (
        sliding_window_view(part.astype(np.float32), (WINDOW_BLOCKS, WINDOW_BLOCKS))[::CELL_BLOCKS, ::CELL_BLOCKS]
        for part in (level, valid)
    )
    taper = np.hanning(WINDOW_BLOCKS + 2)[1:-1].astype(np.float32)
    level_there = (windows - mean.astype(np.float32)[..., np.newaxis, np.newaxis]) * holes * (taper[:, np.newaxis] * taper)
    transformed = np.fft.rfft2(level_there)
    power = transformed.real**2 + transformed.imag**2
    along, across, ring, ripple, long = _wavenumbers(block_m)
    n_rows, n_columns = power.shape[-2:]
    flat = power.reshape(*power.shape[:2], n_rows * n_columns)
    # A row more on each side and a column of negative wavenumbers, which are those of the opposite direction, for every one's neighbours.
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
    return np.log(peak + _FLOOR), np.log(share.astype(np.float64) + _FLOOR), np.where(direction >= math.pi, 0.0, direction), wavelength


def _wavenumbers(block_m: tuple[float, float]) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
    """Of the half plane of the spectrum, flattened: cycles per metre along and across, the ring each belongs to, which may be ripples,
    which are long."""
    along = np.repeat(np.fft.fftfreq(WINDOW_BLOCKS, block_m[0]), WINDOW_BLOCKS // 2 + 1)
    across = np.tile(np.fft.rfftfreq(WINDOW_BLOCKS, block_m[1]), WINDOW_BLOCKS)
    size = np.hypot(along, across)
    ring = np.minimum(np.rint(size * WINDOW_BLOCKS * max(block_m)), WINDOW_BLOCKS // 2).astype(np.intp)
    ripple = (size >= 1.0 / _LONGEST_RIPPLE_M) & (size <= 1.0 / (2.0 * max(block_m)))
    return along, across, ring, ripple, (size > 0.0) & (size < 1.0 / _LONG_M)
