"""Check that a state reported in pieces is combined, and forgotten in time."""

from __future__ import annotations

import math

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.vehicle.dialect import ReportedState
from drivers.vehicle.whereabouts import Whereabouts
from tests.drivers.vehicle.test_pilot import commanding

STAMP = Stamp(0, 0)


def test_every_quantity_is_known_for_so_long_after_it_was_reported() -> None:
    whereabouts = Whereabouts(valid_s=3.0)
    assert whereabouts.at(0.0) is None
    whereabouts.hear(ReportedState(STAMP, 54.0, 8.0, depth_m=20.0), 0.0)
    whereabouts.hear(ReportedState(STAMP, altitude_m=8.0), 2.0)
    state = whereabouts.at(3.0)
    assert state is not None
    assert (state.latitude_deg, state.longitude_deg, state.depth_m, state.altitude_m) == (54.0, 8.0, 20.0, 8.0)
    state = whereabouts.at(4.0)
    assert state is not None
    assert state.altitude_m == 8.0
    assert all(map(math.isnan, (state.latitude_deg, state.longitude_deg, state.depth_m, state.heading_rad)))
    assert whereabouts.position_s == 0.0


@pytest.mark.parametrize(
    "position_deg", [(0.0, 0.0), (NAN, 8.0), (54.0, NAN), (91.0, 8.0), (54.0, 181.0), (math.inf, 8.0)]
)
def test_positions_that_cannot_be_are_not_believed(position_deg: tuple[float, float]) -> None:
    whereabouts = Whereabouts(valid_s=3.0)
    whereabouts.hear(ReportedState(STAMP, *position_deg, depth_m=20.0), 0.0)
    state = whereabouts.at(0.0)
    assert state is not None
    assert math.isnan(state.latitude_deg)
    assert state.depth_m == 20.0
    assert all(map(math.isnan, whereabouts.position_deg))


def test_a_command_that_would_lead_too_deep_is_not_given_to_a_dialect_that_does_not_read_it_back() -> None:
    sea = commanding(10.0)
    n_commands = len(sea.dialect.commands)
    sea.reported["altitude_m"] = 200.0
    sea.tick(5.0)
    assert len(sea.dialect.commands) == n_commands
    assert sea.pilot.counters["vehicle.refused.commands_too_deep"] == 1
    assert sea.pilot.authority != "granted"
