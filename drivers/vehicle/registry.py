"""The vehicles' dialects there are, by the name a configuration gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from auv_mcm.port_config import PortConfig
from auv_mcm.vehicle_config import BluefinSettings, CanSettings, ImcSettings, IverSettings, ReconSettings
from drivers.vehicle.decoders.bluefin import BluefinDecoder
from drivers.vehicle.decoders.can import CanDecoder
from drivers.vehicle.decoders.imc import ImcDecoder
from drivers.vehicle.decoders.iver import IverDecoder
from drivers.vehicle.decoders.recon import ReconDecoder
from drivers.vehicle.seam import Talker, VehicleDecoder
from drivers.vehicle.talkers.bluefin import BluefinTalker
from drivers.vehicle.talkers.can import CanTalker
from drivers.vehicle.talkers.imc import ImcTalker
from drivers.vehicle.talkers.iver import IverTalker
from drivers.vehicle.talkers.recon import ReconTalker

VehicleSettings: TypeAlias = ImcSettings | BluefinSettings | IverSettings | ReconSettings | CanSettings


class VehicleKind(NamedTuple):
    """make_decoder, make_talker: from settings of its own type. is_bus: it speaks in frames instead of bytes."""

    make_decoder: Callable[[Any, str], VehicleDecoder[Any]]
    make_talker: Callable[[Any], Talker[Any]]
    settings: type[VehicleSettings]
    is_bus: bool = False


VEHICLES: Final[Mapping[str, VehicleKind]] = MappingProxyType(
    {
        "imc": VehicleKind(ImcDecoder, ImcTalker, ImcSettings),
        "bluefin": VehicleKind(BluefinDecoder, BluefinTalker, BluefinSettings),
        "iver": VehicleKind(IverDecoder, IverTalker, IverSettings),
        "recon": VehicleKind(ReconDecoder, ReconTalker, ReconSettings),
        "vehicle_can": VehicleKind(CanDecoder, CanTalker, CanSettings, is_bus=True),
    }
)


def settings_of(port: PortConfig) -> VehicleSettings:
    """The settings of a vehicle's port, its dialect's defaults where it gives none."""
    given: VehicleSettings | None = getattr(port, port.device)  # each section is called like its device
    return VEHICLES[port.device].settings() if given is None else given


def decoder_of(device: str, settings: VehicleSettings, port: str) -> VehicleDecoder[Any]:
    """Make the decoder of a dialect. port: name that its fixes carry."""
    return VEHICLES[device].make_decoder(settings, port)


def talker_of(device: str, settings: VehicleSettings) -> Talker[Any]:
    """Make the talker of a dialect."""
    return VEHICLES[device].make_talker(settings)
