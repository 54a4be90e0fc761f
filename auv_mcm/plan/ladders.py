"""Lay sets of legs to begin with: evenly spaced parallel ones, in several layers where one set does not suffice.

A greedy choice by gain per metre takes legs that cross open area at its best places and leaves slivers, each of which
costs a leg of its own. Even spacing leaves none. Several spacings and headings are tried against ranges, sea floor and
ripples.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.plan.orienteering import Problem, Wanting
from auv_mcm.plan.tracks import MoreTime

_MAX_STAGES: Final = 4  # of ladders in a row; bounds time
_MAX_RUNGS: Final = 40  # legs of one ladder; bounds time
_VAIN: Final = 3  # spacings tried in a row without improvement
_MIN_LENGTH: Final = 0.3  # of the longest leg side by side with it, for a rung


class _Rungs(NamedTuple):
    """Hold legs of one heading, the longest on each line, from side to side."""

    leg: NDArray[np.int64]
    offset_m: NDArray[np.float64]
    low_m: float
    high_m: float


def laddered_legs(problem: Problem, tail_m: float, more_time: MoreTime) -> list[int]:
    """Find the ladders that finish soonest if what they leave open costs tail_m of track per square metre."""
    headings = range(int(problem.tracks.heading.max(initial=-1)) + 1)
    rungs = [found for heading in headings if (found := _rungs(problem, heading)) is not None]
    wanting = Wanting(problem)
    legs: list[int] = []
    left_m2 = min(float(-np.expm1(-problem.cells.need) @ problem.cells.weight_m2), problem.enough_m2)
    for _ in range(_MAX_STAGES):
        best_m, best_legs, best_gain_m2 = left_m2 * tail_m, [], 0.0
        for found in rungs:
            if legs and not more_time():
                break
            length_m, tried, gain_m2 = _best_ladder(problem, found, wanting, left_m2, tail_m, set(legs))
            if length_m < best_m:
                best_m, best_legs, best_gain_m2 = length_m, tried, gain_m2
        if not best_legs:
            break
        wanting.take_all(best_legs)
        legs += best_legs
        left_m2 -= best_gain_m2
        if not more_time():
            break
    return legs


def _rungs(problem: Problem, heading: int) -> _Rungs | None:
    tracks, cells = problem.tracks, problem.cells
    legs = np.flatnonzero(tracks.heading == heading)
    length_m = tracks.length_m[legs]
    order = np.lexsort((-length_m, tracks.line[legs]))
    _, first = np.unique(tracks.line[legs][order], return_index=True)
    longest = legs[order[first]]
    longest = longest[tracks.length_m[longest] >= _MIN_LENGTH * length_m.max(initial=0.0)]
    if not len(longest):
        return None
    course = float(tracks.run[longest[0], 0, 2])
    sine, cosine = math.sin(course), math.cos(course)
    offset_m = tracks.run[longest, 0, 0] * cosine - tracks.run[longest, 0, 1] * sine
    across = cells.east_m * cosine - cells.north_m * sine
    return _Rungs(longest, offset_m, float(across.min()), float(across.max()))


def _best_ladder(
    problem: Problem, rungs: _Rungs, wanting: Wanting, left_m2: float, tail_m: float, taken: set[int]
) -> tuple[float, list[int], float]:
    """Find the best ladder: track to the end, its legs, and their gain."""
    best_m, best_legs, best_gain_m2 = math.inf, list[int](), 0.0
    vain = 0
    for n in range(1, min(_MAX_RUNGS, len(rungs.leg)) + 1):
        better = False
        for share in (0.5, 0.0) if n > 1 else (0.5,):
            spacing_m = (rungs.high_m - rungs.low_m) / (n if share else n - 1)
            ideal = rungs.low_m + spacing_m * (np.arange(n) + share)
            at = np.unique(np.abs(rungs.offset_m - ideal[:, np.newaxis]).argmin(axis=1))
            legs = [leg for leg in rungs.leg[at].tolist() if leg not in taken]
            gain_m2 = min(wanting.copy().take_all(legs), left_m2)
            length_m = float(problem.tracks.length_m[legs].sum()) + (len(legs) - 1) * _turn_m(
                spacing_m, problem.turns.radius_m
            )
            total_m = length_m + (left_m2 - gain_m2) * tail_m
            if total_m < best_m:
                best_m, best_legs, best_gain_m2, better = total_m, legs, gain_m2, True
        vain = 0 if better else vain + 1
        if vain >= _VAIN:
            break
    return best_m, best_legs, best_gain_m2


def _turn_m(spacing_m: float, radius_m: float) -> float:
    """Estimate the turn from a rung to the next, m.

    It is half a circle and a straight, or a bulb of up to 7/6 of a full circle.
    """
    apart = spacing_m / (2.0 * radius_m)
    half = math.pi * radius_m
    return half + spacing_m - 2.0 * radius_m if apart >= 1.0 else half * (1.0 + (4.0 / 3.0) * (1.0 - apart))
