"""Decode sentences of a Bluefin's vehicle computer to records and the vehicle's state."""

from __future__ import annotations

import math
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import BluefinSettings
from drivers.vehicle.bluefin_sentences import BluefinGrammar, BluefinPosition, BluefinVelocity, table_of
from drivers.vehicle.decoders.ascii_decoder import AsciiDecoder, state_of
from drivers.vehicle.dialect import ReportedState
from drivers.vehicle.talkers.bluefin_talker import BluefinTalker

_VELOCITY_VALID_NS: Final = 2_000_000_000  # velocities come about once a second, in sentences of their own


class BluefinDecoder(AsciiDecoder):
    """Decode a Bluefin's sentences."""

    of_payload = BluefinTalker.commanding | BluefinTalker.harmless

    def __init__(self, settings: BluefinSettings, port: str) -> None:
        super().__init__(BluefinGrammar(), table_of(settings), port)
        self._velocity: tuple[BluefinVelocity, int] | None = None

    def _state(self, record: Any, received: Stamp) -> ReportedState | None:
        if isinstance(record, BluefinVelocity):
            self._velocity = record, received.mono_ns
        if not isinstance(record, BluefinPosition):
            return None
        speed_mps = NAN
        if self._velocity is not None and received.mono_ns - self._velocity[1] < _VELOCITY_VALID_NS:
            speed_mps = math.hypot(self._velocity[0].east_mps, self._velocity[0].north_mps)
        return state_of(record, received, speed_mps=speed_mps)
