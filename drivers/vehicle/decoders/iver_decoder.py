"""Decode sentences of an Iver under Remote Helm to records and the vehicle's state."""

from __future__ import annotations

from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import IverSettings
from drivers.vehicle.decoders.ascii_decoder import AsciiDecoder, state_of
from drivers.vehicle.dialect import ReportedState
from drivers.vehicle.iver_sentences import IverCompass, IverGrammar, IverState, table_of
from drivers.vehicle.talkers.iver_talker import IverTalker

_COMPASS_VALID_NS: Final = 2_000_000_000  # pitch and roll come in sentences of their own


class IverDecoder(AsciiDecoder):
    """Decode an Iver's sentences."""

    of_payload = IverTalker.commanding | IverTalker.harmless

    def __init__(self, settings: IverSettings, port: str) -> None:
        super().__init__(IverGrammar(), table_of(settings), port)
        self._compass: tuple[IverCompass, int] | None = None  # and the monotonic time

    def _state(self, record: Any, received: Stamp) -> ReportedState | None:
        if isinstance(record, IverCompass):
            self._compass = record, received.mono_ns
        if not isinstance(record, IverState):
            return None
        pitch_rad = roll_rad = NAN
        if self._compass is not None and received.mono_ns - self._compass[1] < _COMPASS_VALID_NS:
            pitch_rad, roll_rad = self._compass[0].pitch_rad, self._compass[0].roll_rad
        return state_of(record, received, pitch_rad=pitch_rad, roll_rad=roll_rad)
