"""Decode RECON frames of a REMUS to records and the vehicle's state."""

from __future__ import annotations

from typing import Any

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import ReconSettings
from drivers.vehicle.decoders.ascii_decoder import AsciiDecoder, state_of
from drivers.vehicle.dialect import ReportedState
from drivers.vehicle.recon_sentences import ReconGrammar, ReconState, table_of
from drivers.vehicle.talkers.recon_talker import ReconTalker


class ReconDecoder(AsciiDecoder):
    """Decode a REMUS's RECON frames."""

    of_payload = ReconTalker.commanding | ReconTalker.harmless

    def __init__(self, settings: ReconSettings, port: str) -> None:
        super().__init__(ReconGrammar(), table_of(settings), port)

    def _state(self, record: Any, received: Stamp) -> ReportedState | None:
        if not isinstance(record, ReconState):
            return None
        return state_of(record, received)
