"""Every spoilt log through the command line: a clear refusal with exit code 3, or a whole replay that says what was
wrong with it.
"""

from __future__ import annotations

import json
import math
import os
import socket
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from auv_mcm.clean_text import is_clean
from auv_mcm.cli import main
from auv_mcm.records import EchoTrace, NavSample, Ping
from auv_mcm.settings.config import Config
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.results_folder import default_results, is_replayed
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from tests.sim_replay.logs.xtf_logs import edit_headers

Events = list[NavSample | Ping]
Spoil = Callable[[Events], Events]
REPLACE = msgspec.structs.replace


@cache
def mission() -> tuple[NavSample | Ping, ...]:
    target = SceneObject(kind="box", leg=0, along_m=12.0, across_m=9.0, length_m=0.9, width_m=0.7, height_m=0.45)
    sonar = Sonar(range_m=20.0, n_samples=400, ping_rate_hz=15.0, beam_lines=3)
    track = Track(plan=Lawnmower(heading_deg=20.0, n_legs=1, leg_m=24.0), altitude_m=5.0)
    return tuple(Mission(Scene(objects=(target,), sonar=sonar, track=track)).events())


def log_of(path: Path, events: Iterable[NavSample | Ping], sample_type: SampleType = "uint16") -> Path:
    write_xtf(path, events, sample_type=sample_type)
    return path


def replayed(log: Path, folder: Path) -> dict[str, object]:
    assert main(["replay", str(log), "--out", str(folder)]) == 0
    for name in (
        "contacts.geojson",
        "contacts.csv",
        "contacts.kml",
        "coverage.geojson",
        "waypoints.geojson",
        "report.html",
    ):
        assert (folder / name).stat().st_size > 0
    summary: dict[str, object] = json.loads((folder / "summary.json").read_bytes())
    return summary


def cut(samples: int) -> Callable[[EchoTrace | None], EchoTrace | None]:
    return lambda trace: None if trace is None else REPLACE(trace, samples=trace.samples[:samples])


def one_ping_shorter(events: Events) -> Events:
    shorter = cut(300)
    return [
        REPLACE(e, port=shorter(e.port), starboard=shorter(e.starboard))
        if isinstance(e, Ping) and e.number == 50
        else e
        for e in events
    ]


SPOILT: dict[str, tuple[Spoil, str]] = {
    "all-zero navigation": (
        lambda events: [
            REPLACE(e, latitude_deg=0.0, longitude_deg=0.0, heading_rad=0.0) if isinstance(e, NavSample) else e
            for e in events
        ],
        "navigation.ping_stale",
    ),
    "time going backwards": (
        lambda events: [
            REPLACE(e, time_s=e.time_s - (600.0 if index > len(events) // 2 else 0.0)) for index, e in enumerate(events)
        ],
        "ping.clock_stepped_back",
    ),
    "one channel only": (lambda events: [REPLACE(e, port=None) if isinstance(e, Ping) else e for e in events], ""),
    "a ping with another sample count": (one_ping_shorter, "reader.sample_count_change"),
}


@pytest.mark.parametrize("name", list(SPOILT))
def test_a_spoilt_log_is_replayed_to_its_end_and_says_what_was_wrong(name: str, tmp_path: Path) -> None:
    spoil, counter = SPOILT[name]
    summary = replayed(log_of(tmp_path / "spoilt.xtf", spoil(list(mission()))), tmp_path / "out")
    counters = summary["counters"]
    assert isinstance(counters, dict)
    assert summary["pings"] == sum(isinstance(event, Ping) for event in mission())
    if counter:
        assert counters.get(counter, 0) > 0, counters


def test_nan_in_navigation_is_bridged_and_counted(tmp_path: Path) -> None:
    log = log_of(tmp_path / "nan.xtf", mission())

    def forget(index: int, header: Any) -> None:
        if index % 20 < 5:
            header.SensorYcoordinate = header.SensorHeading = header.SensorPitch = math.nan

    edit_headers(log, forget)
    summary = replayed(log, tmp_path / "out")
    assert isinstance(summary["counters"], dict)
    assert summary["counters"]["reader.nan_navigation"] > 0
    assert "navigation.ping_stale" not in summary["counters"]


def test_a_log_cut_inside_a_packet_keeps_everything_before(tmp_path: Path) -> None:
    whole = log_of(tmp_path / "whole.xtf", mission()).read_bytes()
    log = tmp_path / "cut.xtf"
    log.write_bytes(whole[: len(whole) * 2 // 3 + 77])
    summary = replayed(log, tmp_path / "out")
    assert 0.6 < float(str(summary["pings"])) / sum(isinstance(event, Ping) for event in mission()) < 0.7
    assert "cut off" in json.dumps(summary["notices"])


def test_a_sample_type_that_changes_is_replayed_on(tmp_path: Path) -> None:
    """Two logs of one mission, the second in another sample type, as after a recorder was reconfigured."""
    middle = len(mission()) // 2
    first = log_of(tmp_path / "a.xtf", mission()[:middle])
    as_float = [
        REPLACE(
            event,
            **{
                side: REPLACE(trace, samples=trace.samples.astype(np.float32))
                for side in ("port", "starboard")
                if (trace := getattr(event, side))
            },
        )
        if isinstance(event, Ping)
        else event
        for event in mission()[middle:]
    ]
    second = log_of(tmp_path / "b.xtf", as_float, sample_type="float32")
    assert main(["replay", str(first), str(second), "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_bytes())
    assert summary["pings"] == sum(isinstance(event, Ping) for event in mission())


def refused(path: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["replay", str(path), "--out", str(folder)]) == 3
    printed = capsys.readouterr().err
    assert "Traceback" not in printed
    assert path.name in printed
    return printed


@pytest.mark.parametrize(
    ("name", "content"),
    [("empty.xtf", b""), ("noise.xtf", bytes(range(256)) * 20), ("half-a-header.xtf", b"\x7b" + bytes(500))],
)
def test_what_is_no_log_is_refused(
    name: str, content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    refused(path, tmp_path / "out", capsys)


def test_a_hostile_file_name_reaches_neither_console_nor_page_raw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "a\x1b[2J\nnotice: all is well<script>\u202e\udc80.xtf"
    # cut off, which a notice says with the name
    log.write_bytes(log_of(tmp_path / "plain.xtf", mission()).read_bytes()[:-100])
    folder = tmp_path / "out\x1b"
    summary = replayed(log, folder)
    assert "cut off" in json.dumps(summary["notices"])
    printed = "".join(capsys.readouterr())
    assert not [
        line for line in printed.splitlines() if not is_clean(line) or "all is well" in line.partition("a\\x1b[2J")[0]
    ]
    for name in ("report.html", "summary.json", "contacts.kml"):
        text = (folder / name).read_text("utf-8")
        assert [line for line in text.split("\n") if not is_clean(line)] == []
        assert "<script>\\u202e" not in text or name == "summary.json"
    assert r"a\x1b[2J\nnotice" in (folder / "report.html").read_text("utf-8")


def test_a_log_whose_name_is_no_utf8_is_found_from_its_results(tmp_path: Path) -> None:
    (old := tmp_path / "old").mkdir()
    log = log_of(old / "l\udce9g.xtf", mission())
    summary = replayed(log, old / "out")
    config = msgspec.convert(summary["config"], Config)
    assert is_replayed(old / "out", config)
    for damaged in ({"config": None}, {"logs": [{"path": str(log)}]}, {"logs": None}):  # as by hand
        rest = {name: value for name, value in (summary | damaged).items() if value is not None}
        (old / "out" / "summary.json").write_text(json.dumps(rest), "utf-8")
        assert not is_replayed(old / "out", config)
    (old / "out" / "summary.json").write_text(json.dumps(summary), "utf-8")
    assert default_results([log], old) == old / "l\udce9g-results"
    old.rename(new := tmp_path / "new")
    assert main(["export", str(new / "out"), "--geotiff", str(tmp_path / "mosaic.tif")]) == 0


def test_a_directory_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "folder.xtf"
    path.mkdir()
    assert "directory" in refused(path, tmp_path / "out", capsys)


def test_a_pipe_given_as_a_log_is_refused_without_waiting(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.xtf")
    assert "not a regular file" in refused(tmp_path / "pipe.xtf", tmp_path / "out", capsys)
    folder = tmp_path / "recording"
    folder.mkdir()
    os.mkfifo(folder / "session-00000.mcap")
    assert "not a regular file" in refused(folder, tmp_path / "out", capsys)
    config = tmp_path / "live.yaml"
    config.write_text(f"service: {{source: 'replay://{tmp_path}/pipe.xtf', output_directory: '{tmp_path}/live'}}\n")
    assert main(["run", "--config", str(config)]) == 3
    assert "not a regular file" in capsys.readouterr().err


def test_a_device_or_a_socket_given_as_a_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket.xtf"))
        for path in (tmp_path / "socket.xtf", Path("/dev/zero"), Path("/dev/tty")):
            assert "not a regular file" in refused(path, tmp_path / "out", capsys)


def test_a_log_without_pings_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(log_of(tmp_path / "no-pings.xtf", []), tmp_path / "out", capsys)


def test_a_log_without_side_scan_is_refused(
    shared_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "side-scan" in refused(shared_data("sidescan/bathymetry-only.xtf"), tmp_path / "out", capsys)
