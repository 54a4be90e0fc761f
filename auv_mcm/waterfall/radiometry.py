"""Normalise radiometry: remove electronic gain steps and the sonar's angle response, then the local seabed level.

First pass, while pings stream: one curve per side of mean log intensity against grazing angle, learnt recursively, so
that a change of altitude does not smear it. Second pass, on the metric grid: division by the masked mean over a few
metres. The result does not depend on absolute gain.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.waterfall_boxes import Levelled, box_level, bright_spots, divide_by_level, usable_pixels
from auv_mcm.kernels.waterfall_rows import along_curve, angle_sums
from auv_mcm.kernels.waterfall_rows import row_medians as medians_of_rows
from auv_mcm.records import VALID

N_ANGLE_BINS: Final = 180  # of the angle response over 90°: half a degree each
_BIN_RAD: Final = math.pi / 2.0 / N_ANGLE_BINS
# nats from the mean beyond which a level counts as that far: objects must not move the response
_CLIP_NATS: Final = 3.0
_TIME_CONSTANT_PINGS: Final = 150.0  # pings over which the angle response is averaged
REFERENCE_PINGS: Final = 20_000.0
"""Time constant of the angle response that levels of the sea floor are measured against: half an hour and more, so that
a patch of one kind of sea floor does not become its own reference."""
_MIN_BIN_SAMPLES: Final = 8  # samples of one ping that an angle needs to be learnt

_GAIN_STEP_NATS: Final = 0.7  # nats (3 dB): a smaller change of level is the sea floor's, a larger one the sonar's gain
_GAIN_HISTORY: Final = 8  # pings whose levels a step stands off from
_MIN_LEVEL_SAMPLES: Final = 24  # samples of a ping that its level needs

LOCAL_MEAN_M: Final = 7.5  # m along and across: the box of the local mean
# how far away a pixel still matters: half a box to the mean's edge, half around what lies there
LOCAL_MEAN_REACH_M: Final = LOCAL_MEAN_M
_MIN_VALID_FRACTION: Final = 0.25  # of the box that has to be measured
_GLINT_LIMIT: Final = 6.0  # times the mean above which a pixel counts as that bright in the local mean
_SLACK_NATS: Final = 1e-3  # more than a logarithm's rounding


class AngleCurve:
    """Learn the recursive mean of ln I per half degree of grazing angle for one side.

    Samples are clipped to +-3 nats around the curve, so that neither targets nor shadows drag it far.
    """

    def __init__(self, time_constant_pings: float = _TIME_CONSTANT_PINGS) -> None:
        self._time_constant_pings = time_constant_pings
        self._level = np.full(N_ANGLE_BINS, np.nan)
        self._weight = np.zeros(N_ANGLE_BINS)

    def learn(
        self,
        log_intensity: NDArray[np.float64],
        usable: NDArray[np.bool_],
        tangent: NDArray[np.float64],
        tangent_row: NDArray[np.int64] | None = None,
    ) -> NDArray[np.float64]:
        """Learn from a block of pings; return the curve at each row of `tangent`, the same shape, float64, nats.

        That is the curve as it was before this block, for angles already known, so that a shadow does not brighten
        itself.

        Parameters
        ----------
        log_intensity, usable
            (n_pings, n_columns), which pixels to learn from.
        tangent
            Of the grazing angle, the same shape; or (n, n_columns) with tangent_row: (n_pings,) int64, the row each
            ping takes.
        """
        if tangent_row is None:
            tangent_row = np.arange(len(log_intensity))
        angle = np.arctan(tangent) * (1.0 / _BIN_RAD)
        unknown = np.isnan(self._level)
        centre = np.where(unknown, 0.0, self._level)
        count, total = angle_sums(angle, tangent_row, log_intensity, usable, N_ANGLE_BINS, centre, _CLIP_NATS)
        if (count[unknown] > 0).any():
            # A bin's first value is its plain mean; only then is there a centre to clip around.
            plain = angle_sums(angle, tangent_row, log_intensity, usable, N_ANGLE_BINS, None, 0.0)[1]
            centre = np.where(unknown, plain / np.maximum(count, 1), self._level)
            total = angle_sums(angle, tangent_row, log_intensity, usable, N_ANGLE_BINS, centre, _CLIP_NATS)[1]
        innovation = total / np.maximum(count, 1)
        enough = count >= _MIN_BIN_SAMPLES
        n_pings = log_intensity.shape[0]
        share = n_pings / np.minimum(self._weight + n_pings, self._time_constant_pings)
        learnt = np.where(enough, centre + np.minimum(share, 1.0) * innovation, self._level)
        level = np.where(unknown, learnt, self._level)
        self._level = learnt
        self._weight += np.where(enough, n_pings, 0)
        known = np.flatnonzero(np.isfinite(level))
        if known.size == 0:
            return np.zeros_like(angle)
        # Between bin centres, because at long range half a degree is metres of sea floor and a decibel of spreading.
        return along_curve(angle, known, level[known])


class GainStepFilter:
    """Take electronic gain steps out: a jump that shows in the water column and on the sea floor alike.

    A jump on the sea floor alone is a change of the sea floor and stays.
    """

    def __init__(self) -> None:
        self._correction = 0.0
        self._seabed: deque[float] = deque(maxlen=_GAIN_HISTORY)  # corrected levels of the last pings
        self._water: deque[float] = deque(maxlen=_GAIN_HISTORY)
        self._baseline = math.nan  # corrected level of the sea floor before the last step
        self._since_step: list[float] = []  # its recorded levels after it

    def corrections(
        self, seabed_level: NDArray[np.float64], water_level: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], int]:
        """Compute the correction in nats to subtract from ln I per ping, (n_pings,) float64, and count gain steps.

        Parameters
        ----------
        seabed_level, water_level
            (n_pings,) float64 median ln I of sea floor and of the water column as recorded, NaN where there are too few
            samples.
        """
        n_pings = seabed_level.shape[0]
        if self._is_steady(seabed_level):
            self._seabed.extend((_finite_end(seabed_level) - self._correction).tolist())
            self._water.extend((_finite_end(water_level) - self._correction).tolist())
            return np.full(n_pings, self._correction), 0
        out = np.empty(n_pings)
        n_steps = 0
        for ping, (seabed, water) in enumerate(zip(seabed_level.tolist(), water_level.tolist(), strict=True)):
            if self._steps(seabed - self._correction, water - self._correction):
                self._baseline = _median(self._seabed)
                self._since_step = []
                n_steps += 1
            if len(self._since_step) < _GAIN_HISTORY and math.isfinite(self._baseline):
                # Over the following pings too: a single ping's median is known to a tenth of a neper only.
                self._since_step.append(seabed)
                following = seabed_level[ping + 1 : ping + 1 + _GAIN_HISTORY - len(self._since_step)]
                levels = np.concatenate([self._since_step, following])
                self._correction = float(levels[np.abs(levels - levels[0]) < _GAIN_STEP_NATS].mean()) - self._baseline
            out[ping] = self._correction
            if math.isfinite(seabed):
                self._seabed.append(seabed - self._correction)
            if math.isfinite(water):
                self._water.append(water - self._correction)
        return out, n_steps

    def _is_steady(self, seabed_level: NDArray[np.float64]) -> bool:
        """Check whether no ping of a block can jump: levels closer together than a step are so to any median of
        them."""
        if len(self._since_step) < _GAIN_HISTORY and math.isfinite(self._baseline):
            return False
        levels = seabed_level[np.isfinite(seabed_level)] - self._correction
        if levels.size == 0:
            return True
        low, high = float(levels.min()), float(levels.max())
        return max(high, *self._seabed, high) - min(low, *self._seabed, low) <= _GAIN_STEP_NATS

    def _steps(self, seabed: float, water: float) -> bool:
        """Check whether both corrected levels of a ping jump alike from those of the last pings."""
        if len(self._seabed) < 3 or len(self._water) < 3 or not (math.isfinite(seabed) and math.isfinite(water)):
            return False
        seabed_jump = seabed - _median(self._seabed)
        if abs(seabed_jump) <= _GAIN_STEP_NATS:
            return False
        water_jump = water - _median(self._water)
        both = min(abs(seabed_jump), abs(water_jump))
        return both > _GAIN_STEP_NATS and seabed_jump * water_jump > 0 and abs(seabed_jump - water_jump) < 0.5 * both


def _finite_end(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take the last finite levels, as many as are remembered."""
    return levels[np.isfinite(levels)][-_GAIN_HISTORY:]


def _median(values: Collection[float]) -> float:
    """Take the median of a few finite values, which numpy takes fifty times as long for."""
    in_order = sorted(values)
    return 0.5 * (in_order[(len(in_order) - 1) // 2] + in_order[len(in_order) // 2])


def ping_levels(values: NDArray[np.float64], usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Take the median of the usable values of each row, (n_rows,) float64; NaN where fewer than 24 are usable."""
    return medians_of_rows(values, None if usable.all() else usable, _MIN_LEVEL_SAMPLES)


def local_mean(
    intensity: NDArray[np.float32], usable: NDArray[np.bool_], row_spacing_m: float, column_spacing_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Average over the 7.5 m x 7.5 m around each pixel, masked: (n_rows, n_columns) float64, and where known, bool.

    Pixels above six times the mean that single-look speckle of the local geometric mean would have count as that much:
    one glint must not darken everything around it. A box that leaves the image is clipped there. Known where at least a
    quarter of the box is usable and not all of it is zero.

    Parameters
    ----------
    intensity, usable
        (n_rows, n_columns); intensity has the angle curve taken off and is 0 where not usable.
    """
    half = _half_box(row_spacing_m, column_spacing_m)
    level, _ = _without_glints(intensity, usable * np.uint8(VALID), half)
    return box_level(level, usable, half, _MIN_VALID_FRACTION)


def level_out(
    intensity: NDArray[np.float32],
    mask: NDArray[np.uint8],
    columns: NDArray[np.int64],
    row_spacing_m: float,
    column_spacing_m: float,
) -> Levelled:
    """Divide an image by the local mean of its usable pixels, which are VALID and not SATURATED; see `local_mean`.

    Parameters
    ----------
    intensity, mask
        (n_rows, n_columns).
    columns
        Those whose mean is returned as well.
    """
    half = _half_box(row_spacing_m, column_spacing_m)
    level, usable = _without_glints(intensity, mask, half)
    return divide_by_level(intensity, mask, level, usable, half, _MIN_VALID_FRACTION, columns)


def _half_box(row_spacing_m: float, column_spacing_m: float) -> tuple[int, int]:
    return max(1, round(0.5 * LOCAL_MEAN_M / row_spacing_m)), max(1, round(0.5 * LOCAL_MEAN_M / column_spacing_m))


def _without_glints(
    intensity: NDArray[np.float32], mask: NDArray[np.uint8], half: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Take the usable pixels of an image, those above their limit brought down to it; 0 elsewhere. Returns also which
    are usable."""
    # The angle curve has brought the sea floor to about 1, so the clip holds whatever the gain.
    level, bounded, usable = usable_pixels(intensity, mask, math.exp(-_CLIP_NATS), math.exp(_CLIP_NATS))
    logarithms = np.log(bounded, out=bounded)
    # Hardly any pixel reaches its limit, which takes an exponential: comparing logarithms shows which may.
    places, log_limits = bright_spots(
        logarithms, usable, half, np.euler_gamma + math.log(_GLINT_LIMIT), _CLIP_NATS, _SLACK_NATS
    )
    flat = level.ravel()
    flat[places] = np.minimum(flat[places], np.exp(log_limits).astype(np.float32))
    return level, usable
