"""List the navigation protocols with a decoder, by their names in the configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from auv_mcm.errors import UsageError
from drivers.navigation.dvl_pd6 import Pd6Unit
from drivers.navigation.dvl_water_linked import WaterLinkedUnit
from drivers.navigation.nav_decoder import NavDecoder
from drivers.navigation.nmea_unit import NmeaUnit

CAN_PROTOCOL: Final = "nmea2000"  # frames instead of bytes: `n2k_bus.N2kBus`
TEXT_PROTOCOLS: Final[Mapping[str, Callable[[str], NavDecoder]]] = MappingProxyType(
    {"nmea0183": NmeaUnit, "pd6": Pd6Unit, "water_linked": WaterLinkedUnit}
)


def text_decoder(protocol: str, source: str) -> NavDecoder:
    """Make a decoder for one link; source: the unit's name. Raises UsageError for an unknown protocol."""
    if protocol not in TEXT_PROTOCOLS:
        raise UsageError(f"unknown navigation protocol '{protocol}'. Known: {', '.join((*TEXT_PROTOCOLS, CAN_PROTOCOL))}")
    return TEXT_PROTOCOLS[protocol](source)
