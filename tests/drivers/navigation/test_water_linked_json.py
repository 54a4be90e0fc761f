"""Reports of a Water Linked DVL in JSON, by the device name that also reads its text."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from drivers.navigation.dvl_water_linked import WaterLinkedAttitude, message_of
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_protocols import text_decoder

NOW = Stamp(5, 7)
VELOCITY: dict[str, Any] = {
    "time": 119.5,
    "vx": 1.78,
    "vy": 0.02,
    "vz": 0.01,
    "fom": 0.002,
    "covariance": [[1e-5, 0, 0], [0, 1e-5, 0], [0, 0, 1e-5]],
    "altitude": 5.9,
    "transducers": [],
    "velocity_valid": True,
    "status": 0,
    "time_of_validity": 1_700_000_000_000_000,
    "time_of_transmission": 1_700_000_000_030_000,
    "format": "json_v3.1",
    "type": "velocity",
}
POSITION: dict[str, Any] = {
    "ts": 1_700_000_000.0,
    "x": 12.4,
    "y": 64.8,
    "z": 1.8,
    "std": 0.002,
    "roll": 0.6,
    "pitch": 0.9,
    "yaw": 53.9,
    "type": "position_local",
    "status": 0,
    "format": "json_v3.1",
}


def line(report: Any) -> bytes:
    return json.dumps(report).encode() + b"\r\n"


def fixes(data: bytes, size: int = 1 << 20) -> tuple[list[NavFix], dict[str, int]]:
    unit = text_decoder("water_linked", "dvl")
    found = [fix for at in range(0, len(data), size) for fix in unit.feed(data[at : at + size], NOW)]
    return [*found, *unit.finish()], dict(unit.counters)


@pytest.mark.parametrize("size", [1, 7, 1 << 20])
def test_velocity_altitude_and_attitude_are_read(size: int) -> None:
    (velocity, attitude), counters = fixes(line(VELOCITY) + line(POSITION), size)
    assert velocity.speed_mps == pytest.approx(math.hypot(1.78, 0.02))
    assert velocity.altitude_m == 5.9
    assert velocity.time_utc_s == pytest.approx(1_700_000_000.0)
    assert velocity.age_s == pytest.approx(0.03)
    assert math.isnan(attitude.heading_rad), "the yaw counts from the last reset"
    assert math.degrees(attitude.pitch_rad) == pytest.approx(0.9)
    assert math.degrees(attitude.roll_rad) == pytest.approx(0.6)
    assert counters == {"water_linked.messages": 2}


def test_without_bottom_lock_there_is_no_speed() -> None:
    (fix,), counters = fixes(line({**VELOCITY, "velocity_valid": False, "altitude": -1}))
    assert not fix.valid
    assert math.isnan(fix.speed_mps)
    assert counters["water_linked.no_bottom_lock"] == 1


def test_the_format_before_types_is_read() -> None:
    later = ("type", "covariance", "time_of_validity", "time_of_transmission")
    (fix,), _ = fixes(line({name: value for name, value in VELOCITY.items() if name not in later}))
    assert fix.speed_mps == pytest.approx(1.78, abs=1e-3)
    assert (fix.time_utc_s, fix.age_s) == (None, 0.0)


def test_text_is_still_read_and_decides_as_well() -> None:
    record = WaterLinkedAttitude(1.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.1, 1.0, 0)
    text = message_of(record)
    (fix,), counters = fixes(text + line(VELOCITY), len(text))
    assert fix.pitch_rad == pytest.approx(0.1, abs=1e-4)
    assert fix.time_utc_s is None, "a second after power-up is no time of day"
    assert counters["water_linked.bytes_skipped"] > 100


@given(
    st.lists(
        st.sampled_from(
            [b"{", b"\xff\0w", b"[]\n", b"{}\n", b'{"vx": null}\n', b'{"type": 3}\n', b"[" * 5000 + b"\n", b"\n\r"]
            + [line({**VELOCITY, name: None}) for name in VELOCITY]
            + [line({**POSITION, name: "x"}) for name in POSITION]
        ),
        max_size=12,
    )
)
def test_no_junk_raises_or_hides_the_next_report(junk: list[bytes]) -> None:
    found, _ = fixes(line(VELOCITY) + b"".join(junk) + b"\n" + line(VELOCITY))
    assert len(found) >= 2
    assert found[-1].speed_mps == pytest.approx(1.78, abs=1e-3)


def test_an_endless_line_is_not_kept() -> None:
    found, counters = fixes(line(VELOCITY) + b"{" * 100_000 + b"\n" + line(VELOCITY), 1000)
    assert len(found) == 2
    assert counters["water_linked.refused.oversize"] == 1
