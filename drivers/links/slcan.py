"""Drive CAN adapters that speak the Lawicel (slcan) text protocol on a serial port.

A frame is 't' and 3, or 'T' and 8 hexadecimal digits of identifier, a digit of length, the data in hexadecimal, and CR.
Some adapters put 4 digits of time, ms, behind the data, though they are commanded not to.
There is no checksum: of frames with one flipped bit about 4 in 10 still look sound, so what comes has to be checked for
sense by whoever uses it.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections import Counter
from typing import Final

from drivers.links.can_frame import CanFrame
from drivers.links.serial_port import open_serial
from drivers.links.stream import StreamPort
from drivers.links.uri import CAN_BITRATES

MAX_LINE_BYTES: Final = 30  # T, identifier, length, 8 bytes of data, time stamp
_STAMP_DIGITS: Final = 4  # of a time stamp
_SURE: Final = 3  # frames in a row with a time stamp, or without, that show what the adapter does (chosen)
_MAX_EXTENDED_ID: Final = 0x1FFFFFFF  # 29 bits, by the CAN specification 2.0 B
_MAX_STANDARD_ID: Final = 0x7FF  # 11 bits, by the CAN specification 2.0 A
# Up to MAX_LINE_BYTES.
_FRAME: Final = rb"(?:T[0-9A-Fa-f]{8}[0-8](?:[0-9A-Fa-f]{2}){0,10}|t[0-9A-Fa-f]{3}[0-8](?:[0-9A-Fa-f]{2}){0,10})\r"
_FRAME_PARTS: Final = (
    rb"[Tt](?P<frame>(?:(?<=T)[0-9A-Fa-f]{8}[0-8](?:[0-9A-Fa-f]{2}){0,10}"
    rb"|(?<=t)[0-9A-Fa-f]{3}[0-8](?:[0-9A-Fa-f]{2}){0,10}))\r"
)
_REMOTE: Final = rb"(?:R[0-9A-Fa-f]{8}|r[0-9A-Fa-f]{3})[0-8]\r"
_ANSWER: Final = rb"(?:[zZ]?|V[0-9A-Fa-f]{4}|N[0-9A-SU-Za-su-z]{4}|F[0-9A-Fa-f]{2})\r"
_TEXT: Final = rb"[^\r\a]*"
_LINE_BEGINS: Final = rb"(?<![^\r\a])"
_ANSWERS: Final = re.compile(_LINE_BEGINS + _ANSWER)
_REMOTES: Final = re.compile(_LINE_BEGINS + _REMOTE)
_BARE_BELLS: Final = re.compile(_LINE_BEGINS + rb"\a")
# One frame and what stands before it, or a run of other lines, as garbage can be nothing but ends of lines. A line's
# last T or t begins its frame, as no digit is one.
_LINES: Final = re.compile(rb"(%b)%b|(?P<others>(?:(?!%b%b)%b[\r\a])+)" % (_TEXT, _FRAME_PARTS, _TEXT, _FRAME, _TEXT))


class SlcanParser:
    """Parse an adapter's text, however damaged and however cut up, to frames. Holds less than one line; never raises.

    Time stamps are taken off an adapter that sends them, from the third frame on: one frame alone may as well have a
    damaged length.

    counters: slcan.frames, .time_stamps (taken off), .remote (frames without data, dropped), .answers and .refusals (of
    the adapter, to commands), and what was refused: slcan.refused.line (no frame), .length (data longer or shorter than
    it says), .identifier, .before_frame (something stands in front of a sound frame, as when the end of the one before
    got lost).
    """

    def __init__(self, counters: Counter[str]) -> None:
        self.counters = counters
        self._rest = b""  # of the line so far, its end
        self._is_long = False  # more stood before it
        self._has_stamps = False
        self._n_unlike = 0  # frames in a row that are not as `_has_stamps` says

    def feed(self, data: bytes) -> list[CanFrame]:
        """Return the frames that these bytes complete, in order."""
        text = self._rest + data
        stop = max(text.rfind(b"\r"), text.rfind(b"\a")) + 1
        frames: list[CanFrame] = []
        if stop and self._is_long:  # more stood before it, so that the first line is a frame's or nobody's
            text, stop = b"?" + text, stop + 1
        for match in _LINES.finditer(text, 0, stop):
            if match.lastgroup == "frame":
                frame = self._frame(match)
                if frame is not None:
                    frames.append(frame)
            else:
                self._count(match.group())
        if frames:
            self.counters["slcan.frames"] += len(frames)
        rest = text[stop:]
        self._is_long = len(rest) > MAX_LINE_BYTES or (self._is_long and not stop)
        self._rest = rest[-MAX_LINE_BYTES:]
        return frames

    def _count(self, lines: bytes) -> None:
        """Count lines that are not frames."""
        n_refusals = lines.count(b"\a")
        n_answers, n_remote = len(_ANSWERS.findall(lines)), len(_REMOTES.findall(lines))
        n_bare = len(_BARE_BELLS.findall(lines)) if n_refusals else 0
        counts = {
            "answers": n_answers,
            "remote": n_remote,
            "refusals": n_refusals,
            "refused.line": lines.count(b"\r") - n_answers - n_remote + n_refusals - n_bare,
        }
        for name, count in counts.items():
            if count:
                self.counters[f"slcan.{name}"] += count

    def _frame(self, match: re.Match[bytes]) -> CanFrame | None:
        before, text = match.group(1, 2)
        is_long = match.string[match.start(2) - 1] == ord("T")
        n_id = 8 if is_long else 3
        digits = text[n_id + 1 :]
        n_over = len(digits) - 2 * (text[n_id] - ord("0"))
        if n_over not in (0, _STAMP_DIGITS) or not self._is_as_usual(has_stamp=n_over > 0):
            self.counters["slcan.refused.length"] += 1
            return None
        if n_over:
            digits = digits[:-_STAMP_DIGITS]
            self.counters["slcan.time_stamps"] += 1
        can_id = int(text[:n_id], 16)
        if can_id > (_MAX_EXTENDED_ID if is_long else _MAX_STANDARD_ID):
            self.counters["slcan.refused.identifier"] += 1
            return None
        if before:
            self.counters["slcan.refused.before_frame"] += 1
        return CanFrame(can_id, unhexlify(digits), is_long)

    def _is_as_usual(self, *, has_stamp: bool) -> bool:
        """Check whether a frame has a time stamp or none as the adapter's others; learn it from some in a row."""
        if has_stamp == self._has_stamps:
            self._n_unlike = 0
            return True
        self._n_unlike += 1
        if self._n_unlike < _SURE:
            return False
        self._has_stamps, self._n_unlike = has_stamp, 0
        return True


def encode(frame: CanFrame) -> bytes:
    """Encode a frame as the adapter takes and gives it. Raises ValueError for one that no classic CAN bus carries."""
    if not 0 <= frame.can_id <= (_MAX_EXTENDED_ID if frame.extended else _MAX_STANDARD_ID) or len(frame.data) > 8:
        raise ValueError(f"not a frame of a classic CAN bus: identifier {frame.can_id:#x}, {len(frame.data)} bytes")
    head = f"T{frame.can_id:08X}" if frame.extended else f"t{frame.can_id:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode("ascii")


class SlcanPort:
    """Carry CAN frames through an adapter on a serial port. The adapter is sent: close, no time stamps, bit rate, open.

    Answers are not waited for, as many adapters give none. An adapter that lost power and came back is found silent and
    set up again. counters: those of SlcanParser and StreamPort, slcan.refused.unsendable.
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
        """Return how long to let more come before the next read, s."""
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
            return (
                f"The adapter answers: check that the bus has {self._bitrate} bit/s and power, its wires and its "
                "termination."
            )
        if refused:
            return (
                "What arrives is neither a CAN frame nor an answer of the adapter: check that the adapter speaks "
                "slcan, and the rate of its serial line."
            )
        return "The adapter does not answer either: check its power, and that it speaks slcan."

    def _n_answers(self) -> int:
        return self._counters["slcan.answers"] + self._counters["slcan.refusals"]

    def _start(self) -> None:
        self._n_answers_before = self._n_answers()
        self._n_refused_before = self._counters["slcan.refused.line"]
        self._stream.write(
            b"\r\rC\rZ0\rS%d\rO\r" % CAN_BITRATES.index(self._bitrate)
        )  # the first ends a command cut short


async def open_slcan(path: str, baud: int, bitrate: int, counters: Counter[str]) -> SlcanPort:
    """Open the serial port and the adapter's channel. Raises HardwareError that says what to do."""
    return SlcanPort(await open_serial(path, baud, counters), bitrate, counters)
