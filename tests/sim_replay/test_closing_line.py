"""The one line that a replay ends with."""

from __future__ import annotations

from typing import Any

from sim_replay.closing_line import closing_line


def summary(**changes: Any) -> dict[str, Any]:
    return {
        "contacts_called": 7,
        "operating_point": {
            "asked_per_km2": 100.0,
            "searched_km2": 0.05,
            "area_too_small": False,
            "expected_per_km2": {"middle": 60.0, "low": 10.0, "high": 200.0},
        },
        "searched": {"km2": 0.0512, "p_detected_mean": 0.713},
        "notices": [],
    } | changes


def test_it_says_what_was_found_and_how_well_how_much_was_searched() -> None:
    assert closing_line(summary()) == (
        "7 contacts called mines, of which 3 are expected to be none; 0.0512 km² searched, where 71 % of mines are "
        "expected to be found."
    )


def test_one_contact_and_none_are_worded_as_such() -> None:
    assert closing_line(summary(contacts_called=1)).startswith("1 contact called mine, of which")
    assert closing_line(summary(contacts_called=0)).startswith("0 contacts called mines; ")


def test_calls_where_nothing_counts_as_searched_are_not_expected_to_be_right() -> None:
    point = summary()["operating_point"] | {"searched_km2": 0.0}
    assert closing_line(summary(operating_point=point, searched=None)) == (
        "7 contacts called mines; no sea floor searched."
    )


def test_it_names_what_a_person_should_mend_first() -> None:
    point = summary()["operating_point"] | {"area_too_small": True}
    notices = [{"code": code, "text": "", "place": ""} for code in ("nav.gap", "transfer.chosen")]
    line = closing_line(summary(operating_point=point, notices=notices))
    assert "To mend: set sonar.transfer" in line
    assert "too small for 100 false alarms per km²" in line


def test_a_log_without_positions_says_what_that_cost() -> None:
    point = summary()["operating_point"] | {"area_too_small": True}
    lost = {"operating_point": point, "searched": {}, "counters": {"detect.without_position": 94}}
    line = closing_line(summary(contacts_called=0, **lost))
    assert line.endswith("To mend: record positions, as 94 detections without one are left out.")


def test_a_log_whose_pings_and_positions_have_two_clocks_says_so() -> None:
    line = closing_line({"counters": {"navigation.ping_stale": 2634}})
    assert line.endswith("To mend: give pings and navigation one clock, as 2634 pings are not near a position in time.")


def test_a_mission_without_floor_or_odds_has_a_line_too() -> None:
    assert closing_line({}) == "0 contacts called mines; no sea floor searched."
