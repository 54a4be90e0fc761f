"""Assemble NMEA 2000 fast packets: messages of 9 to 223 bytes in frames of 8.

Byte 0 of a frame is a sequence number (3 bits) and a frame number (5 bits); byte 1 of frame 0 is the message's length.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

MAX_MESSAGE_BYTES: Final = 223  # 6 of the first frame and 7 of each of the 31 that follow
_MAX_OPEN: Final = 64  # messages under way: more talkers than any bus has for the groups that are read


class FastPackets:
    """Assemble messages by group, source and sequence number; drop a message with a gap.

    `counters`: n2k.fast_packet.incomplete (dropped for a gap, or because the next began), .orphan (frames without their
    frame 0), .length, .messages. Holds at most 64 messages under way.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._open: dict[tuple[int, int, int], tuple[int, bytearray]] = {}  # length, and what has come

    def add(self, pgn: int, source: int, frame: bytes) -> bytes | None:
        """Take a frame's data; return the message if that completes one."""
        if len(frame) < 2:
            self.counters["n2k.fast_packet.length"] += 1
            return None
        key = pgn, source, frame[0] >> 5
        number = frame[0] & 0x1F
        started = self._open.pop(key, None)
        if number == 0:
            if started is not None:
                self.counters["n2k.fast_packet.incomplete"] += 1
            length = frame[1]
            if not 0 < length <= MAX_MESSAGE_BYTES:
                self.counters["n2k.fast_packet.length"] += 1
                return None
            data = bytearray(frame[2:])
            n_due = 6
        elif started is None:
            self.counters["n2k.fast_packet.orphan"] += 1
            return None
        else:
            length, data = started
            n_due = 6 + 7 * number
            if len(data) != n_due - 7:
                self.counters["n2k.fast_packet.incomplete"] += 1
                return None
            data += frame[1:]
        if len(data) >= length:
            self.counters["n2k.fast_packet.messages"] += 1
            return bytes(data[:length])
        if len(data) != n_due:
            self.counters["n2k.fast_packet.incomplete"] += 1
            return None
        if len(self._open) == _MAX_OPEN:
            del self._open[next(iter(self._open))]
            self.counters["n2k.fast_packet.incomplete"] += 1
        self._open[key] = length, data
        return None


def frames_of(data: bytes, sequence: int) -> list[bytes]:
    """Split a message into frames, the last one filled up with ones.

    Raises ValueError for more than 223 bytes or none.
    """
    if not 0 < len(data) <= MAX_MESSAGE_BYTES:
        raise ValueError(f"a fast packet has 1 to {MAX_MESSAGE_BYTES} bytes, not {len(data)}")
    head = (sequence & 7) << 5
    frames = [bytes((head, len(data))) + data[:6]]
    frames += [
        bytes((head | number,)) + data[start : start + 7]
        for number, start in enumerate(range(6, len(data), 7), start=1)
    ]
    return [frame.ljust(8, b"\xff") for frame in frames]
