"""Drive Imagenex SportScan and similar sonars: a serial side-scan that answers every switch command with one ping.

Layouts (Imagenex, "SportScan" and "852" interface descriptions): the command is 27 bytes from FE 44 to FD, and no other
byte may be FD; the answer is 'IGX', 9 more bytes of header, 400 echo bytes of 0..127 and FC, 413 bytes in all.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace
from drivers.framing import Grammar, StampedFramer, StampedMessage
from drivers.message_candidates import MessageCandidates
from drivers.sonar.sonar_decoder import SonarFrame, SonarReply, SonarSettings
from drivers.sonar.sonar_settings import check_settings

COMMAND_BYTES: Final = 27  # of a switch data command (SportScan interface description)
RETURN_BYTES: Final = 413  # header, echo and terminator
RANGES_M: Final = (15, 30, 60, 90, 120)  # m that the sonar can be set to
MAX_GAIN: Final = 40  # dB
STARBOARD, PORT, BOTH = 1, 2, 3  # channel

_SYNC: Final = b"IGX"
_HEADER_BYTES: Final = 12  # of a return, before the echo
_N_ECHO: Final = 400  # bytes of echo of one side
_HEAD_ID: Final = 0x10  # of the head in its interface description
_TERMINATOR: Final = 0xFC  # last byte of a return
_COMMAND_START: Final = b"\xfe\x44"
_COMMAND_END: Final = 0xFD  # last byte of a command; must not occur before it
_MAX_ECHO: Final = 127  # of 7 bits
_HEADER: Final = (
    rb"\x10.[\x00\x01][\x01-\x03][\x0f\x1e\x3c\x5a\x78].."  # head, status, kind, channel, range, two unused
)
_COUNT: Final = rb"(?:\x10\x03|\x1c\x03)"  # 400 or 412, seven bits a byte
_SOUND_SPEED_MPS: Final = 1500.0  # m/s that the sonar takes for its ranges
_OVERRUN: Final = 0x80  # of the serial status
_ACCEPTED: Final = 0x40  # status of a return without an error


class SwitchCommand(NamedTuple):
    """Command one ping of the head. gain_db: 0..40. absorption: hundredths of dB/m. pulse_us: transmit pulse."""

    range_m: int
    gain_db: int = 20
    absorption: int = 20
    pulse_us: int = 100
    data_points: int = 50
    frequency: int = 0


class IgxReturn(NamedTuple):
    """Hold one ping. channel: 1 starboard, 2 port, 3 both, starboard and port in turn. echo: (400,) uint8 of 0..127."""

    range_m: int
    channel: int
    echo: NDArray[np.uint8]
    dual_frequency: bool = False
    status: int = _ACCEPTED


def encode_command(command: SwitchCommand) -> bytes:
    """Encode a switch command in 27 bytes.

    Raises UsageError for a value that would be taken for the end of the command.
    """
    frame = bytearray(COMMAND_BYTES)
    frame[:3] = (*_COMMAND_START, _HEAD_ID)
    frame[3] = command.range_m
    frame[8] = command.gain_db
    frame[10] = command.absorption
    frame[14] = command.pulse_us
    frame[19] = command.data_points
    frame[25] = command.frequency
    if _COMMAND_END in frame:
        raise UsageError(
            f"sportscan: {command} has a value of {_COMMAND_END}, which ends the command. Give one more or less."
        )
    frame[26] = _COMMAND_END
    return bytes(frame)


def decode_command(frame: bytes) -> SwitchCommand | None:
    """Decode a switch command from 27 bytes; return None for other bytes."""
    if (
        len(frame) != COMMAND_BYTES
        or not frame.startswith(_COMMAND_START)
        or frame.find(_COMMAND_END) != COMMAND_BYTES - 1
    ):
        return None
    return SwitchCommand(frame[3], frame[8], frame[10], frame[14], frame[19], frame[25])


def encode_return(ping: IgxReturn) -> bytes:
    """Encode one ping in 413 bytes."""
    count = _HEADER_BYTES + _N_ECHO
    head = bytes(
        (
            *_SYNC,
            _HEAD_ID,
            ping.status,
            int(ping.dual_frequency),
            ping.channel,
            ping.range_m,
            0,
            0,
            count & 0x7F,
            count >> 7 & 0x7F,
        )
    )
    return head + np.minimum(ping.echo, _MAX_ECHO).astype(np.uint8).tobytes() + bytes((_TERMINATOR,))


_CANDIDATES: Final = MessageCandidates(
    (_SYNC,),
    alive=rb"IGX(?:.{0,8}\Z|%b%b)" % (_HEADER, _COUNT),
    dead=rb"(?!)()|IGX(?:%b()|())" % _HEADER,
    reasons=("", "length", "header"),
)


class IgxGrammar(Grammar[IgxReturn]):
    """Echo bytes have seven bits, so that the terminator stands in its place only if nothing was lost or inserted."""

    name = "sportscan"
    head_bytes = len(_SYNC)
    max_message_bytes = RETURN_BYTES
    proven = True
    find = staticmethod(_CANDIDATES.find)

    def read(self, buffer: bytearray, at: int) -> tuple[IgxReturn, int] | int | str:
        n_there = len(buffer) - at
        if n_there < _HEADER_BYTES:
            return _HEADER_BYTES
        head_id, status, kind, channel, range_m, _, _, low, high = buffer[at + 3 : at + _HEADER_BYTES]
        if head_id != _HEAD_ID or kind > 1 or channel not in (STARBOARD, PORT, BOTH) or range_m not in RANGES_M:
            return "header"
        # Descriptions differ in whether the count includes the header.
        if (high << 7 | low) not in (_N_ECHO, _HEADER_BYTES + _N_ECHO):
            return "length"
        if n_there < RETURN_BYTES:
            return RETURN_BYTES
        start = at + _HEADER_BYTES
        if buffer[start + _N_ECHO] != _TERMINATOR:
            return "terminator"
        echo_bytes = bytes(buffer[start : start + _N_ECHO])
        if not echo_bytes.isascii():  # some byte is above _MAX_ECHO
            return "echo"
        echo = np.frombuffer(echo_bytes, np.uint8)
        return IgxReturn(range_m, channel, echo, kind == 1, status), RETURN_BYTES


class SportScanDecoder:
    """Make a frame of each return. The device reports neither number, time nor scale; frames are counted from 0."""

    def __init__(self) -> None:
        self._framer = StampedFramer(IgxGrammar())
        self.counters = self._framer.counters
        self._number = 0

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarFrame | SonarReply]:
        return [self._frame(arrived) for arrived in self._framer.feed(data, stamp)]

    def finish(self) -> list[SonarFrame | SonarReply]:
        return [self._frame(arrived) for arrived in self._framer.finish()]

    def _frame(self, arrived: StampedMessage[IgxReturn]) -> SonarFrame:
        ping = arrived.message
        if ping.status & _OVERRUN:
            self.counters["sportscan.command_overrun"] += 1
        both = ping.channel == BOTH
        starboard = ping.echo[0::2] if both else ping.echo
        port = ping.echo[1::2] if both else ping.echo
        number, self._number = self._number, self._number + 1
        return SonarFrame(
            number=number,
            port=_trace(port, ping.range_m) if ping.channel != STARBOARD else None,
            starboard=_trace(starboard, ping.range_m) if ping.channel != PORT else None,
            transfer=None,
            received=arrived.received,
            n_bytes=arrived.n_bytes,
            sound_speed_mps=_SOUND_SPEED_MPS,
        )


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return the command to send for every ping; none while not enabled.

    Raises UsageError for what the head cannot do.
    """
    check_settings(settings, "sportscan", max_range_m=float(RANGES_M[-1]), max_gain=MAX_GAIN)
    if settings.range_m not in RANGES_M:
        known = ", ".join(map(str, RANGES_M))
        raise UsageError(f"sportscan: a range of {settings.range_m:g} m cannot be set. Give one of {known} m.")
    command = SwitchCommand(round(settings.range_m))
    if settings.gain is not None:
        command = command._replace(gain_db=settings.gain)
    return (encode_command(command),) if settings.enabled else ()


def _trace(echo: NDArray[np.uint8], range_m: int) -> EchoTrace:
    spacing_m = range_m / echo.shape[0]
    return EchoTrace(samples=echo, first_range_m=0.5 * spacing_m, spacing_m=spacing_m)
