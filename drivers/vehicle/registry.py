"""The vehicles' dialects there are, by the name a configuration gives."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from auv_mcm import vehicle_config
from auv_mcm.port_config import PortConfig
from drivers.vehicle.seam import Dialect

BUS_DIALECTS: Final[frozenset[str]] = frozenset({"vehicle_can"})  # frames instead of bytes
DIALECTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "imc": "drivers.vehicle.imc:ImcDialect",
        "bluefin": "drivers.vehicle.bluefin:BluefinDialect",
        "iver": "drivers.vehicle.iver:IverDialect",
        "recon": "drivers.vehicle.recon:ReconDialect",
        "vehicle_can": "drivers.vehicle.can_dialect:CanDialect",
    }
)
_SETTINGS: Final[Mapping[str, str]] = {"imc": "Imc", "bluefin": "Bluefin", "iver": "Iver", "recon": "Recon", "vehicle_can": "Can"}


def settings_of(port: PortConfig) -> Any:
    """The settings of a vehicle's port, its dialect's defaults where it gives none."""
    given = getattr(port, port.device, None)
    made = getattr(vehicle_config, f"{_SETTINGS[port.device]}Settings", dict)
    return made() if given is None else given


def dialect_of(name: str, settings: Any) -> Dialect[Any]:
    """A dialect with its settings; each call makes one anew."""
    module, _, dialect = DIALECTS[name].partition(":")
    made: Dialect[Any] = getattr(importlib.import_module(module), dialect)(settings)
    return made
