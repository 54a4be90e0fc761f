"""Logs of every format through one door.

The same contacts as live, whatever a file is called, and words for what cannot be read.
"""

from __future__ import annotations

import math
import os
import tracemalloc
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Notice, Ping
from auv_mcm.settings.config import Config, parse_config
from drivers.framing import Framer
from drivers.recording.session_layout import file_name
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import SideScanData, Validity, decode_data, encode_data
from sim_replay.logs.open_log import find_format, is_session, open_log
from sim_replay.logs.recorded import RecordedMission, open_mission
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.wire_logs import Run, jsf_string, nmea_packet, svlog_head, write_jsf, write_session
from tests.sim_replay.logs.sonar_logs import (
    ECHO_S,
    UTC_S,
    WRITERS,
    SonarKind,
    apart_m,
    bytes_of,
    contacts_of,
    live_contacts,
    live_events,
    mission,
    pings,
    replayed,
    run_of,
    stamp_at,
    written,
)

KINDS = list(WRITERS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recorded_session_gives_the_very_contacts_of_the_live_run(kind: SonarKind, tmp_path: Path) -> None:
    run = run_of(kind, late_s := 3e-3)
    folder = write_session(run, tmp_path / "recording")
    live = [bytes_of(contact) for contact in live_contacts(kind, late_s)]
    assert len(live) >= 2
    for path in (folder, folder / file_name(0)):
        assert [bytes_of(contact) for contact in replayed(path, Config())] == live


@pytest.mark.parametrize("kind", KINDS)
def test_a_sonars_own_log_gives_the_contacts_of_the_live_run(kind: SonarKind, tmp_path: Path) -> None:
    run = run_of(kind)
    live, found = live_contacts(kind), replayed(written(kind, tmp_path / "log"), run.config)
    assert sum(contact.p_mine > 0.25 for contact in live) == 2
    assert [contact.id for contact in found] == [contact.id for contact in live]
    assert [contact.classification for contact in found] == [contact.classification for contact in live]
    for one, other in zip(live, found, strict=True):
        assert apart_m(one, other) < 2e-3
        assert other.p_mine == pytest.approx(one.p_mine, abs=1e-3)
        assert other.time_s == pytest.approx(one.time_s, abs=1e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_config", [True, False])
def test_a_link_that_was_late_costs_centimetres(kind: SonarKind, with_config: bool, tmp_path: Path) -> None:
    """SonarView does not record when a sentence came.

    A ping interval and the compass's latency, 0.2 m of way, are not known.
    """
    run = run_of(kind, 3e-3)
    path = WRITERS[kind](run, tmp_path / "log")
    live = [contact for contact in live_contacts(kind, 3e-3) if contact.p_mine > 0.25]
    found = [contact for contact in replayed(path, run.config if with_config else Config()) if contact.p_mine > 0.25]
    assert len(live) == len(found) == 2
    for one in live:
        assert min(apart_m(one, other) for other in found) < 0.25


def with_header_navigation(run: Run, navigation: str = "{}") -> Run:
    """The same run, but the sonar's messages carry the navigation, as those of a topside do, and there is no
    compass."""
    samples = [event for event in mission() if isinstance(event, NavSample)]
    start_s = mission()[0].time_s
    changed = []
    for recorded in run.recorded:
        if recorded.port != "sonar":
            continue
        (framed,) = Framer(JsfGrammar()).feed(recorded.data)
        data = decode_data(framed.message.body)
        assert data is not None
        header = data.header
        nav = min(samples, key=lambda sample: abs(sample.time_s - start_s - (header.utc_s - UTC_S)))
        bits = Validity.POSITION | Validity.HEADING | Validity.PITCH_ROLL | Validity.SPEED
        header = header._replace(
            validity=header.validity | bits,
            latitude=round(nav.latitude_deg * 600_000.0),
            longitude=round(nav.longitude_deg * 600_000.0),
            heading_cdeg=round(math.degrees(nav.heading_rad) % 360.0 * 100.0) % 36_000,
            pitch_counts=round(nav.pitch_rad / math.pi * 32768.0),
            roll_counts=round(nav.roll_rad / math.pi * 32768.0),
            speed_dkn=round(nav.speed_mps * 3600.0 / 1852.0 * 10.0),
        )
        message = framed.message
        wire = encode_data(SideScanData(header, data.values), message.subsystem, message.channel, message.sequence)
        changed.append(recorded._replace(data=wire))
    text = f"ports: [{{name: sonar, link: 'tcp://192.168.2.92:1601', device: jsf, navigation: {navigation}}}]"
    return run._replace(config=parse_config(text, "vehicle.yaml"), recorded=tuple(changed))


def test_navigation_in_the_sonars_messages_gives_the_contacts_of_the_live_run(tmp_path: Path) -> None:
    run = with_header_navigation(run_of("jsf"))
    live = contacts_of(live_events(run), run.config)
    path = write_jsf(run, tmp_path / "log")
    assert len(live) >= 2
    for config in (run.config, Config()):
        found = replayed(path, config)
        assert [contact.id for contact in found] == [contact.id for contact in live]
        assert max(apart_m(one, other) for one, other in zip(live, found, strict=True)) < 2e-3


@pytest.mark.parametrize("navigation", ["{}", "{use_unit_time: true}"])
def test_the_navigation_of_a_sonars_message_is_of_the_transmission(navigation: str) -> None:
    """A message is sent when its last echo is back, ECHO_S later than its data on the vehicle."""
    run = with_header_navigation(run_of("jsf"), navigation)
    events = list(live_events(run))
    sample = next(event for event in events if isinstance(event, NavSample))
    ping = next(event for event in events if isinstance(event, Ping))
    assert sample.time_s == pytest.approx(ping.time_s, abs=1e-4)
    assert ping.time_s == pytest.approx(run.recorded[0].stamp.utc_ns * 1e-9 - ECHO_S, abs=1e-3)


def test_a_log_is_known_by_its_content_whatever_it_is_called(tmp_path: Path) -> None:
    xtf = tmp_path / "a.jsf"
    write_xtf(xtf, mission())
    assert find_format(xtf).name == "xtf"
    assert find_format(written("jsf", tmp_path / "b.svlog")).name == "jsf"
    assert find_format(written("ping_protocol", tmp_path / "c.xtf")).name == "svlog"
    folder = write_session(run_of("jsf"), tmp_path / "d.xtf")
    assert find_format(folder).name == find_format(folder / file_name(0)).name == "session"
    assert is_session(folder)
    assert not is_session(xtf)
    assert not is_session(tmp_path / "nowhere")


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_whose_beginning_is_damaged_is_known_by_what_follows(kind: SonarKind, tmp_path: Path) -> None:
    whole = written(kind, tmp_path / "log").read_bytes()
    path = tmp_path / "damaged"
    path.write_bytes(b"\xff" * 3000 + whole[3000:])
    assert find_format(path).name == find_format(tmp_path / "log").name
    log = open_log(path, run_of(kind).config)
    n_pings = len(pings(iter(log)))
    assert n_pings >= len(pings(iter(open_log(tmp_path / "log", Config())))) - 3


def test_what_is_no_log_is_refused_with_what_is_known(tmp_path: Path) -> None:
    empty, noise, pipe = tmp_path / "empty", tmp_path / "noise", tmp_path / "pipe"
    empty.touch()
    noise.write_bytes(np.random.Generator(np.random.PCG64(1)).bytes(30_000))
    os.mkfifo(pipe)
    for path, words in (
        (empty, "is empty .0 bytes.*fetch it again"),
        (noise, "is not a readable log: it begins with 0x.*XTF.*JSF.*svlog.*session.*Export"),
        (pipe, "is not a regular file but a pipe, a socket or a device. Copy"),
        (tmp_path, "is a directory without a recorded session.*Name a log inside"),
        (tmp_path / "nowhere", "does not exist. Check"),
    ):
        with pytest.raises(BadInputError, match=words):
            open_log(path, Config())


def sonar_only(kind: SonarKind) -> bytes:
    return b"".join(recorded.data for recorded in run_of(kind).recorded if recorded.port == "sonar")


@pytest.mark.parametrize(
    ("kind", "words"), [("jsf", "type 80.*type 2002.*Record with"), ("ping_protocol", "109.*150.*Record with")]
)
def test_a_log_without_navigation_is_rejected_with_what_is_missing(kind: SonarKind, words: str, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(sonar_only(kind))
    with pytest.raises(BadInputError, match=f"not one position: .*{words}"):
        open_mission([path], Config())


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_cut_off_at_any_byte_gives_what_was_whole(kind: SonarKind, tmp_path: Path) -> None:
    whole = written(kind, tmp_path / "whole").read_bytes()
    expected = [ping.number for ping in pings(iter(open_log(tmp_path / "whole", Config())))]
    random = np.random.Generator(np.random.PCG64(5))
    path = tmp_path / "cut"
    for n_bytes in [1, 2, 15, 17, 40, *random.integers(50, len(whole), 12).tolist()]:
        path.write_bytes(whole[:n_bytes])
        found = numbers(path)
        if found is None:
            assert n_bytes < 40_000
            continue
        assert found == expected[: len(found)]
        assert len(found) >= len(expected) * n_bytes / len(whole) - 4


def numbers(path: Path) -> list[int] | None:
    """Of all pings; None for a log that is refused."""
    try:
        return [ping.number for ping in pings(open_mission([path], Config()).events())]
    except BadInputError:
        return None


@pytest.mark.parametrize("kind", KINDS)
def test_flipped_bytes_cost_what_they_hit_and_never_a_traceback(kind: SonarKind, tmp_path: Path) -> None:
    whole = written(kind, tmp_path / "whole").read_bytes()
    n_pings = len(pings(iter(open_log(tmp_path / "whole", Config()))))
    random = np.random.Generator(np.random.PCG64(9))
    path = tmp_path / "flipped"
    for n_flips in (1, 10, 100):
        data = np.frombuffer(whole, np.uint8).copy()
        at = random.integers(len(data), size=n_flips)
        data[at] ^= random.integers(1, 256, size=n_flips).astype(np.uint8)
        path.write_bytes(data.tobytes())
        log = open_log(path, Config())
        found = pings(iter(log))
        assert n_pings - 3 * n_flips <= len(found) <= n_pings + n_flips
    assert log.counters[f"reader.{kind}.bytes_skipped"] > 0


def write_mission(path: Path) -> Path:
    write_xtf(path, mission())
    return path


@pytest.mark.parametrize("write", [partial(written, "jsf"), partial(written, "ping_protocol"), write_mission])
@pytest.mark.parametrize("chunk_bytes", [1, 7, 777])
def test_the_read_buffer_changes_nothing(write: Callable[[Path], Path], chunk_bytes: int, tmp_path: Path) -> None:
    data = bytearray(write(tmp_path / "log").read_bytes()[:60_000])
    data[5000:5100] = bytes(100)
    (tmp_path / "log").write_bytes(data)

    def read(chunk_bytes: int) -> tuple[list[str], Counter[str]]:
        log = open_log(tmp_path / "log", Config(), chunk_bytes)
        return [repr(structs.astuple(event)) for event in log], log.counters

    assert read(chunk_bytes) == read(1 << 18)


@pytest.mark.parametrize("kind", KINDS)
def test_memory_does_not_grow_with_the_log(kind: SonarKind, tmp_path: Path) -> None:
    path = tmp_path / "long"
    path.write_bytes(written(kind, tmp_path / "whole").read_bytes() * 2)
    log = open_log(path, Config(), chunk_bytes=1 << 14)
    tracemalloc.start()
    try:
        assert sum(isinstance(event, Ping) for event in log) > 400
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert path.stat().st_size > 1 << 20
    assert peak_bytes < 1 << 19


def test_logs_of_several_formats_are_one_mission_in_order_of_time(tmp_path: Path) -> None:
    jsf, svlog, xtf = written("jsf", tmp_path / "jsf"), written("ping_protocol", tmp_path / "svlog"), tmp_path / "xtf"
    svlog.write_bytes(svlog_head(UTC_S + 100.0) + svlog.read_bytes()[len(svlog_head(UTC_S)) :])
    start_s = mission()[0].time_s
    write_xtf(xtf, [structs.replace(event, time_s=event.time_s - start_s + UTC_S - 100.0) for event in mission()])
    bare = tmp_path / "bare"
    bare.write_bytes(sonar_only("jsf"))
    both = RecordedMission([svlog, jsf, bare, xtf], Config())
    assert list(both.sizes_bytes) == [xtf, jsf, svlog]
    events = list(both.events())
    times = [event.time_s for event in events if isinstance(event, Ping)]
    assert times == sorted(times)
    assert len(times) == 3 * 212
    assert both.fraction_done == 1.0
    assert both.counters()["replay.log_unusable"] == 1
    notice = events[0]
    assert isinstance(notice, Notice)
    assert notice.code == "log_unusable"
    assert "bare holds pings but not one position" in notice.text


def test_sentences_without_a_checksum_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "log"
    strings = b"".join(jsf_string(b"$GPHDT,12.0,T", stamp_at(0.1 * n)) for n in range(20))
    path.write_bytes(written("jsf", tmp_path / "whole").read_bytes() + strings)
    log = open_log(path, Config())
    list(log)
    assert log.counters["port.nmea.nmea.refused.checksum_absent"] == 20


def test_navigation_before_the_first_ping_is_kept_within_bounds(tmp_path: Path) -> None:
    whole = written("ping_protocol", tmp_path / "whole").read_bytes()
    head = svlog_head(UTC_S)
    path = tmp_path / "log"
    path.write_bytes(head + nmea_packet(b"$GPHDT,12.0,T*08\r\n") * 1000 + whole[len(head) :])
    log = open_log(path, Config())
    assert len(pings(iter(log))) == 212
    assert log.counters["reader.navigation_dropped"] >= 744
