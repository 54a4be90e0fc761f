"""List the vehicles' dialects, by their names in the configuration.

Other packages add dialects through entry points of the group `auv_mcm.vehicle`, each naming a `VehicleKind`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

import msgspec

from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import Plugin, load_plugin, remedy
from auv_mcm.settings.port_settings import PortConfig
from auv_mcm.settings.strict_yaml import explain_validation_error
from auv_mcm.settings.vehicle_settings import (
    VEHICLE_NAMES,
    BluefinSettings,
    CanSettings,
    ImcSettings,
    IverSettings,
    ReconSettings,
)
from drivers.plugin_device import checked, checked_decoder, device_plugin
from drivers.vehicle.decoders.bluefin_decoder import BluefinDecoder
from drivers.vehicle.decoders.can_decoder import CanDecoder
from drivers.vehicle.decoders.imc_decoder import ImcDecoder
from drivers.vehicle.decoders.iver_decoder import IverDecoder
from drivers.vehicle.decoders.recon_decoder import ReconDecoder
from drivers.vehicle.dialect import Talker, VehicleDecoder, VehicleMessage
from drivers.vehicle.talkers.bluefin_talker import BluefinTalker
from drivers.vehicle.talkers.can_talker import CanTalker
from drivers.vehicle.talkers.imc_talker import ImcTalker
from drivers.vehicle.talkers.iver_talker import IverTalker
from drivers.vehicle.talkers.recon_talker import ReconTalker

VehicleSettings: TypeAlias = msgspec.Struct  # each dialect has a type of its own

_N_DRAWN: Final = 0xFFFF  # request ids from 1 on


class VehicleKind(NamedTuple):
    """Describe a dialect.

    make_decoder: from settings of its own type and the port's name, which fixes carry as `source`. make_talker: from
    settings and a number drawn for each run, 0 to 65534. settings: a msgspec.Struct with forbid_unknown_fields=True and
    a default for every field that has one; of another package's dialect it is read from the port's section `options`.
    is_bus: it speaks in CAN frames instead of bytes.
    """

    make_decoder: Callable[[Any, str], VehicleDecoder[Any]]
    make_talker: Callable[[Any, int], Talker[Any]]
    settings: type[VehicleSettings]
    is_bus: bool = False


VEHICLES: Final[Mapping[str, VehicleKind]] = MappingProxyType(
    {
        "imc": VehicleKind(ImcDecoder, lambda settings, drawn: ImcTalker(settings, drawn + 1), ImcSettings),
        "bluefin": VehicleKind(BluefinDecoder, lambda settings, drawn: BluefinTalker(settings), BluefinSettings),
        "iver": VehicleKind(IverDecoder, lambda settings, drawn: IverTalker(settings), IverSettings),
        "recon": VehicleKind(ReconDecoder, lambda settings, drawn: ReconTalker(settings), ReconSettings),
        "vehicle_can": VehicleKind(CanDecoder, lambda settings, drawn: CanTalker(settings), CanSettings, is_bus=True),
    }
)


def vehicle_named(name: str) -> VehicleKind:
    """Return a dialect, built in or of another package.

    Raises UsageError for an unknown name, and for a dialect of another package that cannot be loaded.
    """
    if name in VEHICLES:
        return VEHICLES[name]
    return vehicle_of(device_plugin("vehicle", name, ", ".join(VEHICLES)))


def vehicle_of(plugin: Plugin) -> VehicleKind:
    """Import the dialect of another package. Raises UsageError if it cannot be used."""
    kind = load_plugin(plugin, VehicleKind)
    if not (isinstance(kind.settings, type) and issubclass(kind.settings, msgspec.Struct)):
        raise UsageError(f"{plugin}: its settings are not a class of msgspec.Struct. {remedy(plugin)}")
    if not kind.settings.__struct_config__.forbid_unknown_fields:
        raise UsageError(
            f"{plugin}: its settings lack forbid_unknown_fields=True, so that no mistake in them would show. "
            f"{remedy(plugin)}"
        )
    return kind._replace(
        make_decoder=checked_decoder(plugin, kind.make_decoder, VehicleDecoder, VehicleMessage),
        make_talker=checked(plugin, kind.make_talker, Talker),
    )


def vehicle_settings_of(port: PortConfig, key: str) -> VehicleSettings:
    """Return the settings of a vehicle's port, its dialect's defaults where it gives none.

    key: path of the port in the configuration, for messages. Raises UsageError for options that its dialect does not
    have.
    """
    kind = vehicle_named(port.device)
    if port.device in VEHICLE_NAMES:
        given: VehicleSettings | None = getattr(port, port.device)  # each section is called like its device
        return kind.settings() if given is None else given
    try:
        return msgspec.convert(port.options or {}, kind.settings)
    except msgspec.ValidationError as error:
        raise UsageError(f"{key}.options: {explain_validation_error(error, kind.settings)}") from error


def decoder_of(device: str, settings: VehicleSettings, port: str) -> VehicleDecoder[Any]:
    """Make the decoder of a dialect. port: name that its fixes carry. Raises UsageError, see `vehicle_named`."""
    return vehicle_named(device).make_decoder(settings, port)


def talker_of(
    device: str, settings: VehicleSettings, draw: Callable[[int], int], *, may_command: bool = True
) -> Talker[Any]:
    """Make the talker of a dialect.

    Parameters
    ----------
    draw
        A random number below its argument, which nobody can foresee.
    may_command
        If not, control that was not requested is another payload's, not of a run before, and left alone.

    Raises UsageError, see `vehicle_named`.
    """
    talker = vehicle_named(device).make_talker(settings, draw(_N_DRAWN))
    if isinstance(talker, ImcTalker | ReconTalker):
        talker.ends_what_is_left = may_command
    return talker
