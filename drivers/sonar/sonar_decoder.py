"""Define what every sonar driver gives and takes: transmissions, answers, settings."""

from __future__ import annotations

from typing import Literal, Protocol, TypeAlias, runtime_checkable

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, EchoTrace, NavSample, Notice
from drivers.framing import Decoder


class SonarFrame(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold one transmission, both sides or one, as the device reported it.

    number: the device's own. transfer: what its samples are, as in SonarConfig, where the protocol defines it; None if
    it does not. sound_speed_mps: that the ranges were made with. altitude_m: NaN if not reported. device_time_s: of the
    transmission, on the device's own counter or, if device_time_is_utc, seconds since 1970; None if the device reports
    no time. received: when the last byte of its first message was read; n_bytes: bytes on the wire from that message's
    first to the end of the chunk read then, which took n_bytes * 10 / baud seconds. navigation: of the vehicle, as the
    message reports it, at device_time_s (time_s is NaN unless UTC).
    """

    number: int
    port: EchoTrace | None
    starboard: EchoTrace | None
    transfer: Literal["amplitude", "intensity"] | None
    received: Stamp
    n_bytes: int
    sound_speed_mps: float = 1500.0
    altitude_m: float = NAN
    device_time_s: float | None = None
    device_time_is_utc: bool = False
    navigation: NavSample | None = None


class SonarReply(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a device's answer to a command. request: the message id it answers. text: its words, for a person.

    utc_s: the device's clock, in answer to a time request, None otherwise.
    """

    request: int
    accepted: bool
    received: Stamp
    n_bytes: int
    text: str = ""
    utc_s: float | None = None


class SonarSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the ping settings.

    range_m: slant range. gain: the device's own index or percentage, None: automatic. sound_speed_mps: for its ranges.

    subsystem: which frequency of an EdgeTech sonar, 20, 21 or 22; None: the high one, 21.
    """

    range_m: float
    enabled: bool = True
    gain: int | None = None
    n_samples: int = 1200
    sound_speed_mps: float = 1500.0
    subsystem: int | None = None


SonarItem: TypeAlias = SonarFrame | SonarReply | Notice
"""What a decoder finds: frames, answers to commands, and what a person should know of the device."""


@runtime_checkable
class SonarDecoder(Decoder[SonarItem], Protocol):
    """Decode bytes of one link of a sonar."""
