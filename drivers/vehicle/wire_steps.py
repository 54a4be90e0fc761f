"""Round what is commanded to the steps of a wire, to the safe side: up, and slower."""

from __future__ import annotations

import math
from typing import Final

from drivers.vehicle.dialect import Vertical

_SAME_STEP: Final = 1e-6  # steps: a number this near to a whole one is that, whatever the rounding


def shallower(vertical: Vertical, step_m: float) -> Vertical:
    """Return a depth rounded down, or an altitude rounded up, to a whole number of steps, m."""
    if not math.isfinite(vertical.value_m):
        return vertical
    return vertical._replace(value_m=_stepped(vertical.value_m, step_m, up=vertical.reference == "altitude"))


def slower(speed_mps: float, step_mps: float) -> float:
    """Return a speed rounded down to a whole number of steps, m/s."""
    return _stepped(speed_mps, step_mps, up=False) if math.isfinite(speed_mps) else speed_mps


def _stepped(value: float, step: float, *, up: bool) -> float:
    steps = value / step
    nearest = round(steps)
    if abs(steps - nearest) > _SAME_STEP:
        nearest = math.ceil(steps) if up else math.floor(steps)
    return nearest * step
