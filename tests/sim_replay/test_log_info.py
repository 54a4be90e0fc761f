"""What `auv-mcm info` says of a log is what is in it, and what a replay of it says."""

from __future__ import annotations

import json
import shutil
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.settings.config import Config
from sim_replay.log_info import describe
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, Sonar, Track
from sim_replay.wire_logs import write_jsf, write_session, write_svlog
from tests.sim_replay.logs.sonar_logs import mission, run_of
from tests.sim_replay.logs.xtf_logs import edit_headers


@pytest.fixture(scope="module")
def xtf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("xtf") / "mission.xtf"
    write_xtf(path, mission(), sample_type="float32", frequency_khz=450.0)
    return path


def info_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["info", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_the_numbers_are_those_of_the_mission(xtf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (info,) = info_of(capsys, str(xtf))["logs"]
    assert (info["format"], info["frequency_khz"]) == ("xtf", 450.0)
    assert info["pings"]["count"] == 212
    assert info["pings"]["rate_per_s"] == pytest.approx(12.5, rel=0.15)
    assert info["pings"]["gaps"]["count"] == 0
    for side in ("port", "starboard"):
        assert info["sides"][side]["samples"] == 800
        assert info["sides"][side]["range_m"] == pytest.approx(20.0, rel=0.02)
    navigation = info["navigation"]
    assert navigation["quantities"]["position"]["count"] > 100
    assert navigation["speed_mps"]["track"] == pytest.approx(navigation["speed_mps"]["stated"], rel=0.05)
    assert abs(navigation["heading_minus_course_deg"]) < 5.0
    assert info["altitude"]["stated_m"] == pytest.approx(5.0, abs=0.5)
    assert info["altitude"]["first_return_m"] == pytest.approx(5.0, abs=0.5)
    assert info["used"] == {"pings": 212, "pings_with_position": 212}


def test_what_an_image_lacks_is_listed_a_line_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "line.npy", np.ones((8, 8)))
    assert main(["info", str(tmp_path / "line.npy")]) == 3
    said = capsys.readouterr().out
    assert "\n  side: the side that the sonar looks to" in said
    assert "\\n" not in said


def test_a_clock_in_steps_of_10_ms_does_not_change_the_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = Scene(sonar=Sonar(range_m=12.0, ping_rate_hz=12.0, beam_lines=1), track=Track(plan=Lawnmower(n_legs=1)))
    write_xtf(tmp_path / "log.xtf", islice(Mission(scene).events(), 200))
    (info,) = info_of(capsys, str(tmp_path / "log.xtf"))["logs"]
    assert info["pings"]["rate_per_s"] == pytest.approx(12.0, rel=0.01)
    assert info["navigation"]["quantities"]["position"]["rate_per_s"] == pytest.approx(12.0, rel=0.01)


@pytest.mark.parametrize("kind", ["jsf", "svlog", "session", "folder of a session"])
def test_every_format_is_described(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if kind == "jsf":
        path = write_jsf(run_of("jsf"), tmp_path / "log")
    elif kind == "svlog":
        path = write_svlog(run_of("ping_protocol"), tmp_path / "log")
    else:
        path = write_session(run_of("jsf"), tmp_path / "recording")
        path = tmp_path if kind == "folder of a session" else path
    (info,) = info_of(capsys, str(path))["logs"]
    assert info["pings"]["count"] == 212
    assert info["navigation"]["quantities"]["position"]["count"] > 50
    assert info["navigation"]["sources"]["position"] in ("nmea", "compass")
    assert info["transfer"]


def test_a_compass_that_is_turned_round_is_180_degrees_off_the_course(xtf: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(xtf, tmp_path / "turned.xtf"))

    def turn(index: int, header: Any) -> None:
        header.SensorXcoordinate, header.SensorYcoordinate = 5.0, 43.0 + 2e-5 * max(index, 1)
        header.SensorHeading = 170.0 if index < 107 else 190.0

    edit_headers(path, turn)
    off_deg = describe(path, Config())["navigation"]["heading_minus_course_deg"]
    assert abs(off_deg) == pytest.approx(180.0, abs=11.0)


def test_notices_are_those_of_the_replay(xtf: Path, tmp_path: Path) -> None:
    path = tmp_path / "odd.xtf"
    shutil.copy(xtf, path)
    edit_headers(path, lambda index, header: setattr(header, "SensorPrimaryAltitude", 500.0))
    info = describe(path, Config())
    assert main(["replay", str(path), "--out", str(tmp_path / "results")]) == 0
    summary = json.loads((tmp_path / "results" / "summary.json").read_text())
    codes = {notice["code"] for notice in info["notices"]}
    assert "navigation.altitude_beyond_range" in codes
    assert codes <= {notice["code"] for notice in summary["notices"]}


def test_a_folder_of_logs_says_which_are_the_same(
    xtf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(xtf, tmp_path / "a.xtf")
    shutil.copy(xtf, tmp_path / "b.xtf")
    (tmp_path / "notes.txt").write_text("no log")
    found = info_of(capsys, str(tmp_path))
    assert len(found["logs"]) == 2
    assert [notice["code"] for notice in found["notices"]] == ["log_repeated"]


def test_text_is_for_people_and_what_cannot_be_read_is_said(
    xtf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log.xtf").write_bytes(b"\x1f\x8b\x08")
    (tmp_path / "empty").mkdir()
    assert main(["info", str(tmp_path / "empty"), str(xtf), str(tmp_path / "log.xtf")]) == 0
    printed = capsys.readouterr().out
    assert "212 pings of 800 samples (float32)" in printed
    assert "compressed (gzip). Unpack it" in printed
    assert "empty is a directory without a recorded session" in printed
    assert main(["info", str(tmp_path / "log.xtf")]) == 3
    assert main(["info", str(tmp_path / "nowhere")]) == 3
