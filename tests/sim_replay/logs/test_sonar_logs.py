"""What JSF files and svlogs hold: subsystems, motion, times and counters."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NavSample, Notice, Ping
from auv_mcm.settings.config import Config, SonarConfig
from drivers.framing import Framer
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nmea_unit import NmeaUnit
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import JsfMessage
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import OsMonoProfile, PingMessage, decode, encode
from drivers.sonar.ping_messages import to_wire as ping_wire
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.logs.jsf_recording import JsfRecording
from sim_replay.logs.open_log import open_log
from sim_replay.logs.recorded import open_mission
from sim_replay.wire_logs import jsf_time, svlog_head
from tests.sim_replay.logs.sonar_logs import (
    UTC_S,
    apart_m,
    bytes_of,
    contacts_of,
    live_contacts,
    mavlink,
    mission,
    pings,
    replayed,
    run_of,
    stamp_at,
    written,
)


def messages_of(folder: Path) -> list[JsfMessage]:
    """Write a JSF log, `whole`, and return its messages."""
    framer = Framer(JsfGrammar())
    framed = framer.feed(written("jsf", folder / "whole").read_bytes()) + framer.finish()
    return [each.message for each in framed]


def jsf_log(folder: Path, messages: Iterable[JsfMessage]) -> Path:
    """Write a log of other messages, `log`, beside it."""
    path = folder / "log"
    path.write_bytes(b"".join(map(jsf_wire, messages)))
    return path


def is_side_scan(message: JsfMessage) -> bool:
    return message.message_type == 80


def is_sentence(message: JsfMessage) -> bool:
    return message.message_type == 2002


def test_a_jsf_log_of_the_low_frequency_alone_is_taken(tmp_path: Path) -> None:
    whole = messages_of(tmp_path)
    low = jsf_log(tmp_path, (each._replace(subsystem=20) if is_side_scan(each) else each for each in whole))
    found, expected = replayed(low, Config()), replayed(tmp_path / "whole", Config())
    assert [bytes_of(contact) for contact in found] == [bytes_of(contact) for contact in expected]


def test_data_with_the_command_byte_of_a_normal_source_are_no_replies(tmp_path: Path) -> None:
    marked = jsf_log(tmp_path, (each._replace(command=2) for each in messages_of(tmp_path)))
    log, expected = open_log(marked, Config()), open_log(tmp_path / "whole", Config())
    assert [repr(event) for event in log] == [repr(event) for event in expected]
    assert log.counters == expected.counters


def test_of_several_subsystems_the_highest_is_used_or_the_one_configured(tmp_path: Path) -> None:
    parts: list[JsfMessage] = []
    for message in messages_of(tmp_path):
        parts += [message._replace(subsystem=20), message] if is_side_scan(message) else [message]
    both = jsf_log(tmp_path, parts)
    events = list(open_log(both, Config()))
    n_pings = len(pings(iter(open_log(tmp_path / "whole", Config()))))
    assert len(pings(iter(events))) == n_pings
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "reader.frequency_chosen"
    assert "20 (low frequency) and 21 (high frequency): 21 is used. Set sonar.subsystem: 20" in notice.text
    for subsystem in (20, 21):
        log = open_log(both, Config(sonar=SonarConfig(subsystem=subsystem)))
        assert len(pings(iter(log))) == n_pings
        assert log.counters[f"reader.not_used.subsystem_{41 - subsystem}"] == 2 * n_pings
    with pytest.raises(UsageError, match=r"sonar\.subsystem is 22, but .*log holds side scan of subsystem 20 and 21"):
        open_log(both, Config(sonar=SonarConfig(subsystem=22)))


def test_a_damaged_header_makes_no_second_subsystem(tmp_path: Path) -> None:
    messages = messages_of(tmp_path)
    whole = bytearray((tmp_path / "whole").read_bytes())
    offset = sum(len(jsf_wire(each)) for each in takewhile(lambda each: not is_side_scan(each), messages))
    whole[offset + 7] ^= 1
    path = tmp_path / "flipped"
    path.write_bytes(whole)
    log = open_log(path, Config())
    assert len(pings(iter(log))) > 100
    assert log.counters["reader.not_used.subsystem_20"] == 1


def test_a_jsf_log_without_side_scan_is_rejected_with_its_contents(tmp_path: Path) -> None:
    path = jsf_log(tmp_path, (each._replace(subsystem=0) for each in messages_of(tmp_path) if is_side_scan(each)))
    with pytest.raises(
        BadInputError, match=r"holds no side-scan message.*of type 80 of subsystem 0.*side scan switched on"
    ):
        open_log(path, Config())


def _packed(message: JsfMessage, **changes: int) -> JsfMessage:
    """Cut a message to a third and give it a data format of EdgeTech's own."""
    body = message.body[:34] + b"\x00\x01" + message.body[36 : 240 + (len(message.body) - 240) // 3]
    return message._replace(body=body, **changes)


def test_side_scan_in_a_data_format_that_is_not_read_is_refused_in_words(tmp_path: Path) -> None:
    path = jsf_log(tmp_path, map(_packed, filter(is_side_scan, messages_of(tmp_path))))
    with pytest.raises(BadInputError, match=r"of type 80 of subsystem 21 in data format 256\..*convert them with its"):
        open_log(path, Config())


@pytest.mark.parametrize("subsystem", [0, 22])
def test_what_is_recorded_in_another_data_format_beside_side_scan_is_no_damage(subsystem: int, tmp_path: Path) -> None:
    parts: list[JsfMessage] = []
    for message in messages_of(tmp_path):
        parts += [message, _packed(message, subsystem=subsystem)] if is_side_scan(message) else [message]
    log, plain = open_log(jsf_log(tmp_path, parts), Config()), open_log(tmp_path / "whole", Config())
    assert [repr(event) for event in log] == [repr(event) for event in plain]


def test_pitch_and_roll_of_the_motion_sensor_serve_where_nothing_else_gives_them(tmp_path: Path) -> None:
    def motion(at_s: float) -> JsfMessage:
        body = bytearray(44)
        body[:12] = jsf_time(stamp_at(at_s))
        struct.pack_into(
            "<hh6xHI", body, 24, round(3.0 / 180 * 32768), round(-5.0 / 180 * 32768), 12_345, 1 << 6 | 1 << 7 | 1 << 9
        )
        return JsfMessage(2020, bytes(body), subsystem=101)

    parts = [each for each in messages_of(tmp_path) if is_side_scan(each) or b"GGA" in each.body]
    last_s = run_of("jsf").recorded[-1].stamp.utc_ns * 1e-9 - UTC_S
    path = jsf_log(tmp_path, [*parts, *(motion(last_s + 0.1 * n) for n in range(9))])
    samples = [
        event for event in open_log(path, Config()) if isinstance(event, NavSample) and not math.isnan(event.roll_rad)
    ]
    assert len(samples) == 9
    for sample in samples:
        assert math.degrees(sample.pitch_rad) == pytest.approx(3.0, abs=0.02)
        assert math.degrees(sample.roll_rad) == pytest.approx(-5.0, abs=0.02)
        assert math.degrees(sample.heading_rad) == pytest.approx(123.45, abs=0.02)
    assert samples[0].time_s == pytest.approx(UTC_S + last_s, abs=1e-3)


@pytest.mark.parametrize(("bit", "given"), [(0, "speed"), (5, "altitude"), (6, "heading"), (7, "pitch"), (8, "roll")])
def test_each_bit_of_a_doppler_log_stands_for_its_own_quantity(tmp_path: Path, bit: int, given: str) -> None:
    numbers = (1 << bit, 812, 0, 0, 812, -300, 1600, 250, -480, 12_345)
    body = struct.pack("<12xI4i2h10x2hH20x", *numbers)
    sides = filter(is_side_scan, messages_of(tmp_path))
    path = jsf_log(tmp_path, [*sides, JsfMessage(2080, body, subsystem=101)])
    last = [event for event in JsfRecording(path, None, 1 << 16) if event.port == "doppler"][-1]
    (fix,) = NmeaUnit("doppler").feed(last.data, last.stamp) or [NavFix(source="", received=last.stamp)]
    found = {
        "speed": (fix.speed_mps, math.hypot(0.3, 1.6)),
        "altitude": (fix.altitude_m, 8.12),
        "heading": (math.degrees(fix.heading_rad), 123.45),
        "pitch": (math.degrees(fix.pitch_rad), 2.5),
        "roll": (math.degrees(fix.roll_rad), -4.8),
    }
    assert {name for name, (value, _) in found.items() if not math.isnan(value)} == {given}
    assert found[given][0] == pytest.approx(found[given][1], abs=0.01)


@pytest.mark.parametrize(
    ("kind", "body"), [(2080, struct.pack("<56xH14x", 1450)), (2060, struct.pack("<32xI40x", 1_450_000))]
)
@pytest.mark.parametrize("once", [False, True])
def test_the_sound_speed_of_a_sensor_scales_ranges_even_if_stated_once(
    tmp_path: Path, kind: int, body: bytes, once: bool
) -> None:
    sensor = JsfMessage(kind, body, subsystem=101)
    parts = [sensor]
    for message in messages_of(tmp_path):
        changed = bytearray(message.body)
        if is_side_scan(message):
            changed[31] &= ~(1 << 6)  # validity, bit 14: no sound speed
        parts += [message._replace(body=bytes(changed)), *[sensor] * (not once)]
    log = open_log(jsf_log(tmp_path, parts), Config())
    assert {ping.sound_speed_mps for ping in pings(iter(log))} == {1450.0}


def test_a_sound_speed_that_is_called_valid_and_is_0_counts_as_none(tmp_path: Path) -> None:
    parts = [
        each._replace(body=each.body[:148] + bytes(4) + each.body[152:]) if is_side_scan(each) else each
        for each in messages_of(tmp_path)
    ]
    notices = [event.code for event in open_log(jsf_log(tmp_path, parts), Config()) if isinstance(event, Notice)]
    assert notices == ["reader.sound_speed_assumed"]


def test_a_frequency_above_655_khz_is_read_from_all_of_its_bits(tmp_path: Path) -> None:
    parts = []
    for message in messages_of(tmp_path):
        body = bytearray(message.body)
        if is_side_scan(message):
            for at, shift, khz in ((126, 0, 1550), (128, 4, 1650)):
                body[16] |= (khz * 100 >> 16) << shift
                body[at : at + 2] = (khz * 100 & 0xFFFF).to_bytes(2, "little")
        parts.append(message._replace(body=bytes(body)))
    assert JsfRecording(jsf_log(tmp_path, parts), None, 1 << 16).frequency_khz == pytest.approx(1600.0)


def moved(message: JsfMessage, by_s: float) -> JsfMessage:
    """A message of a JSF log at another time."""
    (seconds,) = struct.unpack_from("<i", message.body)
    return message._replace(body=struct.pack("<i", seconds + round(by_s)) + message.body[4:])


def test_a_clock_set_back_in_a_log_costs_no_ping(tmp_path: Path) -> None:
    messages = messages_of(tmp_path)
    middle = len(messages) // 2
    parts = (moved(each, -3600.0 if n > middle else 0.0) for n, each in enumerate(messages))
    log = open_log(jsf_log(tmp_path, parts), Config())
    events = list(log)
    n_pings = len(pings(iter(open_log(tmp_path / "whole", Config()))))
    found = pings(iter(events))
    assert n_pings <= len(found) <= n_pings + 1  # the ping in the middle may have one side on each side of the step
    assert sum(later.time_s < earlier.time_s for earlier, later in pairwise(found)) == 1
    assert log.counters["reader.time_backwards"] == 1
    assert any(isinstance(event, Notice) and event.code == "reader.time_backwards" for event in events)
    late = [event for event in events if isinstance(event, NavSample) and event.time_s < UTC_S - 1000.0]
    assert sum(math.isfinite(event.latitude_deg) for event in late) > 50


@pytest.mark.parametrize("by_s", [-20.0, -3.0, 0.0, 3.0, 3600.0])
def test_a_clock_of_navigation_that_is_off_that_of_the_pings_costs_no_position(tmp_path: Path, by_s: float) -> None:
    parts = (moved(each, by_s) if is_sentence(each) else each for each in messages_of(tmp_path))
    log, pipeline = open_log(jsf_log(tmp_path, parts), Config()), Pipeline(Config())
    events = list(log)
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    assert pipeline.counters["navigation.ping_stale"] == log.counters["reader.time_backwards"] == 0
    codes = [event.code for event in events if isinstance(event, Notice)]
    assert codes == ["reader.packet_time_doubted"] * (abs(by_s) > 1.0)
    found, truth = (
        np.array([(e.time_s, e.latitude_deg) for e in some if isinstance(e, NavSample) and e.latitude_deg > 0.0])
        for some in (events, open_log(tmp_path / "whole", Config()))
    )
    off_deg = np.abs(found[:, 1] - np.interp(found[:, 0], *truth.T))
    assert off_deg.max() * 111_200.0 < 0.2, "metres: a tenth of a second"


def test_a_clock_of_navigation_that_is_off_stays_so_while_the_sonar_is_silent(tmp_path: Path) -> None:
    messages = messages_of(tmp_path)
    parts = [
        moved(each, -3.0) if is_sentence(each) else each
        for each in messages
        if is_sentence(each) or not 6.0 <= struct.unpack_from("<i", each.body)[0] - UTC_S < 13.0
    ]
    log = open_log(jsf_log(tmp_path, parts), Config())
    assert len(pings(iter(log))) == 124
    assert log.counters["reader.packet_time_doubted"] == sum(map(is_sentence, messages))
    assert log.counters["reader.time_backwards"] == log.counters["reader.time_outlier"] == 0


def test_one_impossible_time_is_left_out(tmp_path: Path) -> None:
    messages = messages_of(tmp_path)
    at = next(n for n, message in enumerate(messages) if n > 50 and is_side_scan(message))
    messages[at] = moved(messages[at], 1e6)
    log = open_log(jsf_log(tmp_path, messages), Config())
    found = pings(iter(log))
    assert log.counters["reader.time_outlier"] == 1
    assert max(ping.time_s for ping in found) < UTC_S + 1000.0


def test_a_clock_that_was_never_set_is_reported_and_the_log_is_read(tmp_path: Path) -> None:
    path = jsf_log(tmp_path, (each._replace(body=bytes(4) + each.body[4:]) for each in messages_of(tmp_path)))
    events = list(open_mission([path], Config()).events())
    assert sum(isinstance(event, Ping) for event in events) > 100
    assert "reader.time_unknown" in {event.code for event in events if isinstance(event, Notice)}


def test_messages_are_put_in_order_of_time(tmp_path: Path) -> None:
    """Recorders write what came within a second in any order."""
    messages = messages_of(tmp_path)
    random = np.random.Generator(np.random.PCG64(3))
    place = np.arange(len(messages)) + random.uniform(0.0, 20.0, len(messages))
    strings = np.array([is_sentence(message) for message in messages])
    place = np.where(strings, place, np.arange(len(messages)))  # sides of a ping stay together
    path = jsf_log(tmp_path, (messages[n] for n in np.argsort(place)))
    found, expected = positions(path), positions(tmp_path / "whole")
    assert len(found) == 212
    assert found == expected


def positions(path: Path) -> list[tuple[float, float, float]]:
    samples = [event for event in open_log(path, Config()) if isinstance(event, NavSample)]
    return [(e.time_s, e.latitude_deg, e.longitude_deg) for e in samples if not math.isnan(e.latitude_deg)]


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


@pytest.mark.parametrize("n_before", [0, 60])
@pytest.mark.parametrize("look_deg", [0.0, 90.0])
def test_heads_that_share_a_channel_have_counters_of_their_own(look_deg: float, n_before: int, tmp_path: Path) -> None:
    """The other head was powered up a minute later; they differ by device number, or by look angle.

    n_before: pings that it has counted more.
    """
    parts = []
    for message, _, _ in Framer(PingGrammar()).feed(written("ping_protocol", tmp_path / "whole").read_bytes()):
        profile = decode(message)
        if isinstance(profile, OsMonoProfile):
            side, source = 2 * profile.channel_number - 1, 0 if look_deg else 1 + profile.channel_number
            later = profile._replace(
                channel_number=0,
                ping_number=profile.ping_number + n_before * profile.channel_number,
                timestamp_ms=profile.timestamp_ms - 30_000 * (1 + side),
                transducer_heading_deg=side * look_deg,
            )
            message = message._replace(payload=encode(later)[8:-2], source=source)
        parts.append(ping_wire(message))
    path = tmp_path / "log"
    path.write_bytes(b"".join(parts))
    log = open_log(path, Config())
    events = list(log)
    found, expected = pings(iter(events)), pings(iter(open_log(tmp_path / "whole", Config())))
    assert [ping.time_s for ping in found] == pytest.approx([ping.time_s for ping in expected], abs=1e-6)
    assert all(ping.port and ping.starboard for ping in found)
    assert log.counters["reader.sonar_restarted"] == 0
    assert "device_clock_anchored_anew" not in {event.code for event in events if isinstance(event, Notice)}
