"""Recordings with one odd property each: navigation, headings, clocks. Right within the limits of their notes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError
from auv_mcm.records import Contact
from auv_mcm.settings.config import Config, NavigationConfig
from drivers.navigation.corrections import offset_m
from sim_replay.logs.open_log import logs_config, open_log
from tests.make.odd_line import Result, chain

Located = Callable[[str], Path]

OBJECT = (43.0933700, 5.8874211)
COVERED_M2 = 530.0  # of the whole line of 90 pings, by its sound copy


def result_of(path: Path, config: Config | None = None) -> Result:
    config = config or logs_config([path]) or Config()
    log = open_log(path, config)
    log.first_time_s()
    return chain(log, config)


def off_m(contact: Contact) -> float:
    return math.hypot(*offset_m(OBJECT, (contact.latitude_deg, contact.longitude_deg)))


@pytest.mark.parametrize(
    ("name", "least_m2", "code"),
    [
        ("xtf-speed-zero/speed0.xtf", 480.0, None),
        ("xtf-speed-mps/speed_mps.xtf", 480.0, None),
        ("xtf-speed-too-high/speed_x3.xtf", 480.0, None),
        ("xtf-position-every-5-s/usbl5s.xtf", 440.0, None),
        ("xtf-nav-in-packets/nav107.xtf", 460.0, None),
        ("xtf-navunits-0-degrees/navunits0.xtf", 480.0, "reader.units_by_value"),
        ("xtf-no-clock/year0.xtf", 480.0, "reader.time_unknown"),
        ("xtf-sensor-position-frozen/frozen.xtf", 350.0, "reader.sensor_position_still"),
        ("jsf-before-version-8/v7.jsf", 480.0, None),
        ("jsf-sound-speed-elsewhere/sv2060.jsf", 480.0, None),
    ],
)
def test_the_object_is_found_and_the_floor_that_was_passed_is_covered(
    shared_data: Located, name: str, least_m2: float, code: str | None
) -> None:
    result = result_of(shared_data(f"wild/{name}"))
    (contact,) = (contact for contact in result.contacts if contact.p_mine > 0.5)
    assert off_m(contact) < 0.8  # of the sound copies: 0.44 m, as JSF 0.50 m
    assert least_m2 <= result.area_m2 <= 1.05 * COVERED_M2
    assert code is None or code in result.codes


def test_a_true_heading_by_ths_swings_the_contact_about_the_track(shared_data: Located) -> None:
    result = result_of(shared_data("wild/svlog-heading-ths/ths.svlog"))
    (contact,) = result.contacts
    assert off_m(contact) == pytest.approx(2.0 * 18.0 * math.sin(math.radians(7.5)), abs=1.0)


def test_metres_are_read_by_their_projection_and_refused_without_it(shared_data: Located) -> None:
    path = shared_data("wild/xtf-utm-metres/utm32n.xtf")
    pytest.importorskip("pyproj", reason="pyproj of the bench extra is not installed")
    (contact,) = result_of(path, Config(navigation=NavigationConfig(epsg=32632))).contacts
    assert off_m(contact) < 1.0
    with pytest.raises(BadInputError, match=r"navigation\.epsg"):
        open_log(path, Config())


@pytest.mark.parametrize(("name", "code"), [("utc-clock-ahead-60-s", None), ("utc-gps-week-rollover", "utc_rollover")])
def test_a_clock_that_utc_sets_back_costs_no_mission(shared_data: Located, name: str, code: str | None) -> None:
    result = result_of(shared_data(f"wild/{name}/session.mcap"))
    assert result.area_m2 == pytest.approx(2983.0, rel=0.05)
    assert code is None or code in result.codes
    assert all(contact.time_s > 1.79e9 for contact in result.contacts), "dated 2026"
