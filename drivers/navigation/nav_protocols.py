"""List the navigation protocols with a decoder, by their names in the configuration.

Other packages add protocols on serial, TCP and UDP links through entry points of the group `auv_mcm.navigation`, each
naming a callable that makes a `NavDecoder`; its argument is the unit's name, which every fix carries as `source`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import Plugin, import_plugin, remedy
from drivers.navigation.dvl_pd6 import Pd6Unit
from drivers.navigation.nav_decoder import NavDecoder, NavFix
from drivers.navigation.nmea_unit import NmeaUnit
from drivers.navigation.water_linked_unit import WaterLinkedUnit
from drivers.plugin_device import checked_decoder, device_plugin

CAN_PROTOCOL: Final = "nmea2000"  # frames instead of bytes: `n2k_bus.N2kBus`
TEXT_PROTOCOLS: Final[Mapping[str, Callable[[str], NavDecoder]]] = MappingProxyType(
    {"nmea0183": NmeaUnit, "pd6": Pd6Unit, "water_linked": WaterLinkedUnit}
)


def text_decoder(protocol: str, source: str) -> NavDecoder:
    """Make a decoder for one link, built in or of another package. source: the unit's name.

    Raises UsageError for an unknown protocol, and for a decoder of another package that cannot be made.
    """
    if protocol in TEXT_PROTOCOLS:
        return TEXT_PROTOCOLS[protocol](source)
    return nav_maker_of(device_plugin("navigation", protocol, ", ".join((*TEXT_PROTOCOLS, CAN_PROTOCOL))))(source)


def nav_maker_of(plugin: Plugin) -> Callable[[str], NavDecoder]:
    """Import what makes the decoders of another package's protocol, given the unit's name.

    Raises UsageError if it cannot be used.
    """
    make = import_plugin(plugin)
    if not callable(make):
        raise UsageError(
            f"{plugin}: {plugin.target} is of type {type(make).__name__}, and does not make decoders. {remedy(plugin)}"
        )
    return checked_decoder(plugin, make, NavDecoder, NavFix)
