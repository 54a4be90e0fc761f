"""Define the score of a pixel as the centre of a highlight with a shadow behind, by box means.

The sea floor sets its own scale. The variance of the logarithm of box means is measured around each pixel at two box
sizes, as equivalent looks: it holds speckle, its correlation from pixel to pixel, and texture, and how it falls from
the small to the large box says how many independent samples other boxes have. Ratios of box means to the background
then become standard deviations in closed form. Highlights and shadows of several sizes are tried, shadows in multiples
of what an object of given height casts at that range and altitude.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.ftest import equivalent_looks
from auv_mcm.records import Tile

# Along track, across track, metres.
HIGHLIGHTS_M: Final = ((0.12, 0.18), (0.36, 0.24), (0.36, 0.48), (0.84, 0.36), (1.6, 0.36))
# Along track and height of the object that casts it, metres.
SHADOWS_M: Final = ((0.12, 0.1), (0.12, 0.2), (0.36, 0.1), (0.36, 0.2), (0.36, 0.35), (0.84, 0.35), (0.84, 0.7))
SHADOW_LENGTH_M: Final = (0.18, 6.0)
MIN_ALTITUDE_M: Final = 0.05
SHADOW_LAG_M: Final = 0.6  # from the highlight's centre to where the shadow starts, maximum

# Background: a frame around the object, narrow enough to follow the sea floor, hollow so that the object stays out of
# it.
FRAME_ROWS_M: Final = 1.5
_FRAME_NEAR_M: Final = 1.0
_FRAME_FAR_M: Final = 2.0
_HOLLOW_ROWS_M: Final = 0.6
_HOLLOW_NEAR_M: Final = 0.4
_HOLLOW_FAR_M: Final = 1.2
BACKGROUND_CLIP: Final = 6.0  # times the local mean: one speckle in 400 is brighter
MIN_BACKGROUND: Final = 0.3
NO_ECHO: Final = np.float32(1e-6)
"""Background where nothing around echoes, and the least that there is."""
MIN_SHADOW: Final = 0.6  # share of a shadow box that has to be measured

LOOKS_ROWS_M: Final = 5.0  # m along the track over which the looks of the sea floor are estimated
LOOKS_COLUMNS_M: Final = 4.0  # m across the track, the same
SMALL_BOX_M: Final = (0.36, 0.24)  # m along and across: the highlight of a small mine
THIN_BOX_M: Final = (0.12, 0.24)  # m: the highlight of one seen end on
LARGE_BOX_M: Final = (0.84, 0.84)  # m: that of the largest mine sought, broadside
LOG_CLIP: Final = 1.2  # bright objects and shadows must not pass for texture
MIN_DECAY: Final = 0.3  # less is measured where a structure, not texture, spans the large boxes
MIN_LOG_VARIANCE: Final = 1e-3  # nats²: a thousand looks; keeps deviates finite where nothing scatters

# A shadow is the better witness: speckle, glints and texture make bright spots, hardly anything else makes dark ones.
# But they seldom make brighter ones than this, and from there on a highlight counts like a shadow: far off it often is
# all that can be seen.
HIGHLIGHT_WEIGHT: Final = 0.5
PAIR_NORM: Final = float(np.hypot(HIGHLIGHT_WEIGHT, 1.0))
CLEAR_HIGHLIGHT: Final = 4.0
# Beyond these deviates more contrast says little more; the small slope left keeps the order of strong echoes.
_HIGHLIGHT_KNEE: Final = 6.0
_SHADOW_KNEE: Final = 6.0
_LOWEST_DEVIATE: Final = -2.0
# An echo may be so strong that it counts without a shadow: over soft mud, or with the shadow filled by multipath.
GLINT_DISCOUNT: Final = 4.0
_GLINT_KNEE: Final = 5.0
_BEYOND_KNEE: Final = 0.05
MAX_RATIO: Final = 100.0

MARGIN_M: Final = 1.0
"""How far beyond a tile's core pixels are scored, so that a peak in the core is compared with all its neighbours."""
CONTEXT_M: Final = LOOKS_ROWS_M + FRAME_ROWS_M + 1.0
"""Along-track reach of a score: a pixel this far inside a tile is scored as it would be anywhere else."""


class Floor(NamedTuple):
    """Hold the sea floor around one pixel: mean intensity, and variance of the logarithm of small box means."""

    background: float
    log_variance: float


class Peak(NamedTuple):
    """Hold a local maximum of the score: tile-local row and column, and the score there."""

    score: float
    row: int
    column: int


class PixelGrid(NamedTuple):
    """Convert lengths to whole pixels of a tile, 1 at the minimum, and boxes to half-open offsets from a pixel."""

    row_m: float
    column_m: float

    def rows(self, length_m: float) -> int:
        """Convert a length along the track, m, to whole rows, 1 at the minimum."""
        return max(1, round(length_m / self.row_m))

    def columns(self, length_m: float) -> int:
        """Convert a length across the track, m, to whole columns, 1 at the minimum."""
        return max(1, round(length_m / self.column_m))

    def centred(self, size_m: tuple[float, float]) -> tuple[tuple[int, int, int, int], int]:
        """Return the half-open offsets of a box around a pixel, and its area in pixels."""
        half_row, half_column = self.rows(size_m[0]) // 2, self.columns(size_m[1]) // 2
        return (-half_row, half_row + 1, -half_column, half_column + 1), (2 * half_row + 1) * (2 * half_column + 1)

    def frame(self) -> tuple[tuple[int, int, int, int], tuple[int, int, int, int], int]:
        """Return the background's frame and its hollow as half-open offsets, and the area between them in pixels."""
        hollow_rows = self.rows(_HOLLOW_ROWS_M)
        hollow = (-hollow_rows, hollow_rows + 1, -self.columns(_HOLLOW_NEAR_M), self.columns(_HOLLOW_FAR_M))
        # On a coarse grid the frame stays at least a pixel wide.
        rows = max(self.rows(FRAME_ROWS_M), hollow_rows + 1)
        outer = (
            -rows,
            rows + 1,
            min(-self.columns(_FRAME_NEAR_M), hollow[2] - 1),
            max(self.columns(_FRAME_FAR_M), hollow[3] + 1),
        )
        area = (outer[1] - outer[0]) * (outer[3] - outer[2]) - (hollow[1] - hollow[0]) * (hollow[3] - hollow[2])
        return outer, hollow, area


class Spread(NamedTuple):
    """Hold how much box means vary on the sea floor around each pixel of a band, float32.

    Variances of the logarithm for the thin and the small box, and the power of area with which larger boxes vary less.
    """

    thin: NDArray[np.float32]
    small: NDArray[np.float32]
    decay: NDArray[np.float32]
    thin_area: int
    small_area: int

    def looks(self, n_rows: int, area: NDArray[np.float32] | float) -> NDArray[np.float32]:
        """Compute the equivalent looks of the mean over a box.

        What is smaller than the boxes measured holds speckle alone, which falls with area.
        """
        variance, measured_area = (self.thin, self.thin_area) if n_rows == 1 else (self.small, self.small_area)
        growth = np.log(np.asarray(area, dtype=np.float32) / np.float32(measured_area))
        return equivalent_looks(variance * np.exp(-np.where(growth < 0.0, np.float32(1.0), self.decay) * growth))


def decay_of(small: NDArray[np.float32], large: NDArray[np.float32], area_ratio: float) -> NDArray[np.float32]:
    """Compute the power of area with which variances fall from the small to the large box.

    area_ratio: of the large box over the small one.
    """
    # On a grid too coarse to separate the two boxes both variances are equal, and any growth of area will do.
    per_area = np.float32(1.0 / np.log(max(area_ratio, 2.0)))
    return np.asarray(np.clip(np.log(small / large) * per_area, MIN_DECAY, 1.0), dtype=np.float32)


def combined(highlight: NDArray[np.float32], shadow: NDArray[np.float32]) -> NDArray[np.float32]:
    """Combine a highlight's and a shadow's deviates into a score, float32 of any shape."""
    pair = (worth(highlight) + saturate_shadow(shadow)) * np.float32(1.0 / PAIR_NORM)
    return np.asarray(np.maximum(pair, glint(highlight)))


def worth(highlight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute what a highlight's deviate adds to a pair."""
    bright = saturate(highlight, _HIGHLIGHT_KNEE)
    clear = np.maximum(bright - np.float32(CLEAR_HIGHLIGHT), np.float32(0.0))
    return np.asarray(HIGHLIGHT_WEIGHT * bright + (1.0 - HIGHLIGHT_WEIGHT) * clear)


def saturate_shadow(shadow: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute what a shadow's deviate adds to a pair."""
    return saturate(shadow, _SHADOW_KNEE)


def glint(highlight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Score a highlight without a shadow."""
    return saturate(highlight - np.float32(GLINT_DISCOUNT), _GLINT_KNEE)


def saturate(deviate: NDArray[np.float32], knee: float) -> NDArray[np.float32]:
    """Bound deviates: linear up to the knee, less steep above."""
    bounded = np.maximum(deviate, np.float32(_LOWEST_DEVIATE))
    return np.asarray(np.minimum(bounded, np.float32(knee) + np.float32(_BEYOND_KNEE) * (bounded - np.float32(knee))))


def clearance_m(tile: Tile, height_m: float) -> NDArray[np.float64]:
    """Compute the altitude over the top of an object of `height_m` in each row, m.

    (n_rows,) float64, bounded from below.
    """
    altitude_m = np.maximum(tile.first_return_m, MIN_ALTITUDE_M)
    return np.maximum(altitude_m - height_m, 0.3 * altitude_m)
