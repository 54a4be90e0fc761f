"""Compute what a UART reads of a line that runs at another speed than it was set to."""

from __future__ import annotations

from typing import Final

_BITS: Final = 10  # start, 8 data bits from the lowest on, stop


def misread(data: bytes, sender_baud: int, receiver_baud: int) -> bytes:
    """Return the bytes that a receiver makes of `data`, sent 8N1 in one go on a line that is idle before and after.

    The receiver waits for a falling edge and reads each bit at its middle by its own clock. A byte without a stop bit
    is read as 0, as Linux does.
    """
    line = [bit for byte in data for bit in (0, *((byte >> i) & 1 for i in range(8)), 1)]
    bit = sender_baud / receiver_baud  # one of the receiver's, in those of the sender

    def level(at: float) -> int:
        index = int(at)
        return line[index] if index < len(line) else 1

    read = bytearray()
    at = 0.0
    before = 1
    while True:
        index = int(at)
        while index < len(line) and not (before == 1 and line[index] == 0):
            before = line[index]
            index += 1
        if index >= len(line):
            return bytes(read)
        start = max(float(index), at)
        value = sum(level(start + (1.5 + i) * bit) << i for i in range(8))
        at = start + (_BITS - 0.5) * bit
        before = level(at)
        read.append(value if before else 0)
