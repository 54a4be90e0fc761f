"""Assemble frames of one sender to whole messages."""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple

from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_messages import (
    BY_NUMBER,
    CRC16_BYTES,
    CRC32_BYTES,
    FRAME_BYTES,
    HEAD_BYTES,
    TRANSFER_S,
    CanMessage,
    Record,
    Sender,
    crc16,
    crc_of,
    decode,
    number_and_address,
)

_MAX_OPEN: Final = 8  # transfers of one message under way: a sender has one at a time, the others are remains


class Received(NamedTuple):
    """Hold a whole message. sequence, crc: of its transfer, 0 for a message of one frame."""

    record: Record
    sequence: int
    crc: int


class _Transfer:
    """Hold the parts of one transfer so far, by number."""

    def __init__(self, begun_s: float) -> None:
        self.begun_s = begun_s
        self.contents: dict[int, bytes] = {}


class CanReceiver:
    """Assemble one sender's messages, in whatever order their frames arrive; never raises, whatever they hold.

    counters: NAME.messages, NAME.ignored (frames of others' protocols, 11-bit identifiers, messages of the own side),
    and what was refused: NAME.refused.foreign (messages of this sender from another address), .message (no such
    number), .length, .part (no such part), .crc, .value (out of range), .repeated (a part once more), .incomplete
    (transfers that did not become whole).
    """

    def __init__(self, name: str, sender: Sender, address: int, counters: Counter[str]) -> None:
        self.counters = counters
        self._name = name
        self._sender = sender
        self._address = address
        self._open: dict[int, dict[int, _Transfer]] = {message.number: {} for message in BY_NUMBER.values()}

    def add(self, frame: CanFrame, now_s: float) -> Received | None:
        """Take a frame; return the message if that completes one."""
        found = number_and_address(frame.can_id) if frame.extended else None
        if found is None:
            self.counters[f"{self._name}.ignored"] += 1
            return None
        number, address = found
        message = BY_NUMBER.get(number)
        if message is None:
            self._refuse("message")
        elif message.sender != self._sender:
            self.counters[f"{self._name}.ignored"] += 1
        elif address != self._address:
            self._refuse("foreign")
        elif len(frame.data) != FRAME_BYTES:
            self._refuse("length")
        elif message.is_transfer:
            return self._part(message, frame.data, now_s)
        else:
            return self._single(message, frame.data)
        return None

    def _single(self, message: CanMessage, data: bytes) -> Received | None:
        content = data[:-CRC16_BYTES]
        if int.from_bytes(data[-CRC16_BYTES:], "little") != crc16(message.number, self._address, content):
            self._refuse("crc")
            return None
        return self._whole(message, [content], 0, 0)

    def _part(self, message: CanMessage, data: bytes, now_s: float) -> Received | None:
        part, sequence, content = data[0], data[1], data[HEAD_BYTES:]
        if part >= len(message.parts):
            self._refuse("part")
            return None
        transfer = self._transfer(message, sequence, now_s)
        if part in transfer.contents:
            self._refuse("repeated")
        # The later one counts: a damaged frame that strayed in here came before the part that belongs here more often
        # than after it.
        transfer.contents[part] = content
        if len(transfer.contents) < len(message.parts):
            return None
        contents = [transfer.contents[number] for number in range(len(message.parts))]
        joined = b"".join(contents)
        crc = crc_of(message.number, self._address, joined[:-CRC32_BYTES])
        if int.from_bytes(joined[-CRC32_BYTES:], "little") != crc:
            self._refuse("crc")
            return None
        del self._open[message.number][sequence]
        return self._whole(message, contents, sequence, crc)

    def _transfer(self, message: CanMessage, sequence: int, now_s: float) -> _Transfer:
        """Return the transfer under way, or a new one; drop those that take too long."""
        under_way = self._open[message.number]
        for old in [old for old, transfer in under_way.items() if not 0.0 <= now_s - transfer.begun_s <= TRANSFER_S]:
            del under_way[old]
            self._refuse("incomplete")
        if sequence not in under_way:
            if len(under_way) == _MAX_OPEN:
                del under_way[next(iter(under_way))]
                self._refuse("incomplete")
            under_way[sequence] = _Transfer(now_s)
        return under_way[sequence]

    def _whole(self, message: CanMessage, contents: list[bytes], sequence: int, crc: int) -> Received | None:
        try:
            record = decode(message, contents)
        except ValueError:
            self._refuse("value")
            return None
        self.counters[f"{self._name}.messages"] += 1
        return Received(record, sequence, crc)

    def _refuse(self, reason: str) -> None:
        self.counters[f"{self._name}.refused.{reason}"] += 1
