"""Whose UTC pings and navigation have: this computer's, a unit's ZDA, or its pulses that ZDA names."""

from __future__ import annotations

import itertools
import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from drivers.links.pulse import pack_edge
from drivers.navigation.nmea0183 import sentence
from drivers.navigation.sentences import Zda, body_of
from drivers.port_intake import NO_PORT, PortIntake
from drivers.ports import read_ports
from tests.drivers.port_traffic import MONO_S, UTC_S, Chunk, config_of, fix, is_close, profile, stamp

AHEAD_S = 3600.25  # of the unit's UTC before this computer's
TAKES_S = 38 * 10 / 9600.0  # a ZDA on the line
SONAR = "{name: sonar, link: 'tcp://10.0.0.2:1', device: ping_protocol, sonar: {range_m: 30}}"
ZDA = (
    f"ports: [{SONAR}, {{name: gnss, link: 'serial:///dev/ttyS0?baud=9600', device: nmea0183, navigation: "
    f"{{gives_utc: true}}}}]"
)
PPS = ZDA.replace("gives_utc: true", "gives_utc: true, pulse_link: 'pps:///dev/pps0'")


def zda(utc_s: float) -> bytes:
    return sentence(body_of(Zda(utc_s % 86_400.0, math.floor(utc_s / 86_400.0))))


def zda_at(time_s: float, ahead_s: float = AHEAD_S, late_s: float = 0.0) -> Chunk:
    """The sentence that says what time it was as its first byte was sent, time_s after the beginning."""
    return Chunk("gnss", zda(UTC_S + time_s + ahead_s), stamp(time_s + TAKES_S + late_s))


def pulse_at(time_s: float) -> Chunk:
    return Chunk("gnss.pulse", pack_edge(round((MONO_S + time_s) * 1e9)), stamp(time_s + 0.02))


def pings_at(times_s: list[float]) -> list[Chunk]:
    return [
        Chunk("sonar", profile(k, channel, s), stamp(s + 0.04)) for k, s in enumerate(times_s) for channel in (0, 1)
    ]


def taken_in(text: str, *streams: list[Chunk]) -> tuple[list[SourceEvent], PortIntake]:
    intake = PortIntake(config_of(text))
    ticks = [Chunk(NO_PORT, b"", stamp(0.25 * k)) for k in range(160)]
    chunks = sorted((chunk for stream in (*streams, ticks) for chunk in stream), key=lambda chunk: chunk.stamp.mono_ns)
    return [event for chunk in chunks for event in intake.feed(*chunk)] + intake.finish(), intake


def reported(events: list[SourceEvent]) -> list[str]:
    return [event.code for event in events if isinstance(event, Notice) and event.code.startswith("utc")]


def ahead_of(events: list[SourceEvent], times_s: list[float]) -> list[float]:
    """By how much the time of each ping is ahead of this computer's."""
    pings = [event for event in events if isinstance(event, Ping)]
    return [ping.time_s - UTC_S - times_s[ping.number] for ping in pings]


def host_steps(chunks: list[Chunk], at_s: float, by_s: float) -> list[Chunk]:
    from_ns, by_ns = stamp(at_s).mono_ns, round(by_s * 1e9)
    return [
        chunk._replace(stamp=Stamp(t.mono_ns, t.utc_ns + by_ns * (t.mono_ns >= from_ns)))
        for chunk in chunks
        for t in (chunk.stamp,)
    ]


TIMES_S = [0.1 * k for k in range(390)]


@pytest.mark.parametrize("by_s", [-0.15, -0.6, -1.05])
def test_no_ping_comes_twice_where_a_clock_is_set_back_by_little(by_s: float) -> None:
    """The chain takes what steps back by less than a second for late, and leaves it out."""
    times_s = [0.1 * k for k in range(2100)]
    pings = host_steps(pings_at(times_s), 5.0, by_s)
    events, _ = taken_in(ZDA.replace("gives_utc: true", ""), pings)
    times = [event.time_s for event in events if isinstance(event, Ping)]
    assert len(times) == len(times_s)
    assert min(after - before for before, after in itertools.pairwise(times)) > 0.09
    assert "utc_stepped" in reported(events)
    assert is_close(ahead_of(events, times_s)[-1], by_s, 0.1)


def test_pings_and_navigation_are_in_the_utc_of_zda_however_wrong_this_computers_is() -> None:
    gnss = [zda_at(float(s), late_s=0.003 * (s % 4)) for s in range(39)]
    fixes = [Chunk("gnss", fix(s + 0.5 + AHEAD_S, 43.0, 5.0), stamp(s + 0.6)) for s in range(38)]
    streams = [host_steps(stream, 20.0, -7000.0) for stream in (gnss, fixes, pings_at(TIMES_S))]
    events, intake = taken_in(ZDA, *streams)
    assert reported(events) == ["utc_taken"], "that this computer's clock was set in the middle is of no importance"
    assert all(event.for_the_record for event in events if isinstance(event, Notice) and event.code == "utc_taken")
    ahead_s = ahead_of(events, TIMES_S)
    assert all(is_close(value, 0.0, 0.02) for value in ahead_s[:9])
    assert all(is_close(value, AHEAD_S, 0.01) for value in ahead_s[15:])
    samples = [event.time_s for event in events if isinstance(event, NavSample)]
    assert all(is_close((time_s - UTC_S - AHEAD_S) % 1.0, 0.6, 0.15) for time_s in samples[-20:])
    assert (intake.counters["utc.readings"], intake.counters["utc.refused"]) == (38, 1), (
        "one sentence alone may say anything"
    )


@pytest.mark.parametrize("ahead_s", [-0.05, -0.6])
def test_no_ping_comes_twice_where_a_unit_gives_an_earlier_utc(ahead_s: float) -> None:
    gnss = [zda_at(float(s), ahead_s) for s in range(3, 39)]
    events, _ = taken_in(ZDA, gnss, pings_at(TIMES_S))
    assert reported(events) == ["utc_taken"]
    times = [event.time_s for event in events if isinstance(event, Ping)]
    assert min(after - before for before, after in itertools.pairwise(times)) > 0.09
    assert ahead_s < ahead_of(events, TIMES_S)[-1] < -0.015, "it is on its way"


@pytest.mark.parametrize("silence", [b"", sentence("GPZDA,101530.00,,,,00,00"), fix(0.0, 43.0, 5.0)])
def test_without_zda_this_computers_utc_stands_and_a_person_is_informed(silence: bytes) -> None:
    gnss = [Chunk("gnss", silence, stamp(float(s))) for s in range(39)]
    events, _ = taken_in(ZDA, gnss, pings_at(TIMES_S))
    assert reported(events) == ["utc_lost"]
    (text,) = [event.text for event in events if isinstance(event, Notice) and event.code == "utc_lost"]
    assert re.search(
        r"'gnss' gave no ZDA with its date for 10 s: UTC is this computer's own until it does. Check that", text
    )
    assert all(is_close(value, 0.0, 0.02) for value in ahead_of(events, TIMES_S))


def test_when_zda_ends_utc_goes_on_without_a_step_until_it_is_back() -> None:
    gnss = [zda_at(float(s)) for s in range(39) if s < 8 or s > 25]
    streams = [host_steps(stream, 15.0, 500.0) for stream in (gnss, pings_at(TIMES_S))]
    events, _ = taken_in(ZDA, *streams)
    assert reported(events) == ["utc_taken", "utc_lost", "utc_back"]
    assert all(is_close(value, AHEAD_S, 0.02) for value in ahead_of(events, TIMES_S)[15:])


@settings(max_examples=20)
@given(st.integers(0, 38), st.sampled_from([-1e6, -86_400.0, -1.0, 0.7, 3600.0]))
def test_one_wrong_zda_changes_nothing(wrong: int, by_s: float) -> None:
    gnss = [zda_at(float(s), AHEAD_S + by_s * (s == wrong)) for s in range(39)]
    events, _ = taken_in(ZDA, gnss, pings_at(TIMES_S[::10]))
    assert reported(events) == ["utc_taken"]
    ahead_s = ahead_of(events, TIMES_S[::10])
    assert all(is_close(value, AHEAD_S, 0.02) for value in ahead_s[5:])


def test_a_unit_whose_utc_steps_for_good_is_followed_and_reported() -> None:
    gnss = [zda_at(float(s), AHEAD_S - 18.0 * (s >= 20)) for s in range(39)]
    events, _ = taken_in(ZDA, gnss, pings_at(TIMES_S))
    assert reported(events) == ["utc_taken", "utc_stepped"]
    (text,) = [event.text for event in events if isinstance(event, Notice) and event.code == "utc_stepped"]
    assert "UTC of port 'gnss' stepped by -18.0" in text
    assert is_close(ahead_of(events, TIMES_S)[-1], AHEAD_S - 18.0, 0.02)


def test_the_date_of_a_receiver_that_has_not_found_its_own_yet_adds_no_weeks_to_it() -> None:
    """It begins with the day that GPS began."""
    gnss = [zda_at(float(s), AHEAD_S if s >= 10 else 315_964_800.0 - UTC_S) for s in range(39)]
    events, _ = taken_in(ZDA, gnss, pings_at(TIMES_S))
    assert reported(events) == ["utc_rollover", "utc_taken", "utc_stepped"]
    assert is_close(ahead_of(events, TIMES_S)[-1], AHEAD_S, 0.02)


def test_pulses_that_zda_names_give_utc_to_the_microsecond() -> None:
    """The unit sends its ZDA any time from 100 to 300 ms after the pulse; its seconds begin a quarter before this
    computer's."""
    begins_s = [s + 0.75 for s in range(38)]
    gnss = [Chunk("gnss", zda(UTC_S + s + AHEAD_S), stamp(s + 0.1 + 0.05 * (k % 5))) for k, s in enumerate(begins_s)]
    depth = Chunk("gnss", sentence("SDDPT,7.5,0.0"), stamp(36.5))
    events, intake = taken_in(PPS, [pulse_at(s) for s in begins_s], [*gnss, depth])
    assert reported(events) == ["utc_taken"]
    (text,) = [event.text for event in events if isinstance(event, Notice) and event.code == "utc_taken"]
    assert text == "UTC now comes from the ZDA and pulses of 'gnss', +3600.250 s from this computer's clock"
    (sample,) = [event for event in events if isinstance(event, NavSample)]
    assert is_close(sample.time_s, UTC_S + 36.5 + AHEAD_S - len(depth.data) * 10 / 9600.0, 2e-6)
    assert intake.counters["utc.readings"] == 37  # one pulse alone may be anything


def test_zda_without_pulses_is_not_taken_for_one_with() -> None:
    events, intake = taken_in(PPS, [zda_at(float(s)) for s in range(39)], [Chunk("gnss.pulse", b"short", stamp(1.0))])
    assert reported(events) == ["utc_lost"]
    assert any("gave no ZDA that names a pulse" in event.text for event in events if isinstance(event, Notice))
    assert intake.counters["utc.pulse.label_not_full_second"] + intake.counters["utc.pulse.label_without_pulse"] == 38


def test_a_pulse_has_a_port_of_its_own() -> None:
    ports = read_ports(config_of(PPS))
    assert [(port.name, port.device, port.address.place) for port in ports[1:]] == [
        ("gnss", "nmea0183", "serial:///dev/ttyS0"),
        ("gnss.pulse", "pulse", "pps:///dev/pps0"),
    ]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("device: nmea0183", "device: pd6", "navigation.gives_utc is for a device 'nmea0183'"),
        ("gives_utc: true, ", "", "add gives_utc: true"),
        ("pps:///dev/pps0", "serial:///dev/ttyS1?baud=9600", "ports[1].navigation.pulse_link .*not a source of pulses"),
        ("serial:///dev/ttyS0?baud=9600", "pps:///dev/pps0", "ports[1].link .*a device 'nmea0183' needs a serial:"),
        (
            SONAR,
            "{name: b, link: 'tcp://10.0.0.2:1', device: nmea0183, navigation: {gives_utc: true}}",
            "b and gnss both have",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(UsageError, match=message.replace("[", r"\[")):
        read_ports(config_of(PPS.replace(old, new)))
