"""The `vehicle:` section of the configuration: what the payload may ask of the vehicle, and within which bounds."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta

VehicleName: TypeAlias = Literal["imc", "bluefin", "iver", "recon", "vehicle_can"]
VEHICLE_NAMES: Final[tuple[VehicleName, ...]] = get_args(VehicleName)
Latitude: TypeAlias = Annotated[float, Meta(ge=-90.0, le=90.0)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180.0, le=180.0)]


class _Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    pass


class VehicleConfig(_Settings, frozen=True, kw_only=True):
    """What the payload may ask of the vehicle. Without `command: true` it tells contacts and health and asks for nothing."""

    command: Annotated[bool, Meta(description="ask for control to look again at contacts; needs a fence")] = False
    fence_deg: Annotated[
        tuple[tuple[Latitude, Longitude], ...],
        Meta(description="corners [latitude, longitude] of the area that no command leads out of, in order; degrees"),
    ] = ()
    fence_margin_m: Annotated[float, Meta(ge=0.0, le=1000.0, description="commands keep as far inside the fence, m")] = 5.0
    altitude_m: Annotated[float, Meta(gt=0.0, le=200.0, description="altitude that is commanded, m")] = 5.0
    min_altitude_m: Annotated[float, Meta(gt=0.0, le=200.0, description="nothing lower is commanded, and no control is kept below, m")] = (
        2.0
    )
    max_depth_m: Annotated[float, Meta(gt=0.0, le=6000.0, description="nothing deeper is commanded, and no control is kept below, m")] = (
        100.0
    )
    speed_mps: Annotated[float, Meta(gt=0.0, le=10.0, description="speed that is commanded, m/s")] = 1.5
    arrival_radius_m: Annotated[float, Meta(gt=0.0, le=100.0, description="as near to a way-point counts as there, m")] = 3.0
    command_valid_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="a command that the payload has not confirmed for so long is void, s")
    ] = 5.0
    plan_valid_s: Annotated[
        float, Meta(gt=0.0, le=7200.0, description="a plan is dropped, and control returned, so long after it was made, s")
    ] = 900.0
    max_control_s: Annotated[float, Meta(gt=0.0, le=86400.0, description="control is returned after so long in one piece, s")] = 1800.0
    ask_again_s: Annotated[
        float, Meta(ge=1.0, le=3600.0, description="control that was refused or taken back is asked for again not sooner, s")
    ] = 60.0
    state_valid_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="without a position of the vehicle for so long control is returned, s")
    ] = 3.0
    report_min_p_mine: Annotated[
        float, Meta(ge=0.0, le=1.0, description="contacts less likely to be mines are not told to the vehicle")
    ] = 0.2

    def __post_init__(self) -> None:
        if self.command and len(self.fence_deg) < 3:
            raise ValueError("vehicle: command is true without a fence: give fence_deg at least three corners [latitude, longitude]")
        if self.fence_deg and len(self.fence_deg) < 3:
            raise ValueError("vehicle: fence_deg needs at least three corners [latitude, longitude]")
        if not all(math.isfinite(value) for corner in self.fence_deg for value in corner):
            raise ValueError("vehicle: fence_deg holds a corner that is no number")
        if self.altitude_m < self.min_altitude_m:
            raise ValueError(f"vehicle: altitude_m ({self.altitude_m}) must not be below min_altitude_m ({self.min_altitude_m})")
        if self.command_valid_s > self.plan_valid_s:
            raise ValueError(f"vehicle: command_valid_s ({self.command_valid_s}) must not exceed plan_valid_s ({self.plan_valid_s})")
