"""Write a driver for a sonar of your own, and try it on bytes before there is hardware.

    python own_driver.py LOG

The sonar is made up: each ping is `LS`, its number (u32), milliseconds since power-up (u32), range in m (f32), samples
per side (u16), the amplitudes of port and starboard, near to far (u16 each), and a CRC-32, all little-endian. The pings
of LOG are sent through the driver in small pieces, with bytes damaged on the way.

To use a driver live, add it to your package's pyproject.toml; `device: lab_sonar` of a port then names it:

    [project.entry-points."auv_mcm.sonar"]
    lab_sonar = "my_package.own_driver:SONAR"
"""

from __future__ import annotations

import struct
import sys
from collections import Counter
from pathlib import Path
from zlib import crc32

import numpy as np

from auv_mcm.clock import Stamp
from auv_mcm.records import EchoTrace, Ping
from auv_mcm.settings.config import Config, SonarConfig
from drivers.framing import Refused, StampedFramer
from drivers.sonar.sonar_decoder import SonarFrame, SonarReply, SonarSettings
from drivers.sonar.sonars import SonarDevice
from sim_replay.logs.open_log import open_log

HEADER = struct.Struct("<2sIIfH")
MAX_SAMPLES = 20_000  # per side; a damaged header must not make the driver wait for more


class LabGrammar:
    """Recognise whole pings in a stream of bytes: where one may begin, and whether it is intact."""

    name = "lab_sonar"  # counters: lab_sonar.messages, lab_sonar.refused.checksum, ...
    head_bytes = 2
    max_message_bytes = HEADER.size + 4 * MAX_SAMPLES + 4
    proven = True  # by the checksum

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        return buffer.find(b"LS", start)

    def read(self, buffer: bytearray, at: int) -> tuple[bytes, int] | int | str:
        if len(buffer) < at + HEADER.size:
            return HEADER.size  # as many bytes are needed to go on
        n_samples = int.from_bytes(buffer[at + HEADER.size - 2 : at + HEADER.size], "little")
        n_bytes = HEADER.size + 4 * n_samples + 4
        if not 0 < n_samples <= MAX_SAMPLES:
            return "header"  # why this is no ping
        if len(buffer) < at + n_bytes:
            return n_bytes
        message = bytes(buffer[at : at + n_bytes])
        return (message, n_bytes) if crc32(message[:-4]).to_bytes(4, "little") == message[-4:] else "checksum"

    def forget(self, n_bytes: int) -> None: ...


class LabDecoder:
    """Decode the bytes of one link; it never raises, whatever comes."""

    def __init__(self) -> None:
        self._framer = StampedFramer(LabGrammar())

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarFrame | SonarReply]:
        return [frame_of(*framed) for framed in self._framer.feed(data, stamp)]

    def finish(self) -> list[SonarFrame | SonarReply]:
        return [frame_of(*framed) for framed in self._framer.finish()]


def frame_of(message: bytes, received: Stamp, n_bytes: int) -> SonarFrame:
    """Turn one message into a frame: the echoes of both sides and when they were received."""
    _, number, time_ms, range_m, n_samples = HEADER.unpack_from(message)
    port, starboard = np.frombuffer(message[HEADER.size : -4], "<u2").reshape(2, n_samples)
    step_m = range_m / n_samples
    traces = [EchoTrace(samples=side, first_range_m=0.5 * step_m, spacing_m=step_m) for side in (port, starboard)]
    return SonarFrame(
        number=number,
        port=traces[0],
        starboard=traces[1],
        transfer="amplitude",  # what the numbers are; None if the protocol does not define it
        received=received,
        n_bytes=n_bytes,  # on the wire: the time that they took is taken off
        device_time_s=1e-3 * time_ms,
    )


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return what makes the sonar ping as configured; raise UsageError for what it cannot do."""
    return (b"RANGE %.1f\n" % settings.range_m,) if settings.enabled else ()


SONAR = SonarDevice(lambda sonar: LabDecoder(), commands, sets_gain=False, counter_period_s=2**32 / 1000.0)


def wire_bytes(ping: Ping) -> bytes:
    """Encode a ping as the sonar sends it."""
    traces = [trace for trace in (ping.port, ping.starboard) if trace is not None]
    n_samples = len(traces[0].samples)
    header = HEADER.pack(
        b"LS", ping.number, round(1e3 * ping.time_s) % 2**32, n_samples * traces[0].spacing_m, n_samples
    )
    message = header + b"".join(np.clip(trace.samples, 0, 65535).astype("<u2").tobytes() for trace in traces)
    return message + crc32(message).to_bytes(4, "little")


def main(log: Path) -> None:
    """Send the pings of a log through the driver, in chunks that cut messages."""
    pings = [event for event in open_log(log, Config()) if isinstance(event, Ping)]
    wire = bytearray(b"".join(wire_bytes(ping) for ping in pings))
    wire[1000::100_000] = bytes(len(wire[1000::100_000]))  # noise on the line
    decoder = SONAR.decoder(SonarConfig())
    n_frames = sum(
        len(decoder.feed(bytes(wire[start : start + 512]), Stamp(0, 0))) for start in range(0, len(wire), 512)
    )
    n_frames += len(decoder.finish())
    print(f"{n_frames} of {len(pings)} pings decoded; counters: {dict(decoder.counters)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
