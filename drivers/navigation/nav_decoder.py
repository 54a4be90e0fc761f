"""Define the fixes that every navigation decoder delivers, whatever the protocol."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.framing import Decoder


class NavFix(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the content of one sentence, burst or message of one unit, with the signs of its wire format.

    NaN: not reported.

    source: the unit, as the configuration names it; units on one bus are SOURCE.ADDRESS. received: when the chunk with
    its last byte, or of a burst with the last byte of its first sentence, was read; n_bytes: bytes on the wire from its
    first byte to the end of that chunk, 0 on a bus. time_utc_s: the unit's own time of the measurement, UTC seconds
    since 1970, if reported; age_s: how old the measurement was when the unit sent it, as reported. valid: False where
    the unit itself flags a value as bad; that value is NaN. estimated: the position is the unit's own dead reckoning.
    is_time_message: the message's purpose is the time, time_utc_s. course_rad: direction of motion over ground,
    clockwise from true north; drift_rad: the same against the bow, positive to starboard. water_speed_mps: through the
    water, where speed_mps is over ground. *_sigma_*: 1-sigma as the unit reports it, position per axis.
    """

    source: str
    received: Stamp
    n_bytes: int = 0
    time_utc_s: float | None = None
    age_s: float = 0.0
    valid: bool = True
    estimated: bool = False
    is_time_message: bool = False
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


@runtime_checkable
class NavDecoder(Decoder[NavFix], Protocol):
    """Decode bytes of one link to fixes."""
