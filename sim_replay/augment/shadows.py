"""Find shadow in a recorded image: dark stretches of range behind something bright, which mud and smooth sand
are not."""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

BOX_M: Final = 0.5  # echoes are averaged over this range and BOX_PINGS to separate shadow from speckle
BOX_PINGS: Final = 3  # pings averaged
MIN_SHADOW_M: Final = 0.3  # m: shorter ones are speckle
_AROUND_M: Final = 6.0  # m along and across: the level that a shadow stands off from
_BEFORE_M: Final = 0.8  # nearer than the shadow, where its cause shows
_CAUSE: Final = 2.0  # of the floor's level, at its brightest; sand beside mud is less
_DARK: Final = 0.25  # of the floor's level, where the noise is not known
_DARKEST, _BRIGHTEST = 0.1, 0.35  # bounds of the same where it is
_ABOVE_NOISE: Final = 2.0  # times the noise, below which a stretch is shadow
_MIN_LEVEL: Final = 0.03  # of the typical level: a floor cannot be darker

Floats: TypeAlias = NDArray[np.float64]


class ShadowRuns(NamedTuple):
    """Hold shadows of single pings, (n,) int64 each: row, first column and one past the last."""

    row: NDArray[np.int64]
    start: NDArray[np.int64]
    stop: NDArray[np.int64]

    def mask(self, shape: tuple[int, int], trim: int = 0) -> NDArray[np.bool_]:
        """Return the image's pixels in shadow, without `trim` at either end of each run."""
        step = np.zeros((shape[0], shape[1] + 1), dtype=np.int64)
        start, stop = self.start + trim, np.maximum(self.stop - trim, self.start + trim)
        np.add.at(step, (self.row, np.minimum(start, shape[1])), 1)
        np.add.at(step, (self.row, np.minimum(stop, shape[1])), -1)
        return np.asarray(np.cumsum(step, axis=1)[:, :-1] > 0)


def shadow_runs(intensity: Floats, noise: Floats | None, row_spacing_m: float, column_spacing_m: float) -> ShadowRuns:
    """Find shadows in an image (n_pings, n_columns) of linear intensity, 0 where nothing was recorded.

    noise: mean intensity of noise that broadcasts against it, None if not known. Columns may be slant or ground range.
    """
    # A running sum leaves rounding errors where nothing was recorded, of either sign.
    box = np.maximum(
        uniform_filter(intensity, (BOX_PINGS, max(3, round(BOX_M / column_spacing_m))), mode="nearest"), 0.0
    )
    typical = np.median(box, axis=0)[None, :]
    around = (max(5, round(_AROUND_M / row_spacing_m)), max(5, round(_AROUND_M / column_spacing_m)))
    level = np.maximum(
        uniform_filter(np.minimum(box, 4.0 * typical + 1e-30), around, mode="nearest"), _MIN_LEVEL * typical
    )
    if noise is None:
        dark = box < _DARK * level
    else:
        limit = np.clip(np.sqrt(noise * level), _DARKEST * level, _BRIGHTEST * level)
        dark = (box < limit) & (noise < _BRIGHTEST * level)
        # Within a shadow wider than the surroundings only its level decides.
        dark |= (box < _ABOVE_NOISE * noise) & (noise < _DARKEST * typical)
    edge = np.diff(np.pad(dark.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    row, start = np.nonzero(edge == 1)
    stop = np.nonzero(edge == -1)[1]
    reach = max(2, round(_BEFORE_M / column_spacing_m))
    bright = _brightest_before(box / np.maximum(np.maximum(level, typical), 1e-30), reach)
    caused = (stop - start >= max(3, round(MIN_SHADOW_M / column_spacing_m))) & (bright[row, start] > _CAUSE)
    return ShadowRuns(row[caused], start[caused], stop[caused])


def _brightest_before(image: Floats, reach: int) -> Floats:
    """Return the highest value among `reach` columns before each column."""
    padded = np.pad(image, ((0, 0), (reach, 0)), constant_values=0.0)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded[:, :-1], reach, axis=1).max(axis=2))
