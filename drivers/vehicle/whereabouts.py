"""Combine the vehicle's state from messages that each report a part of it."""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.records import NAN
from drivers.vehicle.dialect import ReportedState

_QUANTITIES: Final = ("heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps")

_NEVER: Final = (NAN, -math.inf)


class Whereabouts:
    """Hold the vehicle's last report of each quantity. valid_s: older values count as not known.

    A position is believed only if it can be one: latitude and longitude together, on Earth, and not 0, 0, which is what
    records hold that nobody filled.
    """

    def __init__(self, valid_s: float) -> None:
        self._valid_s = valid_s
        self._reported: dict[str, tuple[float, float]] = {}  # quantity: value, when
        self._position_s = -math.inf
        self._state: ReportedState | None = None

    @property
    def position_s(self) -> float:
        """Return when the position was reported; -inf if never."""
        return self._position_s

    @property
    def position_deg(self) -> tuple[float, float]:
        """Return the last latitude, longitude, however old; NaN if there was none."""
        return self._reported.get("latitude_deg", _NEVER)[0], self._reported.get("longitude_deg", _NEVER)[0]

    def hear(self, state: ReportedState, now_s: float) -> None:
        self._state = state
        latitude_deg, longitude_deg = state.latitude_deg, state.longitude_deg
        possible = (
            abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and (latitude_deg, longitude_deg) != (0.0, 0.0)
        )
        if possible:
            self._position_s = now_s
            self._reported["latitude_deg"], self._reported["longitude_deg"] = (
                (latitude_deg, now_s),
                (longitude_deg, now_s),
            )
        for quantity in _QUANTITIES:
            value = getattr(state, quantity)
            if math.isfinite(value):
                self._reported[quantity] = (value, now_s)

    def at(self, now_s: float) -> ReportedState | None:
        """Return the state as known now, NaN where nothing is; None if the vehicle never reported anything."""
        if self._state is None:
            return None
        known = {
            quantity: value if now_s - reported_s <= self._valid_s else NAN
            for quantity, (value, reported_s) in self._reported.items()
        }
        return ReportedState(self._state.received, **known)
