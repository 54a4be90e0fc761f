"""The benches, as a person runs them."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.cli import main
from auv_mcm.confirmation import confirm_detection
from auv_mcm.settings.config import Config
from sim_replay.benches.confirmation import EFFORTS, look_costs_s, p_mine_by_effort
from sim_replay.commands.bench import BENCHES, FROZEN
from tests.auv_mcm.test_confirmation import detection_in, mine
from tests.sim_replay.logs.xtf_logs import written

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("bench", BENCHES)
def test_every_bench_that_is_offered_explains_itself(bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", bench, "--help"])
    assert ended.value.code == 0
    assert f"auv-mcm bench {bench}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "--repeat", "0"],
        ["simulate", "--minutes", "nan"],
        ["library", "--seeds", "-3"],
        ["detect", "--repeat", "many"],
    ],
)
def test_numbers_that_nothing_can_be_measured_with_are_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", *arguments])
    assert ended.value.code == 2
    assert f"'{arguments[-1]}' is no" in capsys.readouterr().err


@pytest.mark.parametrize("study", FROZEN)
def test_a_finished_study_says_where_it_is(study: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", study, "--markdown"]) == 2
    assert f"'{study}' is a finished study, kept in the sources at the tag studies-1" in capsys.readouterr().err


def test_a_bench_loads_no_other_ones_modules() -> None:
    code = (
        "import sys; from auv_mcm.cli import main\n"
        "try: main(['bench', 'detect', '--help'])\n"
        "except SystemExit: print(sorted(name for name in sys.modules if name.startswith('sim_replay.benches')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines()[-1] == str([f"sim_replay.benches{name}" for name in ("", ".detect", ".log")])


def test_detect_prints_what_each_step_costs_per_pixel_and_peak(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "detect", str(written(tmp_path / "log.xtf", 150)), "--repeat", "1"]) == 0
    printed = capsys.readouterr().out
    assert "log: log.xtf" in printed
    assert all(step in printed for step in ("weigh contrasts", "find peaks", "measure peaks"))


def test_waterfall_prints_costs_per_stage_of_a_short_and_a_long_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["bench", "waterfall", str(written(tmp_path / "log.xtf", 150)), "--repeat", "1", "--minutes", "0.5"]) == 0
    )
    printed = capsys.readouterr().out
    assert all(
        word in printed for word in ("waterfall", "detect", "total", "short", "long", "x real time", "--exhaustive")
    )


def test_confirmation_prints_how_many_looks_a_log_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "confirmation", str(written(tmp_path / "log.xtf", 150)), "--repeat", "1"]) == 0
    printed = capsys.readouterr().out
    assert "log.xtf: " in printed
    assert all(word in printed for word in ("looks", "median ms", "p99 ms", "best of 1"))


def test_the_cost_of_a_look_is_that_of_its_steps_by_the_clock_given() -> None:
    ticks = itertools.count()
    costs = look_costs_s(detection_in(mine("sphere", 3, width_m=0.8)), Config(), 2, lambda: float(next(ticks)))
    once = dict.fromkeys(("survey", "first contours", "field", "second contours", "solids", "whole look"), 1.0)
    assert costs == {**once, "features": 2.0}


def test_a_search_as_it_is_moves_no_look() -> None:
    detection, config = detection_in(mine("sphere", 3, width_m=0.8)), Config()
    p_mine = p_mine_by_effort(detection, config)
    looked_at = confirm_detection(detection, config.sonar.beam_width_rad, shipped_odds("contrast"), config.confirm)
    assert len(p_mine) == len(EFFORTS)
    assert p_mine[0] == looked_at.p_mine
