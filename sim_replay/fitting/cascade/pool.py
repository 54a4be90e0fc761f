"""Build the features a cascade may choose from: pairs of boxes around a highlight, and the difference of their means.

Boxes have the sizes of mines, 0.3-2.6 m long and 0.3-0.8 m high, in metres and in multiples of the reference shadow.
Ratios of means do not depend on the gain; differences over the window's mean hardly do, and still carry information
where one mean is all but nothing. Source of the box families: P. Viola, M. Jones, Int. J. Computer Vision 57(2), 2004;
highlight and shadow pairs after J. Sawas, Y. Petillot, Y. Pailhas, ECUA 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import WINDOW, FeatureBox, areas, band_edges, bands_at, pixel_boxes
from auv_mcm.detect.cascade.codes import CodePlane, box_sums
from auv_mcm.detect.cascade.model import Stump
from sim_replay.fitting.cascade.boost import N_BINS, Bins, BoostedStump

_SEED: Final = 20100512  # of the features drawn, fixed so that models repeat
# Features drawn of each family; all of those that have fewer.
_SHARES: Final = {
    "highlight and sea floor": 1400,
    "highlight and shadow": 1500,
    "shadow and sea floor": 1800,
    "centre and surround": 400,
    "parts of the shadow": 500,
    "sides": 400,
}
_CHUNK: Final = 2048
_WINDOWS_AT_ONCE: Final = 256
_LARGEST: Final = 1e3  # of a threshold, and one over it the minimum of a ratio


class Feature(NamedTuple):
    """Compare means of boxes `a` and `b`, numbers into the pool's boxes: a / b if `is_ratio`, else (a - b) / window."""

    is_ratio: bool
    a: int
    b: int


class Pool(NamedTuple):
    """Hold boxes: the first is the window. features: what is made of them."""

    boxes: tuple[FeatureBox, ...]
    features: tuple[Feature, ...]


@cache
def feature_pool() -> Pool:
    """Return the same several thousand features every time."""
    rng = np.random.Generator(np.random.PCG64(_SEED))
    numbers: dict[FeatureBox, int] = {WINDOW: 0}
    features = []
    for name, pairs in _families().items():
        every = [(is_ratio, a, b) for a, b in dict.fromkeys(pairs) if a != b for is_ratio in (True, False)]
        chosen = np.sort(rng.choice(len(every), size=min(_SHARES[name], len(every)), replace=False))
        for is_ratio, a, b in (every[index] for index in chosen):
            features.append(Feature(is_ratio, numbers.setdefault(a, len(numbers)), numbers.setdefault(b, len(numbers))))
    return Pool(tuple(numbers), tuple(dict.fromkeys(features)))


def pool_box_means(
    plane: CodePlane, boxes: Sequence[FeatureBox], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return (n_boxes, n_windows) float32 mean code of every box around the given pixels of a plane.

    Parameters
    ----------
    rows, columns
        (n_windows,) intp.
    """
    by_band = pixel_boxes(boxes, plane.row_spacing_m, plane.column_spacing_m)
    area = areas(by_band).astype(np.float32)
    bands = bands_at(band_edges(plane.first_return_m, plane.n_columns, plane.column_spacing_m), rows, columns)
    means = np.empty((len(boxes), rows.size), dtype=np.float32)
    for start in range(0, rows.size, _WINDOWS_AT_ONCE):
        some = slice(start, start + _WINDOWS_AT_ONCE)
        sums = box_sums(plane, rows[some, np.newaxis], columns[some, np.newaxis], by_band[bands[some]])
        means[:, some] = (sums.astype(np.float32) / area[bands[some]]).T
    return means


def feature_values(
    pool: Pool, features: Sequence[int] | NDArray[np.intp], means: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Compute values of the chosen features for box means (n_boxes, n_windows): (n_chosen, n_windows) float32.

    Where the divisor is 0 the value is infinite or not a number: no comparison with a threshold holds for it.
    """
    chosen = [pool.features[feature] for feature in features]
    a, b = means[[feature.a for feature in chosen]], means[[feature.b for feature in chosen]]
    is_ratio = np.array([feature.is_ratio for feature in chosen], dtype=np.bool_)[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(is_ratio, a, a - b) / np.where(is_ratio, b, means[:1]), dtype=np.float32)


def bin_edges(pool: Pool, means: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute edges between bins that hold about as many windows each, (n_features, 255) float32.

    From box means (n_boxes, n_windows).

    Ascending, repeats allowed; half way between two values, so that rounding moves no window of these to the other
    side. Raises ValueError if there is no window.
    """
    n_windows = means.shape[1]
    if not n_windows:
        raise ValueError("no windows to take quantiles of")
    edges = np.empty((len(pool.features), N_BINS - 1), dtype=np.float32)
    at = (np.arange(1, N_BINS) * n_windows) // N_BINS
    min_value = np.where([feature.is_ratio for feature in pool.features], 1.0 / _LARGEST, -_LARGEST).astype(np.float32)[
        :, np.newaxis
    ]
    for start in range(0, len(edges), _CHUNK):
        some = np.arange(start, min(start + _CHUNK, len(edges)))
        values = np.sort(np.clip(feature_values(pool, some, means), min_value[some], np.float32(_LARGEST)), axis=1)
        # What is not a number sorts last; an edge is one all the same.
        edges[some] = np.nan_to_num(0.5 * (values[:, at] + values[:, np.maximum(at - 1, 0)]), nan=_LARGEST)
    return edges


def quantise(pool: Pool, edges: NDArray[np.float32], means: NDArray[np.float32]) -> Bins:
    """Quantise features to (n_features, n_windows) uint8.

    A value is below edge k if and only if its bin is k or less.
    """
    bins = np.empty((len(pool.features), means.shape[1]), dtype=np.uint8)
    for start in range(0, means.shape[1], _CHUNK):
        windows = slice(start, start + _CHUNK)
        values = feature_values(pool, range(len(pool.features)), means[:, windows])
        for feature in range(len(values)):
            bins[feature, windows] = np.searchsorted(edges[feature], values[feature], side="right")
    return bins


def model_stump(pool: Pool, edges: NDArray[np.float32], stump: BoostedStump) -> Stump:
    """Convert a boosted stump to the comparison of box means that a model holds."""
    feature = pool.features[stump.feature]
    return Stump(
        kind="ratio" if feature.is_ratio else "contrast",
        a=pool.boxes[feature.a],
        b=pool.boxes[feature.b],
        w=None if feature.is_ratio else pool.boxes[0],
        threshold=float(edges[stump.feature, stump.last_below]),
        below=stump.below,
        above=stump.above,
    )


def _families() -> dict[str, list[tuple[FeatureBox, FeatureBox]]]:
    """List every pair of each family, in a fixed order."""
    highlights, shadows, floors, sides = _highlights(), _shadows(), _floors(), _sides()
    return {
        "highlight and sea floor": list(product(highlights, floors)),
        "highlight and shadow": list(product(highlights, shadows)),
        "shadow and sea floor": list(product(shadows, floors)),
        "centre and surround": [(box, around) for box in highlights for around in (*_surrounds(), WINDOW)],
        "parts of the shadow": [
            (a, b) for a, b in product(shadows, shadows) if (a.top_m, a.bottom_m) == (b.top_m, b.bottom_m)
        ],
        "sides": [(a, b) for group in sides for a, b in product(group, group)],
    }


def _highlights() -> list[FeatureBox]:
    sizes = product((0.12, 0.36, 0.6, 0.84, 1.2, 1.6), (0.12, 0.24, 0.36, 0.5))
    centred = [_box(0.0, along, at, across) for (along, across), at in product(sizes, (-0.06, 0.06, 0.18))]
    beside = [
        _box(at, along, 0.06, across)
        for at, along, across in product((-0.6, -0.3, 0.3, 0.6), (0.24, 0.48), (0.24, 0.48))
    ]
    return [*centred, *beside]


def _shadows() -> list[FeatureBox]:
    """List pieces of shadows of different lengths and heights.

    From right behind the highlight to where only tall objects cast any.
    """
    boxes = []
    for along, at in (
        (0.24, 0.0),
        (0.48, 0.0),
        (0.84, 0.0),
        (1.2, 0.0),
        (1.8, 0.0),
        (0.36, -0.3),
        (0.36, 0.3),
        (0.4, -0.6),
        (0.4, 0.6),
    ):
        for start_m in (0.1, 0.25, 0.4):
            for start, stop in ((0.0, 0.3), (0.0, 0.6), (0.0, 1.0), (0.2, 0.5), (0.3, 0.8), (0.5, 1.0), (0.8, 1.2)):
                boxes.append(_shadow(at, along, start_m, start, start_m + 0.1, stop))
        for start_m, length_m in product((0.1, 0.25, 0.4, 0.6), (0.2, 0.5)):
            boxes.append(_shadow(at, along, start_m, 0.0, start_m + length_m, 0.0))
    return boxes


def _floors() -> list[FeatureBox]:
    """List boxes of the sea floor around an object of up to 1.6 m and its shadow: before, behind, beside either end,
    and all of it.
    """
    before = [_shadow(0.0, along, -1.0, 0.0, stop, 0.0) for along, stop in product((0.6, 1.2, 2.0), (-0.3, -0.5))]
    behind = [_shadow(0.0, along, 0.5, start, 1.0, 1.2) for along, start in product((0.6, 1.2, 2.0), (0.8, 1.0))]
    beside = [
        FeatureBox(top_m=top, bottom_m=bottom, near_m=near_m, near_shadow=near, far_m=far_m, far_shadow=far)
        for (top, bottom), (near_m, near, far_m, far) in product(
            ((-1.0, -0.5), (-1.0, -0.75), (0.5, 1.0), (0.75, 1.0)),
            ((-1.0, 0.0, 1.0, 1.0), (-0.4, 0.0, 0.4, 0.0), (0.3, 0.0, 0.4, 1.0), (-1.0, 0.0, 0.4, 0.0)),
        )
    ]
    return [WINDOW, *before, *behind, *beside]


def _surrounds() -> list[FeatureBox]:
    return [
        _box(0.0, along, 0.06, across)
        for along, across in ((0.6, 0.6), (0.84, 1.0), (1.2, 1.2), (2.0, 1.0), (2.0, 1.8))
    ]


def _sides() -> list[list[FeatureBox]]:
    """List groups of strips that sea floor without relief shows alike: ripples and slopes do not."""
    rows = np.arange(-1.0, 1.0, 0.4).round(2).tolist()
    along = [_shadow(top + 0.2, 0.4, -1.0, 0.0, 1.0, 1.0) for top in rows]
    near = [_shadow(top + 0.2, 0.4, -1.0, 0.0, -0.3, 0.0) for top in rows]
    across = [_shadow(0.0, 2.0, start, 0.0, start + 0.4, 0.0) for start in (-1.0, -0.6, -0.2, 0.2, 0.6)]
    far = [_shadow(0.0, 2.0, 0.0, start, 0.3, start + 0.3) for start in (0.0, 0.3, 0.6, 0.9)]
    return [along, near, [*across, *far]]


def _box(at_row_m: float, along_m: float, at_column_m: float, across_m: float) -> FeatureBox:
    return _shadow(at_row_m, along_m, at_column_m - 0.5 * across_m, 0.0, at_column_m + 0.5 * across_m, 0.0)


def _shadow(
    at_row_m: float, along_m: float, near_m: float, near_shadow: float, far_m: float, far_shadow: float
) -> FeatureBox:
    metres = (at_row_m - 0.5 * along_m, at_row_m + 0.5 * along_m, near_m, near_shadow, far_m, far_shadow)
    top_m, bottom_m, near_m, near_shadow, far_m, far_shadow = (round(value, 3) for value in metres)
    return FeatureBox(
        top_m=top_m, bottom_m=bottom_m, near_m=near_m, near_shadow=near_shadow, far_m=far_m, far_shadow=far_shadow
    )
