"""Reject settings that a sonar cannot have."""

from __future__ import annotations

import math

from auv_mcm.errors import UsageError
from drivers.sonar.sonar_decoder import SonarSettings


def check_settings(settings: SonarSettings, device: str, *, max_range_m: float, max_gain: int) -> None:
    """Check settings; raise UsageError for a range, gain or sound speed outside of what the device takes."""
    if not 1.0 <= settings.range_m <= max_range_m:
        raise UsageError(f"{device}: a range of {settings.range_m:g} m cannot be set. Give 1 to {max_range_m:g} m.")
    if settings.gain is not None and not 0 <= settings.gain <= max_gain:
        raise UsageError(
            f"{device}: a gain of {settings.gain} cannot be set. Give 0 to {max_gain}, or none for automatic gain."
        )
    if not (math.isfinite(settings.sound_speed_mps) and 1400.0 <= settings.sound_speed_mps <= 1600.0):
        raise UsageError(
            f"{device}: a sound speed of {settings.sound_speed_mps:g} m/s cannot be set. Give 1400 to 1600 m/s."
        )
