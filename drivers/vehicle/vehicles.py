"""The vehicles' dialects there are, by the name a configuration gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from auv_mcm.settings.port_settings import PortConfig
from auv_mcm.settings.vehicle_settings import BluefinSettings, CanSettings, ImcSettings, IverSettings, ReconSettings
from drivers.vehicle.bluefin import BluefinDialect
from drivers.vehicle.can_dialect import CanDialect
from drivers.vehicle.dialect import Dialect
from drivers.vehicle.imc import ImcDialect
from drivers.vehicle.iver import IverDialect
from drivers.vehicle.recon import ReconDialect

VehicleSettings: TypeAlias = ImcSettings | BluefinSettings | IverSettings | ReconSettings | CanSettings


class VehicleKind(NamedTuple):
    """make: a dialect from settings of its own type. is_bus: it speaks in frames instead of bytes."""

    make: Callable[[Any], Dialect[Any]]
    settings: type[VehicleSettings]
    is_bus: bool = False


VEHICLES: Final[Mapping[str, VehicleKind]] = MappingProxyType(
    {
        "imc": VehicleKind(ImcDialect, ImcSettings),
        "bluefin": VehicleKind(BluefinDialect, BluefinSettings),
        "iver": VehicleKind(IverDialect, IverSettings),
        "recon": VehicleKind(ReconDialect, ReconSettings),
        "vehicle_can": VehicleKind(CanDialect, CanSettings, is_bus=True),
    }
)


def settings_of(port: PortConfig) -> VehicleSettings:
    """The settings of a vehicle's port, its dialect's defaults where it gives none."""
    given: VehicleSettings | None = getattr(port, port.device)  # each section is called like its device
    return VEHICLES[port.device].settings() if given is None else given


def dialect_of(device: str, settings: VehicleSettings) -> Dialect[Any]:
    """A dialect with its settings; each call makes one anew."""
    return VEHICLES[device].make(settings)
