"""Leave out detections that show once more what their passage has shown as a likely mine.

The two ends of a cylinder may make a detection each, and in a turn the beam crosses an object twice. Suppression works
in pixels, before anything is known of either: it keeps both where they are apart by more than it joins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.contacts.ledger import SAME_PASSAGE_S, same_passage
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Detection

# m: the length of the longest mine listed. In twenty missions 22 of 343 mines found were called twice: 3 still are, by
# 1 m 13 would be, by 3 m 4, and as many are found.
_ONE_OBJECT_M: Final = 2.0


def without_repeats(
    detections: Sequence[Detection], before: Sequence[Detection]
) -> tuple[list[Detection], list[Detection]]:
    """Leave out what lies within two metres of a likelier mine of the same passage and side.

    Parameters
    ----------
    detections
        With all confirmation, in any order.
    before
        Likely mines that later detections may repeat, as the call before returned them.

    Returns
    -------
    kept
        Those not left out, in the order given.
    likely
        Likely mines among them and before, of the last SAME_PASSAGE_S.
    """
    likely = list(before)
    left_out: set[int] = set()
    if any(one.p_mine >= MINE_LIKE_P for one in (*detections, *before)):
        for index, one in sorted(enumerate(detections), key=lambda pair: _likeliest_first(pair[1])):
            if any(_repeats(one, other) for other in likely):
                left_out.add(index)
            elif one.p_mine >= MINE_LIKE_P:
                likely.append(one)
    kept = [one for index, one in enumerate(detections) if index not in left_out]
    newest_s = max((one.time_s for one in (*detections, *before)), default=-math.inf)
    return kept, [one for one in likely if abs(newest_s - one.time_s) < SAME_PASSAGE_S]


def _likeliest_first(one: Detection) -> tuple[float, float, str, float]:
    return -one.p_mine, one.time_s, one.side, one.column


def _repeats(one: Detection, other: Detection) -> bool:
    """Check whether a detection shows the object that a likelier one of its passage has shown."""
    if one.p_mine > other.p_mine or not same_passage(one, other):
        return False
    if one.side != other.side or one.squint_rad != other.squint_rad:
        return False
    frame = LocalFrame(latitude_deg=other.latitude_deg, longitude_deg=other.longitude_deg, height_m=0.0)
    east_m, north_m, _ = frame.to_enu(np.float64(one.latitude_deg), np.float64(one.longitude_deg), 0.0)
    return math.hypot(east_m, north_m) < _ONE_OBJECT_M
