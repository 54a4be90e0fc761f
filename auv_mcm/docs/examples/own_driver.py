"""Write a driver for a sonar of your own, and try it on bytes before there is hardware.

    python own_driver.py LOG

The sonar is made up: a ping is `LS`, its number (u32), range in m (f32), samples per side (u16), amplitudes of port and
starboard, near to far (u16 each), and a CRC-32, all little-endian. The pings of LOG go through the driver in small
pieces, with bytes damaged on the way. In a package, one line of pyproject.toml makes `device: lab_sonar` name it:

    [project.entry-points."auv_mcm.sonar"]
    lab_sonar = "my_package.own_driver:SONAR"
"""

import struct
import sys
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

HEADER = struct.Struct("<2sIfH")
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
        n_samples: int = HEADER.unpack_from(buffer, at)[-1]
        n_bytes = HEADER.size + 4 * n_samples + 4
        if not 0 < n_samples <= MAX_SAMPLES:
            return "header"  # why this is not a ping
        message = bytes(buffer[at : at + n_bytes])
        if len(message) < n_bytes:
            return n_bytes
        return (message, n_bytes) if crc32(message[:-4]).to_bytes(4, "little") == message[-4:] else "checksum"

    def forget(self, n_bytes: int) -> None: ...


class LabDecoder:
    """Decode the bytes of one link; it never raises, whatever comes."""

    def __init__(self) -> None:
        self._framer = StampedFramer(LabGrammar())
        self.counters = self._framer.counters

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarFrame | SonarReply]:
        return [frame_of(*framed) for framed in self._framer.feed(data, stamp)]

    def finish(self) -> list[SonarFrame | SonarReply]:
        return [frame_of(*framed) for framed in self._framer.finish()]


def frame_of(message: bytes, received: Stamp, n_bytes: int) -> SonarFrame:
    """Turn a message into a frame. n_bytes: on the wire, whose time is taken off."""
    _, number, range_m, n_samples = HEADER.unpack_from(message)
    step_m = range_m / n_samples
    sides = np.frombuffer(message[HEADER.size : -4], "<u2").reshape(2, n_samples)
    port, starboard = (EchoTrace(samples=side, first_range_m=0.5 * step_m, spacing_m=step_m) for side in sides)
    return SonarFrame(
        number=number, port=port, starboard=starboard, transfer="amplitude", received=received, n_bytes=n_bytes
    )


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return what makes the sonar ping as configured; raise UsageError for what it cannot do."""
    return (b"RANGE %.1f\n" % settings.range_m,) if settings.enabled else ()


def encode(ping: Ping) -> bytes:
    """Write a ping as the sonar sends it, for tests."""
    sides = [trace for trace in (ping.port, ping.starboard) if trace is not None]
    n_samples = len(sides[0].samples)
    message = HEADER.pack(b"LS", ping.number, n_samples * sides[0].spacing_m, n_samples)
    message += b"".join(np.clip(side.samples, 0, 65535).astype("<u2").tobytes() for side in sides)
    return message + crc32(message).to_bytes(4, "little")


SONAR = SonarDevice(lambda sonar: LabDecoder(), commands, sets_gain=False)


def main(log: Path) -> None:
    """Send the pings of a log through the driver, in chunks that cut messages."""
    pings = [event for event in open_log(log, Config()) if isinstance(event, Ping)]
    wire = bytearray(b"".join(map(encode, pings)))
    wire[1000::100_000] = bytes(len(wire[1000::100_000]))  # noise on the line
    decoder = SONAR.decoder(SonarConfig())
    chunks = (bytes(wire[start : start + 512]) for start in range(0, len(wire), 512))
    n_frames = sum(len(decoder.feed(chunk, Stamp(0, 0))) for chunk in chunks) + len(decoder.finish())
    print(f"{n_frames} of {len(pings)} pings decoded; counters: {dict(decoder.counters)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
