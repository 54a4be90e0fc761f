"""A pitch of the wrong sign is reported once; a right one, a level way and who hovers are not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from auv_mcm.geometry.navigation_watch import NavigationWatch
from auv_mcm.records import NavSample

RATE_HZ = 5.0
TRIM_RAD = math.radians(3.0)


def way(climb_m: float, pitch_sign: float, *, apart: bool = False, seed: int = 1) -> Iterator[NavSample]:
    """Sail up and down by climb_m over 80 m at 2 m/s, for 400 s; apart: each quantity in a sample of its own."""
    noise = np.random.default_rng(seed)
    turn = 2.0 * math.pi / 40.0
    for number in range(round(400.0 * RATE_HZ)):
        time_s = number / RATE_HZ
        path_rad = math.atan(-0.5 * climb_m * turn * math.cos(turn * time_s) / 2.0)
        fields: dict[str, Any] = {
            "depth_m": 15.0 + 0.5 * climb_m * math.sin(turn * time_s) + 0.05 * noise.standard_normal(),
            "pitch_rad": pitch_sign * path_rad + TRIM_RAD + 0.02 * noise.standard_normal(),
            "speed_mps": 2.0,
        }
        for part in [{name: value} for name, value in fields.items()] if apart else [fields]:
            yield NavSample(time_s=1.7e9 + time_s, **part)


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize(
    ("climb_m", "pitch_sign", "found"),
    [(6.0, -1.0, ["navigation.pitch_turned"]), (6.0, 1.0, []), (6.0, 0.0, []), (1.5, -1.0, []), (0.0, 1.0, [])],
)
def test_a_pitch_that_falls_where_the_vehicle_rises_is_reported_once(
    climb_m: float, pitch_sign: float, found: list[str], apart: bool
) -> None:
    watch = NavigationWatch()
    raised = [notice for sample in way(climb_m, pitch_sign, apart=apart) for notice in watch.add(sample)]
    assert [notice.code for notice in raised] == found
    assert all("pitch_sign" in notice.text for notice in raised)
