"""What Linux reports of processes and temperatures, and what it does not."""

from __future__ import annotations

import math
import os
from pathlib import Path

from auv_mcm.shell.health.measure import measure_computer, measure_process, perception_process


def zone(thermal: Path, number: int, degrees: str, **trips: str) -> None:
    folder = thermal / f"thermal_zone{number}"
    folder.mkdir(parents=True)
    (folder / "temp").write_text(degrees)
    for n, (kind, limit) in enumerate(trips.items()):
        (folder / f"trip_point_{n}_type").write_text(kind + "\n")
        (folder / f"trip_point_{n}_temp").write_text(limit)


def test_this_process_has_memory_and_has_been_busy() -> None:
    found = measure_process(os.getpid())
    assert found is not None
    assert found.busy_s > 0.0
    assert found.memory_bytes > 1e6


def test_a_name_with_spaces_and_brackets_does_not_shift_the_numbers(tmp_path: Path) -> None:
    (tmp_path / "7").mkdir()
    fields = ["S", *(str(number) for number in range(4, 30))]  # numbered as proc(5) does, from 3
    (tmp_path / "7" / "stat").write_text(f"7 (a ) b) {' '.join(fields)}")
    found = measure_process(7, tmp_path)
    assert found is not None
    assert found.busy_s == (14 + 15) / os.sysconf("SC_CLK_TCK")
    assert found.memory_bytes == 24 * os.sysconf("SC_PAGE_SIZE")


def test_a_process_that_is_gone_or_unreadable_is_not_measured(tmp_path: Path) -> None:
    (tmp_path / "8").mkdir()
    (tmp_path / "8" / "stat").write_text("8 (cut")
    assert measure_process(8, tmp_path) is measure_process(9, tmp_path) is measure_process(None, tmp_path) is None
    assert perception_process() is None


def test_the_zone_nearest_to_its_limit_counts(tmp_path: Path) -> None:
    zone(tmp_path / "thermal", 0, "80000", active="60000", critical="110000")
    zone(tmp_path / "thermal", 1, "70000", passive="75000", hot="90000")
    zone(tmp_path / "thermal", 2, "no number", passive="1000")
    found = measure_computer(tmp_path, tmp_path / "thermal")
    assert (found.temperature_c, found.hot_c) == (70.0, 75.0)
    assert found.free_bytes > 0.0


def test_a_zone_without_a_limit_is_never_hot(tmp_path: Path) -> None:
    zone(tmp_path / "thermal", 0, "95000", passive="0", critical="-1000")
    found = measure_computer(tmp_path, tmp_path / "thermal")
    assert (found.temperature_c, found.hot_c) == (95.0, math.inf)


def test_a_computer_that_states_nothing_is_not_known(tmp_path: Path) -> None:
    found = measure_computer(tmp_path / "absent", tmp_path / "thermal")
    assert math.isnan(found.temperature_c)
    assert math.isnan(found.free_bytes)
