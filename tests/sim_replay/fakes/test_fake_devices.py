"""Fake devices speak so that the drivers understand: what goes in comes out, to the resolution of the wire."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import NAN, EchoTrace, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig
from drivers.links.can_frame import CanFrame
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_protocols import text_decoder
from drivers.sonar.sonar_decoder import SonarFrame, SonarReply, SonarSettings
from drivers.sonar.sonars import sonar_named
from sim_replay.fakes.feed import mission_events, time_line
from sim_replay.fakes.job import Job, read_job
from sim_replay.fakes.navigation import NAVIGATION_UNITS
from sim_replay.fakes.sonar import DeviceTime, FakeSonar, JsfSonar, PingProtocolSonar, SportScanSonar, resampled

NOW = DeviceTime(since_power_up_s=12.345, utc_s=1_700_000_000.125)
STAMP = Stamp(mono_ns=10**12, utc_ns=1_700_000_000 * 10**9)


def a_ping(seed: int = 0, n_samples: int = 300, range_m: float = 30.0) -> Ping:
    random = np.random.Generator(np.random.PCG64(seed))
    spacing_m = range_m / n_samples
    port, starboard = (
        EchoTrace(
            samples=random.rayleigh(2000.0, n_samples).astype(np.uint16) + 1,
            first_range_m=0.5 * spacing_m,
            spacing_m=spacing_m,
        )
        for _ in range(2)
    )
    return Ping(number=7, time_s=1.0, port=port, starboard=starboard, sound_speed_mps=1500.0, altitude_m=5.25)


def reported(name: str, messages: list[bytes]) -> list[SonarFrame | SonarReply]:
    decoder = sonar_named(name).decoder(SonarConfig())
    items = [item for message in messages for item in decoder.feed(message, STAMP)]
    items += decoder.finish()
    assert not any("refused" in counter for counter in decoder.counters)
    return [item for item in items if not isinstance(item, Notice)]


def set_up(sonar: FakeSonar, name: str, **settings: float) -> list[SonarFrame | SonarReply]:
    wanted = SonarSettings(**{"range_m": 30.0, "n_samples": 300, **settings})  # type: ignore[arg-type]  # numbers by name
    return reported(
        name, [answer for command in sonar_named(name).commands(wanted) for answer in sonar.heard(command, NOW)]
    )


def traces_of(items: list[SonarFrame | SonarReply]) -> tuple[SonarFrame, EchoTrace, EchoTrace]:
    (frame,) = items
    assert isinstance(frame, SonarFrame)
    assert frame.port is not None
    assert frame.starboard is not None
    return frame, frame.port, frame.starboard


def test_a_ping_protocol_sonar_is_silent_until_it_is_enabled_and_after_losing_its_power() -> None:
    sonar = PingProtocolSonar()
    assert sonar.ping(a_ping(), NOW) == []
    replies = set_up(sonar, "ping_protocol")
    assert all(isinstance(reply, SonarReply) and reply.accepted for reply in replies)
    assert len(sonar.ping(a_ping(), NOW)) == 2
    assert sonar.settings == "on, 30 m, automatic gain, 300 results"
    sonar.power_up()
    assert sonar.ping(a_ping(), NOW) == []


def test_a_ping_protocol_sonar_refuses_what_it_cannot_do() -> None:
    from drivers.sonar.ping_messages import OsPingParams, encode

    sonar = PingProtocolSonar()
    (reply,) = reported("ping_protocol", sonar.heard(encode(OsPingParams(start_mm=0, length_mm=900_000)), NOW))
    assert isinstance(reply, SonarReply)
    assert not reply.accepted
    assert sonar.settings == ""


@given(seed=st.integers(0, 100))
def test_profiles_carry_the_missions_echoes_times_and_numbers(seed: int) -> None:
    sonar, ping = PingProtocolSonar(), a_ping(seed)
    set_up(sonar, "ping_protocol")
    frame, port, starboard = traces_of(reported("ping_protocol", sonar.ping(ping, NOW)))
    assert frame.device_time_s == 12.345
    for decoded_trace, trace in ((port, ping.port), (starboard, ping.starboard)):
        assert trace is not None
        assert decoded_trace.first_range_m == pytest.approx(trace.first_range_m)
        assert decoded_trace.spacing_m == pytest.approx(trace.spacing_m)
        # 90 dB in 65535 steps: half a step is 0.02 %; single precision and the range of 90 dB do the rest.
        np.testing.assert_allclose(decoded_trace.samples, trace.samples.astype(np.float64) ** 2, rtol=3e-4)


def test_a_range_that_the_mission_does_not_have_is_interpolated_and_ends_in_silence() -> None:
    ping = a_ping()
    assert ping.port is not None
    found = resampled(ping.port, 0.05, 0.1, 600)
    np.testing.assert_allclose(found[:300], ping.port.samples, rtol=1e-12)
    assert not found[301:].any()
    between = resampled(ping.port, 0.1, 0.1, 10)
    np.testing.assert_allclose(between, 0.5 * (found[:10] + found[1:11]))


def test_a_jsf_sonar_pings_when_enabled_and_sends_time_altitude_and_exact_samples() -> None:
    sonar, ping = JsfSonar(), a_ping()
    assert sonar.ping(ping, NOW) == []
    assert all(isinstance(reply, SonarReply) and reply.accepted for reply in set_up(sonar, "jsf", gain=30))
    frame, port, starboard = traces_of(reported("jsf", sonar.ping(ping, NOW)))
    assert (frame.device_time_s, frame.device_time_is_utc, frame.altitude_m) == (1_700_000_000.125, True, 5.25)
    assert ping.port is not None
    assert ping.starboard is not None
    np.testing.assert_array_equal(port.samples, ping.port.samples)
    np.testing.assert_array_equal(starboard.samples, ping.starboard.samples)
    assert port.spacing_m == pytest.approx(ping.port.spacing_m, rel=1e-6)
    set_up(sonar, "jsf", enabled=0)
    assert sonar.ping(ping, NOW) == []


def test_a_sport_scan_answers_each_command_with_its_newest_ping_and_gain_makes_it_louder() -> None:
    sonar, ping = SportScanSonar(), a_ping()
    assert sonar.ping(ping, NOW) == []
    (command,) = sonar_named("sportscan").commands(SonarSettings(range_m=30.0, gain=20))
    frame, port, _ = traces_of(reported("sportscan", sonar.heard(command, NOW)))
    assert frame.starboard is not None
    assert (port.samples.shape, port.spacing_m) == ((200,), 0.15)
    assert 24.0 < np.mean([port.samples, frame.starboard.samples]) < 26.0
    (louder,) = sonar_named("sportscan").commands(SonarSettings(range_m=30.0, gain=26))
    split = [*sonar.heard(louder[:10], NOW), *sonar.heard(louder[10:], NOW)]
    assert traces_of(reported("sportscan", split))[1].samples.mean() == pytest.approx(
        2.0 * port.samples.mean(), rel=0.1
    )


SAMPLES = st.builds(
    NavSample,
    time_s=st.floats(0.0, 1000.0),
    latitude_deg=st.floats(-89.0, 89.0),
    longitude_deg=st.floats(-179.9, 179.9),
    heading_rad=st.floats(0.0, 6.28),
    pitch_rad=st.floats(-0.7, 0.7),
    roll_rad=st.floats(-0.7, 0.7),
    depth_m=st.floats(0.0, 300.0),
    altitude_m=st.floats(0.5, 50.0),
    speed_mps=st.floats(0.0, 5.0),
)
POSITION = {"latitude_deg": 1e-7, "longitude_deg": 1e-7}
ANGLES = {"heading_rad": 1e-4, "pitch_rad": 1e-4, "roll_rad": 1e-4}
TOLERANCES = {
    "nmea0183": {**POSITION, **ANGLES, "altitude_m": 6e-3, "speed_mps": 1e-3},
    "pixse": {**POSITION, **ANGLES, "depth_m": 1e-3, "speed_mps": 2e-3},
    "pd6": {**ANGLES, "altitude_m": 6e-3, "speed_mps": 2e-3, "depth_m": 0.06},
    "water_linked": {"pitch_rad": 1e-4, "roll_rad": 1e-4, "altitude_m": 6e-3, "speed_mps": 1e-3},
    "nmea2000": {**POSITION, **ANGLES, "altitude_m": 6e-3, "speed_mps": 6e-3},
}


def fixes_of(kind: str, sample: NavSample) -> list[NavFix]:
    messages = NAVIGATION_UNITS[kind]().measured(sample, NOW.utc_s)
    if kind == "nmea2000":
        bus = N2kBus("nav")
        fixes = [
            fix
            for frame in messages
            if isinstance(frame, CanFrame)
            for fix in bus.feed(frame.can_id, frame.data, STAMP)
        ]
        assert bus.units == {"nav.12": 0xC0_32_82_00_1B_E0_04_D2}
        assert not bus.counters["n2k.ignored"]
        return fixes
    unit = text_decoder({"pixse": "nmea0183"}.get(kind, kind), "nav")
    fed = [fix for message in messages if isinstance(message, bytes) for fix in unit.feed(message, STAMP)]
    fixes = [*fed, *unit.finish()]
    assert not any("refused" in name or "malformed" in name for name in unit.counters)
    return fixes


@pytest.mark.parametrize("kind", TOLERANCES)
@given(sample=SAMPLES)
def test_units_report_measurements_to_the_resolution_of_their_wire(kind: str, sample: NavSample) -> None:
    fixes = fixes_of(kind, sample)
    for name, tolerance in TOLERANCES[kind].items():
        values = [value for fix in fixes if math.isfinite(value := getattr(fix, name))]
        assert values, f"{kind} reported no {name}"
        for value in values:
            expected = getattr(sample, name)
            apart = math.remainder(value - expected, 2.0 * math.pi) if name == "heading_rad" else value - expected
            assert abs(apart) <= tolerance
    times = {fix.time_utc_s for fix in fixes} - {None}
    assert all(time_s == pytest.approx(NOW.utc_s, abs=0.006) for time_s in times)


@pytest.mark.parametrize("kind", TOLERANCES)
def test_units_without_a_measurement_report_nothing_false(kind: str) -> None:
    unknown = NavSample(time_s=0.0)
    for fix in fixes_of(kind, unknown):
        assert math.isnan(fix.latitude_deg)
        assert math.isnan(fix.heading_rad)
        assert math.isnan(fix.speed_mps)
        assert math.isnan(fix.altitude_m)


def test_an_accelerated_vehicle_is_really_faster() -> None:
    events: list[SourceEvent] = [
        Notice(code="any", text="without a time"),
        NavSample(time_s=100.0, speed_mps=2.0),
        structs.replace(a_ping(), time_s=100.5),
        NavSample(time_s=NAN),
        NavSample(time_s=99.0, speed_mps=NAN),
        NavSample(time_s=104.0, speed_mps=1.0),
    ]
    line = list(time_line(events, 4.0))
    assert [fed.at_s for fed in line] == [0.0, 0.125, 0.125, 1.0]
    assert all(fed.event.time_s == fed.at_s for fed in line)
    speeds = [fed.event.speed_mps for fed in line if isinstance(fed.event, NavSample)]
    np.testing.assert_array_equal(speeds, [8.0, NAN, 4.0])


def test_a_device_plays_a_scene_or_a_log_and_not_both() -> None:
    assert isinstance(next(iter(mission_events(None, "demo"))), NavSample)
    for log, scene in ((None, None), (Path("a.xtf"), "demo")):
        with pytest.raises(UsageError, match="either a log or a scene"):
            mission_events(log, scene)


def test_a_scene_that_stores_logarithms_is_refused(tmp_path: Path) -> None:
    scene = tmp_path / "log.yaml"
    plan = "{pattern: lawnmower, heading_deg: 0, n_legs: 1, leg_m: 20, spacing_m: 20}"
    scene.write_text(f"sonar: {{recorder: {{samples: log_uint8}}}}\ntrack: {{plan: {plan}}}\n")
    with pytest.raises(UsageError, match="log_uint8"):
        mission_events(None, str(scene))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{device: {device: nmea2000}}", "does not go with a link 'serial'"),
        ("{device: {device: jsf, link: slcan}}", "does not go with a link 'slcan'"),
        ("{device: {device: pd6, baud: 115201}}", "115201 baud is not standard"),
        ("{device: {device: jsf, link: tcp, faults: [{do: wrong_baud, at_s: 1, baud: 9600}]}}", "has no baud rate"),
        ("{device: {device: jsf, link: tcp, faults: [{do: freeze, at_s: 1}]}}", "not a navigation unit"),
        ("{device: {device: pd6, faults: [{do: explode, at_s: 1}]}}", "explode"),
        ("{device: {device: pd6, faults: [{do: stall, at_s: -1}]}}", "at_s"),
        ("{device: {device: pd6}, speed: 0}", "speed"),
        ("{device: {device: nmea2000, link: slcan, bus_bitrate: 123}}", "123 bit/s is not standard"),
    ],
)
def test_jobs_that_cannot_be_are_refused_with_what_is_wrong(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "job.yaml"
    path.write_text("{name: nav, folder: here, " + text[1:])
    with pytest.raises(UsageError, match=named):
        read_job(path)


def test_a_job_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "job.yaml"
    path.write_text(
        "{name: nav, folder: here, log: a.xtf, device: {device: pd6, faults: [{do: stall, at_s: 1, for_s: 2}]}}"
    )
    job = read_job(path)
    assert isinstance(job, Job)
    assert (job.device.device, job.device.link, job.device.faults[0].for_s) == ("pd6", "serial", 2.0)
