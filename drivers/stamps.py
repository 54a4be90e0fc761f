"""When bytes were read, on both clocks of this computer."""

from __future__ import annotations

from typing import NamedTuple


class Stamp(NamedTuple):
    """When the last byte of a chunk was read. mono_ns: monotonic clock; utc_ns: since 1970, as this computer had it then."""

    mono_ns: int
    utc_ns: int
