"""Check the plain baseline: fair on easy floors, and never a crash."""

from __future__ import annotations

import math

import msgspec
import pytest

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample, Ping
from sim_replay.scoring.baseline import baseline_contacts
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import parse_scene

EASY = """
world: {relief_rms_m: 0.0, seabeds: [{type: sand, relief_rms_m: 0.0, texture_shape: 0, stones_per_ha: 0}]}
sonar: {ping_rate_hz: 12, n_samples: 512, range_m: 40, noise_db: -25, beam_lines: 1}
track: {altitude_m: 6, plan: {pattern: lawnmower, heading_deg: 30, n_legs: 1, leg_m: 45}}
navigation_error: {position_sigma_m: 0, heading_bias_sigma_deg: 0, altitude_bias_percent: 0}
"""
TARGET = (
    "objects: [{kind: box, leg: 0, along_m: 22, across_m: ACROSS, length_m: 1.4, width_m: 1.0, height_m: 0.6, "
    "azimuth_deg: 30}]\n"
)


def flown(text: str) -> tuple[list[NavSample | Ping], Mission]:
    mission = Mission(parse_scene(text, "test"))
    return list(mission.events()), mission


@pytest.mark.parametrize("across_m", [-18.0, 22.0])
def test_an_obvious_target_on_an_easy_floor_is_called_where_it_lies(across_m: float) -> None:
    events, mission = flown(EASY + TARGET.replace("ACROSS", str(across_m)))
    (truth,) = mission.truth()["objects"]
    (contact,) = baseline_contacts(events)
    east, north, _ = LocalFrame(latitude_deg=truth["lat"], longitude_deg=truth["lon"]).to_enu(
        contact.latitude_deg, contact.longitude_deg, 0.0
    )
    assert math.hypot(east, north) < 1.0
    assert contact.p_mine >= 0.5
    assert contact.ground_range_m == pytest.approx(abs(across_m), abs=1.0)


def test_an_empty_easy_floor_has_no_call() -> None:
    events, _ = flown(EASY)
    assert baseline_contacts(events) == []


def test_nothing_comes_of_nothing() -> None:
    events, _ = flown(EASY)
    pings = [event for event in events if isinstance(event, Ping)]
    navigation = [event for event in events if isinstance(event, NavSample)]
    assert baseline_contacts([]) == []
    assert baseline_contacts(pings) == []
    assert baseline_contacts(navigation) == []
    assert baseline_contacts([*navigation, *pings[:3]]) == []
    assert baseline_contacts([*navigation, *(msgspec.structs.replace(ping, port=None) for ping in pings)]) == []


def test_pings_of_another_format_are_left_out() -> None:
    events, _ = flown(EASY + TARGET.replace("ACROSS", "22"))
    strange = next(event for event in events if isinstance(event, Ping))
    assert strange.port is not None
    assert strange.starboard is not None
    short = msgspec.structs.replace(
        strange,
        port=msgspec.structs.replace(strange.port, samples=strange.port.samples[:100]),
        starboard=msgspec.structs.replace(strange.starboard, samples=strange.starboard.samples[:100]),
    )
    assert baseline_contacts([*events, short]) == baseline_contacts(events)
