"""The service around a pipeline: nothing lost on the way, nothing announced before it is on disk, and no end that
hangs."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.errors import AuvMcmError, BadInputError, HardwareError, UsageError
from auv_mcm.kernels import Loaded
from auv_mcm.records import Notice, SourceEvent
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.health.files import read_health
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.perception import MakePipeline, PerceptionError
from auv_mcm.shell.recovery import BALLAST_BYTES, RECORDING, Ballast
from auv_mcm.shell.service import Service
from auv_mcm.shell.sources import parse_source_uri
from auv_mcm.source import EventSink, PortState, QuantityState, Record, SourceHealth, VehiclePilot
from drivers.recording.session_recorder import SessionRecorder
from sim_replay.logs.session_parts import recordings_of
from sim_replay.logs.session_reader import Session
from tests.auv_mcm.shell import fake_pipelines as fake

ROOT = Path(__file__).resolve().parents[3]


class Events:
    """A source of given events; an exception among them is raised in its turn."""

    def __init__(
        self, events: Sequence[SourceEvent | Exception], *, lossless: bool = True, endless: bool = False
    ) -> None:
        self.lossless = lossless
        self._events = events
        self._endless = endless

    async def run(self, sink: EventSink) -> None:
        for event in self._events:
            if isinstance(event, Exception):
                raise event
            await self._give(event, sink)
        if self._endless:
            await asyncio.Event().wait()

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        if self.lossless:
            await sink.put(event)
        else:
            sink.push(event)

    def counters(self) -> Counter[str]:
        return Counter({"source.events": len(self._events)})


class Ports(Events):
    """A live source of given events, which gives the rest when stopped. It hands a byte per event to the recorder."""

    def __init__(self, events: Sequence[SourceEvent | Exception], rest: Sequence[SourceEvent] = ()) -> None:
        super().__init__(events, lossless=False)
        self._rest = rest
        self._stopped = asyncio.Event()

    def record_with(self, record: Record) -> None:
        self._record = record

    def stop(self) -> None:
        self._stopped.set()

    def health(self) -> SourceHealth:
        return SourceHealth((PortState("one", "up", 1, 0, 0.0),), (QuantityState("position", "one", 0.0),))

    def faults(self) -> list[str]:
        return []

    vehicle: VehiclePilot | None = None

    async def serve_vehicle(self) -> None:
        raise AssertionError("there is no vehicle")

    async def run(self, sink: EventSink) -> None:
        await super().run(sink)
        await self._stopped.wait()
        for event in self._rest:
            sink.push(event)

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        self._record("one", "in", Stamp(1, 2), b"x")
        await super()._give(event, sink)


def mission(n_pings: int) -> list[SourceEvent | Exception]:
    return [event for number in range(n_pings) for event in (fake.navigation(number), fake.ping(number))]


def serve(
    folder: Path,
    source: Events,
    make: MakePipeline = fake.Base,
    console: Callable[[str], None] = lambda line: None,
    queue_pings: int = 512,
) -> Path:
    config = Config(
        service=ServiceConfig(
            output_directory=str(folder), queue_pings=queue_pings, health_period_s=0.05, stop_within_s=60.0
        )
    )
    return asyncio.run(Service(config, source, console=console, make_pipeline=make).run())


def serve_ports(
    folder: Path, source: Ports, *, record: bool = True, console: Callable[[str], None] = lambda line: None
) -> Path:
    """Stops once the ninth ping's contact was announced."""

    async def run() -> Path:
        def stop_at_nine(line: str) -> None:
            console(line)
            if "C0009" in line:
                service.stop()

        config = Config(
            service=ServiceConfig(output_directory=str(folder), record=record, health_period_s=0.05, stop_within_s=60.0)
        )
        service = Service(config, source, console=stop_at_nine, make_pipeline=fake.Base)
        return await service.run()

    return asyncio.run(run())


def ids(results: Path) -> list[str]:
    return [
        feature["properties"]["id"] for feature in json.loads((results / "contacts.geojson").read_bytes())["features"]
    ]


def summary(results: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((results / "summary.json").read_bytes())
    return content


def journal(results: Path) -> list[str]:
    return [
        json.loads(line)["contact"]["properties"]["id"]
        for line in (results / "contacts.jsonl").read_text().splitlines()
    ]


def test_a_mission_leaves_every_result(tmp_path: Path) -> None:
    results = serve(tmp_path, Events(mission(30)))
    expected = [f"C{number:04d}" for number in (*range(0, 30, 3), 9999)]
    assert ids(results) == expected
    assert journal(results) == expected
    assert {path.name for path in results.iterdir()} == {
        *("contacts.geojson", "contacts.csv", "contacts.kml", "contacts.jsonl"),
        *("coverage.geojson", "clearance.geojson", "waypoints.geojson", "summary.json", "snippets"),
        *("health.json", "health.jsonl"),
    }
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


def test_a_contact_is_on_disk_before_it_is_announced(tmp_path: Path) -> None:
    def console(line: str) -> None:
        if line.startswith("contact"):
            announced.append(line.split()[1])
            assert announced[-1] in journal(tmp_path / "latest")

    announced: list[str] = []
    results = serve(tmp_path, Events(mission(30)), console=console)
    assert announced == ids(results)


def test_a_console_that_went_away_costs_no_result(tmp_path: Path) -> None:
    def gone(line: str) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    results = serve(tmp_path, Events(mission(30)), console=gone)
    assert journal(results) == ids(results) != []
    assert summary(results)["counters"]["service.console_failed"] > 1


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


def test_contacts_are_announced_even_if_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    lines: list[str] = []
    monkeypatch.setattr("auv_mcm.shell.journal.Journal.append", full)
    results = serve(tmp_path, Events(mission(4)), console=lines.append)
    assert [line.split()[1] for line in lines] == ids(results)
    assert summary(results)["counters"]["service.journal_failed"] == 3


def test_what_a_full_disk_does_not_take_is_counted_reported_and_still_among_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    def full_of_pictures(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.suffix == ".png":
            full()
        replace(new, old, **folders)

    with monkeypatch.context() as disk:
        disk.setattr("auv_mcm.safe_files.os.replace", full_of_pictures)
        results = serve(tmp_path, Events(mission(30)), fake.SeeingOnFullDisk)
    assert ids(results) == ["C00001"]
    counters = summary(results)["counters"]
    assert counters["service.kept_in_memory"] == counters["perception.kept_in_memory"] == 1
    assert counters["service.snippets_failed"] > 0
    assert any("pictures of contacts are missing" in record.getMessage() for record in caplog.records)


def test_a_disk_that_gives_nothing_back_is_counted_and_every_contact_is_announced_and_in_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    lines: list[str] = []
    monkeypatch.setattr("auv_mcm.contacts.record_file.os.pread", broken)
    results = serve(tmp_path, Events(mission(4)), console=lines.append)
    announced = [line.split()[1] for line in lines if line.startswith("contact ")]
    assert announced == journal(results) == ["C0000", "C0003", "C9999"]
    assert ids(results) == announced, "from the journal, in place of the disk"
    assert any("contacts_in_journal" in line for line in lines)
    assert summary(results)["counters"]["service.unreadable"] > 0


@pytest.mark.parametrize("make", [fake.Base, fake.Dying])
def test_the_session_holds_what_was_found_and_no_other_file(
    tmp_path: Path, make: MakePipeline, capfd: pytest.CaptureFixture[str]
) -> None:
    with contextlib.suppress(PerceptionError):
        serve(tmp_path, Events(mission(30)), make)
    files = {path.name for path in (tmp_path / "latest").iterdir()}
    assert files <= {
        *("contacts.geojson", "contacts.csv", "contacts.kml", "contacts.jsonl"),
        *("coverage.geojson", "clearance.geojson", "waypoints.geojson", "summary.json", "snippets"),
        *("health.json", "health.jsonl"),
    }


def test_pictures_are_there_when_a_contact_is_announced_and_outlive_perception(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def console(line: str) -> None:
        if line.startswith("contact"):
            seen.append((tmp_path / "latest" / "snippets" / f"{line.split()[1]}.png").read_bytes()[:4])

    seen: list[bytes] = []
    with pytest.raises(PerceptionError):
        serve(tmp_path, Events(mission(30)), fake.SeeingThenDying, console)
    assert set(seen) == {b"\x89PNG"}
    assert [path.name for path in (tmp_path / "latest" / "snippets").iterdir()] == ["C00001.png"]


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


def test_stop_works_off_what_is_queued_and_loses_no_contact(tmp_path: Path) -> None:
    async def run() -> Path:
        config = Config(service=ServiceConfig(output_directory=str(tmp_path)))

        def console(line: str) -> None:
            if "C0009" in line:
                service.stop()

        service = Service(config, Events(mission(30), endless=True), console=console, make_pipeline=fake.Base)
        return await service.run()

    results = asyncio.run(run())
    pings = summary(results)["pings"]
    assert ids(results) == [f"C{number:04d}" for number in (*range(0, pings, 3), 9999)]
    assert pings >= 10


@pytest.mark.parametrize(
    ("error", "raised"), [(BadInputError("bad log"), BadInputError), (ValueError("defect"), HardwareError)]
)
def test_what_came_before_a_source_failed_is_worked_off(
    tmp_path: Path, error: Exception, raised: type[AuvMcmError]
) -> None:
    with pytest.raises(raised, match=str(error)):
        serve(tmp_path, Events([*mission(10), error]))
    assert len(ids(tmp_path / "latest")) == 5


@pytest.mark.parametrize("make", [fake.Dying, fake.Failing])
def test_contacts_announced_before_perception_failed_are_kept(
    tmp_path: Path, make: MakePipeline, capfd: pytest.CaptureFixture[str]
) -> None:
    lines: list[str] = []
    with pytest.raises(PerceptionError) as caught:
        serve(tmp_path, Events(mission(300)), make, lines.append)
    assert caught.value.exit_code == 4
    announced = [line.split()[1] for line in lines]
    assert announced == ids(tmp_path / "latest") == journal(tmp_path / "latest") == ["C0000", "C0003"]


def test_contacts_lost_with_perception_are_reported_to_be_in_the_recording(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lines: list[str] = []
    config = Config(service=ServiceConfig(output_directory=str(tmp_path)))
    with pytest.raises(PerceptionError):
        asyncio.run(Service(config, Ports(mission(300)), console=lines.append, make_pipeline=fake.Dying).run())
    (line,) = [line for line in lines if line.startswith("notice contacts_in_recording")]
    command = shlex.split(line.partition("run: ")[2])
    assert command[:2] == ["auv-mcm", "report"]
    (recording,) = recordings_of(Path(command[2]))
    assert len(list(Session(recording))) > 5
    assert "contacts_in_recording" in [notice["code"] for notice in summary(tmp_path / "latest")["notices"]]
    assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "it was already reported"


def test_a_restart_after_a_kill_says_how_to_get_what_was_not_announced(tmp_path: Path) -> None:
    killed = serve_ports(tmp_path, Ports(mission(10)))
    (killed / "summary.json").unlink()
    with contextlib.closing(Journal(killed / "contacts.jsonl")):
        assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "it still runs"
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").symlink_to(killed.name)
    (line,) = [line for line in started_again(tmp_path) if line.startswith("notice contacts_in_recording")]
    assert line.endswith(f"To get them run: auv-mcm report {killed}")
    assert not [line for line in started_again(tmp_path) if "contacts_in_recording" in line], "once is enough"


def started_again(folder: Path) -> list[str]:
    lines: list[str] = []
    serve(folder, Events(mission(1)), console=lines.append)
    return lines


def test_a_disk_too_full_for_one_result_takes_the_others_and_the_error_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_for_the_largest(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.name in ("contacts.geojson", "coverage.geojson"):
            raise OSError(28, "No space left on device")
        replace(new, old, **folders)

    monkeypatch.setattr("auv_mcm.safe_files.os.replace", full_for_the_largest)
    with pytest.raises(
        HardwareError, match=r"contacts\.geojson, coverage\.geojson cannot be written.*No space.*contacts\.jsonl"
    ):
        serve(tmp_path, Events(mission(30)))
    results = tmp_path / "latest"
    assert len((results / "contacts.csv").read_text().splitlines()) == 12
    assert [notice["code"] for notice in summary(results)["notices"]] == ["results_missing"]
    assert not [path for path in results.iterdir() if path.suffix == ".new"]


def test_space_is_held_for_the_results_and_pictures_come_after_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    class Watched(Ballast):
        def release(self) -> None:
            done.append(f"release {self.n_bytes}")
            super().release()

    def replace(new: Path, old: Path, replace: Callable[..., None] = os.replace, **folders: int) -> None:
        if old.suffix == ".png" and not any(entry.startswith("release") for entry in done):
            raise OSError(28, "No space left on device")
        if old.name not in ("latest", "health.json") and old.parent.name != "state":
            done.append(old.name)
        replace(new, old, **folders)

    monkeypatch.setattr("auv_mcm.shell.service.Ballast", Watched)
    monkeypatch.setattr("auv_mcm.safe_files.os.replace", replace)
    serve(tmp_path, Events(mission(30)), fake.Seeing)
    assert done[:3] == [f"release {BALLAST_BYTES}", "contacts.geojson", "contacts.csv"]
    assert done[-1] == "C00001.png"


def test_results_are_written_although_their_folder_was_removed_on_the_way(tmp_path: Path) -> None:
    def remove(line: str) -> None:
        if "C0003" in line:
            shutil.rmtree((tmp_path / "latest").resolve())

    results = serve(tmp_path, Events(mission(30)), console=remove)
    assert len(ids(results)) == 11
    assert summary(results)["contacts"] == 11


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


# A program that serves an endless mission: python -c PROGRAM FOLDER PIPELINE
PROGRAM = """
import logging, sys
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell import test_service as t
from auv_mcm.shell import service
from auv_mcm.settings.config import Config, ServiceConfig

logging.basicConfig(stream=sys.stdout, format="%(message)s", level=logging.INFO)
service.open_source = lambda uri, config, clock: t.Events(t.mission(30), endless=True)
config = Config(service=ServiceConfig(output_directory=sys.argv[1], source="replay:///none", health_period_s=3600))
try:
    service.serve(config, make_pipeline=getattr(fake, sys.argv[2]))
except KeyboardInterrupt:
    sys.exit(130)
"""


def program(folder: Path, pipeline: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-u", "-c", PROGRAM, str(folder), pipeline]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def read_until(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdout is not None
    seen = []
    for line in process.stdout:
        seen.append(line)
        if word in line:
            return
    pytest.fail(f"'{word}' never came:\n{''.join(seen)}")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_the_whole_process_group_ends_in_order(tmp_path: Path, number: signal.Signals) -> None:
    with program(tmp_path, "Base") as process:
        read_until(process, "C0027")
        os.killpg(process.pid, number)  # as a terminal and a service manager do: the worker gets it too
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    assert ids(tmp_path / "latest") == [f"C{number:04d}" for number in (*range(0, 30, 3), 9999)]
    assert "leaked" not in output


def test_killing_all_processes_at_once_leaves_no_shared_memory_and_no_other_file_behind(tmp_path: Path) -> None:
    with program(tmp_path, "Stuck") as process:
        read_until(process, "C0027")
        assert len(group(process.pid)) >= 2, "perception is a process of its own"
        shared = shared_memory(process.pid)
        os.killpg(
            process.pid, signal.SIGKILL
        )  # as a supervisor that kills a control group does, and a shortage of memory
        output, _ = process.communicate(timeout=60)
    assert [path for path in shared if path.exists()] == []
    assert {path.name for path in (tmp_path / "latest").iterdir()} <= {
        *("contacts.jsonl", "snippets", "state", "health.json", "health.jsonl")
    }
    assert "leaked" not in output


def test_killing_the_service_alone_ends_perception_and_is_no_news_of_leaks(tmp_path: Path) -> None:
    with program(tmp_path, "Base") as process:
        read_until(process, "C0027")
        shared = shared_memory(process.pid)
        process.kill()
        output, _ = process.communicate(timeout=60)  # ends with the last process that holds the pipe
    assert [path for path in shared if path.exists()] == []
    assert "leaked" not in output
    while group(process.pid):  # on their way out, as they let go of the pipe
        time.sleep(0.01)


def shared_memory(leader: int) -> set[Path]:
    """Where the shared memory of a process group lies, or lay."""
    lines = [
        line
        for pid in group(leader)
        for line in Path(f"/proc/{pid}/maps").read_text().splitlines()
        if "/dev/shm/" in line
    ]
    return {Path(line[line.index("/dev/shm/") :].removesuffix(" (deleted)")) for line in lines}


def group(leader: int) -> list[int]:
    """Processes of a group that still run."""
    members = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, process_group = status.read_text().rpartition(")")[2].split()[:3]
            if int(process_group) == leader and state != "Z":
                members.append(int(status.parent.name))
    return members


def test_a_second_signal_ends_at_once_with_the_journal_whole(tmp_path: Path) -> None:
    with program(tmp_path, "Stuck") as process:
        read_until(process, "C0027")
        os.killpg(process.pid, signal.SIGTERM)
        read_until(process, "stopping")
        os.killpg(process.pid, signal.SIGTERM)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert journal(tmp_path / "latest") == [f"C{number:04d}" for number in range(0, 30, 3)]


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
