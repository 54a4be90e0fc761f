"""The files of a mission: the map of clearance, and a plan only from a known pose."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.shell.results import plan_waypoints, write_clearance
from auv_mcm.shell.tally import Tally


def test_without_a_pose_there_is_no_plan_and_it_is_counted() -> None:
    counters: Counter[str] = Counter()
    assert plan_waypoints([], Tally(), PlanConfig(), counters) == ()
    assert counters == {"plan.start_pose_unknown": 1}


def test_a_map_of_clearance_comes_with_its_picture_and_goes_where_nothing_was_searched(tmp_path: Path) -> None:
    write_clearance(tmp_path, None, b"picture")
    assert json.loads((tmp_path / "clearance.geojson").read_text())["features"] == []
    assert (tmp_path / "clearance.png").read_bytes() == b"picture"
    write_clearance(tmp_path, None, b"")
    assert not (tmp_path / "clearance.png").exists()
