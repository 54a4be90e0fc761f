"""Number the legs of a mission, for a mosaic of each."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from auv_mcm.records import Tile

LEG_TURN_RAD: Final = math.radians(60.0)  # chosen: legs of a survey lie at right angles or opposite


def leg_numbers() -> Callable[[Tile], int]:
    """Make what numbers the leg of each tile, in order: a new leg begins where the course differs by LEG_TURN_RAD."""
    number, course_rad = 1, math.nan

    def number_of(tile: Tile) -> int:
        nonlocal number, course_rad
        heading = tile.pose.heading_rad[tile.core_start : tile.core_stop]
        known = heading[np.isfinite(heading)]
        if not len(known):
            return number
        here = math.atan2(float(np.sin(known).mean()), float(np.cos(known).mean()))
        if abs(math.remainder(here - course_rad, 2.0 * math.pi)) > LEG_TURN_RAD:
            number += 1
        elif not math.isnan(course_rad):
            return number
        course_rad = here
        return number

    return number_of
