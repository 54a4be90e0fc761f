"""Extract the feature families of the source paper (section 4.4.1).

Central filters, wavelets, thresholds, variances, templates, histograms.

The paper names them; each documents what it measures here. All are functions of the contrast of chips (n, N_ROWS,
N_COLUMNS) float64, ln of intensity over the chip's median, so no gain changes them, and none separates a chip from its
mirror image along track.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from sim_replay.fitting.cascade.classical.chips import CENTRE_COLUMN, CENTRE_ROW, N_COLUMNS, N_OBJECT_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.wavelets import analyse

Array = NDArray[np.float64]
Family: TypeAlias = Literal["central", "wavelets", "thresholds", "variances", "templates", "histograms"]
FAMILIES: Final[tuple[Family, ...]] = get_args(Family)

_MIN_POWER: Final = 1e-3  # (nats)^2 below which differences are noise
_TIMES: Final = (2.0, 4.0, 8.0)  # the median, whose exceedance is counted
_QUANTILES: Final = (0.05, 0.1, 0.25, 0.75, 0.9, 0.95)  # of the histogram
_N_LEVELS: Final = 3  # of the wavelets: eight cells
_HIGHEST_MOMENT: Final = 10.0  # bounds skewness and kurtosis of few cells


class Zone(NamedTuple):
    """Select rows up to `half_rows` from the centre and columns [near, far) of a chip."""

    half_rows: int
    near: int
    far: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Return the rows and columns of the zone."""
        return slice(CENTRE_ROW - self.half_rows, CENTRE_ROW + self.half_rows + 1), slice(self.near, self.far)


class CentralFilter(NamedTuple):
    """Subtract the mean over `dark`, without its part in `bright`, from the mean over `bright`."""

    bright: Zone
    dark: Zone


WHOLE: Final = Zone(CENTRE_ROW, 0, N_COLUMNS)
HIGHLIGHT: Final = Zone(3, CENTRE_COLUMN - 4, CENTRE_COLUMN + 5)
SHADOW: Final = Zone(3, N_OBJECT_COLUMNS - 2, N_OBJECT_COLUMNS + 17)
_ZONES: Final = {"whole": WHOLE, "highlight": HIGHLIGHT, "shadow": SHADOW}

_CENTRES: Final = (CENTRE_COLUMN, 20, 26, 34)  # the highlight; near, middle and far in the shadow
_SIZES: Final = (
    (0, 1),
    (1, 2),
    (2, 4),
    (3, 6),
)  # half rows and half columns of the middle; the ring is twice as far out
_MATCHED_HEIGHTS: Final = (1, 3)  # half rows
_MATCHED_COLUMNS: Final = (CENTRE_COLUMN - 3, CENTRE_COLUMN + 4)
_MATCHED_SHADOWS: Final = ((17, 24), (17, 32), (17, 40))  # columns from, up to, of shadows filtered for

CENTRAL_FILTERS: Final[Mapping[str, CentralFilter]] = MappingProxyType(
    {
        f"ring_{centre}_{half_rows}_{half_columns}": CentralFilter(
            Zone(half_rows, max(centre - half_columns, 0), min(centre + half_columns + 1, N_COLUMNS)),
            Zone(
                2 * half_rows + 1, max(centre - 2 * half_columns - 1, 0), min(centre + 2 * half_columns + 2, N_COLUMNS)
            ),
        )
        for centre, (half_rows, half_columns) in product(_CENTRES, _SIZES)
    }
    | {
        f"pair_{half_rows}_{far}": CentralFilter(Zone(half_rows, *_MATCHED_COLUMNS), Zone(half_rows, near, far))
        for half_rows, (near, far) in product(_MATCHED_HEIGHTS, _MATCHED_SHADOWS)
    }
    | {
        f"flank_{half_rows}_{far}": CentralFilter(Zone(half_rows, near, far), Zone(CENTRE_ROW, near, far))
        for half_rows, (near, far) in product(_MATCHED_HEIGHTS, _MATCHED_SHADOWS)
    }
)
"""ring: a middle against what is around it, at several places and sizes. pair: a highlight against the shadow behind
it, matched to objects of two lengths and shadows of three. flank: that shadow against the floor before and after it."""

_INNER: Final = slice(CENTRE_ROW - 3, CENTRE_ROW + 4)
_BLOCKS: Final = ((0, 9), (9, 17), (17, 28), (28, N_COLUMNS))


def extract(contrast: Array, families: Sequence[Family], templates: Mapping[str, Array]) -> Array:
    """Return (n, n_features) float64 features of chips (n, N_ROWS, N_COLUMNS), family after family."""
    return np.concatenate([_EXTRACTORS[family](contrast, templates) for family in families], axis=1)


def feature_names(families: Sequence[Family], templates: Sequence[str]) -> tuple[str, ...]:
    """Return the name of each feature that `extract` gives, with templates of these names."""
    names: dict[Family, list[str]] = {
        "central": list(CENTRAL_FILTERS),
        "wavelets": [
            f"{band}_{level}_{zone}"
            for level, band, zone in product(range(1, _N_LEVELS + 1), ("columns", "rows", "both"), ("object", "shadow"))
        ],
        "thresholds": [f"{zone}_{side}_{times:g}" for zone, times, side in product(_ZONES, _TIMES, ("above", "below"))],
        "variances": [f"{rows}_{near}_{far}" for (near, far), rows in product(_BLOCKS, ("inner", "outer"))],
        "templates": [f"{name}_{zone}" for name, zone in product(templates, ("whole", "object", "shadow"))],
        "histograms": [*(f"quantile_{share:g}" for share in _QUANTILES), "deviation", "skewness", "kurtosis"],
    }
    return tuple(f"{family}.{name}" for family in families for name in names[family])


def central(contrast: Array) -> Array:
    """Return responses of CENTRAL_FILTERS."""
    return np.asarray(np.einsum("nrc,frc->nf", contrast, _bank()))


def wavelets(contrast: Array) -> Array:
    """Compute ln of the mean power in each detail subband of three levels.

    It is taken over the object's columns and over the shadow's.
    """
    features: list[Array] = []
    smooth, n_object = contrast, N_OBJECT_COLUMNS
    for _ in range(_N_LEVELS):
        bands = analyse(smooth)
        smooth = bands.smooth
        n_even, n_odd = (n_object + 1) // 2, n_object // 2
        for band, split in ((bands.columns, n_odd), (bands.rows, n_even), (bands.both, n_odd)):
            features += [_log_power((part**2).mean(axis=(1, 2))) for part in (band[..., :split], band[..., split:])]
        n_object = n_even
    return np.stack(features, axis=1)


def thresholds(contrast: Array) -> Array:
    """Compute shares of the cells of each zone that are far above or below the floor.

    That is above 2, 4 and 8 times the floor, or below as many parts of it.
    """
    features: list[Array] = []
    for zone, times in product(_ZONES.values(), _TIMES):
        part = contrast[:, *zone.slices]
        features += [(part > math.log(times)).mean(axis=(1, 2)), (part < -math.log(times)).mean(axis=(1, 2))]
    return np.stack(features, axis=1)


def variances(contrast: Array) -> Array:
    """Return ln of the variance in blocks: before the object, of the object, of the near and the far shadow.

    Rows of the object and others.
    """
    outer = np.concatenate([contrast[:, : _INNER.start], contrast[:, _INNER.stop :]], axis=1)
    parts = [rows[:, :, near:far] for (near, far) in _BLOCKS for rows in (contrast[:, _INNER], outer)]
    return np.stack([_log_power(part.var(axis=(1, 2))) for part in parts], axis=1)


def match_templates(contrast: Array, templates: Mapping[str, Array]) -> Array:
    """Correlate chips with templates.

    Normalised correlation with each template (N_ROWS, N_COLUMNS): all of it, the object's columns, the shadow's; 0
    without variance.
    """
    features = []
    for template in templates.values():
        for columns in (slice(None), slice(None, N_OBJECT_COLUMNS), slice(N_OBJECT_COLUMNS, None)):
            part, wanted = contrast[:, :, columns], template[:, columns]
            part, wanted = part - part.mean(axis=(1, 2), keepdims=True), wanted - wanted.mean()
            power = (part**2).mean(axis=(1, 2)) * (wanted**2).mean()
            product_mean = np.einsum("nrc,rc->n", part, wanted) / wanted.size
            features.append(
                np.where(power > _MIN_POWER**2, product_mean / np.sqrt(np.maximum(power, _MIN_POWER**2)), 0.0)
            )
    return np.stack(features, axis=1)


def histograms(contrast: Array) -> Array:
    """Compute quantiles and moments of ln intensity over the median.

    The moments are standard deviation, skewness and excess kurtosis, the last two bounded.
    """
    flat = contrast.reshape(len(contrast), N_ROWS * N_COLUMNS)
    centred = flat - flat.mean(axis=1, keepdims=True)
    variance = (centred**2).mean(axis=1)
    safe = np.maximum(variance, _MIN_POWER)
    third, fourth = (centred**3).mean(axis=1) / safe**1.5, (centred**4).mean(axis=1) / safe**2 - 3.0
    moments = [np.sqrt(variance), *(np.clip(moment, -_HIGHEST_MOMENT, _HIGHEST_MOMENT) for moment in (third, fourth))]
    return np.stack([*np.quantile(flat, _QUANTILES, axis=1), *moments], axis=1)


def mean_chip(contrasts: Array) -> Array:
    """Return the (N_ROWS, N_COLUMNS) mean of chips (n, N_ROWS, N_COLUMNS) and their mirror images along track."""
    mean = contrasts.mean(axis=0)
    return np.asarray(0.5 * (mean + mean[::-1]))


def _bank() -> Array:
    """Return (n_filters, N_ROWS, N_COLUMNS) weights of the central filters, each of which sums to 0."""
    bank = np.zeros((len(CENTRAL_FILTERS), N_ROWS, N_COLUMNS))
    for weights, found in zip(bank, CENTRAL_FILTERS.values(), strict=True):
        bright, dark = (np.zeros((N_ROWS, N_COLUMNS), dtype=np.bool_) for _ in range(2))
        bright[found.bright.slices] = True
        dark[found.dark.slices] = True
        dark &= ~bright
        weights[bright] = 1.0 / bright.sum()
        weights[dark] = -1.0 / dark.sum()
    return bank


def _log_power(power: Array) -> Array:
    return np.asarray(np.log(power + _MIN_POWER))


_EXTRACTORS: Final[Mapping[Family, Callable[[Array, Mapping[str, Array]], Array]]] = MappingProxyType(
    {
        "central": lambda contrast, _: central(contrast),
        "wavelets": lambda contrast, _: wavelets(contrast),
        "thresholds": lambda contrast, _: thresholds(contrast),
        "variances": lambda contrast, _: variances(contrast),
        "templates": match_templates,
        "histograms": lambda contrast, _: histograms(contrast),
    }
)
