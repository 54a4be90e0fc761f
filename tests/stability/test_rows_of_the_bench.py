"""Every row of `auv-mcm bench all --stress`, with few inputs, within the bound that its table states."""

from __future__ import annotations

import math
from pathlib import Path

import mpmath
import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.geometry.shadow import shadow_height_m
from sim_replay.benches.every_stage import bench
from sim_replay.benches.every_stage.stages import every_row
from sim_replay.benches.stability.rows import Found, NumberRow, Watch, measure_row, relative

ROWS = {row.name: row for row in every_row()}


@pytest.mark.parametrize("name", ROWS)
def test_no_stage_is_farther_from_exact_arithmetic_than_its_row_says(name: str) -> None:
    result = measure_row(ROWS[name], quick=True)
    assert result.holds, result


def test_every_row_has_a_name_of_its_own() -> None:
    assert len(ROWS) == len(every_row())


def row_of(error: float, raises: bool = False) -> NumberRow:
    def measure(watch: Watch, quick: bool) -> Found:
        if raises:
            watch(lambda: np.float64(1.0) / np.zeros(1))
        return Found(error)

    return NumberRow("made here", "nothing", "itself", "m", 1e-9, measure)


@pytest.mark.parametrize(
    ("row", "code"), [(row_of(1e-10), 0), (row_of(1e-8), 5), (row_of(math.inf), 5), (row_of(0.0, raises=True), 5)]
)
def test_a_row_that_fails_ends_the_bench_with_code_5(
    row: NumberRow, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "every_row", lambda: [row])
    assert main(["bench", "all", "--stress", "--quick", "--json", str(tmp_path / "found.json")]) == code
    assert ("FAILED" in capsys.readouterr().out) == (code == 5)
    (written,) = bench.read_every_stage(tmp_path / "found.json").stress
    assert (written.bound, written.holds) == (1e-9, code == 0)


def test_short_shadows_keep_the_digits_of_their_height() -> None:
    """Shadows of a micrometre at 150 m lost ten of sixteen digits to a difference of two ranges."""
    found = shadow_height_m(0.3, 150.0, 150.000001)
    with mpmath.workdps(50):
        near, far = (mpmath.hypot(mpmath.mpf(place), mpmath.mpf(0.3)) for place in (150.0, 150.000001))
        assert relative([found], [mpmath.mpf(0.3) * (1 - near / far)]) < 1e-15


def test_the_older_name_measures_the_same(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(bench, "every_row", lambda: [row_of(1e-10)])
    assert main(["bench", "stability", "--quick"]) == 0
    assert "1 of 1 rows hold" in capsys.readouterr().out
