"""What every navigation unit is turned into, whatever it speaks."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN


class NavFix(msgspec.Struct, frozen=True, kw_only=True):
    """What one sentence, burst or message of one unit told, with the signs of its wire format. Whatever it did not tell is NaN.

    source: the unit, as the configuration names it; units on one bus are SOURCE.ADDRESS. received: when the chunk with its last byte, or
    of a burst with the last byte of its first sentence, was read; n_bytes: bytes on the wire from its first byte to the end of that chunk,
    0 on a bus. time_utc_s: the unit's own time of the measurement, UTC seconds since 1970, if it told; age_s: how old the measurement was
    when the unit sent it, as it told. valid: False where the unit itself says that something is not good; that is NaN then. estimated:
    the position is the unit's own dead reckoning. tells_utc: the message is there to tell the time, which time_utc_s is.
    course_rad: direction of motion over ground, clockwise from true north; drift_rad: the same against the bow, positive to starboard.
    water_speed_mps: through the water, where speed_mps is over ground.
    *_sigma_*: 1-sigma as the unit told, position per axis.
    """

    source: str
    received: Stamp
    n_bytes: int = 0
    time_utc_s: float | None = None
    age_s: float = 0.0
    valid: bool = True
    estimated: bool = False
    tells_utc: bool = False
    latitude_deg: float = NAN
    longitude_deg: float = NAN
    heading_rad: float = NAN
    pitch_rad: float = NAN
    roll_rad: float = NAN
    depth_m: float = NAN
    altitude_m: float = NAN
    speed_mps: float = NAN
    course_rad: float = NAN
    drift_rad: float = NAN
    water_speed_mps: float = NAN
    position_sigma_m: float = NAN
    heading_sigma_rad: float = NAN
    attitude_sigma_rad: float = NAN
    depth_sigma_m: float = NAN
    speed_sigma_mps: float = NAN


class NavDecoder(Protocol):
    """Bytes of one link to fixes. Never raises, whatever the bytes; `counters` tell what was refused, by dotted name."""

    @property
    def counters(self) -> Counter[str]: ...

    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]:
        """What a chunk completes, in order. stamp: when its last byte was read."""
        ...

    def finish(self) -> list[NavFix]:
        """What waits for more, at the end of a log or link."""
        ...
