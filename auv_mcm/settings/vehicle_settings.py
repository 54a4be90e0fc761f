"""Define the `vehicle:` section of the configuration: what the payload may request, and within which bounds."""

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
    """Set what the payload may request. Without `command: true` it reports contacts and health and requests nothing."""

    command: Annotated[bool, Meta(description="request control to view contacts again; needs a fence")] = False
    fence_deg: Annotated[
        tuple[tuple[Latitude, Longitude], ...],
        Meta(description="corners [latitude, longitude] of the area that no command leads out of, in order; degrees"),
    ] = ()
    fence_margin_m: Annotated[
        float, Meta(ge=0.0, le=1000.0, description="commands keep as far inside the fence, m")
    ] = 5.0
    altitude_m: Annotated[float, Meta(gt=0.0, le=200.0, description="altitude that is commanded, m")] = 5.0
    min_altitude_m: Annotated[
        float, Meta(gt=0.0, le=200.0, description="minimum altitude commanded; below it control is returned, m")
    ] = 2.0
    max_depth_m: Annotated[
        float, Meta(gt=0.0, le=6000.0, description="maximum depth commanded; below it control is returned, m")
    ] = 100.0
    speed_mps: Annotated[float, Meta(gt=0.0, le=10.0, description="speed that is commanded, m/s")] = 1.5
    arrival_radius_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="arrival radius: a way-point this near counts as reached, m")
    ] = 3.0
    command_valid_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="a command that the payload has not confirmed for so long is void, s")
    ] = 5.0
    plan_valid_s: Annotated[
        float,
        Meta(gt=0.0, le=7200.0, description="a plan is dropped, and control returned, so long after it was made, s"),
    ] = 900.0
    max_control_s: Annotated[
        float,
        Meta(gt=0.0, le=86400.0, description="maximum uninterrupted control time, after which control is returned, s"),
    ] = 1800.0
    ask_again_s: Annotated[
        float,
        Meta(ge=1.0, le=3600.0),
        Meta(description="minimum time before control that was refused or revoked is requested again, s"),
    ] = 60.0
    state_valid_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="without a position of the vehicle for so long control is returned, s")
    ] = 3.0
    report_min_p_mine: Annotated[
        float, Meta(ge=0.0, le=1.0, description="contacts less likely to be mines are not reported to the vehicle")
    ] = 0.2

    def __post_init__(self) -> None:
        if self.command and len(self.fence_deg) < 3:
            raise ValueError(
                "vehicle: command is true without a fence: give fence_deg at least three corners [latitude, longitude]"
            )
        if self.fence_deg and len(self.fence_deg) < 3:
            raise ValueError("vehicle: fence_deg needs at least three corners [latitude, longitude]")
        if not all(math.isfinite(value) for corner in self.fence_deg for value in corner):
            raise ValueError("vehicle: fence_deg holds a corner that is not a finite number")
        if self.altitude_m < self.min_altitude_m:
            raise ValueError(
                f"vehicle: altitude_m ({self.altitude_m}) must not be below min_altitude_m ({self.min_altitude_m})"
            )
        if self.command_valid_s > self.plan_valid_s:
            raise ValueError(
                f"vehicle: command_valid_s ({self.command_valid_s}) must not exceed plan_valid_s ({self.plan_valid_s})"
            )


class ImcSettings(_Settings, frozen=True, kw_only=True):
    """Set how to address a vehicle that speaks IMC."""

    source_id: Annotated[int, Meta(ge=0x6000, le=0x7FFF, description="our own IMC address, 24576 to 32767")] = 0x6000
    vehicle_id: Annotated[
        int,
        Meta(ge=0, le=0xFFFE),
        Meta(
            description="the vehicle's IMC address; 0: that of the first vehicle heard, until it is silent for 60 s; "
            "where several are heard none is commanded"
        ),
    ] = 0
    own_plan: Annotated[
        bool,
        Meta(
            description="take over by starting a plan of ours, which ends the vehicle's; "
            "false: wait until the vehicle's plan comes to a FollowReference for us, after which it goes on"
        ),
    ] = True
    control_timeout_s: Annotated[
        float,
        Meta(ge=2.0, le=60.0),
        Meta(description="the vehicle takes control back after so long without a reference of ours, s"),
    ] = 5.0
    acknowledges: Annotated[
        bool,
        Meta(
            description="the vehicle supports messages 1700 (contact) and 1701 (its answer); false: contacts go as "
            "Target alone"
        ),
    ] = False


class CanSettings(_Settings, frozen=True, kw_only=True):
    """Set the addresses on a CAN bus whose messages deploy/auv_mcm.dbc describes."""

    payload_address: Annotated[
        int, Meta(ge=0, le=253, description="last byte of the identifiers of what the payload sends")
    ] = 96
    vehicle_address: Annotated[
        int, Meta(ge=0, le=253, description="last byte of the identifiers of what the vehicle's controller sends")
    ] = 32
    nmea2000_addresses: Annotated[
        tuple[Annotated[int, Meta(ge=0, le=251)], ...],
        Meta(
            description="NMEA 2000 units on this bus that report the vehicle's position; empty: its controller reports "
            "it by VEHICLE_STATE"
        ),
    ] = ()

    def __post_init__(self) -> None:
        if self.payload_address == self.vehicle_address:
            raise ValueError(
                f"payload_address and vehicle_address are both {self.payload_address}: give each a number of its own"
            )


class IverSettings(_Settings, frozen=True, kw_only=True):
    """Set up an Iver under Remote Helm."""

    remote_helm_version: Annotated[
        int,
        Meta(ge=1, le=99),
        Meta(description="major version on the vehicle; before 5 it takes depths in feet, from 5 on in metres"),
    ] = 5
    max_pitch_deg: Annotated[
        float, Meta(gt=0.0, le=45.0, description="steepest pitch to dive and climb with, degrees")
    ] = 20.0
    command_timeout_s: Annotated[
        int,
        Meta(ge=1, le=120),
        Meta(description="the vehicle keeps its own plan again so long after a command that no other follows, s"),
    ] = 5
    poll_s: Annotated[float, Meta(ge=0.1, le=2.0, description="period of requests for the vehicle's state, s")] = 0.5
    contact_sentence: Annotated[
        str,
        Meta(pattern="^(P[A-Z0-9]{3,5})?$"),
        Meta(description="name of the sentence for contacts and health; empty: neither is reported"),
    ] = "PMCM"


class ReconSettings(_Settings, frozen=True, kw_only=True):
    """Set up a REMUS by RECON."""

    contact_type: Annotated[
        str,
        Meta(pattern="^[ABDF-PRTUW-Z]?$"),
        Meta(description="type letter of the frame for contacts; empty: contacts are not reported"),
    ] = "K"


BLUEFIN_SENTENCES: Final = (
    "ABT BOY CON CPD CTD DCL DVR EMB GBP GHP KIL LOG MSG NPU RBO RCA RCB RCE RCN RES RGP RMB RMP RNS RTC SAN SEM SIL "
    "SMC SPD STS SUS TMR TOP TRK TRM VEL VER"
)
"""Sentences that payloads may send under Bluefin's standard payload interface, each after `BP`; none of these may name
something else."""


class BluefinSettings(_Settings, frozen=True, kw_only=True):
    """Set up a Bluefin by its standard payload interface."""

    granted_by: Annotated[
        Literal["BFCTL", "BFMIS", "BFMSC"],
        Meta(
            description="what lets the payload command: BFCTL (interface 1.10 and later), a running mission (BFMIS), "
            "or the mission's command to the payload (BFMSC), until the behaviour ends"
        ),
    ] = "BFCTL"
    contact_sentence: Annotated[
        str,
        Meta(
            pattern="^(BP[A-Z]{3})?$", description="name of the sentence for contacts; empty: contacts are not reported"
        ),
    ] = "BPMCM"

    def __post_init__(self) -> None:
        if self.contact_sentence and self.contact_sentence[2:] in BLUEFIN_SENTENCES.split():
            raise ValueError(
                f"contact_sentence: {self.contact_sentence} means something else to the vehicle; take another name, as "
                "BPMCM"
            )
