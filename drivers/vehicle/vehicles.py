"""List the vehicles' dialects, by their names in the configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from auv_mcm.settings.port_settings import PortConfig
from auv_mcm.settings.vehicle_settings import BluefinSettings, CanSettings, ImcSettings, IverSettings, ReconSettings
from drivers.vehicle.decoders.bluefin_decoder import BluefinDecoder
from drivers.vehicle.decoders.can_decoder import CanDecoder
from drivers.vehicle.decoders.imc_decoder import ImcDecoder
from drivers.vehicle.decoders.iver_decoder import IverDecoder
from drivers.vehicle.decoders.recon_decoder import ReconDecoder
from drivers.vehicle.dialect import Talker, VehicleDecoder
from drivers.vehicle.talkers.bluefin_talker import BluefinTalker
from drivers.vehicle.talkers.can_talker import CanTalker
from drivers.vehicle.talkers.imc_talker import ImcTalker
from drivers.vehicle.talkers.iver_talker import IverTalker
from drivers.vehicle.talkers.recon_talker import ReconTalker

VehicleSettings: TypeAlias = ImcSettings | BluefinSettings | IverSettings | ReconSettings | CanSettings


_N_DRAWN: Final = 0xFFFF  # request ids from 1 on


class VehicleKind(NamedTuple):
    """Describe a dialect. make_decoder: from settings of its own type and the port's name.

    make_talker: from settings and a number drawn for each run, below _N_DRAWN. is_bus: it speaks in frames instead of
    bytes.
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


def vehicle_settings_of(port: PortConfig) -> VehicleSettings:
    """Return the settings of a vehicle's port, its dialect's defaults where it gives none."""
    given: VehicleSettings | None = getattr(port, port.device)  # each section is called like its device
    return VEHICLES[port.device].settings() if given is None else given


def decoder_of(device: str, settings: VehicleSettings, port: str) -> VehicleDecoder[Any]:
    """Make the decoder of a dialect. port: name that its fixes carry."""
    return VEHICLES[device].make_decoder(settings, port)


def talker_of(device: str, settings: VehicleSettings, draw: Callable[[int], int]) -> Talker[Any]:
    """Make the talker of a dialect. draw: a random number below its argument, which nobody can foresee."""
    return VEHICLES[device].make_talker(settings, draw(_N_DRAWN))
