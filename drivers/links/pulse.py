"""Read a pulse at each full second (PPS), as the kernel stamps it.

Each edge is 8 bytes, big-endian: the monotonic clock at the edge, ns. A pulse at a serial port's DCD line comes by the
same way once `ldattach PPS /dev/ttyS0` has made a device of it; the port goes on to carry bytes.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections import Counter
from collections.abc import Callable
from typing import Final, NamedTuple

from auv_mcm.clock import Clock
from auv_mcm.errors import HardwareError

# linux/pps.h: struct pps_fdata, which is two sequence numbers, the times of both edges, the mode, and how long to wait:
# not at all.
_FDATA: Final = struct.Struct("=II qiI qiI i4x qiI")
_FETCH: Final = 3 << 30 | struct.calcsize("P") << 16 | ord("p") << 8 | 0xA4
_NS: Final = 1_000_000_000
_EDGE_BYTES: Final = 8


class KernelEdge(NamedTuple):
    """Hold the newest pulse. sequence: counts pulses; utc_ns: the kernel's own UTC at its edge, since 1970."""

    sequence: int
    utc_ns: int


def pack_edge(mono_ns: int) -> bytes:
    """Pack an edge as a session records it."""
    return mono_ns.to_bytes(_EDGE_BYTES, "big")


def unpack_edge(data: bytes) -> int | None:
    """Unpack an edge that `pack_edge` packed; return None for other bytes."""
    return int.from_bytes(data, "big") if len(data) == _EDGE_BYTES else None


class PulsePort:
    """Carry edges, read only.

    The kernel stamps them in UTC: an edge is rejected if the clock was set since, as its age shows.

    counters: pps.edges, pps.refused.age.
    """

    def __init__(
        self,
        fetch: Callable[[], KernelEdge],
        close: Callable[[], None],
        place: str,
        clock: Clock,
        counters: Counter[str],
    ) -> None:
        """fetch: the newest edge; raises OSError."""
        self.note = ""
        self.has_unsent = False
        self.pause_s = 0.0
        self.close = close
        self._fetch = fetch
        self._place = place
        self._clock = clock
        self._counters = counters
        self._sequence: int | None = None

    def fileno(self) -> int:
        """Return -1: not all kernels can wait for a pulse."""
        return -1

    def read(self) -> list[bytes]:
        try:
            edge = self._fetch()
        except OSError as error:
            raise HardwareError(
                f"{self._place}: the pulse failed ({error.strerror}). It is opened again as soon as it is back."
            ) from error
        age_ns = round(self._clock.utc_s() * 1e9) - edge.utc_ns
        mono_ns = round(self._clock.monotonic_s() * 1e9)
        if edge.sequence == self._sequence or edge.sequence == 0:
            return []
        is_first, self._sequence = self._sequence is None, edge.sequence
        if not 0 <= age_ns < _NS:
            if not is_first:
                self._counters["pps.refused.age"] += 1
            return []
        self._counters["pps.edges"] += 1
        return [pack_edge(mono_ns - age_ns)]

    def write(self, item: bytes) -> bool:
        return False

    def flush(self) -> None:
        pass

    def on_silence(self) -> str:
        return "Check that the unit has a fix and gives pulses, their wire, and with a serial port that ldattach runs."


async def open_pulse(path: str, place: str, clock: Clock, counters: Counter[str]) -> PulsePort:
    """Open a pulse's device. Raises HardwareError that says what to do."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise HardwareError(_refusal(path, error)) from error
    port = PulsePort(lambda: _fetched(descriptor), lambda: os.close(descriptor), place, clock, counters)
    try:
        _fetched(descriptor)
    except OSError as error:
        port.close()
        raise HardwareError(
            f"{path}: not a source of pulses ({error.strerror}). Name one: ls /sys/class/pps shows what is there."
        ) from error
    return port


def _fetched(descriptor: int) -> KernelEdge:
    fetched = _FDATA.unpack(fcntl.ioctl(descriptor, _FETCH, bytes(_FDATA.size)))
    return KernelEdge(sequence=fetched[0], utc_ns=fetched[2] * _NS + fetched[3])


def _refusal(path: str, error: OSError) -> str:
    match error.errno:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            return (
                f"{path}: no such device. ls /sys/class/pps shows what is there; ldattach PPS /dev/ttyS0 makes one of "
                "a serial port."
            )
        case errno.EACCES | errno.EPERM:
            return (
                f"{path}: permission denied. Let the user of this service open it, e.g. by a udev rule for the "
                "subsystem pps."
            )
    return (
        f"{path}: cannot be opened ({error.strerror}). Name a source of pulses: ls /sys/class/pps shows what is there."
    )
