"""The running remainder proves any stretch of a stream, wherever the stream was cut."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.running_sum import RunningSum
from drivers.vehicle.imc_crc import RunningRemainder, crc16_arc


@given(
    before=st.binary(max_size=40),
    body=st.binary(max_size=80),
    after=st.binary(max_size=20),
    wrong=st.integers(0, 0xFFFF),
)
def test_remainders_are_equal_where_the_checksum_is_right_and_nowhere_else(
    before: bytes, body: bytes, after: bytes, wrong: int
) -> None:
    for checksum in (crc16_arc(body), wrong):
        right = checksum == crc16_arc(body)
        little = bytearray(before + body + checksum.to_bytes(2, "little") + after)
        start, stop = len(before), len(before) + len(body)
        plain = RunningRemainder().plain(little)
        assert (plain[start] == plain[stop + 2]) == right
        big = bytearray(before + body + checksum.to_bytes(2, "big") + after)
        remainder = RunningRemainder()
        assert (remainder.swapped(big)[stop] == remainder.plain(big)[start]) == right


@given(data=st.data())
def test_dropped_and_added_bytes_change_no_verdict(data: st.DataObject) -> None:
    buffer, remainder, total = bytearray(), RunningRemainder(), RunningSum()
    for _ in range(data.draw(st.integers(1, 8))):
        n_dropped = data.draw(st.integers(0, len(buffer)))
        del buffer[:n_dropped]
        remainder.forget(n_dropped)
        total.forget(n_dropped)
        buffer += data.draw(st.binary(max_size=40))
        if data.draw(st.booleans()):
            plain, sums = remainder.plain(buffer), total.values(buffer)
            start = data.draw(st.integers(0, len(buffer)))
            stop = data.draw(st.integers(start, len(buffer)))
            assert (plain[start] == plain[stop]) == (crc16_arc(buffer[start:stop]) == 0)
            assert (sums[stop] - sums[start]) % 65536 == sum(buffer[start:stop])


def test_a_stream_longer_than_the_period_of_the_powers_is_followed() -> None:
    piece = bytes(range(256)) * 20
    packet = b"123456789" + (0xBB3D).to_bytes(2, "little")
    buffer, remainder = bytearray(), RunningRemainder()
    for _ in range(10):
        n = len(buffer)
        del buffer[:n]
        remainder.forget(n)
        buffer += piece + packet
        plain = remainder.plain(buffer)
        assert plain[len(piece)] == plain[len(buffer)]
        assert plain[len(piece) - 1] != plain[len(buffer)]
