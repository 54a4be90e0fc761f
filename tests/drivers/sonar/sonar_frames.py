"""Made-up sonar messages and a stamp for tests."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from auv_mcm.clock import Stamp
from drivers.sonar.ping_messages import OsMonoProfile
from drivers.sonar.sonar_decoder import SonarDecoder, SonarFrame, SonarItem, SonarReply

NOW: Final = Stamp(5, 7)


def profile(**changes: Any) -> OsMonoProfile:
    """Make a profile to port of ping 7, four results over 50 m, at 123.456 s, but for the changes."""
    made = OsMonoProfile(
        ping_number=7,
        start_mm=0,
        length_mm=50_000,
        timestamp_ms=123_456,
        ping_hz=450_000,
        gain_index=3,
        sound_speed_dmps=14_820,
        channel_number=0,
        pulse_duration_sec=1e-4,
        analog_gain=12.5,
        max_pwr_db=-10.0,
        min_pwr_db=-90.0,
        transducer_heading_deg=0.0,
        vehicle_heading_deg=45.0,
        pwr_results=np.array([0, 21845, 43690, 65535], dtype=np.uint16),
    )
    return made._replace(**changes)


def items_of(decoder: SonarDecoder, *chunks: bytes) -> list[SonarItem]:
    """Decode all chunks, up to the end of the stream."""
    return [*(item for chunk in chunks for item in decoder.feed(chunk, NOW)), *decoder.finish()]


def frames_of(decoder: SonarDecoder, *chunks: bytes) -> list[SonarFrame]:
    return [item for item in items_of(decoder, *chunks) if isinstance(item, SonarFrame)]


def replies_of(decoder: SonarDecoder, *chunks: bytes) -> list[SonarReply]:
    return [item for item in items_of(decoder, *chunks) if isinstance(item, SonarReply)]
