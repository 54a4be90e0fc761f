"""Logs of every format through one door.

The same contacts as live, whatever a file is called, and words for what cannot be read.
"""

from __future__ import annotations

import math
import os
import struct
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Contact, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, SonarConfig, parse_config
from drivers.framing import Framer
from drivers.recording.session_layout import file_name
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import JsfMessage, SideScanData, Validity, decode_data, encode_data
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import NMEA_WRAPPER, OsMonoProfile, PingMessage, decode, encode
from drivers.sonar.ping_messages import to_wire as ping_wire
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.logs.open_log import find_format, is_session, open_log
from sim_replay.logs.recorded import RecordedMission, open_mission
from sim_replay.logs.xtf_writer import write_xtf
from tests.sim_replay.logs.sonar_logs import (
    ECHO_S,
    JSF_TIME,
    UTC_S,
    Run,
    SonarKind,
    contacts_of,
    jsf_string,
    live_contacts,
    live_events,
    mavlink,
    mission,
    run_of,
    stamp_at,
    svlog_head,
    write_jsf,
    write_session,
    write_svlog,
)

Write = Callable[[Run, Path], Path]
WRITERS: dict[SonarKind, Write] = {"jsf": write_jsf, "ping_protocol": write_svlog}
KINDS = list(WRITERS)


def written(kind: SonarKind, path: Path) -> Path:
    return WRITERS[kind](run_of(kind), path)


def replayed(path: Path, config: Config) -> list[Contact]:
    return contacts_of(open_mission([path], config).events(), config)


def pings(events: Iterator[SourceEvent]) -> list[Ping]:
    return [event for event in events if isinstance(event, Ping)]


def apart_m(one: Contact, other: Contact) -> float:
    east = math.cos(math.radians(one.latitude_deg)) * (one.longitude_deg - other.longitude_deg)
    return 111_200.0 * math.hypot(one.latitude_deg - other.latitude_deg, east)


def bytes_of(contact: Contact) -> tuple[Any, ...]:
    return (
        contact.id,
        contact.time_s,
        contact.latitude_deg,
        contact.longitude_deg,
        contact.p_mine,
        contact.covariance_m2.tobytes(),
    )


# --- the same contacts as live ---


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
    return Run(parse_config(text, "vehicle.yaml"), tuple(changed))


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


# --- what a file is ---


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


# --- what a JSF file holds ---


def of_subsystem(data: bytes, subsystem: int) -> bytes:
    return b"".join(
        jsf_wire(framed.message._replace(subsystem=subsystem))
        for framed in _jsf(data)
        if framed.message.message_type == 80
    )


def _jsf(data: bytes) -> list[Any]:
    framer = Framer(JsfGrammar())
    return framer.feed(data) + framer.finish()


def test_a_jsf_log_of_the_low_frequency_alone_is_taken(tmp_path: Path) -> None:
    whole = written("jsf", tmp_path / "high").read_bytes()
    low = tmp_path / "low"
    changed = [f.message._replace(subsystem=20) if f.message.message_type == 80 else f.message for f in _jsf(whole)]
    low.write_bytes(b"".join(map(jsf_wire, changed)))
    found, expected = replayed(low, Config()), replayed(tmp_path / "high", Config())
    assert [bytes_of(contact) for contact in found] == [bytes_of(contact) for contact in expected]


def test_of_several_subsystems_the_highest_is_used_or_the_one_configured(tmp_path: Path) -> None:
    whole = written("jsf", tmp_path / "high").read_bytes()
    both = tmp_path / "both"
    both.write_bytes(b"".join(of_subsystem(jsf_wire(f.message), 20) + jsf_wire(f.message) for f in _jsf(whole)))
    events = list(open_log(both, Config()))
    n_pings = len(pings(iter(open_log(tmp_path / "high", Config()))))
    assert len(pings(iter(events))) == n_pings
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "reader.frequency_chosen"
    assert "20 (low frequency) and 21 (high frequency): 21 is used. Set sonar.subsystem: 20" in notice.text
    for subsystem in (20, 21):
        log = open_log(both, Config(sonar=SonarConfig(subsystem=subsystem)))
        assert len(pings(iter(log))) == n_pings
        assert log.counters[f"reader.not_used.subsystem_{41 - subsystem}"] == 2 * n_pings
    with pytest.raises(UsageError, match=r"sonar\.subsystem is 22, but .*both holds side scan of subsystem 20 and 21"):
        open_log(both, Config(sonar=SonarConfig(subsystem=22)))


def test_a_damaged_header_makes_no_second_subsystem(tmp_path: Path) -> None:
    whole = bytearray(written("jsf", tmp_path / "whole").read_bytes())
    first = next(framed for framed in _jsf(bytes(whole)) if framed.message.message_type == 80)
    whole[first.offset + 7] ^= 1
    path = tmp_path / "flipped"
    path.write_bytes(whole)
    log = open_log(path, Config())
    assert len(pings(iter(log))) > 100
    assert log.counters["reader.not_used.subsystem_20"] == 1


def test_a_jsf_log_without_side_scan_is_rejected_with_its_contents(tmp_path: Path) -> None:
    whole = written("jsf", tmp_path / "high").read_bytes()
    path = tmp_path / "sub-bottom"
    path.write_bytes(of_subsystem(whole, 0))
    with pytest.raises(
        BadInputError, match=r"holds no side-scan message.*of type 80 of subsystem 0.*side scan switched on"
    ):
        open_log(path, Config())


def test_pitch_and_roll_of_the_motion_sensor_serve_where_nothing_else_gives_them(tmp_path: Path) -> None:
    def motion(at_s: float) -> bytes:
        body = bytearray(44)
        seconds, nanoseconds = divmod(stamp_at(at_s).utc_ns, 1_000_000_000)
        body[:12] = JSF_TIME.pack(seconds, nanoseconds // 1_000_000)
        struct.pack_into(
            "<hh6xHI", body, 24, round(3.0 / 180 * 32768), round(-5.0 / 180 * 32768), 12_345, 1 << 6 | 1 << 7 | 1 << 9
        )
        return jsf_wire(JsfMessage(2020, bytes(body), subsystem=101))

    whole = written("jsf", tmp_path / "whole").read_bytes()
    parts = []
    for framed in _jsf(whole):
        message = framed.message
        if message.message_type == 80 or b"GGA" in message.body:
            parts.append(jsf_wire(message))
    last_s = run_of("jsf").recorded[-1].stamp.utc_ns * 1e-9 - UTC_S
    path = tmp_path / "log"
    path.write_bytes(b"".join(parts) + b"".join(motion(last_s + 0.1 * n) for n in range(9)))
    samples = [
        event for event in open_log(path, Config()) if isinstance(event, NavSample) and not math.isnan(event.roll_rad)
    ]
    assert len(samples) == 9
    for sample in samples:
        assert math.degrees(sample.pitch_rad) == pytest.approx(3.0, abs=0.02)
        assert math.degrees(sample.roll_rad) == pytest.approx(-5.0, abs=0.02)
        assert math.degrees(sample.heading_rad) == pytest.approx(123.45, abs=0.02)
    assert samples[0].time_s == pytest.approx(UTC_S + last_s, abs=1e-3)


# --- time ---


def moved(framed: Any, by_s: float) -> bytes:
    """A message of a JSF log at another time."""
    body = bytearray(framed.message.body)
    (seconds,) = struct.unpack_from("<i", body)
    struct.pack_into("<i", body, 0, seconds + round(by_s))
    return jsf_wire(framed.message._replace(body=bytes(body)))


def test_a_clock_set_back_in_a_log_costs_no_ping(tmp_path: Path) -> None:
    messages = _jsf(written("jsf", tmp_path / "whole").read_bytes())
    middle = len(messages) // 2
    path = tmp_path / "back"
    path.write_bytes(b"".join(moved(framed, -3600.0 if n > middle else 0.0) for n, framed in enumerate(messages)))
    log = open_log(path, Config())
    events = list(log)
    n_pings = len(pings(iter(open_log(tmp_path / "whole", Config()))))
    found = pings(iter(events))
    assert n_pings <= len(found) <= n_pings + 1  # the ping in the middle may have one side on each side of the step
    assert sum(later.time_s < earlier.time_s for earlier, later in pairwise(found)) == 1
    assert log.counters["reader.time_backwards"] == 1
    assert any(isinstance(event, Notice) and event.code == "reader.time_backwards" for event in events)
    late = [event for event in events if isinstance(event, NavSample) and event.time_s < UTC_S - 1000.0]
    assert sum(math.isfinite(event.latitude_deg) for event in late) > 50


def test_one_impossible_time_is_left_out(tmp_path: Path) -> None:
    messages = _jsf(written("jsf", tmp_path / "whole").read_bytes())
    at = next(n for n, framed in enumerate(messages) if n > 50 and framed.message.message_type == 80)
    path = tmp_path / "log"
    path.write_bytes(b"".join(moved(framed, 1e6 if n == at else 0.0) for n, framed in enumerate(messages)))
    log = open_log(path, Config())
    found = pings(iter(log))
    assert log.counters["reader.time_outlier"] == 1
    assert max(ping.time_s for ping in found) < UTC_S + 1000.0


def test_a_clock_that_was_never_set_is_reported_and_the_log_is_read(tmp_path: Path) -> None:
    messages = _jsf(written("jsf", tmp_path / "whole").read_bytes())
    path = tmp_path / "log"
    path.write_bytes(b"".join(jsf_wire(f.message._replace(body=bytes(4) + f.message.body[4:])) for f in messages))
    events = list(open_mission([path], Config()).events())
    assert sum(isinstance(event, Ping) for event in events) > 100
    assert "reader.time_unknown" in {event.code for event in events if isinstance(event, Notice)}


def test_messages_are_put_in_order_of_time(tmp_path: Path) -> None:
    """Recorders write what came within a second in any order."""
    messages = _jsf(written("jsf", tmp_path / "whole").read_bytes())
    random = np.random.Generator(np.random.PCG64(3))
    place = np.arange(len(messages)) + random.uniform(0.0, 20.0, len(messages))
    strings = np.array([framed.message.message_type == 2002 for framed in messages])
    place = np.where(strings, place, np.arange(len(messages)))  # sides of a ping stay together
    path = tmp_path / "log"
    path.write_bytes(b"".join(jsf_wire(messages[n].message) for n in np.argsort(place)))
    found, expected = positions(path), positions(tmp_path / "whole")
    assert len(found) == 212
    assert found == expected


def positions(path: Path) -> list[tuple[float, float, float]]:
    samples = [event for event in open_log(path, Config()) if isinstance(event, NavSample)]
    return [(e.time_s, e.latitude_deg, e.longitude_deg) for e in samples if not math.isnan(e.latitude_deg)]


# --- what an svlog holds ---


def sonar_only(kind: SonarKind) -> bytes:
    return b"".join(recorded.data for recorded in run_of(kind).recorded if recorded.port == "sonar")


def test_mavlink_is_navigation_too(tmp_path: Path) -> None:
    start_s = mission()[0].time_s
    samples = iter([event for event in mission() if isinstance(event, NavSample)])
    parts = [svlog_head(UTC_S), ping_wire(PingMessage(150, b'{"message": 3}')), ping_wire(PingMessage(150, b"\xff{"))]
    for recorded in run_of("ping_protocol").recorded:
        if recorded.port == "sonar":
            parts.append(recorded.data)
        elif (sample := next(samples, None)) is not None:
            boot_s = sample.time_s - start_s + 12.0
            north, east = (round(100.0 * sample.speed_mps * f(sample.heading_rad)) for f in (math.cos, math.sin))
            place = {
                "lat": round(1e7 * sample.latitude_deg),
                "lon": round(1e7 * sample.longitude_deg),
                "alt": 0,
                "hdg": 65535,
            }
            parts.append(mavlink("GLOBAL_POSITION_INT", boot_s, vx=north, vy=east, **place))
            angles = {
                "roll": sample.roll_rad,
                "pitch": sample.pitch_rad,
                "yaw": math.remainder(sample.heading_rad, math.tau),
            }
            parts += [mavlink("ATTITUDE", boot_s, **angles), mavlink("HEARTBEAT", boot_s)]
    path = tmp_path / "log"
    path.write_bytes(b"".join(parts))
    log = open_log(path, Config())
    live = [contact for contact in live_contacts("ping_protocol") if contact.p_mine > 0.25]
    found = [contact for contact in contacts_of(iter(log), Config()) if contact.p_mine > 0.25]
    assert log.counters["reader.mavlink_malformed"] == 2
    assert len(found) == len(live) == 2
    for one in live:
        assert min(apart_m(one, other) for other in found) < 0.25


def test_an_svlog_without_a_time_counts_from_1970_and_reports_it(tmp_path: Path) -> None:
    whole = written("ping_protocol", tmp_path / "whole").read_bytes()
    path = tmp_path / "log"
    path.write_bytes(whole[len(svlog_head(UTC_S)) :])
    events = list(open_log(path, Config()))
    assert pings(iter(events))[0].time_s == pytest.approx(0.0, abs=1e-3)
    assert [event.code for event in events if isinstance(event, Notice)].count("reader.time_unknown") == 1


def restamped(data: bytes, counter_of: Callable[[int, int], int]) -> list[bytes]:
    """The packets of an svlog, the counters of its profiles changed by their number in the log and their value, ms."""
    framer = Framer(PingGrammar())
    parts = []
    for n, (message, _, _) in enumerate(framer.feed(data) + framer.finish()):
        profile = decode(message)
        if isinstance(profile, OsMonoProfile):
            parts.append(encode(profile._replace(timestamp_ms=counter_of(n, profile.timestamp_ms))))
        else:
            parts.append(ping_wire(message))
    return parts


def test_a_counter_that_starts_over_after_49_days_is_no_new_start(tmp_path: Path) -> None:
    whole = written("ping_protocol", tmp_path / "whole").read_bytes()
    path = tmp_path / "log"
    path.write_bytes(b"".join(restamped(whole, lambda n, counter_ms: (counter_ms - 77_000 - 5_000) % 2**32)))
    log = open_log(path, Config())
    found, expected = pings(iter(log)), pings(iter(open_log(tmp_path / "whole", Config())))
    assert [ping.time_s for ping in found] == pytest.approx([ping.time_s for ping in expected], abs=1e-6)
    assert log.counters["reader.sonar_restarted"] == 0


def test_logs_joined_into_one_file_have_the_times_of_their_heads(tmp_path: Path) -> None:
    whole = written("ping_protocol", tmp_path / "whole").read_bytes()
    path = tmp_path / "log"
    later = svlog_head(UTC_S + 1000.0) + whole[len(svlog_head(UTC_S)) :]
    path.write_bytes(whole + later)
    found = pings(iter(open_log(path, Config())))
    assert len(found) == 2 * 212
    assert found[212].time_s - found[0].time_s == pytest.approx(1000.0, abs=1e-3)


def test_a_sonar_that_was_powered_up_anew_goes_on_in_time(tmp_path: Path) -> None:
    whole = written("ping_protocol", tmp_path / "whole").read_bytes()
    parts = restamped(whole, lambda n, counter_ms: counter_ms - 77_000 if n > 800 else counter_ms)
    path = tmp_path / "log"
    path.write_bytes(b"".join(parts))
    log = open_log(path, Config())
    found = pings(iter(log))
    steps = np.diff([ping.time_s for ping in found])
    assert len(found) >= 212
    assert steps.min() >= 0.0
    assert steps.max() < 0.3
    assert log.counters["reader.sonar_restarted"] == 1


# --- what is missing or damaged ---


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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("chunk_bytes", [1, 777])
def test_the_read_buffer_changes_nothing(kind: SonarKind, chunk_bytes: int, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(written(kind, tmp_path / "whole").read_bytes()[:60_000])

    def read(chunk_bytes: int) -> tuple[list[Any], Counter[str]]:
        log = open_log(path, Config(), chunk_bytes)
        return [structs.astuple(event) for event in log if not isinstance(event, Ping)], log.counters

    (one, counters), (other, other_counters) = read(1 << 18), read(chunk_bytes)
    assert repr(one) == repr(other)
    assert counters == other_counters


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


# --- several logs ---


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
    path.write_bytes(head + ping_wire(PingMessage(NMEA_WRAPPER, b"$GPHDT,12.0,T*08\r\n")) * 1000 + whole[len(head) :])
    log = open_log(path, Config())
    assert len(pings(iter(log))) == 212
    assert log.counters["reader.navigation_dropped"] >= 744
