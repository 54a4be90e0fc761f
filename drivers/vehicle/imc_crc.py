"""Compute the CRC-16/ARC of any stretch of a stream at a cost that does not depend on its length.

The checksum of IMC packets: polynomial 0x8005, reflected, from 0. It is the remainder of the stretch, read as a
polynomial over GF(2), by x^16 + x^15 + x^2 + 1. Here the remainder of the stream is divided by x once for each of its
bits, so that what a bit adds to it depends on where the bit stands, not on what follows. A stretch then has remainder 0
if the running remainders at both its ends are equal; a packet followed by its checksum, low byte first, is such a
stretch. Powers of x repeat after 32767.
"""

from __future__ import annotations

from array import array
from functools import cache
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

_PERIOD: Final = 32767  # after which powers of x repeat
_POLYNOMIAL: Final = 0xA001  # reflected
_NIBBLE: Final = 16  # values of 4 bits: a table of so many columns fits the cache


def crc16_arc(data: bytes | bytearray) -> int:
    """Return the CRC-16/ARC of bytes."""
    crc, table = 0, _byte_table()
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 0xFF]
    return crc


class RunningRemainder:
    """Keep remainders of a buffer that drops bytes in front and takes bytes behind."""

    def __init__(self) -> None:
        self._phase = 0  # of the buffer's first byte, 0.._PERIOD - 1
        self._plain = array("H", (0,))
        self._swapped = array("H")

    def plain(self, buffer: bytearray) -> array[int]:
        """Return the running remainder before each byte of the buffer and behind the last."""
        done = len(self._plain) - 1
        if done < len(buffer):
            added = _powers(np.frombuffer(buffer, np.uint8, offset=done), self._phase + done)
            added[0] ^= self._plain[-1]
            self._plain.frombytes(np.bitwise_xor.accumulate(added).tobytes())
        return self._plain

    def swapped(self, buffer: bytearray) -> array[int]:
        """Return, for each byte but the last, the running remainder behind it and the next, both swapped.

        Equal to the plain one at the beginning of a packet whose checksum comes high byte first.
        """
        done, n = len(self._swapped), len(buffer) - 1
        if done < n:
            plain = np.array(self.plain(buffer)[done:n], dtype=np.uint16)
            these = np.frombuffer(buffer, np.uint8, n - done, done)
            others = np.frombuffer(buffer, np.uint8, n - done, done + 1)
            at = self._phase + done
            self._swapped.frombytes((plain ^ _powers(others, at) ^ _powers(these, at + 1)).tobytes())
        return self._swapped

    def forget(self, n_bytes: int) -> None:
        """Drop the first bytes, as the buffer did."""
        self._phase = (self._phase + n_bytes) % _PERIOD
        if n_bytes < len(self._plain):
            del self._plain[:n_bytes]
        else:
            self._plain = array("H", (0,))  # any value will do, since only differences count
            self._swapped = array("H")
        del self._swapped[:n_bytes]


def _powers(data: NDArray[np.uint8], phase: int) -> NDArray[np.uint16]:
    """Compute what each byte adds to the running remainder, (n,) uint16. phase: number of the first byte."""
    low, high = _nibble_tables()
    first = phase % _PERIOD
    rows = _rows()[first : first + len(data)]
    if len(rows) < len(data):
        rows = _NIBBLE * (np.arange(first, first + len(data)) % _PERIOD)
    return low[rows + (data & 15)] ^ high[rows + (data >> 4)]


@cache
def _rows() -> NDArray[np.int64]:
    """Return where the tables hold the bytes from any phase on, for two periods: datagrams are much shorter."""
    return _NIBBLE * (np.arange(2 * _PERIOD) % _PERIOD)


@cache
def _byte_table() -> tuple[int, ...]:
    return tuple(list(accumulate(range(8), _divided, initial=byte))[-1] for byte in range(256))


def _divided(remainder: int, _: int) -> int:
    """Divide a remainder by x, reflected: times x for the checksum that reads bits from the lowest on."""
    return (remainder >> 1) ^ (_POLYNOMIAL if remainder & 1 else 0)


@cache
def _nibble_tables() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return the tables of what the low and the high four bits of a byte add, each (_PERIOD * 16,) uint16.

    Indexed by the byte's number times 16 plus the bits.

    2 MiB in all, made within 10 ms when the first candidate is to be proven.
    """
    steps = np.fromiter(
        accumulate(range(_PERIOD - 1), _divided, initial=1), np.uint16, _PERIOD
    )  # reflected remainders of x^15, x^16, ...
    first_bit = -8 * np.arange(_PERIOD)
    of_bit = [steps[(first_bit - bit) % _PERIOD] for bit in range(8)]
    values = np.arange(_NIBBLE)
    tables = []
    for bits in (of_bit[:4], of_bit[4:]):
        table = np.zeros((_PERIOD, _NIBBLE), np.uint16)
        for bit, powers in enumerate(bits):
            table ^= powers[:, None] * (values >> bit & 1).astype(np.uint16)
        tables.append(table.reshape(-1))
    return tables[0], tables[1]
