"""Read the command in a packet of the payload's own, for the guard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal

from auv_mcm.records import NAN
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import Vertical, WireCommand
from drivers.vehicle.imc_codec import decode, number_of
from drivers.vehicle.imc_messages import RefFlag, ZUnits
from drivers.vehicle.imc_wire import ImcGrammar

_REFERENCE: Final = number_of(imc.Reference)
_HARMLESS: Final = frozenset(
    number_of(kind) for kind in (imc.Heartbeat, imc.PlanControl, imc.EntityState, imc.Target, imc.MineContact)
)
_VERTICALS: Final[Mapping[int, Literal["depth", "altitude"]]] = MappingProxyType(
    {ZUnits.DEPTH: "depth", ZUnits.ALTITUDE: "altitude"}
)
_METRES_PER_SECOND: Final = 0  # IMC.xml, SpeedUnits


def command_in(packet: bytes, holds_s: float) -> WireCommand | None:
    """Return the command of a packet, None for one that commands nothing.

    A plan that is started holds one FollowReference, which leads nowhere by itself. What is in units not known here is
    NaN. holds_s: how long the vehicle obeys a reference.
    """
    found = ImcGrammar().read(bytearray(packet), 0)
    if not isinstance(found, tuple) or found[1] != len(packet):
        return WireCommand()
    number, payload, *_, order = found[0]
    if number in _HARMLESS:
        return None
    try:
        message = decode(number, payload, order) if number == _REFERENCE else None
    except ValueError:
        message = None
    if not isinstance(message, imc.Reference):
        return WireCommand()
    return None if message.flags & RefFlag.MANDONE else _numbers(message, holds_s)


def _numbers(reference: imc.Reference, holds_s: float) -> WireCommand:
    speed, z = reference.speed, reference.z
    place_deg = math.degrees(reference.lat), math.degrees(reference.lon)
    return WireCommand(
        place_deg=place_deg if reference.flags & RefFlag.LOCATION else None,
        radius_m=reference.radius if reference.flags & RefFlag.RADIUS else None,
        vertical=None if z is None else Vertical(_VERTICALS.get(z.z_units, "depth"), _known(z.value, z.z_units)),
        speed_mps=None if speed is None else speed.value if speed.speed_units == _METRES_PER_SECOND else NAN,
        holds_s=holds_s,
    )


def _known(value_m: float, units: int) -> float:
    return value_m if units in _VERTICALS else NAN
