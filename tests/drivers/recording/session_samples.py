"""Make a session's description and traffic of its ports."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from auv_mcm.clock import Stamp
from drivers.recording.session_layout import Direction, PortDescription, Recorded, SessionDescription
from drivers.recording.session_writer import DurableFile, SessionWriter

MONO_NS = 77_000_000_000
UTC_NS = 1_700_000_000_000_000_000


def description() -> SessionDescription:
    return SessionDescription(
        version="0.1.0",
        started=Stamp(MONO_NS, UTC_NS),
        config_yaml="mission: harbour ü\n",
        ports=(
            PortDescription(name="sonar", uri="tcp://10.0.0.2:1234", device="ping_protocol"),
            PortDescription(name="gps", uri="serial:///dev/ttyS0?baud=9600", device="nmea0183"),
        ),
    )


def traffic(seed: int, n_chunks: int, max_bytes: int = 60) -> list[Recorded]:
    """Chunks of both ports both ways, some empty, with a clock of the host that steps an hour back in the middle."""
    rng = np.random.Generator(np.random.PCG64(seed))
    directions: tuple[Direction, Direction] = ("in", "out")
    made = []
    for k in range(n_chunks):
        mono_ns = MONO_NS + k * 10_000_000 + int(rng.integers(1000))
        utc_ns = UTC_NS + (mono_ns - MONO_NS) - (3_600_000_000_000 if k > n_chunks // 2 else 0)
        data = rng.bytes(int(rng.integers(max_bytes + 1)))
        port = ("sonar", "gps")[int(rng.integers(2))]
        made.append(Recorded(port, directions[int(rng.integers(8) == 0)], Stamp(mono_ns, utc_ns), data))
    return made


def write_session(
    folder: Path, chunks: list[Recorded], per_flush: int, *, file_bytes: int = 1 << 30, close: bool = True
) -> SessionWriter:
    """Write a session as the recorder does, made durable after every per_flush chunks."""
    writer = SessionWriter(folder, description(), file_bytes=file_bytes)
    for k, chunk in enumerate(chunks, 1):
        writer.add(chunk)
        if k % per_flush == 0:
            writer.flush()
    if close:
        writer.close()
    return writer


class FullDisk(DurableFile):
    """Fake a file on a disk with room for `room_bytes` more: it takes what fits of a write, and then nothing."""

    room_bytes = 0

    def write_some(self, data: memoryview) -> int:
        n_bytes = super().write_some(data[: max(self.room_bytes - self.tell(), 0)])
        if n_bytes == 0:
            raise OSError(28, "No space left on device")
        return n_bytes
