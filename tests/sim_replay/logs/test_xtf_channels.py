"""Logs whose channels are numbered, ordered, spread over packets or stored otherwise than the format says: the same
pings on the same sides, or a notice that names it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyxtf
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import Ping
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.logs.open_log import open_log
from sim_replay.logs.xtf import XtfLog
from sim_replay.logs.xtf_samples import are_signed, magnitude
from tests.sim_replay.logs.xtf_logs import (
    FOUR,
    Stored,
    StoredPing,
    codes_of,
    describe,
    edit_channels,
    edit_file_header,
    low,
    navigated,
    packet,
    ping,
    pings_of,
    read,
    same_trace,
    samples,
    stored,
    written,
)

N_PINGS = 60


def plain(tmp_path: Path, n_samples: int = 400) -> tuple[list[Ping], Path]:
    pings = [ping(number, n_samples=n_samples) for number in range(N_PINGS)]
    return pings, written(tmp_path / "log.xtf", navigated(pings))


def repack(
    path: Path, channels_of: Callable[[StoredPing], Sequence[Stored]], described: Sequence[tuple[int, str, float]] = ()
) -> None:
    """Write a plain log again: these channels in one packet per ping, described so in the file header if given."""
    head, kept = stored(path)
    if described:
        describe(head, described)
    path.write_bytes(bytes(head) + b"".join(packet(one.header, channels_of(one)) for one in kept))


def check_same(found: Sequence[Ping], expected: Sequence[Ping]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert same_trace(one.port, other.port)
        assert same_trace(one.starboard, other.starboard)
        assert one.time_s == pytest.approx(other.time_s, abs=0.011)


# --- numbers of channels, and packets of a channel each ---


def test_of_two_frequencies_the_highest_is_taken(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    data = bytearray(path.read_bytes())

    def fill(header: Any) -> None:
        header.NumberOfSonarChannels = 4
        for number, kind in enumerate((1, 2, 1, 2)):
            header.ChanInfo[number] = header.ChanInfo[number % 2]
            header.ChanInfo[number].TypeOfChannel = kind
            header.ChanInfo[number].Frequency = 400.0 if number < 2 else 900.0

    path.write_bytes(data)
    edit_file_header(path, fill)
    edit_channels(
        path, lambda index, channel, header: setattr(header, "ChannelNumber", channel + 2 if index == 1 else channel)
    )
    for subsystem, n_pings in ((None, 1), (20, 2), (21, 1)):
        events, log = read(path, subsystem=subsystem)
        assert codes_of(events) == ["reader.frequency_chosen", "reader.other_channel"]
        assert len(pings_of(events)) == n_pings
        assert log.counters["reader.other_channel"] == 2 * (3 - n_pings)
        assert log.counters["reader.ping_without_side_scan"] == 3 - n_pings
    with pytest.raises(UsageError, match=r"20 \(400 kHz\) and 21 \(900 kHz\). Set one of them"):
        read(path, subsystem=22)


def test_more_channels_than_fit_into_one_header_block(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 3)
    edit_file_header(path, lambda header: setattr(header, "NumberOfBathymetryChannels", 6))
    data = path.read_bytes()
    path.write_bytes(data[:1024] + bytes(1024) + data[1024:])
    events, log = read(path)
    assert len(pings_of(events)) == 3
    assert log.counters == {"reader.pings": 3}


NUMBERS = {"zeros": (0, 0), "from one": (1, 2), "high": (6, 7), "as the format says": (0, 1)}


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("numbers", NUMBERS)
@pytest.mark.parametrize("shares", ["number and time", "number", "time"])
def test_sides_are_found_however_they_are_numbered_and_packed(
    numbers: str, apart: bool, shares: str, tmp_path: Path
) -> None:
    pings, path = plain(tmp_path)
    head, kept = stored(path)
    parts = [bytes(head)]
    for count, one in enumerate(kept):
        sides = [side.with_fields(ChannelNumber=n) for side, n in zip(one.sides, NUMBERS[numbers], strict=True)]
        if not apart:
            parts.append(packet(one.header, sides))
            continue
        first = {} if shares != "time" else {"PingNumber": 2 * count + 1}
        second: dict[str, int] = {} if shares != "time" else {"PingNumber": 2 * count + 2}
        if shares == "number":
            hundredths = pyxtf.XTFPingHeader.from_buffer_copy(one.header).HSeconds
            second["HSeconds"] = hundredths + 3 if hundredths < 97 else hundredths - 3
        parts += [packet(one.header, sides[:1], **first), packet(one.header, sides[1:], **second)]
    path.write_bytes(b"".join(parts))
    events, log = read(path)
    check_same(pings_of(events), pings)
    assert log.counters["reader.time_tied"] == 0
    odd = numbers in ("zeros", "high")
    assert ("reader.channel_numbers" in codes_of(events)) == odd


def test_a_lost_packet_of_one_side_costs_that_side_alone(tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    head, kept = stored(path)
    parts = [packet(one.header, [side]) for one in kept for side in one.sides]
    del parts[41]  # starboard of ping 20
    path.write_bytes(bytes(head) + b"".join(parts))
    found = pings_of(read(path)[0])
    assert found[20].starboard is None
    check_same([*found[:20], *found[21:]], [*pings[:20], *pings[21:]])


def test_one_side_recorded_alone_stays_one_ping_per_packet(tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    repack(path, lambda one: one.sides[1:])
    found = pings_of(read(path)[0])
    assert len(found) == N_PINGS
    assert all(p.port is None and same_trace(p.starboard, q.starboard) for p, q in zip(found, pings, strict=True))


# --- two frequencies ---


@pytest.mark.parametrize("packed", ["together", "pairs", "each"])
@pytest.mark.parametrize("stated", ["file header", "hertz", "packets", "names", "numbers restart", "two described"])
@pytest.mark.parametrize("high_first", [False, True])
def test_the_higher_of_two_frequencies_is_used_and_both_are_named(
    packed: str, stated: str, high_first: bool, tmp_path: Path
) -> None:
    if stated in ("numbers restart", "two described") and packed == "together":
        pytest.skip("a packet cannot hold a number twice without being read by order")
    pings, path = plain(tmp_path)
    head, kept = stored(path)
    order = FOUR[2:] + FOUR[:2] if high_first else FOUR
    scale = {"hertz": 1000.0, "packets": 0.0, "names": 0.0}.get(stated, 1.0)
    named = [(k, f"{name} {khz:g} kHz" if stated == "names" else name, scale * khz) for k, name, khz in order]
    describe(head, named[:2] if stated == "two described" else named)
    restart = stated in ("numbers restart", "two described")
    parts = [bytes(head)]
    for one in kept:
        channels = []
        for place, (kind, _, khz) in enumerate(order):
            side = one.sides[kind - 1]
            fields = {"ChannelNumber": place % 2 if restart else place}
            if restart or stated == "packets":
                fields["Frequency"] = int(khz)
            channels.append((side if khz > 200.0 else low(side)).with_fields(**fields))
        size = {"together": 4, "pairs": 2, "each": 1}[packed]
        parts += [packet(one.header, channels[at : at + size]) for at in range(0, 4, size)]
    path.write_bytes(b"".join(parts))
    events, _ = read(path)
    check_same(pings_of(events), pings)
    (notice,) = [event for event in events if getattr(event, "code", "") == "reader.frequency_chosen"]
    assert "at 100 and 450 kHz: 450 kHz is used. Set sonar.subsystem: 20 for 100 kHz" in notice.text  # type: ignore[union-attr]
    assert not notice.for_the_record  # type: ignore[union-attr]

    lower = pings_of(read(path, subsystem=20)[0])
    assert len(lower) == N_PINGS
    assert all(p.port is not None and p.port.samples.shape[0] == 50 for p in lower)
    with pytest.raises(UsageError, match="Set one of them"):
        list(XtfLog(path, SonarConfig(subsystem=22)))


@pytest.mark.parametrize(
    "channels", [FOUR, [(1, "port", 445.0), (2, "stbd", 455.0)]], ids=["two not recorded", "two of one pair"]
)
def test_a_frequency_not_recorded_or_little_different_is_no_other(
    channels: list[tuple[int, str, float]], tmp_path: Path
) -> None:
    pings, path = plain(tmp_path)
    repack(path, lambda one: one.sides, channels)
    events, _ = read(path)
    check_same(pings_of(events), pings)
    assert "reader.frequency_chosen" not in codes_of(events)


# --- file headers ---


@pytest.mark.parametrize("n_declared", [0, 1])
def test_channels_that_are_described_but_not_declared_are_read(n_declared: int, tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    edit_file_header(path, lambda header: setattr(header, "NumberOfSonarChannels", n_declared))
    check_same(pings_of(read(path)[0]), pings)


@pytest.mark.parametrize(
    ("channels", "exchanged", "words"),
    [
        ([(1, "port", 0.0), (1, "stbd", 0.0)], False, "both have the type of port: their names are taken"),
        ([(2, "STARBOARD", 0.0), (2, "PORT", 0.0)], True, "both have the type of starboard: their names are taken"),
        ([(1, "a", 0.0), (1, "b", 0.0)], False, "channel 0 is taken as port, 1 as starboard"),
        ([(1, "Starboard", 0.0), (2, "Port", 0.0)], False, "the types are taken"),
        ([(2, "stbd", 0.0), (1, "port", 0.0)], True, ""),
        ([(1, "port", 0.0), (2, "stbd", 0.0)], False, ""),
    ],
)
def test_the_side_is_what_type_and_name_agree_on(
    channels: list[tuple[int, str, float]], exchanged: bool, words: str, tmp_path: Path
) -> None:
    pings, path = plain(tmp_path)
    repack(path, lambda one: one.sides, channels)
    events, _ = read(path, port_order="auto")
    assert all((p.port is not None, p.starboard is not None) == (True, True) for p in pings_of(events))
    first = pings_of(events)[0]
    assert same_trace(first.starboard if exchanged else first.port, pings[0].port)
    assert same_trace(first.port if exchanged else first.starboard, pings[0].starboard)
    notices = [event for event in events if getattr(event, "code", "") == "reader.sides_disagree"]
    asked = [notice.text for notice in notices if "stored near to far" not in notice.text]  # type: ignore[union-attr]
    assert [words in text and "sonar.sides: swapped" in text for text in asked] == [True] * bool(words)


def test_the_key_exchanges_sides(tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    found = pings_of(list(open_log(path, Config(sonar=SonarConfig(sides="swapped")))))
    assert all(same_trace(p.port, q.starboard) for p, q in zip(found, pings, strict=True))
    assert all(same_trace(p.starboard, q.port) for p, q in zip(found, pings, strict=True))


# --- what samples are ---


def resampled(path: Path, change: Callable[[NDArray[np.uint16]], NDArray[Any]]) -> None:
    """Change all samples of a plain log."""

    def changed(side: Stored) -> Stored:
        return Stored(side.header, change(np.frombuffer(side.samples, "<u2")).astype("<u2").tobytes())

    repack(path, lambda one: [changed(side) for side in one.sides])


def set_unipolar(header: Any, value: int) -> None:
    for info in header.ChanInfo:
        info.UniPolar = value


@pytest.mark.parametrize("unipolar", [0, 1])
def test_signed_samples_are_used_by_magnitude(unipolar: int, tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    random = np.random.default_rng(3)
    resampled(
        path, lambda values: (values.astype(int) * random.choice([-1, 1], values.shape)).astype(np.int16).view("u2")
    )
    edit_file_header(path, lambda header: set_unipolar(header, unipolar))
    events, _ = read(path)
    check_same(pings_of(events), pings)
    notices = [event for event in events if getattr(event, "code", "") == "reader.signed_samples"]
    assert [notice.for_the_record for notice in notices] == [not unipolar] * 2  # type: ignore[union-attr]


def test_unsigned_samples_stay_what_they_are_though_the_header_says_signed(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", navigated(pings := [ping(n, n_samples=400) for n in range(N_PINGS)]))
    resampled(path, lambda values: values * 257)  # up to the end of the range
    edit_file_header(path, lambda header: set_unipolar(header, 0))
    events, _ = read(path)
    assert "reader.signed_samples" not in codes_of(events)
    for one, other in zip(pings_of(events), pings, strict=True):
        assert one.port is not None
        assert other.port is not None
        assert np.array_equal(one.port.samples, other.port.samples * 257)


@given(
    seed=st.integers(0, 1000),
    scale=st.sampled_from([3.0, 40.0, 400.0, 8000.0]),
    dtype=st.sampled_from(["u1", "<u2", "<u4", "<f4"]),
)
def test_numbers_about_zero_are_signed_and_amplitudes_are_not(seed: int, scale: float, dtype: str) -> None:
    random = np.random.default_rng(seed)
    scale = min(scale, 30.0) if dtype == "u1" else scale
    about_zero = np.round(random.normal(0.0, scale, 4000))
    kind = np.dtype(dtype)
    if kind.kind == "f":
        as_stored = about_zero.astype(kind)
    else:
        width = kind.itemsize
        limit = 2 ** (8 * width - 1)
        about_zero = np.clip(about_zero, -limit, limit - 1)
        as_stored = about_zero.astype(f"i{width}").view(f"u{width}").astype(kind)
    assert are_signed(as_stored, True)
    assert np.array_equal(magnitude(as_stored), np.abs(about_zero))
    top = np.inf if kind.kind == "f" else float(np.iinfo(kind).max)
    amplitude = np.minimum(random.rayleigh(scale, 4000), top).astype(kind)
    saturated = np.minimum(random.exponential(top / 2 if math.isfinite(top) else scale, 4000), top).astype(kind)
    for usual in (amplitude, saturated):
        assert not are_signed(usual, False)
        assert not are_signed(usual, True)


@pytest.mark.parametrize("kind", [1, 2])
@pytest.mark.parametrize("spare", [0, 1])
def test_both_sides_in_one_channel_are_split(kind: int, spare: int, tmp_path: Path) -> None:
    pings, path = plain(tmp_path)

    def joined(one: StoredPing) -> list[Stored]:
        port, starboard = one.sides  # port is stored far to near
        both = Stored(port.header, port.samples + bytes(2 * spare) + starboard.samples)
        return [both.with_fields(NumSamples=len(both.samples) // 2)]

    repack(path, joined, [(kind, "side scan", 0.0)])
    events, _ = read(path, port_order="auto")
    check_same(pings_of(events), pings)
    assert "reader.both_sides_in_one_channel" in codes_of(events)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("turned", [False, True])
def test_one_side_alone_is_not_split(side: int, turned: bool, tmp_path: Path) -> None:
    pings = [ping(number, n_samples=400) for number in range(N_PINGS)]
    path = written(tmp_path / "log.xtf", navigated(pings), port_far_to_near=turned)
    repack(path, lambda one: [one.sides[side].with_fields(ChannelNumber=0)], [(1 + side, "side scan", 0.0)])
    events, _ = read(path, port_order="auto")
    assert "reader.both_sides_in_one_channel" not in codes_of(events)
    for one, other in zip(pings_of(events), pings, strict=True):
        assert same_trace((one.port, one.starboard)[side], (other.port, other.starboard)[side])


def test_starboard_stored_far_to_near_is_turned(tmp_path: Path) -> None:
    pings, path = plain(tmp_path)

    def turned(side: Stored) -> Stored:
        return Stored(side.header, np.frombuffer(side.samples, "<u2")[::-1].tobytes())

    repack(path, lambda one: [one.sides[0], turned(one.sides[1])])
    events, _ = read(path, port_order="auto")
    check_same(pings_of(events), pings)
    assert "reader.starboard_order" in codes_of(events)


def test_a_slant_range_of_zero_is_computed_from_the_duration(tmp_path: Path) -> None:
    pings, path = plain(tmp_path)
    edit_channels(path, lambda index, channel, header: setattr(header, "SlantRange", 0.0))
    events, log = read(path)
    check_same(pings_of(events), pings)
    assert log.counters["reader.range_from_duration"] == 2 * N_PINGS
    assert codes_of(events).count("reader.range_from_duration") == 1


def test_evidence_needs_samples() -> None:
    assert not are_signed(np.zeros(0, "<u2"), True)
    assert not are_signed(np.full(100, 7, "<u2"), True)
    assert not are_signed(samples(1).astype("<u2"), True)
