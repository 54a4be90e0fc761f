"""Mines are announced while the vehicle is still near them."""

from __future__ import annotations

from pathlib import Path

from sim_replay.benches.run_time.latency import first_waits
from sim_replay.benches.run_time.lines import fly_scene, with_short_legs
from sim_replay.simulator.scene_file import read_scene


def test_nearly_all_views_that_end_as_called_are_announced_in_time_on_a_rough_floor(tmp_path: Path) -> None:
    """20 of 20 are; 16 were while the early look left out more than the finished tile does."""
    waits = first_waits(fly_scene(with_short_legs(read_scene("rough"), 9400), "rough", "rough", tmp_path))
    assert len(waits) >= 18
    assert sum(wait.is_in_time for wait in waits) >= len(waits) - 1
