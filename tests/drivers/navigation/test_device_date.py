"""A time of day belongs to the day of the unit's clock, however long ago it said which."""

from __future__ import annotations

import pytest

from auv_mcm.clock import Stamp
from drivers.navigation.device_date import DAY_S, DeviceDate

NOON_S = 20_000.0 * DAY_S + 43_200.0


@pytest.mark.parametrize("later_s", [0.0, 40_000.0, 46_000.0, 3.0 * DAY_S])
def test_days_go_by_since_a_unit_said_its_date(later_s: float) -> None:
    """The computer's own date is wrong."""
    date = DeviceDate()
    assert date.dated(20_000.0, 43_200.0, Stamp(mono_ns=10**12, utc_ns=0)) == NOON_S
    later = Stamp(mono_ns=10**12 + round(later_s * 1e9), utc_ns=0)
    assert date.nearest((43_200.0 + later_s) % DAY_S, later) == NOON_S + later_s
