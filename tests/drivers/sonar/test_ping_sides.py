"""Which side a profile looks to, and which of several frequencies is used: the same live and from a log."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.records import Notice
from auv_mcm.settings.config import SonarConfig
from drivers.sonar.ping_messages import OsMonoProfile, PingMessage, encode, to_wire
from drivers.sonar.ping_protocol import PingDecoder
from drivers.sonar.ping_sides import look_side
from drivers.sonar.sonar_decoder import SonarFrame, SonarItem
from drivers.sonar.sonars import sonar_named
from tests.drivers.sonar.sonar_frames import items_of, profile

N_PINGS = 20
PORT, STARBOARD = 4, 6  # samples of a side, to know it by


def head(number: int, n_samples: int, **changes: Any) -> OsMonoProfile:
    results = np.arange(n_samples, dtype=np.uint16) + number
    return profile(ping_number=number, timestamp_ms=100 * number, pwr_results=results, **changes)


def pings(port: dict[str, Any] | None, starboard: dict[str, Any] | None, n_pings: int = N_PINGS) -> list[OsMonoProfile]:
    """Pings of two heads, port first, each with these fields; None for a head that is not there."""
    sides = [(PORT, port), (STARBOARD, starboard)]
    return [head(n, size, **fields) for n in range(n_pings) for size, fields in sides if fields is not None]


def decoded(profiles: list[OsMonoProfile], decoder: PingDecoder | None = None) -> tuple[list[SonarFrame], list[str]]:
    items: list[SonarItem] = items_of(decoder or PingDecoder(), *map(encode, profiles))
    notices = [item.code for item in items if isinstance(item, Notice)]
    return [item for item in items if isinstance(item, SonarFrame)], notices


def check_sides(frames: list[SonarFrame], *, port: int | None = PORT, starboard: int | None = STARBOARD) -> None:
    assert len(frames) == N_PINGS
    for frame in frames:
        assert (None if frame.port is None else frame.port.samples.shape[0]) == port
        assert (None if frame.starboard is None else frame.starboard.samples.shape[0]) == starboard


def channel(number: int, look_deg: float = 0.0, vehicle_deg: float = 0.0) -> dict[str, Any]:
    return {"channel_number": number, "transducer_heading_deg": look_deg, "vehicle_heading_deg": vehicle_deg}


@pytest.mark.parametrize(
    ("port", "starboard", "codes"),
    [
        (channel(0), channel(1), []),
        (channel(1), channel(2), []),
        (channel(2), channel(3), []),
        (channel(0), channel(0), ["sonar_channels_alike"]),
        (channel(1), channel(1), ["sonar_channels_alike"]),
        (channel(0, -90.0), channel(1, 90.0), []),
        (channel(0, 270.0), channel(1, 90.0), []),
        (channel(1, -90.0), channel(2, 90.0), []),
        (channel(1, -90.0), channel(0, 90.0), ["sonar_sides_disagree"]),
        (channel(0, -90.0), channel(0, 90.0), ["sonar_sides_disagree"]),
        (channel(1, -75.0), channel(0, 80.0), ["sonar_sides_disagree"]),
        (channel(1, 120.0, 210.0), channel(0, 300.0, 210.0), ["sonar_sides_disagree"]),
        (channel(1, 0.0, 90.0), channel(0, 180.0, 90.0), ["sonar_sides_disagree"]),
        (channel(0, math.nan), channel(1, math.inf), []),
        (channel(255, -90.0), channel(255, 90.0), []),
        (channel(255), channel(255), ["sonar_channels_alike"]),
        (channel(0), channel(1) | {"ping_hz": 500_000}, []),
    ],
)
def test_sides_go_by_look_angle_then_number_then_order(
    port: dict[str, Any], starboard: dict[str, Any], codes: list[str]
) -> None:
    frames, notices = decoded(pings(port, starboard))
    check_sides(frames)
    assert notices == codes


@pytest.mark.parametrize("starboard_first", [False, True])
def test_heads_that_count_from_one_are_known_by_number_whichever_comes_first(starboard_first: bool) -> None:
    profiles = pings(channel(1), channel(2))
    if starboard_first:
        profiles = [item for pair in zip(profiles[1::2], profiles[::2], strict=True) for item in pair]
    frames, _ = decoded(profiles)
    check_sides(frames)


@pytest.mark.parametrize(("number", "look_deg"), [(0, 90.0), (1, 90.0), (0, 89.0), (255, 90.0)])
def test_a_single_head_looks_where_its_angle_says(number: int, look_deg: float) -> None:
    frames, notices = decoded(pings(None, channel(number, look_deg)))
    check_sides(frames, port=None)
    assert notices == (["sonar_sides_disagree"] if number == 0 else [])


def test_channel_numbers_alone_count_where_that_is_configured() -> None:
    decoder = sonar_named("ping_protocol").decoder(SonarConfig(sides="by_number"))
    assert isinstance(decoder, PingDecoder)
    frames, notices = decoded(pings(None, channel(0, 90.0)), decoder)
    check_sides(frames, port=STARBOARD, starboard=None)
    assert notices == []


def test_a_profile_sent_again_is_no_other_side() -> None:
    profiles = [item for item in pings(channel(0), None) for _ in range(2)]
    frames, notices = decoded(profiles)
    check_sides(frames, starboard=None)
    assert notices == []


def test_heads_with_numbers_of_their_own_and_one_channel_are_known_by_the_device_number() -> None:
    wire = b""
    for one in pings(channel(0), channel(0)):
        message = to_wire_of(one, source=1 if one.pwr_results.shape[0] == PORT else 2)
        wire += message
    frames = [item for item in items_of(PingDecoder(), wire) if isinstance(item, SonarFrame)]
    check_sides(frames)


def to_wire_of(one: OsMonoProfile, source: int) -> bytes:
    wire = encode(one)
    return to_wire(PingMessage(2198, wire[8:-2], source, 0))


@pytest.mark.parametrize("channels", [(0, 1, 0, 1), (0, 1, 2, 3), (2, 3, 0, 1)])
@pytest.mark.parametrize(("subsystem", "used"), [(None, "high"), (21, "high"), (20, "low")])
def test_of_two_frequencies_the_higher_is_used_or_the_one_configured(
    channels: tuple[int, int, int, int], subsystem: int | None, used: Literal["low", "high"]
) -> None:
    profiles = []
    for n in range(N_PINGS + 3):
        for size, number, khz in zip((2, 3, PORT, STARBOARD), channels, (450, 450, 1200, 1200), strict=True):
            profiles.append(head(n, size, channel_number=number, ping_hz=1000 * khz))
    decoder = sonar_named("ping_protocol").decoder(SonarConfig(subsystem=subsystem))  # type: ignore[arg-type]
    assert isinstance(decoder, PingDecoder)
    frames, notices = decoded(profiles, decoder)
    sizes = {"low": (2, 3), "high": (PORT, STARBOARD)}[used]
    settled = [frame for frame in frames if frame.number >= 3]
    assert len(settled) == N_PINGS
    for frame in settled:
        assert frame.port is not None
        assert frame.starboard is not None
        assert (frame.port.samples.shape[0], frame.starboard.samples.shape[0]) == sizes
    assert notices == ["sonar_frequency_chosen"]
    assert decoder.counters["ping_protocol.not_used.frequency"] >= 2 * N_PINGS


def test_a_lower_frequency_is_used_once_the_higher_has_ended() -> None:
    profiles = [
        head(n, size, channel_number=number, ping_hz=1_200_000 if n < 300 else 450_000)
        for n in range(500)
        for number, size in enumerate((PORT, STARBOARD))
    ]
    frames, _ = decoded(profiles)
    assert {*range(300), *range(400, 500)} <= {frame.number for frame in frames}


@pytest.mark.parametrize(
    ("transducer_deg", "vehicle_deg", "side"),
    [
        (90.0, 0.0, "starboard"),
        (-90.0, 0.0, "port"),
        (270.0, 10.0, "port"),
        (61.0, 0.0, "starboard"),
        (0.0, 0.0, None),
        (45.0, 45.0, None),
        (180.0, 0.0, None),
        (180.0, 90.0, "starboard"),
        (85.0, 175.0, "port"),
        (90.0, 180.0, "starboard"),
        (math.nan, 3.0, None),
    ],
)
def test_an_angle_counts_where_it_is_one_to_a_side(transducer_deg: float, vehicle_deg: float, side: str | None) -> None:
    assert look_side(transducer_deg, vehicle_deg) == side


@settings(deadline=None)
@given(
    heads=st.lists(
        st.tuples(st.integers(0, 3), st.sampled_from([330_000, 450_000, 900_000]), st.sampled_from([0.0, 90.0, -90.0])),
        max_size=30,
    ),
    each_pings=st.integers(1, 3),
)
def test_whatever_heads_and_frequencies_come_in_any_order_each_profile_is_used_once_or_counted(
    heads: list[tuple[int, int, float]], each_pings: int
) -> None:
    """Damage changes the frequency while a profile is held: that one is of no frequency in use any more."""
    decoder = PingDecoder()
    profiles = [
        head(n // each_pings, PORT + n, **channel(number, look_deg), ping_hz=hz)
        for n, (number, hz, look_deg) in enumerate(heads)
    ]
    frames, _ = decoded(profiles, decoder)
    used = [trace for frame in frames for trace in (frame.port, frame.starboard) if trace is not None]
    assert len({trace.samples.shape[0] for trace in used}) == len(used)
    counted = ("ping_protocol.not_used.frequency", "ping_protocol.not_used.channel", "pairing.repeated_side")
    assert len(used) + sum(decoder.counters[name] for name in counted) == len(profiles)
