"""Keep the chain's memory from growing by what was freed: planes of a tile come and go by the hundred megabytes."""

from __future__ import annotations

import ctypes
from typing import Final

# Options of mallopt, by glibc's malloc.h.
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_LARGE_BYTES: Final = 8 << 20
"""Arrays of this size go back to the system when they are freed: 199 MB at the peak on the named scene `deep` instead
of 202 to 204 MB with 32 MB here, at no processor time that could be measured."""
_KEPT_BYTES: Final = 48 << 20
"""Free memory at the heap's end that is kept, about what the planes of a tile take. With less the same memory is asked
for again and again: with 12 MB there are 2.5 times the page faults on the named scenes `flat` and `deep`, and about a
tenth more processor time on `deep`, whose peak is 191 MB with 48 MB and 186 MB with 12 MB."""


def return_large_arrays() -> None:
    """Give the memory of large arrays back to the system as soon as they are freed, where the C library can.

    Otherwise glibc moves the limit up to 32 MB and leaves holes between the planes of a tile.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(_M_MMAP_THRESHOLD, _LARGE_BYTES)
        set_option(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def return_freed_memory() -> None:
    """Give freed memory in the middle of the heap back to the system, where the C library can.

    Costs some 20 ms for the 30 MB that lie free between the tiles of a mission, most of it page faults that follow.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
