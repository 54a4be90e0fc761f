"""Decode the ACME inertial unit: a line of text for each pose.

`INS latitude longitude heading pitch roll depth altitude speed crc`, in degrees, m and m/s; the CRC-32 of all before
its blank is in eight hexadecimal digits.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Final
from zlib import crc32

from auv_mcm.clock import Stamp
from drivers.navigation.nav_decoder import NavFix

_MAX_LINE_BYTES: Final = 256  # of an unfinished line that is kept: bounds memory
_WORD: Final = b"INS"
_N_VALUES: Final = 8  # of a line, between its word and its checksum


def line_of(*values: float) -> bytes:
    """Write a line as the unit sends it."""
    body = b" ".join([_WORD, *(f"{value:.9g}".encode("ascii") for value in values)])
    return b"%b %08X\n" % (body, crc32(body))


class AcmeIns:
    """Decode the lines of one unit. source: its name, which every fix carries."""

    def __init__(self, source: str) -> None:
        self.counters: Counter[str] = Counter()
        self._source = source
        self._rest = b""

    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return the fixes that a chunk completes."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-_MAX_LINE_BYTES:]
        n_behind = len(rest)  # bytes that were read after a line's end
        fixes = []
        for line in reversed(lines):
            n_behind += len(line) + 1
            if (fix := self._fix(line, stamp, n_behind)) is not None:
                fixes.append(fix)
        return fixes[::-1]

    def finish(self) -> list[NavFix]:
        """Return nothing: a line without its end is not whole."""
        return []

    def _fix(self, line: bytes, stamp: Stamp, n_bytes: int) -> NavFix | None:
        body, _, checksum = line.rpartition(b" ")
        word, *texts = body.split(b" ")
        if checksum != b"%08X" % crc32(body) or word != _WORD or len(texts) != _N_VALUES:
            self.counters["acme_ins.refused.damaged"] += 1
            return None
        self.counters["acme_ins.messages"] += 1
        latitude, longitude, heading, pitch, roll, depth, altitude, speed = map(float, texts)
        return NavFix(
            source=self._source,
            received=stamp,
            n_bytes=n_bytes,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=math.radians(heading),
            pitch_rad=math.radians(pitch),
            roll_rad=math.radians(roll),
            depth_m=depth,
            altitude_m=altitude,
            speed_mps=speed,
        )


NAVIGATION: Final = AcmeIns
