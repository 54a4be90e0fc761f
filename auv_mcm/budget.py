"""Plan how much work a tile may cost: a price list, a share of one core, and the order in which work is done.

Work is counted, never timed: so many microseconds per unit of work, from the configuration. The same log and
configuration therefore give the same bytes on every computer and under any load; `auv-mcm calibrate budget` measures
the prices of a computer.

    always done: waterfall, contrasts and their clear peaks, sea floor, coverage, measuring
    then, with what is left less the price of two looks: the cascade's windows, best first
    then, only if no window was cut: looks, likeliest first

A look is the verifier's opinion, and the examination that one in four goes on to; an examination without a verifier.

A stage gets nothing before all work of the stage before it is paid. The windows of a smaller budget are therefore among
those of a larger one, and so are the looks, but for a detection that others, found with the larger budget in the tile
before, crowd below the odds that a look takes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.records import Detection, Tile
from auv_mcm.settings.budget_settings import BudgetConfig

EXAMINED_PER_LOOK: Final = 0.23
"""Share of looks that the verifier lets go on to an examination: 118 of 513 on the named scene `rough`."""
MOVES_PER_LOOK: Final = 150
"""Moves of contour nodes that an examination makes, on average on the named scene `rough`: 150 there."""
HYPOTHESES_PER_LOOK: Final = 7300
"""Hypotheses on solids that an examination weighs, on average on the named scene `rough`: 7310 there."""
CHEAPER_STAGE_WORTH: Final = 0.5
"""Share of coverage that is left where a stage stopped at its cheaper predecessor: contrasts without the cascade, the
cascade without an examination. Measured by `auv-mcm bench chain --knobs budget`: see docs/results.md."""
RESERVED_LOOKS: Final = 2
"""Close looks without which windows are not begun: the cascade without any look found less at equal false alarms than
clear contrasts (Pd of 0.05 and 0.14 at 10 per km² on flat, ripple and rough)."""
_US_PER_S: Final = 1e6  # microseconds per second


class Allowance(NamedTuple):
    """Hold what may be spent on a tile, µs of work by the price list; infinite without a limit.

    total_us: the tile's budget. cheapest_us: price of the cheapest pass, which is always done, measuring left out.
    has_verifier: whether it decides which detections are examined.
    """

    total_us: float
    cheapest_us: float
    prices: BudgetConfig
    has_verifier: bool = True

    @property
    def left_us(self) -> float:
        """Return what is left beyond the cheapest pass, µs."""
        return max(self.total_us - self.cheapest_us, 0.0)

    @property
    def is_limited(self) -> bool:
        """Find whether anything can be beyond the budget."""
        return self.total_us < math.inf

    def comparisons(self) -> int | None:
        """Count the comparisons that the cascade may make, beside the reserved looks; None without a limit."""
        left_us = max(self.left_us - RESERVED_LOOKS * look_price_us(self.prices, self.has_verifier), 0.0)
        return math.floor(left_us / self.prices.comparison_us) if self.is_limited else None

    def n_looks(self, n_evaluations: int, n_measured: int) -> int:
        """Close looks that are paid after so many comparisons and so many peaks measured, the reserved ones first."""
        left_us = self.left_us - n_evaluations * self.prices.comparison_us - n_measured * self.prices.peak_us
        look_us = look_price_us(self.prices, self.has_verifier)
        return max(math.floor(left_us / look_us), min(RESERVED_LOOKS, math.floor(self.left_us / look_us)))


def look_price_us(prices: BudgetConfig, has_verifier: bool = True) -> float:
    """Price a look, µs: an opinion, contours, Markov field and solids, as much of each as a look takes on average."""
    moves_us, hypotheses_us = MOVES_PER_LOOK * prices.contour_move_us, HYPOTHESES_PER_LOOK * prices.hypothesis_us
    examination_us = prices.field_us + moves_us + hypotheses_us
    return prices.opinion_us + EXAMINED_PER_LOOK * examination_us if has_verifier else examination_us


def tile_allowance(
    tile: Tile, n_samples: float, n_sides: int, budget: BudgetConfig, room: float = 1.0, has_verifier: bool = True
) -> Allowance:
    """Give a tile its budget.

    The time that the vehicle took to sail past its core, times the duty, over the number of sides.

    A tile whose times are unknown has no time: the cheapest pass is all that is done.

    Parameters
    ----------
    n_samples
        Stored samples that went into it.
    room
        Share of that time, 0 to 1, that a service which is behind has left; 1 changes nothing.
    has_verifier
        Whether a verifier decides which detections are examined.
    """
    n_pixels = (tile.core_stop - tile.core_start) * tile.mask.shape[1]
    cheapest_us = n_samples * budget.sample_us + n_pixels * budget.pixel_us
    if budget.duty is None and room >= 1.0:
        return Allowance(math.inf, cheapest_us, budget, has_verifier)
    duty = (1.0 if budget.duty is None else budget.duty) * min(max(room, 0.0), 1.0)
    return Allowance(duty * tile_duration_s(tile) * _US_PER_S / max(n_sides, 1), cheapest_us, budget, has_verifier)


def tile_duration_s(tile: Tile) -> float:
    """Time that passed over the core of a tile, s; 0 where it is unknown."""
    times = tile.pose.time_s[tile.core_start : tile.core_stop]
    times = times[np.isfinite(times)]
    n_rows = tile.core_stop - tile.core_start
    if len(times) < 2:
        return 0.0
    # Rows stand for the time around them: n rows last for n steps, not n - 1.
    return max(float(times.max() - times.min()), 0.0) * n_rows / max(n_rows - 1, 1)


def pay_looks(
    result: TileDetections, allowance: Allowance, p_mine: Callable[[Detection], float], min_p_mine: float
) -> TileDetections:
    """Let the likeliest detections of a tile have an examination, as many as are paid.

    Returns also what share of its coverage is earned. p_mine: of a detection before it is examined, independent of
    other tiles; the others beyond those paid, of at least min_p_mine, lose their surroundings, without which there is
    none. None is paid where windows were cut.
    """
    if not allowance.is_limited:
        return result
    p_each = [p_mine(detection) for detection in result.detections]
    wanted = sorted((k for k, p in enumerate(p_each) if p >= min_p_mine), key=lambda k: (-p_each[k], k))
    n_looks = 0 if result.n_cut else allowance.n_looks(result.n_evaluations, len(result.detections))
    beyond = frozenset(wanted[n_looks:])
    total = math.fsum(p_each[k] for k in wanted)
    left_out = math.fsum(p_each[k] for k in wanted[n_looks:]) / total if total > 0.0 else 0.0
    return result._replace(
        detections=tuple(
            msgspec.structs.replace(detection, surroundings=None) if k in beyond else detection
            for k, detection in enumerate(result.detections)
        ),
        covered_share=covered_share(result.n_windows, result.n_cut, 1.0 - left_out),
    )


def covered_share(n_windows: int, n_cut: int, looked_at: float) -> float:
    """Give the share of a tile's coverage that is earned, 0 to 1, when n_cut of n_windows were cut.

    looked_at: share of the mines to be expected among detections worth an examination that had one; 0 where windows
    were cut, since none is made there and nothing is known of those that would be worth one. More windows and more
    examinations never earn less.
    """
    cut = n_cut / n_windows if n_windows else 0.0
    looked_at = 0.0 if n_cut else looked_at
    return (1.0 - (1.0 - CHEAPER_STAGE_WORTH) * cut) * (1.0 - (1.0 - CHEAPER_STAGE_WORTH) * (1.0 - looked_at))
