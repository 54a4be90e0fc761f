"""The files of a mission: the map of clearance, and a plan only from a known pose."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from auv_mcm.records import NavSample
from auv_mcm.settings.config import Config
from auv_mcm.settings.vehicle_settings import VehicleConfig
from auv_mcm.shell.results import plan_waypoints, write_clearance
from auv_mcm.shell.tally import Tally
from tests.auv_mcm.classify import drawn_looks


def test_without_a_pose_there_is_no_plan_and_it_is_counted() -> None:
    counters: Counter[str] = Counter()
    assert plan_waypoints([], Tally(), Config(), counters) == ()
    assert counters == {"plan.start_pose_unknown": 1}


def test_no_way_point_of_the_results_lies_outside_the_fence_and_what_it_costs_is_counted() -> None:
    tally, counters = Tally(), Counter[str]()
    tally.add(NavSample(time_s=0.0, latitude_deg=43.0, longitude_deg=5.0, heading_rad=0.0))
    fence_deg = ((42.999, 4.999), (42.999, 5.001), (43.001, 5.001), (43.001, 4.999))
    contacts = [
        drawn_looks.contact(id=name, latitude_deg=latitude_deg, longitude_deg=5.0, p_mine=0.6, next_look_deg=(90.0,))
        for name, latitude_deg in (("C00001", 43.0002), ("C00002", 43.0012))
    ]
    fenced = Config(vehicle=VehicleConfig(fence_deg=fence_deg))
    everywhere, inside = (plan_waypoints(contacts, tally, config, counters) for config in (Config(), fenced))
    assert {point.contact_id for point in everywhere} == {"C00001", "C00002"}
    assert {point.contact_id for point in inside} == {"C00001"}
    assert all(42.999 < point.latitude_deg < 43.001 and 4.999 < point.longitude_deg < 5.001 for point in inside)
    assert counters == {"plan.outside_fence": 1}
    none = Counter[str]()
    plan_waypoints(contacts[:1], tally, fenced, none)
    assert list(none) == []


def test_a_map_of_clearance_comes_with_its_picture_and_goes_where_nothing_was_searched(tmp_path: Path) -> None:
    write_clearance(tmp_path, None, b"picture")
    assert json.loads((tmp_path / "clearance.geojson").read_text())["features"] == []
    assert (tmp_path / "clearance.png").read_bytes() == b"picture"
    write_clearance(tmp_path, None, b"")
    assert not (tmp_path / "clearance.png").exists()
