"""The content of a sound log must arrive unchanged, and every known habit of recorders must be understood."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.records import NavSample, Notice, Ping
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.port_order import DECISIVE, port_order_evidence
from sim_replay.logs.xtf import XtfLog
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, SampleRecorder, Scene, Seabed, Sonar, Track, World
from tests.sim_replay.logs.xtf_logs import (
    START_S,
    codes_of,
    edit_channels,
    edit_file_header,
    edit_headers,
    mission,
    navigated,
    navigation,
    navigation_of,
    packet_offsets,
    ping,
    pings_of,
    read,
    same_trace,
    trace,
    written,
)


def same_events(a: list[Any], b: list[Any]) -> bool:
    """Byte-identical records (NaN equal to NaN)."""
    return len(a) == len(b) and all(repr(x) == repr(y) for x, y in zip(a, b, strict=True))


def test_events_come_in_file_order_navigation_before_its_ping(tmp_path: Path) -> None:
    events, log = read(written(tmp_path / "log.xtf", 4))
    assert [type(event) for event in events] == [NavSample, Ping] * 4
    assert [p.number for p in pings_of(events)] == [0, 1, 2, 3]
    assert log.counters == {"reader.pings": 4}
    assert log.bytes_read == log.size_bytes


def test_a_second_iteration_gives_the_same_again(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")
    edit_headers(path, lambda _, header: setattr(header, "SoundVelocity", 3.0))
    log = XtfLog(path, SonarConfig())
    first, second = list(log), list(log)
    assert same_events(first, second)
    assert log.counters["reader.pings"] == 8


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    def peak(n_pings: int) -> int:
        path = written(tmp_path / f"{n_pings}.xtf", n_pings)
        tracemalloc.start()
        for _ in XtfLog(path, SonarConfig()):
            pass
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    peak(60)  # imports and caches
    assert peak(600) < peak(150) + 20_000


@pytest.mark.parametrize("stored_far_to_near", [True, False])
@pytest.mark.parametrize("starboard", [True, False])
def test_the_order_of_port_samples_is_seen(tmp_path: Path, stored_far_to_near: bool, starboard: bool) -> None:
    pings = [ping(n, starboard=starboard, n_samples=400) for n in range(60)]
    path = written(tmp_path / "log.xtf", navigated(pings), port_far_to_near=stored_far_to_near)
    events, _ = read(path, port_order="auto")
    assert all(same_trace(p.port, q.port) for p, q in zip(pings_of(events), pings, strict=True))
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "reader.port_order"
    assert notice.for_the_record, "an order that was seen needs nobody to set it"
    assert ("far_to_near" if stored_far_to_near else "near_to_far") in notice.text.split("(")[0]


@pytest.mark.parametrize("kind", ["amplitude_uint16", "log_uint8"])
@pytest.mark.parametrize("altitude_m", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("ring_down_m", [0.0, 0.5])
def test_the_order_is_seen_in_port_alone_whatever_the_samples_mean(
    kind: Literal["amplitude_uint16", "log_uint8"], altitude_m: float, ring_down_m: float
) -> None:
    scene = Scene(
        world=World(depth_m=25.0, seabeds=(Seabed(type="sand", texture_shape=3.0, texture_m=0.5),)),
        sonar=Sonar(
            range_m=30.0,
            ping_rate_hz=15.0,
            ring_down_m=ring_down_m,
            beam_lines=1,
            recorder=SampleRecorder(samples=kind),
        ),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=6.0), altitude_m=altitude_m),
    )
    traces = [event.port for event in Mission(scene).events() if isinstance(event, Ping) and event.port is not None]
    port = np.stack([t.samples for t in traces])
    evidence = port_order_evidence(port[:, ::-1], None, traces[0].spacing_m, 1.0)
    assert evidence.total > DECISIVE
    assert port_order_evidence(port, None, traces[0].spacing_m, 1.0).total == pytest.approx(-evidence.total)


def test_noise_alone_hardly_shows_a_port_order() -> None:
    random = np.random.default_rng(5)
    totals = np.array(
        [port_order_evidence(random.rayleigh(100.0, (50, 1024)), None, 0.03, 1.0).total for _ in range(40)]
    )
    assert np.mean(np.abs(totals) > DECISIVE) < 0.3
    assert np.all(np.abs(totals) < 2.5 * DECISIVE)


@pytest.mark.parametrize("configured", ["far_to_near", "near_to_far"])
def test_a_configured_port_order_is_obeyed_and_disagreement_reported(tmp_path: Path, configured: str) -> None:
    pings = [ping(n, n_samples=400) for n in range(20)]
    path = written(tmp_path / "log.xtf", navigated(pings), port_far_to_near=True)
    events, _ = read(path, port_order=configured)
    agrees = configured == "far_to_near"
    assert codes_of(events) == ([] if agrees else ["reader.port_order_disagrees"])
    port = pings_of(events)[0].port
    assert port is not None
    assert pings[0].port is not None
    assert np.array_equal(port.samples if agrees else port.samples[::-1], pings[0].port.samples)


def test_a_featureless_port_channel_is_assumed_far_to_near_and_reported_as_unseen(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)

    def blank(data: bytearray) -> None:
        for offset in packet_offsets(bytes(data)):
            data[offset + 320 : offset + 320 + 192] = b"\x64\x00" * 96

    data = bytearray(path.read_bytes())
    blank(data)
    path.write_bytes(data)
    events, _ = read(path, port_order="auto")
    text = next(event.text for event in events if isinstance(event, Notice))
    assert "cannot be seen" in text
    assert "far_to_near is assumed" in text


@pytest.mark.parametrize(
    ("stored", "expected", "codes"),
    [
        (1480.0, 1480.0, []),
        (740.0, 1480.0, []),
        (750.0, 1500.0, []),
        (0.0, 1500.0, ["reader.sound_speed_absurd"]),
        (330.0, 1500.0, ["reader.sound_speed_absurd"]),
        (4900.0, 1500.0, ["reader.sound_speed_absurd"]),
        (math.nan, 1500.0, ["reader.sound_speed_absurd"]),
    ],
)
def test_sound_speed_is_taken_two_way_or_replaced_if_absurd(
    tmp_path: Path, stored: float, expected: float, codes: list[str]
) -> None:
    path = written(tmp_path / "log.xtf")
    edit_headers(path, lambda _, header: setattr(header, "SoundVelocity", stored))
    events, _ = read(path)
    assert {p.sound_speed_mps for p in pings_of(events)} == {expected}
    assert codes_of(events) == codes
    port = pings_of(events)[0].port
    assert port is not None
    assert port.spacing_m == pytest.approx(12.0 / 96, rel=1e-6)


def test_an_overriding_sound_speed_scales_ranges_and_is_reported(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")
    events, _ = read(path, sound_speed_mps=1470.0)
    assert codes_of(events) == ["reader.sound_speed_overridden"]
    first = pings_of(events)[0]
    assert first.sound_speed_mps == 1470.0
    assert first.port is not None
    assert first.port.spacing_m == pytest.approx(12.0 / 96 * 1470.0 / 1500.0, rel=1e-6)
    assert first.port.first_range_m == pytest.approx(0.5 * first.port.spacing_m)


def test_only_distinct_fixes_carry_a_position(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 9)

    def repeat(index: int, header: Any) -> None:
        header.SensorYcoordinate = 43.0 + 1e-6 * (index // 3)
        header.SensorXcoordinate = 5.0

    edit_headers(path, repeat)
    events, _ = read(path)
    assert [math.isnan(s.latitude_deg) for s in navigation_of(events)] == [False, True, True] * 3
    assert not any(math.isnan(s.heading_rad) for s in navigation_of(events))


def test_a_header_that_repeats_all_navigation_brings_no_sample(tmp_path: Path) -> None:
    events = [event for n in range(6) for event in (navigation(n // 2, time_s=START_S + 0.1 * n), ping(n))]
    read_events, log = read(written(tmp_path / "log.xtf", events))
    assert [round((s.time_s - START_S) * 10) for s in navigation_of(read_events)] == [0, 2, 4]
    assert log.counters["reader.repeated_navigation"] == 3
    assert len(pings_of(read_events)) == 6


@pytest.mark.parametrize("field", ["SensorYcoordinate", "SensorXcoordinate", "SensorHeading", "SensorSpeed"])
def test_what_is_unknown_again_is_repeated(tmp_path: Path, field: str) -> None:
    path = written(tmp_path / "log.xtf", [event for n in range(6) for event in (navigation(0), ping(n))])
    edit_headers(path, lambda _, header: setattr(header, field, math.nan))
    assert read(path)[1].counters["reader.repeated_navigation"] == 5


def test_units_and_signs_are_those_of_the_format(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 2)

    def fill(_: int, header: Any) -> None:
        header.SensorHeading, header.SensorPitch, header.SensorRoll, header.SensorSpeed = 90.0, -20.0, 5.0, 2.0

    edit_headers(path, fill)
    sample = navigation_of(read(path)[0])[0]
    assert sample.heading_rad == pytest.approx(math.pi / 2)
    assert sample.pitch_rad == pytest.approx(math.radians(-20.0))
    assert sample.roll_rad == pytest.approx(math.radians(5.0))
    assert sample.speed_mps == pytest.approx(2.0 * 0.514444, rel=1e-5)


@pytest.mark.parametrize("nothing", [0.0, math.nan])
def test_gyro_and_ship_speed_stand_in_where_the_sensor_has_none(tmp_path: Path, nothing: float) -> None:
    path = written(tmp_path / "log.xtf")

    def fill(_: int, header: Any) -> None:
        header.SensorHeading = header.SensorSpeed = nothing
        header.ShipGyro, header.ShipSpeed = 120.0, 4.0

    edit_headers(path, fill)
    sample = navigation_of(read(path)[0])[0]
    assert sample.heading_rad == pytest.approx(math.radians(120.0))
    assert sample.speed_mps == pytest.approx(4.0 * 1852 / 3600)


@pytest.mark.parametrize("nothing", [0.0, math.nan])
def test_vessel_positions_stand_in_and_are_reported(tmp_path: Path, nothing: float) -> None:
    path = written(tmp_path / "log.xtf")

    def move(_: int, header: Any) -> None:
        header.ShipYcoordinate, header.ShipXcoordinate = header.SensorYcoordinate, header.SensorXcoordinate
        header.SensorYcoordinate = header.SensorXcoordinate = nothing

    edit_headers(path, move)
    events, _ = read(path)
    assert codes_of(events) == ["reader.ship_position"]
    assert [s.latitude_deg for s in navigation_of(events)] == [navigation(n).latitude_deg for n in range(8)]


def test_longitudes_beyond_180_are_wrapped(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 1)
    edit_headers(path, lambda _, header: setattr(header, "SensorXcoordinate", 190.25))
    assert navigation_of(read(path)[0])[0].longitude_deg == -169.75


@pytest.mark.parametrize("per_second", [1, 3, 10])
def test_pings_that_share_a_time_stamp_are_spread_evenly(tmp_path: Path, per_second: int) -> None:
    n_pings = 5 * per_second
    events, log = read(
        written(tmp_path / "log.xtf", navigated([ping(n, time_s=START_S + n // per_second) for n in range(n_pings)]))
    )
    times = [p.time_s - START_S for p in pings_of(events)]
    assert times == pytest.approx([n / per_second for n in range(n_pings)])
    assert log.counters["reader.time_tied"] == 5 * (per_second - 1)
    assert ("reader.time_tied" in codes_of(events)) == (per_second > 1)


@given(ticks=st.lists(st.integers(0, 3), min_size=1, max_size=40))
def test_times_always_increase_where_the_clock_does_not_run_backwards(
    tmp_path_factory: pytest.TempPathFactory, ticks: list[int]
) -> None:
    stamps = START_S + 0.01 * np.cumsum(ticks)
    path = written(
        tmp_path_factory.mktemp("clock") / "log.xtf",
        navigated([ping(n, time_s=float(t), n_samples=16) for n, t in enumerate(stamps)]),
    )
    times = np.array([p.time_s for p in pings_of(read(path)[0])])
    assert np.all(np.diff(times) > 0.0)
    assert np.all(times >= stamps - 1e-6)


def test_a_clock_that_stands_still_is_replaced_by_the_ping_interval(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated([ping(n, time_s=START_S, n_samples=16) for n in range(150)]))
    edit_channels(path, lambda _index, _channel, header: setattr(header, "SecondsPerPing", 0.05))
    events, log = read(path)
    assert np.diff([p.time_s for p in pings_of(events)]) == pytest.approx(0.05, abs=1e-6)
    assert log.counters["reader.clock_stuck"] == 150 - 64
    assert "reader.clock_stuck" in codes_of(events)


def test_saturated_samples_stay(tmp_path: Path) -> None:
    first = ping(0)
    assert first.port is not None
    clipped = np.where(first.port.samples > 100, 65535, first.port.samples).astype(np.uint16)
    loud = Ping(number=0, time_s=START_S, port=None, starboard=trace(1))
    path = written(tmp_path / "log.xtf", [loud])
    data = bytearray(path.read_bytes())
    data[FIRST_SAMPLE : FIRST_SAMPLE + 192] = clipped.tobytes()
    path.write_bytes(data)
    starboard = pings_of(read(path)[0])[0].starboard
    assert starboard is not None
    assert np.array_equal(starboard.samples, clipped)


FIRST_SAMPLE = 1024 + 256 + 64


def test_other_packets_are_skipped_and_counted_by_type(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    data = path.read_bytes()
    start = packet_offsets(data)[1]

    def packet(kind: int, n_bytes: int) -> bytes:
        return b"\xce\xfa" + bytes([kind, 0]) + bytes(6) + n_bytes.to_bytes(4, "little") + bytes(n_bytes - 14)

    path.write_bytes(data[:start] + packet(3, 64) + packet(107, 64) + packet(3, 64) + packet(222, 128) + data[start:])
    events, log = read(path)
    assert codes_of(events) == []
    assert len(pings_of(events)) == 3
    assert log.counters["reader.packet_not_side_scan.attitude"] == 2
    assert log.counters["reader.packet_not_side_scan.pos_raw_navigation"] == 1
    assert log.counters["reader.packet_not_side_scan.type_222"] == 1


@pytest.mark.parametrize("sample_type", ["uint8", "uint16"])
def test_samples_of_a_format_that_is_not_declared_are_taken_by_their_width(
    tmp_path: Path, sample_type: Literal["uint8", "uint16"]
) -> None:
    pings = [ping(n, dtype=sample_type) for n in range(3)]
    path = written(tmp_path / "log.xtf", navigated(pings), sample_type=sample_type)

    def forget(header: Any) -> None:
        for info in header.ChanInfo:
            info.SampleFormat = 0

    edit_file_header(path, forget)
    assert all(same_trace(p.starboard, q.starboard) for p, q in zip(pings_of(read(path)[0]), pings, strict=True))


def test_a_recording_delay_moves_ranges_out_and_is_reported(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")
    edit_channels(path, lambda _index, _channel, header: setattr(header, "TimeDelay", 0.004))
    events, _ = read(path)
    assert codes_of(events) == ["reader.time_delay"]
    port = pings_of(events)[0].port
    assert port is not None
    assert port.first_range_m == pytest.approx(3.0 + 0.5 * 0.125, rel=1e-5)


def test_a_changed_weight_factor_is_scaled_to_the_first(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 4)
    edit_channels(path, lambda index, _, header: setattr(header, "Weight", 3 if index < 2 else 1))
    events, log = read(path)
    for index, p in enumerate(pings_of(events)):
        original = ping(index).starboard
        assert p.starboard is not None
        assert original is not None
        assert np.array_equal(p.starboard.samples, original.samples if index < 2 else 4.0 * original.samples)
    assert log.counters["reader.weight_change"] == 4
    assert "reader.weight_change" in codes_of(events)


@pytest.mark.parametrize(
    ("stated_deg", "sonar", "is_asked"),
    [
        (1.8, {}, True),
        (0.7, {}, False),  # 0.5 two-way, which is used
        (0.25, {}, False),
        (0.0, {}, False),
        (35.0, {}, False),  # no width along the track
        (1.8, {"beam_width_deg": 1.3}, False),
        (1.2, {"beam_width_deg": 0.85}, False),  # as the notice rounds it
        (1.8, {"kind": "sas"}, False),
    ],
)
def test_a_beam_stated_in_the_log_that_is_wider_than_the_one_used_is_reported(
    stated_deg: float, sonar: dict[str, Any], is_asked: bool, tmp_path: Path
) -> None:
    path = written(tmp_path / "log.xtf")
    edit_file_header(path, lambda header: setattr(header.ChanInfo[1], "HorizBeamAngle", stated_deg))
    notices = [event for event in read(path, **sonar)[0] if isinstance(event, Notice)]
    assert [notice.code for notice in notices] == ["reader.beam_is_wider"] * is_asked
    assert all("1.8 degrees along the track, 1.3 two-way, and 0.5 is used" in notice.text for notice in notices)


def test_mounting_stated_in_the_log_is_reported_but_not_applied(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf")

    def fill(header: Any) -> None:
        header.ChanInfo[0].OffsetX = 1.5
        header.NavigationLatency = 200

    edit_file_header(path, fill)
    (notice,) = [event for event in read(path)[0] if isinstance(event, Notice)]
    assert notice.code == "reader.mounting_not_applied"
    assert "1.5" in notice.text
    assert "200 ms" in notice.text


def test_places_name_file_byte_and_ping(tmp_path: Path) -> None:
    path = written(tmp_path / "dive 7.xtf", 3)
    assert pings_of(read(path)[0])[2].place == f"dive 7.xtf, byte {packet_offsets(path.read_bytes())[2]}, ping 2"


def test_a_pickled_index_beside_the_log_is_not_loaded(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    (tmp_path / "log.pyxtf_idx").write_bytes(b"cos\nsystem\n(S'exit 1'\ntR.")
    assert len(pings_of(read(path)[0])) == 3


def test_joined_logs_are_read_as_one(tmp_path: Path) -> None:
    first = written(tmp_path / "a.xtf", 3)
    second = written(tmp_path / "b.xtf", navigated([ping(n, dtype="uint8") for n in range(3, 6)]), sample_type="uint8")
    joined = tmp_path / "joined.xtf"
    joined.write_bytes(first.read_bytes() + second.read_bytes())
    events, log = read(joined)
    pings = pings_of(events)
    assert [p.starboard.samples.dtype.name for p in pings if p.starboard] == ["uint16"] * 3 + ["uint8"] * 3
    assert log.counters["reader.joined_log"] == 1
    assert log.counters["reader.sample_type_change"] == 2
    assert {"reader.joined_log", "reader.sample_type_change"} <= set(codes_of(events))
    assert all(same_trace(p.port, q.port) for p, q in zip(pings[:3], pings_of(mission(3)), strict=True))


def test_repairs_of_the_reader_are_for_the_record_and_its_requests_are_notices(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated([ping(n, time_s=START_S + n // 2) for n in range(8)]))

    def fill(header: Any) -> None:
        header.ChanInfo[0].OffsetX = 1.5

    edit_file_header(path, fill)
    events, _ = read(path, sound_speed_mps=1480.0)
    reported = {event.code: event.for_the_record for event in events if isinstance(event, Notice)}
    assert reported == {
        "reader.sound_speed_overridden": True,
        "reader.time_tied": True,
        "reader.mounting_not_applied": False,
    }


@pytest.mark.parametrize("n_lost", [1, 40, 150])
def test_a_ping_after_one_that_lost_bytes_of_its_samples_is_read(tmp_path: Path, n_lost: int) -> None:
    """More bytes may be lost than the packet has padding: the next ping starts where samples were said to be."""
    path = written(tmp_path / "log.xtf", 8)
    sent = pings_of(read(path)[0])
    data = path.read_bytes()
    at = packet_offsets(data)[3] + 400
    path.write_bytes(data[:at] + data[at + n_lost :])
    got = {each.time_s: each for each in pings_of(read(path)[0])}
    for intact in (*sent[:3], *sent[4:]):
        assert same_trace(got[intact.time_s].port, intact.port)
        assert same_trace(got[intact.time_s].starboard, intact.starboard)
