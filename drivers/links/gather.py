"""Choose how long bytes may gather in the kernel's buffer: a wake-up costs the same for one byte as for a thousand.

At 921600 baud an adapter that hands on 64 bytes at a time would wake its reader 1440 times a second, at a cost of 50 us
and more each.
"""

from __future__ import annotations

from typing import Final

GATHER_S: Final = 0.002
"""Maximum time of gathering; arrival stamps are late by no more than this."""

PLENTY_BYTES: Final = 1024
"""A read of as many was worth it: the wire is fast, or the reader late, and neither may wait. The kernel holds 4096 of
a serial line."""

_GATHER_BYTES: Final = 256  # no more than come at the line's rate meanwhile
_BITS_PER_BYTE: Final = 10  # 8N1


def gather_s(baud: int) -> float:
    """Return the time of gathering, in seconds, for a serial line of this rate."""
    return min(GATHER_S, _GATHER_BYTES * _BITS_PER_BYTE / baud)
