"""The service around a pipeline: nothing lost on the way, nothing announced before it is on disk, and no end that
hangs."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from auv_mcm.errors import UsageError
from auv_mcm.kernels import Loaded
from auv_mcm.records import Notice
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.health.files import read_health
from auv_mcm.shell.recovery import RECORDING
from auv_mcm.shell.service import Service
from auv_mcm.shell.sources import parse_source_uri
from auv_mcm.source import Record
from drivers.recording.session_recorder import SessionRecorder
from sim_replay.logs.session_reader import Session
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import RESULTS, Events, Ports, ids, journal, mission, serve, serve_ports, summary


def test_a_mission_leaves_every_result_and_a_contact_is_on_disk_before_it_is_announced(tmp_path: Path) -> None:
    def console(line: str) -> None:
        if line.startswith("contact"):
            announced.append(line.split()[1])
            assert announced[-1] in journal(tmp_path / "latest")

    announced: list[str] = []
    results = serve(tmp_path, Events(mission(30)), console=console)
    assert announced == ids(results) == journal(results) == [f"C{number:04d}" for number in (*range(0, 30, 3), 9999)]
    assert {path.name for path in results.iterdir()} == RESULTS
    content = summary(results)
    assert (content["pings"], content["contacts"], content["covered_km2"]) == (30, 11, 0.001)
    assert content["counters"] == {"ping.received": 30, "source.events": 60}


def test_the_results_are_called_by_the_operating_point_of_the_whole_mission(tmp_path: Path) -> None:
    results = serve(tmp_path, Events(mission(30)), fake.Calling)
    features = json.loads((results / "contacts.geojson").read_bytes())["features"]
    assert [feature["properties"]["called"] for feature in features] == [True] * 11
    content = summary(results)
    assert content["contacts_called"] == 11
    assert content["operating_point"] == {
        "asked_per_km2": 100.0,
        "area_too_small": False,
        "called_from_p_mine": 0.2,
        "contacts_counted": 11,
        "searched_km2": 0.5,
    }
    announced = [
        json.loads(line)["contact"]["properties"] for line in (results / "contacts.jsonl").read_text().splitlines()
    ]
    assert {properties["called"] for properties in announced} == {None}, "what was known then"


def test_a_console_that_went_away_costs_no_result(tmp_path: Path) -> None:
    def gone(line: str) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    results = serve(tmp_path, Events(mission(30)), console=gone)
    assert journal(results) == ids(results) != []
    assert summary(results)["counters"]["service.console_failed"] > 1


def test_notices_of_one_code_are_kept_two_hundred_times_and_then_counted(tmp_path: Path) -> None:
    lines: list[str] = []
    lost = [Notice(code="nav_quantity_lost", text=f"lost {number}") for number in range(500)]
    other = Notice(code="port_down", text="gone")
    content = summary(serve(tmp_path, Events([*lost, other, *mission(3)]), console=lines.append))
    assert Counter(one["code"] for one in content["notices"]) == {"nav_quantity_lost": 200, "port_down": 1}
    assert content["counters"]["service.notices_not_kept"] == 300
    assert sum("nav_quantity_lost" in line for line in lines) == 201
    assert "notice nav_quantity_lost: further ones are only counted" in lines


def test_that_numpy_does_the_work_of_the_kernels_is_announced_and_in_every_health_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("auv_mcm.kernels.loaded", lambda: Loaded(None, "not built"))
    lines: list[str] = []
    with caplog.at_level(logging.INFO):
        serve(tmp_path, Events(mission(1)), console=lines.append)
    assert [line for line in lines if line.startswith("notice service.no_kernels: numpy does the work")]
    health = [record.message for record in caplog.records if record.message.startswith("health")]
    assert health
    assert [line for line in health if "kernels=NUMPY" not in line] == []


def test_health_is_kept_up_to_date_while_perception_starts(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        serve(tmp_path, Events(mission(1)))
    said = [record.message.partition(" ")[0] for record in caplog.records]
    assert "health" in said[: said.index("ready:")]


def test_the_last_record_of_health_is_as_the_mission_ended(tmp_path: Path) -> None:
    results = serve_ports(tmp_path, Ports(mission(30)))
    health = read_health(results / "health.json")
    parts = {part.name: part for part in health.parts}
    assert (health.session, health.state) == (str(results), "normal")
    assert {"service", "perception", "port.one", "navigation.position", "recording", "disk"} <= set(parts)
    assert parts["perception"].values["pings_total"] == summary(results)["pings"] == 30
    history = (results / "health.jsonl").read_text().splitlines()
    assert '"state":"boot"' in history[0]


def test_a_port_for_monitors_that_is_taken_costs_no_mission(tmp_path: Path) -> None:
    lines: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as taken:
        service = ServiceConfig(output_directory=str(tmp_path), health_port=taken.getsockname()[1])
        source = Events(mission(30))
        results = asyncio.run(
            Service(Config(service=service), source, console=lines.append, make_pipeline=fake.Base).run()
        )
    assert len(ids(results)) == 11
    assert [line for line in lines if line.startswith("notice service.health_port: no health over HTTP: ")]


def test_monitors_are_answered_while_the_mission_goes_on(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    monitors: list[socket.socket] = []

    def ask(line: str) -> None:
        if not monitors:
            monitors.append(socket.create_connection(("127.0.0.1", port)))
            monitors[0].sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")

    config = Config(service=ServiceConfig(output_directory=str(tmp_path), health_port=port))
    asyncio.run(Service(config, Events(mission(30)), console=ask, make_pipeline=fake.Base).run())
    with monitors[0] as monitor:
        monitor.settimeout(10.0)
        assert monitor.recv(1 << 16).startswith(b"HTTP/1.1 200 OK\r\n")


def test_clutter_is_kept_but_not_announced(tmp_path: Path) -> None:
    lines: list[str] = []
    results = serve(tmp_path, Events(mission(30)), fake.Cluttered, console=lines.append)
    assert journal(results) == ids(results) != []
    assert not [line for line in lines if line.startswith("contact")]


def test_a_live_source_is_recorded_and_stopped_gently(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    rest = [event for event in mission(12)[20:] if not isinstance(event, Exception)]
    results = serve_ports(tmp_path, Ports(mission(10), rest))
    content = summary(results)
    assert content["pings"] == 12
    assert content["counters"]["session.chunks_recorded"] == 20
    assert [chunk.data for chunk in Session(results / RECORDING)] == [b"x"] * 20
    assert any("ports=one:up" in record.getMessage() for record in caplog.records)


def test_nothing_is_recorded_unless_it_is_wanted(tmp_path: Path) -> None:
    class Unrecorded(Ports):
        def record_with(self, record: Record) -> None:
            raise AssertionError("it was not requested")

        def __init__(self) -> None:
            super().__init__(mission(10))
            self._record = lambda *chunk: None

    assert not (serve_ports(tmp_path, Unrecorded(), record=False) / RECORDING).exists()


def test_a_live_source_that_does_not_let_go_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stuck(Ports):
        def stop(self) -> None: ...

    monkeypatch.setattr("auv_mcm.shell.service._STOP_S", 0.05)
    assert len(ids(serve_ports(tmp_path, Stuck(mission(10))))) == 5


def test_what_became_of_the_recording_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "drivers.recording.start_recording.SessionRecorder", partial(SessionRecorder, free_bytes=lambda folder: 0)
    )
    lines: list[str] = []
    results = serve_ports(tmp_path, Ports(mission(10)), console=lines.append)
    assert any(line.startswith("notice session_stopped") for line in lines)
    assert summary(results)["pings"] == 10


def test_a_slow_pipeline_makes_a_lossless_source_wait(tmp_path: Path) -> None:
    results = serve(tmp_path, Events(mission(100)), fake.Slow, queue_pings=1)
    assert summary(results)["counters"]["ping.received"] == 100


def test_a_slow_pipeline_makes_a_live_source_lose_pings_and_counts_them(tmp_path: Path) -> None:
    lines: list[str] = []
    results = serve(tmp_path, Events(mission(300), lossless=False), fake.Slow, queue_pings=1, console=lines.append)
    counters = summary(results)["counters"]
    assert counters["ping.received"] + counters["service.ping_dropped"] == 300
    assert counters["service.ping_dropped"] > 0
    said = [line for line in lines if line.startswith("notice service.pings_lost")]
    assert said
    assert f"{counters['service.ping_dropped']} came faster than perception worked" in said[-1]


@pytest.mark.parametrize("lossless", [True, False])
def test_where_pings_would_be_lost_work_is_shed_first_and_that_is_said_once(lossless: bool, tmp_path: Path) -> None:
    lines: list[str] = []
    results = serve(tmp_path, Events(mission(200), lossless=lossless), fake.Slow, queue_pings=200, console=lines.append)
    counters = summary(results)["counters"]
    assert counters["ping.received"] == 200
    assert "service.ping_dropped" not in counters
    assert sum(line.startswith("notice service.work_shed") for line in lines) == (not lossless)
    if lossless:
        assert not {"service.work_shed", "fake.work_shed"} & counters.keys()
    else:
        assert 0 < counters["fake.work_shed"] <= counters["service.work_shed"] < 200
        assert counters["fake.caught_up"] == 1


@pytest.mark.parametrize(("lossless", "warns"), [(True, False), (False, True)])
def test_perception_at_work_is_a_warning_only_where_pings_may_be_lost(
    lossless: bool, warns: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    serve(tmp_path, Events(mission(100), lossless=lossless), fake.Pondering, queue_pings=128)
    warned = [
        record for record in caplog.records if record.levelname == "WARNING" and "although pings wait" in record.message
    ]
    assert bool(warned) == warns


def test_what_needs_no_action_is_a_remark_and_not_a_notice(tmp_path: Path) -> None:
    requested = Notice(code="port_down", text="port 'nav' is down. Check its cable.", place="nav")
    for_the_record = Notice(code="utc_taken", text="UTC is that of 'nav'", place="nav", for_the_record=True)
    lines: list[str] = []
    results = serve(tmp_path, Events([requested, for_the_record, *mission(3)]), console=lines.append)
    reported = summary(results)
    assert [line for line in lines if line.startswith("notice")] == [
        "notice port_down: port 'nav' is down. Check its cable. (nav)"
    ]
    assert [notice["code"] for notice in reported["notices"]] == ["port_down"]
    assert reported["remarks"] == [{"code": "utc_taken", "text": "UTC is that of 'nav'", "place": "nav"}]


def test_every_run_has_its_own_folder_and_latest_points_to_the_last(tmp_path: Path) -> None:
    results = [serve(tmp_path, Events(mission(1))) for _ in range(3)]
    assert len(set(results)) == 3
    assert (tmp_path / "latest").resolve() == results[-1].resolve()


def test_what_lies_where_the_link_to_the_last_session_belongs_is_left_alone(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "latest").write_bytes(b"mine")
    results = serve(tmp_path, Events(mission(1)))
    assert (tmp_path / "latest").read_bytes() == b"mine"
    assert any("something else of that name" in record.getMessage() for record in caplog.records)
    assert {path.name for path in tmp_path.iterdir()} == {"latest", results.name}


def test_an_output_directory_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(UsageError, match="a file is in its place"):
        serve(tmp_path / "file", Events(mission(1)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("/data/mission.xtf", "unknown scheme"),
        ("ftp:///mission.xtf", "unknown scheme 'ftp'. Known: ports, replay:"),
        ("replay://mission.xtf", "three slashes"),
        ("replay:///m.xtf?speed", "not a URI"),
        ("replay:///m.xtf?speed=1&speed=2", "given twice"),
        ("replay://[/m.xtf", "not a URI"),
    ],
)
def test_a_source_that_cannot_be_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_source_uri(text)


def test_a_source_uri_may_hold_blanks_and_relative_paths() -> None:
    assert parse_source_uri("replay:///my%20log.xtf?speed=max")[1:] == ("replay", "/my log.xtf", {"speed": "max"})
    assert parse_source_uri("replay:logs/a.xtf").path == "logs/a.xtf"


def test_early_contacts_are_on_disk_when_announced_and_stand_in_no_result(tmp_path: Path) -> None:
    def console(line: str) -> None:
        if line.startswith("early contact"):
            lines.append(line.removeprefix("early contact "))
            assert lines[-1][:6] in (tmp_path / "latest" / "early.jsonl").read_text()

    lines: list[str] = []
    results = serve(tmp_path, Events(mission(30)), fake.Early, console=console)
    assert lines == [
        "E00001: unknown, p_mine 0.60, 43.0000000 5.0000000",
        "E00002: unknown, p_mine 0.60, 43.0000000 5.0000000",
        "E00001 is C0003",
        "E00002 withdrawn",
    ]
    records = [json.loads(line) for line in (results / "early.jsonl").read_text().splitlines()]
    assert [(r["contact"]["properties"]["id"], r["state"], r["became"]) for r in records] == [
        ("E00001", "found", ""),
        ("E00002", "found", ""),
        ("E00001", "became", "C0003"),
        ("E00002", "withdrawn", ""),
    ]
    assert journal(results) == ids(results) == [f"C{number:04d}" for number in (*range(0, 30, 3), 9999)]
