from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.fakes.uart import misread

RATES = st.sampled_from([1200, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600])


@given(st.binary(max_size=40), RATES)
def test_at_the_same_rate_everything_is_read_right(data: bytes, baud: int) -> None:
    assert misread(data, baud, baud) == data


@given(st.binary(max_size=40), RATES, st.floats(-0.04, 0.04))
def test_clocks_that_differ_a_little_read_right(data: bytes, baud: int, error: float) -> None:
    assert misread(data, baud, round(baud * (1.0 + error))) == data


@given(st.binary(max_size=40), RATES, RATES)
def test_whatever_the_rates_reading_comes_to_an_end(data: bytes, sender_baud: int, receiver_baud: int) -> None:
    assert len(misread(data, sender_baud, receiver_baud)) <= max(1, 5 * receiver_baud // sender_baud + 1) * len(data)


@pytest.mark.parametrize(
    ("data", "sender_baud", "receiver_baud", "read"),
    [
        # 0xFF is one low bit; to a receiver at half the rate it lasts half a bit, and is over at its middle: the byte
        # is all ones.
        (b"\xff", 9600, 4800, b"\xff"),
        # At double the rate the low start bit covers the start and the lowest data bit.
        (b"\xff", 9600, 19200, b"\xfe"),
        # 9 low bits at a quarter of the receiver's rate: 36 of its bits, so a byte without a stop bit, and no further
        # edge.
        (b"\x00", 9600, 38400, b"\x00"),
        # 0x55 alternates every bit. At double the rate: 0 0 1 1 0 0 1 1 0 0, no stop bit; from the next edge 0 0 1 1 0
        # 0 1 1 1 1.
        (b"\x55", 9600, 19200, b"\x00\xe6"),
    ],
)
def test_what_a_receiver_makes_of_single_bytes(data: bytes, sender_baud: int, receiver_baud: int, read: bytes) -> None:
    assert misread(data, sender_baud, receiver_baud) == read
