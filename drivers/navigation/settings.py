"""How each navigation unit is mounted, what it may deliver, and which one wins."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from auv_mcm.config import ArmLength
from drivers.navigation.seam import QUANTITIES, Quantity

Sign: TypeAlias = Literal[1, -1]
Offset: TypeAlias = Annotated[float, Meta(ge=-180.0, le=180.0)]


class NavUnitSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One unit. Signs come first, then offsets: measured on the vehicle = sign * told + offset."""

    priority: Annotated[int, Meta(ge=0, le=99, description="of the units that deliver a quantity the lowest healthy one serves")] = 1
    delivers: Annotated[tuple[Quantity, ...], Meta(description="quantities that are taken from this unit")] = QUANTITIES
    heading_sign: Sign = 1
    pitch_sign: Annotated[Sign, Meta(description="-1 for a unit whose pitch is positive bow down")] = 1
    roll_sign: Annotated[Sign, Meta(description="-1 for a unit whose roll is positive port down")] = 1
    heading_offset_deg: Annotated[Offset, Meta(description="mounting angle against the vehicle's bow, clockwise, degrees")] = 0.0
    pitch_offset_deg: Offset = 0.0
    roll_offset_deg: Offset = 0.0
    lever_arm_m: Annotated[
        tuple[ArmLength, ArmLength, ArmLength],
        Meta(description="antenna or head from the vehicle's navigation reference: forward, starboard, down, m"),
    ] = (0.0, 0.0, 0.0)
    latency_s: Annotated[float, Meta(ge=0.0, le=5.0, description="from the measurement to the first byte on the wire, s")] = 0.0
    baud: Annotated[
        Annotated[int, Meta(ge=300, le=4_000_000)] | None,
        Meta(description="of its serial line, to take off the time on the wire; empty on networks and buses"),
    ] = None
    use_unit_time: Annotated[
        bool, Meta(description="take the times between measurements from the unit's own clock, which is free of the link's delays")
    ] = False
    surface_only: Annotated[bool, Meta(description="a satellite receiver: its positions are refused under water")] = False
    position_sigma_m: Annotated[float, Meta(ge=0.0, le=1000.0, description="1-sigma per axis where the unit tells none, m")] = 3.0
    heading_sigma_deg: Annotated[float, Meta(ge=0.0, le=45.0, description="1-sigma where the unit tells none, degrees")] = 1.0
    speed_sigma_mps: Annotated[float, Meta(ge=0.0, le=5.0, description="1-sigma where the unit tells none, m/s")] = 0.05
    valid_s: Annotated[float, Meta(gt=0.0, le=60.0, description="without a new value for longer than this a quantity is lost, s")] = 1.5


class NavMergeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All units, by the names that their fixes carry; the units of one bus share the settings of the bus unless they have their own."""

    units: dict[str, NavUnitSettings]
    max_speed_mps: Annotated[float, Meta(gt=0.0, le=30.0, description="no fix is believed that needs more than this, m/s")] = 6.0
    recover_s: Annotated[float, Meta(ge=0.0, le=600.0, description="a better unit serves again after being healthy this long, s")] = 5.0
    surface_depth_m: Annotated[float, Meta(gt=0.0, le=20.0, description="deeper than this no satellite receiver is believed, m")] = 1.0

    def unit(self, source: str) -> NavUnitSettings | None:
        """Settings of a source: its own, else its bus's, which is named before the dot."""
        return self.units.get(source) or self.units.get(source.partition(".")[0])
