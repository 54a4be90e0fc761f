"""A vehicle's decoder and talker joined, as the intake and the pilot join them."""

from __future__ import annotations

from collections import Counter
from typing import Any

from auv_mcm.clock import Stamp
from drivers.vehicle.dialect import VehicleEvent
from drivers.vehicle.vehicles import VEHICLES, VehicleSettings, decoder_of, talker_of


class Conversation:
    """Calls a talker, and has it hear what the decoder makes of the bytes, or of the frame."""

    def __init__(self, settings: VehicleSettings) -> None:
        device = next(name for name, kind in VEHICLES.items() if kind.settings is type(settings))
        self.decoder = decoder_of(device, settings, "vehicle")
        self.talker = talker_of(device, settings, lambda n: 0)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.talker, name)

    @property
    def counters(self) -> Counter[str]:
        return self.talker.counters + self.decoder.counters

    def hear(self, data: Any, stamp: Stamp) -> list[VehicleEvent]:
        return self.talker.hear(self.decoder.feed(data, stamp), stamp)
