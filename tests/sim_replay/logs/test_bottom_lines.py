"""Bottom lines corrected by hand: kept beside their log, used by replay, and refused where they belong to another."""

from __future__ import annotations

import json
import os
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.cli import main
from auv_mcm.records import Notice, Ping
from auv_mcm.settings.config import Config
from sim_replay.closing_line import closing_line
from sim_replay.log_info import describe
from sim_replay.logs.bottom_lines import FoundLine, bottom_line_path, corrected, line_of, write_bottom_line
from sim_replay.logs.log_reader import Log
from sim_replay.logs.open_log import open_log
from sim_replay.logs.recorded import open_mission
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.replay import replay
from sim_replay.results_folder import is_replayed
from sim_replay.simulator.mission import Mission
from tests.sim_replay.test_replay import content, scene

START_S = 1_700_000_000.0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("logs") / "line.xtf"
    write_xtf(path, Mission(scene(START_S, 0.0)).events())
    return path.read_bytes()


@pytest.fixture
def log(written: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "line.xtf"
    path.write_bytes(written)
    return path


def correct(log: Path, *stretches: list[tuple[float, float]]) -> Path:
    return write_bottom_line(log, line_of(open_log(log, Config()), "kim", START_S, stretches))


def returns_m(log: Path) -> list[float]:
    events = open_mission([log], Config()).events()
    return [event.first_return_m for event in events if isinstance(event, Ping)]


def test_a_replay_with_a_corrected_line_says_so_and_is_the_same_every_time(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replay([log], tmp_path / "before", Config())
    assert is_replayed(tmp_path / "before", Config())
    place = correct(log, [(START_S + 1.0, 3.0), (START_S + 4.0, 3.6)])
    assert not is_replayed(tmp_path / "before", Config())
    summaries = [replay([log], tmp_path / name, Config()) for name in ("one", "two")]
    assert content(tmp_path / "one") == content(tmp_path / "two") != content(tmp_path / "before")
    n_pings = summaries[0]["counters"]["bottom.corrected"]
    assert n_pings == np.isfinite(returns_m(log)).sum() == pytest.approx(45, abs=2)  # 3 s at 15 a second
    assert summaries[0]["bottom_lines"][0]["by"] == "kim"
    assert f"bottom line corrected by hand over {n_pings} pings" in closing_line(summaries[0])
    assert is_replayed(tmp_path / "two", Config())
    assert main(["info", str(log)]) == 0
    assert f"corrected by hand by kim over {n_pings} pings: {place}" in capsys.readouterr().out
    # without its last stretch the file goes, and the answer is what it was
    assert not correct(log).exists()
    assert not is_replayed(tmp_path / "two", Config())
    assert "bottom_lines" not in replay([log], tmp_path / "after", Config())
    assert content(tmp_path / "after") == content(tmp_path / "before")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[:-20], "is not a corrected bottom line"),
        (lambda text: text.replace("first_return_m", "altitude"), "is not a corrected bottom line"),
        (lambda text: text.replace(": 3.0", ": -3.0"), "is not a corrected bottom line"),
        (lambda text: text.replace("21.000Z", "51.000Z"), "not in order of time"),
        (lambda text: text.replace("21.000Z", "21.000"), "no time zone"),
        (lambda text: text.replace('"bytes": ', '"bytes": 1'), "was made for another log, 'line.xtf'"),
        (lambda text: text.replace('"head_sha256": "', '"head_sha256": "0'), "was made for another log"),
        (lambda text: text.replace("2023", "2024"), "1 of 1 stretches in"),
    ],
)
def test_a_line_that_does_not_fit_its_log_is_said_and_not_used(log: Path, change: Any, words: str) -> None:
    place = correct(log, [(START_S + 1.0, 3.0), (START_S + 4.0, 3.6)])
    changed = change(place.read_text())
    assert changed != place.read_text()
    place.write_text(changed)
    mission = open_mission([log], Config())
    events = list(mission.events())
    assert not any(np.isfinite(event.first_return_m) for event in events if isinstance(event, Ping))
    (text,) = (event.text for event in events if isinstance(event, Notice) and event.code == "bottom_line_unused")
    assert words in text
    assert str(place) in text
    assert describe(log, Config())["notices"][-1]["code"] == "bottom_line_unused"


def test_a_line_beyond_what_its_pings_reach_is_counted_and_not_used(log: Path) -> None:
    correct(log, [(START_S + 1.0, 60.0), (START_S + 2.0, 60.0)])
    info = describe(log, Config())
    assert info["left_out"]["bottom.correction_beyond_range"] == pytest.approx(15, abs=2)
    assert "bottom_corrected" not in info["used"]


def test_no_link_or_pipe_stands_in_for_the_file(log: Path, tmp_path: Path) -> None:
    os.mkfifo(bottom_line_path(log))
    assert any("not a regular file" in notice.text for notice in open_mission([log], Config()).notices)
    bottom_line_path(log).unlink()
    (tmp_path / "other").write_text("kept")
    bottom_line_path(log).symlink_to(tmp_path / "other")
    correct(log, [(START_S + 1.0, 3.0), (START_S + 4.0, 3.6)])
    assert (tmp_path / "other").read_text() == "kept"


@given(
    steps=st.lists(st.tuples(st.floats(0.01, 9.0), st.floats(0.5, 30.0)), min_size=2, max_size=8),
    gap_s=st.floats(0.01, 9.0),
    pings=st.lists(st.floats(0.0, 160.0), min_size=1, max_size=20),
)
def test_pings_of_a_stretch_get_what_lies_between_its_points(
    steps: list[tuple[float, float]], gap_s: float, pings: list[float]
) -> None:
    times_s = np.cumsum([round(step, 3) for step, _ in steps])
    points = [(START_S + time_s, return_m) for time_s, (_, return_m) in zip(times_s.tolist(), steps, strict=True)]
    later = [(when_s + times_s[-1] + gap_s, return_m) for when_s, return_m in points]

    named = SimpleNamespace(sizes_bytes={Path(__file__): 1})
    line = line_of(cast(Log, named), "", 0.0, [later, points])
    given_s = sorted({START_S + round(when_s, 3) for when_s in pings})
    events = [Ping(number=n, time_s=when_s, port=None, starboard=None) for n, when_s in enumerate(given_s)]
    found = FoundLine(Path("line"), "", line)
    got = [event for event in corrected(events, found) if isinstance(event, Ping)]
    for ping in got:
        bounds = [(when_s, return_m) for when_s, return_m in [*points, *later]]
        around = [
            (low, high)
            for low, high in pairwise(bounds)
            if low[0] <= ping.time_s <= high[0] and (low, high) != (points[-1], later[0])
        ]
        if around:
            (low_s, low_m), (high_s, high_m) = around[0]
            share = (ping.time_s - low_s) / (high_s - low_s)
            assert ping.first_return_m == pytest.approx(low_m + share * (high_m - low_m), abs=0.02 * 30.0)
        elif all(abs(ping.time_s - when_s) > 2e-3 for when_s, _ in bounds):
            assert np.isnan(ping.first_return_m)


def test_the_file_is_small_and_for_people(log: Path) -> None:
    place = correct(log, [(START_S + 1.0, 3.0), (START_S + 4.0, 3.6)])
    assert place.name == "line.xtf.bottom-line.json"
    held = json.loads(place.read_text())
    assert held["stretches"] == [
        [
            {"time": "2023-11-14T22:13:21.000Z", "first_return_m": 3.0},
            {"time": "2023-11-14T22:13:24.000Z", "first_return_m": 3.6},
        ]
    ]
    assert held["by"] == "kim"
