"""Suppress all but the best of detections close together, in metres over a whole pass, wherever tiles were cut.

Detections close together are one object seen more than once: the best one stays. Greedy suppression spreads along
chains, so a chain of neighbours is settled at once, when no later row can add to it or to its surroundings. Where
clutter is so dense that chains would never end, borders fixed on the mission grid end them; across a border the
stronger of two hides the weaker.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import crowding, odds_of, probability
from auv_mcm.detect.candidates import NO_FAINT_PLACES, FaintPlaces
from auv_mcm.detect.measure import ROWS_M
from auv_mcm.records import Detection
from auv_mcm.settings.config import DetectConfig

_SURROUNDINGS_M: Final = 8.0  # m around a detection within which those alike crowd it
_MAX_SHADOW_M: Final = 4.0  # m of shadow behind a detection that may hide another, maximum
_ALIKE: Final = 0.5  # standard deviations of strength that a neighbour may be weaker by
_CROWDED: Final = 6  # neighbours from which the reason is given; display only, the odds fall gradually
_LONGEST_OBJECT_M: Final = 4.0 * ROWS_M  # more than half of the longest that is measured reaches beyond its middle

_LINK_M: Final = 2.5  # m between neighbours of a chain; detections closer than that are one structure
_BORDER_M: Final = 60.0  # m of track between the borders that end chains: bounds delay and memory
_STRUCTURE_MEMBERS: Final = 6  # detections of a chain, from which it may be a structure
_STRUCTURE_LARGE: Final = 2  # of them longer than any mine
_STRUCTURE_P: Final = 0.02  # p_mine that remains to a part of a structure; chosen, not measured
_OUTLINE_STEP_M: Final = 2.5  # m between the detections that outline a structure
_ALONE_P: Final = 0.1  # p_mine from which a mine-sized detection stays beside a structure; chosen, not measured
_BESIDE_STRUCTURE_ODDS: Final = 0.7  # nats of log-odds that it loses there; chosen, not measured


class Suppressor:
    """Settle the detections of one side in the order of rows.

    Feed every tile's detections with the row where its core stops.
    """

    def __init__(self, config: DetectConfig, row_spacing_m: float, counters: Counter[str]) -> None:
        self._config = config
        self._row_m = row_spacing_m
        self._counters = counters
        self._link_m = max(_LINK_M, config.suppression_m)
        self._waiting: list[Detection] = []
        # As they came: settled, but still surroundings of waiting ones or of those to come.
        self._recent: list[Detection] = []
        self._faint = NO_FAINT_PLACES
        self.settled_to_row = -math.inf
        """Everything before this row of the mission grid is settled."""

    def add(
        self, detections: tuple[Detection, ...], complete_to_row: float, faint: FaintPlaces = NO_FAINT_PLACES
    ) -> list[Detection]:
        """Take a tile's detections; return those that are final now, in order of rows.

        Parameters
        ----------
        faint
            Places that are no detections but crowd them, on the mission grid.
        complete_to_row
            Mission grid row before which no later tile has a score peak; the object a peak belongs to may have its
            centre up to ROWS_M before it.
        """
        self._waiting = sorted([*self._waiting, *detections], key=_order)
        self._faint = FaintPlaces(*(np.concatenate(pair) for pair in zip(self._faint, faint, strict=True)))
        return self._settle(complete_to_row)

    def flush(self) -> list[Detection]:
        """Settle everything left at the end of a segment."""
        settled = self._settle(math.inf)
        self._recent = []
        self._faint = NO_FAINT_PLACES
        return settled

    def _settle(self, complete_to_row: float) -> list[Detection]:
        surroundings = max(_SURROUNDINGS_M, self._link_m) / self._row_m
        known_to = complete_to_row - ROWS_M / self._row_m
        horizon = known_to - surroundings
        known = [*self._recent, *self._waiting]
        around = _Neighbours.of(known, self._faint)
        settled: list[Detection] = []
        waiting: list[Detection] = []
        for chain in _chains(self._waiting, self._link_m):
            if max(d.row for d in chain) >= horizon:
                waiting += chain
                continue
            best = [
                d for d in self._best_of(chain, self._config.suppression_m) if not self._hidden_across_border(d, around)
            ]
            if _is_structure(chain, self._config.max_object_m):
                best = _outline(best, chain)
            self._counters["detect.suppressed"] += len(chain) - len(best)
            settled += [self._in_surroundings(detection, around) for detection in best]
        self._waiting = sorted(waiting, key=_order)
        self.settled_to_row = min([horizon, *(d.row for d in waiting)])
        first_needed = min([known_to, *(d.row for d in waiting)]) - surroundings
        still_waiting = {id(d) for d in waiting}
        self._recent = [d for d in known if d.row >= first_needed and id(d) not in still_waiting]
        needed = self._faint.rows >= first_needed
        self._faint = FaintPlaces(*(values[needed] for values in self._faint))
        return sorted(settled, key=_order)

    def _best_of(self, chain: list[Detection], reach_m: float) -> list[Detection]:
        kept: list[Detection] = []
        for detection in sorted(chain, key=_strongest_first):
            if not any(_same_object(detection, better, reach_m) for better in kept):
                kept.append(detection)
        return kept

    def _hidden_across_border(self, detection: Detection, around: _Neighbours) -> bool:
        stretch = _stretch(detection)
        return any(
            _strongest_first(other) < _strongest_first(detection)
            and _same_object(detection, other, self._config.suppression_m)
            for other in around.on_other_stretches(detection, stretch)
        )

    def _in_surroundings(self, detection: Detection, around: _Neighbours) -> Detection:
        """Lower the odds of the detection by others about as strong within a few metres."""
        distance_m = around.distance_m(detection)
        alike = around.strength >= detection.strength - _ALIKE
        n_alike = int(
            np.count_nonzero(alike & (distance_m > self._config.suppression_m) & (distance_m < _SURROUNDINGS_M))
        )
        reasons = (*detection.reasons, "crowded") if n_alike >= _CROWDED else detection.reasons
        return msgspec.structs.replace(
            detection, p_mine=probability(odds_of(detection.p_mine) - crowding(n_alike)), reasons=reasons
        )


class _Neighbours(NamedTuple):
    """Hold detections and, behind them in each array, the faint places beside them, (n,) each."""

    detections: list[Detection]
    stretches: NDArray[np.int64]
    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    strength: NDArray[np.float64]

    @staticmethod
    def of(detections: list[Detection], faint: FaintPlaces) -> _Neighbours:
        values = np.array([(d.row, d.column, d.strength) for d in detections]).reshape(-1, 3).T
        rows, columns, strength = (np.concatenate(pair) for pair in zip(values, faint, strict=True))
        stretches = np.array([_stretch(d) for d in detections], dtype=np.int64)
        return _Neighbours(detections, stretches, rows, columns, strength)

    def on_other_stretches(self, detection: Detection, stretch: int) -> Iterator[Detection]:
        """Iterate over detections across a border from one that are near enough to be of the same object."""
        near = np.abs(self.rows[: len(self.detections)] - detection.row) * detection.row_spacing_m < _LONGEST_OBJECT_M
        return (self.detections[k] for k in np.flatnonzero(near & (self.stretches != stretch)))

    def distance_m(self, detection: Detection) -> NDArray[np.float64]:
        """Compute the distances of all from a detection, m, (n,)."""
        along_m = (self.rows - detection.row) * detection.row_spacing_m
        return np.hypot(along_m, (self.columns - detection.column) * detection.column_spacing_m)


def _stretch(detection: Detection) -> int:
    """Number the stretch of track between two borders."""
    return math.floor(detection.row * detection.row_spacing_m / _BORDER_M)


def _strongest_first(detection: Detection) -> tuple[float, float, float]:
    return -detection.strength, detection.row, detection.column


def _distance_m(a: Detection, b: Detection) -> float:
    return math.hypot((a.row - b.row) * a.row_spacing_m, (a.column - b.column) * a.column_spacing_m)


def _same_object(detection: Detection, better: Detection, reach_m: float) -> bool:
    along_m = abs(detection.row - better.row) * better.row_spacing_m
    across_m = (detection.column - better.column) * better.column_spacing_m
    # A better detection's shadow, the gap before it and its far edge belong to the same object.
    shadow_m = better.shadow_length_m if math.isfinite(better.shadow_length_m) else 0.0
    behind_m = reach_m + min(shadow_m, _MAX_SHADOW_M)
    # So do the ends of a long one, whose score peaks near its middle.
    beside_m = reach_m if "too_large" in better.reasons else max(reach_m, 0.5 * (better.length_m + reach_m))
    return along_m < beside_m and -reach_m < across_m < behind_m


def _outline(kept: list[Detection], chain: list[Detection]) -> list[Detection]:
    """Reduce a structure to a few detections with its whole size, and to what is mine-like by itself.

    An object laid beside a wreck must not vanish in it, but a wreck must not fill the contact list either.
    """
    rows_m = [d.row * d.row_spacing_m for d in chain]
    columns_m = [d.column * d.column_spacing_m for d in chain]
    extents_m = (max(rows_m) - min(rows_m), max(columns_m) - min(columns_m))
    result: list[Detection] = []
    for detection in sorted(kept, key=_strongest_first):
        alone = "too_large" not in detection.reasons and detection.p_mine >= _ALONE_P
        if alone:
            odds = odds_of(detection.p_mine) - _BESIDE_STRUCTURE_ODDS
            result.append(
                msgspec.structs.replace(detection, p_mine=probability(odds), reasons=(*detection.reasons, "extended"))
            )
        elif all(_distance_m(detection, other) >= _OUTLINE_STEP_M for other in result if "too_large" in other.reasons):
            size = {"length_m": max(*extents_m, detection.length_m), "width_m": max(min(extents_m), detection.width_m)}
            reasons = tuple(dict.fromkeys((*detection.reasons, "too_large", "extended")))
            result.append(msgspec.structs.replace(detection, p_mine=_STRUCTURE_P, reasons=reasons, **size))
    return result


def _order(detection: Detection) -> tuple[float, float, float]:
    return detection.row, detection.column, -detection.strength


def _chains(detections: list[Detection], link_m: float) -> list[list[Detection]]:
    """Group detections so that each is within `link_m` of another on the same stretch.

    Groups are sorted by row as `detections` are.
    """
    parent = list(range(len(detections)))

    def root(index: int) -> int:
        while parent[index] != index:
            parent[index] = parent[parent[index]]
            index = parent[index]
        return index

    for index, detection in enumerate(detections):
        for other in range(index - 1, -1, -1):
            along_m = (detection.row - detections[other].row) * detection.row_spacing_m
            if along_m > link_m or _stretch(detection) != _stretch(detections[other]):
                break
            across_m = (detection.column - detections[other].column) * detection.column_spacing_m
            if math.hypot(along_m, across_m) <= link_m:
                a, b = sorted((root(index), root(other)))
                parent[b] = a
    groups: dict[int, list[Detection]] = {}
    for index, detection in enumerate(detections):
        groups.setdefault(root(index), []).append(detection)
    return list(groups.values())


def _is_structure(chain: list[Detection], max_object_m: float) -> bool:
    """Decide whether detections form a structure, such as a wreck or an outcrop.

    That is many over more than an object's length, several of them too large.
    """
    if len(chain) < _STRUCTURE_MEMBERS:
        return False
    rows_m = [d.row * d.row_spacing_m for d in chain]
    columns_m = [d.column * d.column_spacing_m for d in chain]
    extent_m = math.hypot(max(rows_m) - min(rows_m), max(columns_m) - min(columns_m))
    return extent_m > max_object_m and sum("too_large" in d.reasons for d in chain) >= _STRUCTURE_LARGE
