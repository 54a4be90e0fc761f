"""Drive the ACME side-scan sonar on a serial line.

A ping is `ACME`, a header (number u32, milliseconds since power-up u32, range in cm u16, samples per side u16), the
amplitudes of port and of starboard, near to far, u16 each, and a CRC-32 of all that. All numbers are little-endian.
The command is `RANGE` and metres in three digits.
"""

from __future__ import annotations

import struct
from collections import Counter
from typing import Final, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace
from drivers.framing import Refused, StampedFramer
from drivers.sonar.sonar_decoder import SonarFrame, SonarReply, SonarSettings
from drivers.sonar.sonars import SonarDevice

SYNC: Final = b"ACME"
_HEADER: Final = struct.Struct("<4sIIHH")
_CRC: Final = struct.Struct("<I")
MAX_SAMPLES: Final = 4096
MAX_RANGE_M: Final = 200.0
COUNTER_PERIOD_S: Final = 2**32 / 1000.0  # milliseconds in 32 bits


class AcmePing(NamedTuple):
    """Hold one ping. time_ms: since power-up. port, starboard: (n,) uint16 amplitudes, near to far."""

    number: int
    time_ms: int
    range_cm: int
    port: NDArray[np.uint16]
    starboard: NDArray[np.uint16]


def encode(ping: AcmePing) -> bytes:
    """Encode a ping as the sonar sends it."""
    header = _HEADER.pack(SYNC, ping.number, ping.time_ms, ping.range_cm, ping.port.shape[0])
    body = header + ping.port.astype("<u2").tobytes() + ping.starboard.astype("<u2").tobytes()
    return body + _CRC.pack(crc32(body))


class AcmeGrammar:
    """Recognise pings in a stream of bytes."""

    name = "acme_sonar"
    head_bytes = len(SYNC)
    max_message_bytes = _HEADER.size + 4 * MAX_SAMPLES + _CRC.size
    proven = True

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        return buffer.find(SYNC, start)

    def read(self, buffer: bytearray, at: int) -> tuple[AcmePing, int] | int | str:
        if len(buffer) - at < _HEADER.size:
            return _HEADER.size
        number, time_ms, range_cm, n_samples = _fields(buffer, at)
        if not (0 < n_samples <= MAX_SAMPLES and 0 < range_cm <= 100.0 * MAX_RANGE_M):
            return "header"
        crc_at = at + _HEADER.size + 4 * n_samples
        if len(buffer) < crc_at + _CRC.size:
            return crc_at + _CRC.size - at
        body = bytes(buffer[at:crc_at])
        if _CRC.unpack_from(buffer, crc_at)[0] != crc32(body):
            return "checksum"
        port, starboard = np.frombuffer(body, "<u2", offset=_HEADER.size).reshape(2, n_samples)
        return AcmePing(number, time_ms, range_cm, port, starboard), crc_at + _CRC.size - at

    def forget(self, n_bytes: int) -> None: ...


def _fields(buffer: bytearray, at: int) -> tuple[int, int, int, int]:
    """Return the fields behind the sync of a header."""
    _, number, time_ms, range_cm, n_samples = _HEADER.unpack_from(buffer, at)
    return number, time_ms, range_cm, n_samples


class AcmeDecoder:
    """Decode the pings of one link."""

    def __init__(self) -> None:
        self._framer = StampedFramer(AcmeGrammar())

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarFrame | SonarReply]:
        return [_frame(ping, received, n_bytes) for ping, received, n_bytes in self._framer.feed(data, stamp)]

    def finish(self) -> list[SonarFrame | SonarReply]:
        return [_frame(ping, received, n_bytes) for ping, received, n_bytes in self._framer.finish()]


def _frame(ping: AcmePing, received: Stamp, n_bytes: int) -> SonarFrame:
    return SonarFrame(
        number=ping.number,
        port=_trace(ping.port, ping.range_cm),
        starboard=_trace(ping.starboard, ping.range_cm),
        transfer="amplitude",
        received=received,
        n_bytes=n_bytes,
        device_time_s=1e-3 * ping.time_ms,
    )


def _trace(samples: NDArray[np.uint16], range_cm: int) -> EchoTrace:
    spacing_m = 0.01 * range_cm / samples.shape[0]
    return EchoTrace(samples=samples, first_range_m=0.5 * spacing_m, spacing_m=spacing_m)


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return the command that sets the range; none while not enabled. Raises UsageError for a range that cannot be
    set."""
    if not 1.0 <= settings.range_m <= MAX_RANGE_M:
        raise UsageError(f"acme_sonar: a range of {settings.range_m:g} m cannot be set. Give 1 to {MAX_RANGE_M:g} m.")
    return (b"RANGE%03d" % round(settings.range_m),) if settings.enabled else ()


SONAR: Final = SonarDevice(lambda sonar: AcmeDecoder(), commands, sets_gain=False, counter_period_s=COUNTER_PERIOD_S)
