"""CAN adapters that speak the Lawicel (slcan) text protocol on a serial port.

A frame is 't' and 3, or 'T' and 8 hexadecimal digits of identifier, a digit of length, the data in hexadecimal, and CR. There is no
checksum: of frames with one flipped bit about 4 in 10 still look sound, so what comes has to be checked for sense by whoever uses it.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Final

from drivers.links.can_frame import CanFrame
from drivers.links.serial_port import open_serial
from drivers.links.stream import StreamPort
from drivers.links.uri import CAN_BITRATES

MAX_LINE_BYTES: Final = 26  # T, identifier, length, 8 bytes of data
_MAX_EXTENDED_ID: Final = 0x1FFFFFFF
_MAX_STANDARD_ID: Final = 0x7FF
_FRAME: Final = re.compile(rb"(?:T([0-9A-Fa-f]{8})|t([0-9A-Fa-f]{3}))([0-8])((?:[0-9A-Fa-f]{2})*)")
_REMOTE: Final = re.compile(rb"(?:R[0-9A-Fa-f]{8}|r[0-9A-Fa-f]{3})[0-8]")
_ANSWER: Final = re.compile(rb"[zZ]?|V[0-9A-Fa-f]{4}|N[0-9A-Za-z]{4}|F[0-9A-Fa-f]{2}")
_ENDS: Final = re.compile(rb"[\r\a]")


class SlcanParser:
    """The text of an adapter, however damaged and however cut up, to frames. Holds less than one line; never raises.

    counters: slcan.frames, .remote (frames without data, left out), .answers and .refusals (of the adapter, to commands), and what was
    refused: slcan.refused.line (no frame), .length (data longer or shorter than it says), .identifier, .before_frame (something stands
    in front of a sound frame, as when the end of the one before got lost).
    """

    def __init__(self, counters: Counter[str]) -> None:
        self.counters = counters
        self._rest = b""  # of the line so far, its end
        self._is_long = False  # more stood before it

    def feed(self, data: bytes) -> list[CanFrame]:
        """The frames these bytes complete, in order."""
        frames: list[CanFrame] = []
        at = 0
        for end in _ENDS.finditer(data):
            self._extend(data[at : end.start()])
            at = end.end()
            frame = self._line(is_bell=end.group() == b"\a")
            if frame is not None:
                frames.append(frame)
            self._rest, self._is_long = b"", False
        self._extend(data[at:])
        return frames

    def _extend(self, data: bytes) -> None:
        line = self._rest + data
        self._is_long |= len(line) > MAX_LINE_BYTES
        self._rest = line[-MAX_LINE_BYTES:]

    def _line(self, is_bell: bool) -> CanFrame | None:
        line = self._rest
        if is_bell:
            self.counters["slcan.refusals"] += 1
            if line:
                self.counters["slcan.refused.line"] += 1
            return None
        # No digit is a T: a sound frame starts at the last one, whatever stands before.
        start = max(line.rfind(b"T"), line.rfind(b"t"))
        if start < 0:
            if self._is_long:
                self.counters["slcan.refused.line"] += 1
            elif _ANSWER.fullmatch(line):
                self.counters["slcan.answers"] += 1
            else:
                self.counters["slcan.remote" if _REMOTE.fullmatch(line) else "slcan.refused.line"] += 1
            return None
        match = _FRAME.fullmatch(line, start)
        if match is None:
            self.counters["slcan.refused.line"] += 1
            return None
        long_id, short_id, length, digits = match.groups()
        if len(digits) != 2 * int(length):
            self.counters["slcan.refused.length"] += 1
            return None
        can_id = int(long_id or short_id, 16)
        if can_id > (_MAX_EXTENDED_ID if long_id else _MAX_STANDARD_ID):
            self.counters["slcan.refused.identifier"] += 1
            return None
        if start or self._is_long:
            self.counters["slcan.refused.before_frame"] += 1
        self.counters["slcan.frames"] += 1
        return CanFrame(can_id, bytes.fromhex(digits.decode("ascii")), bool(long_id))


def encode(frame: CanFrame) -> bytes:
    """A frame as the adapter takes and gives it. Raises ValueError for one that no classic CAN bus carries."""
    if not 0 <= frame.can_id <= (_MAX_EXTENDED_ID if frame.extended else _MAX_STANDARD_ID) or len(frame.data) > 8:
        raise ValueError(f"not a frame of a classic CAN bus: identifier {frame.can_id:#x}, {len(frame.data)} bytes")
    head = f"T{frame.can_id:08X}" if frame.extended else f"t{frame.can_id:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode("ascii")


class SlcanPort:
    """A Port of CAN frames on a serial port with an adapter, which is told to close, to leave out time stamps, its bit rate, and to open.

    Answers are not waited for, as many adapters give none. An adapter that lost power and came back is found silent and told again.
    counters: those of SlcanParser and StreamPort, slcan.refused.unsendable.
    """

    def __init__(self, stream: StreamPort, bitrate: int, counters: Counter[str]) -> None:
        self.note = ""
        self.close = stream.close
        self.fileno = stream.fileno
        self.flush = stream.flush
        self._stream = stream
        self._bitrate = bitrate
        self._counters = counters
        self._parser = SlcanParser(counters)
        self._n_answers_before = 0
        self._n_refused_before = 0
        self._start()

    @property
    def has_unsent(self) -> bool:
        return self._stream.has_unsent

    @property
    def pause_s(self) -> float:
        return self._stream.pause_s

    def read(self) -> list[CanFrame]:
        return [frame for data in self._stream.read() for frame in self._parser.feed(data)]

    def write(self, item: CanFrame) -> bool:
        try:
            text = encode(item)
        except ValueError:
            self._counters["slcan.refused.unsendable"] += 1
            return False
        return self._stream.write(text)

    def on_silence(self) -> str:
        answered = self._n_answers() > self._n_answers_before
        refused = self._counters["slcan.refused.line"] > self._n_refused_before
        self._start()
        if answered:
            return f"The adapter answers: check that the bus has {self._bitrate} bit/s and power, its wires and its termination."
        if refused:
            return "What comes is no frame and no answer: check that the adapter speaks slcan, and at a serial line its rate."
        return "The adapter does not answer either: check its power, and that it speaks slcan."

    def _n_answers(self) -> int:
        return self._counters["slcan.answers"] + self._counters["slcan.refusals"]

    def _start(self) -> None:
        self._n_answers_before = self._n_answers()
        self._n_refused_before = self._counters["slcan.refused.line"]
        self._stream.write(b"\r\rC\rZ0\rS%d\rO\r" % CAN_BITRATES.index(self._bitrate))  # the first ends a command cut short


async def open_slcan(path: str, baud: int, bitrate: int, counters: Counter[str]) -> SlcanPort:
    """Open the serial port and the adapter's channel. Raises HardwareError that says what to do."""
    return SlcanPort(await open_serial(path, baud, counters), bitrate, counters)
