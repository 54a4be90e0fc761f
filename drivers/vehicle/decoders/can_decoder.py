"""Frames of a CAN bus to the messages of a vehicle's controller, and to what NMEA 2000 units on the same bus say."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, Literal, get_args

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.navigation.n2k_bus import N2kBus
from drivers.navigation.n2k_messages import identifier_of
from drivers.navigation.nav_decoder import NavFix
from drivers.vehicle.can_messages import StateMessage, number_and_address
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.dialect import ReportedState, VehicleMessage, fix_of

_NAME: Final = "vehicle_can"
_FIX_VALID_S: Final = 1.0  # s that a value of the vehicle counts for a fix
_TURN: Final = 2.0 * math.pi
_S_PER_NS: Final = 1e-9  # seconds per nanosecond

_Quantity = Literal["heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"]
_QUANTITIES: Final[tuple[_Quantity, ...]] = get_args(_Quantity)


class CanDecoder:
    """Decode a vehicle's controller and the units on its bus.

    Where NMEA 2000 units report the position, a state comes with every position of theirs, its other quantities up
    to 1 s old; the depth stays the controller's, and fixes are the units' alone.

    counters: those of CanReceiver. bus_counters: those of N2kBus, and n2k.not_extended (frames).
    """

    def __init__(self, settings: CanSettings, port: str) -> None:
        """port: name that fixes carry, followed by the address of a unit."""
        self._units = frozenset(settings.nmea2000_addresses)
        self._port = port
        self._own: Counter[str] = Counter()
        self._receiver = CanReceiver(_NAME, "vehicle", settings.vehicle_address, self._own)
        self._bus = N2kBus(port)
        self._not_extended: Counter[str] = Counter()
        self._last: dict[_Quantity, tuple[float, int]] = {}  # of every quantity from NMEA 2000, and when it came

    @property
    def counters(self) -> Counter[str]:
        return self._own

    @property
    def bus_counters(self) -> Counter[str]:
        """Count what came over the whole bus, not from the vehicle alone."""
        return self._bus.counters + self._not_extended

    def feed(self, data: CanFrame, stamp: Stamp) -> list[VehicleMessage]:
        """Decode a frame; see `VehicleDecoder.feed`."""
        fixes: tuple[NavFix, ...] = ()
        if data.extended:
            fixes = tuple(self._bus.feed(data.can_id, data.data, stamp))
            if (
                self._units
                and number_and_address(data.can_id) is None
                and identifier_of(data.can_id).source in self._units
            ):
                states = [state for fix in fixes for state in self._states(fix)]
                return [
                    VehicleMessage(None, stamp, None, fixes, of_vehicle=False),
                    *(VehicleMessage(None, stamp, state, of_vehicle=False) for state in states),
                ]
        else:
            self._not_extended["n2k.not_extended"] += 1
        received = self._receiver.add(data, stamp.mono_ns * _S_PER_NS)
        if received is None:
            return [VehicleMessage(None, stamp, None, fixes, of_vehicle=False)] if fixes else []
        if not isinstance(received.record, StateMessage):
            return [VehicleMessage(received.record, stamp, None, fixes)]
        state = _state(received.record, stamp)
        if self._units:  # which report the rest; none of them reports a depth
            return [VehicleMessage(received.record, stamp, ReportedState(stamp, depth_m=state.depth_m), fixes)]
        return [VehicleMessage(received.record, stamp, state, (fix_of(self._port, state), *fixes))]

    def _states(self, fix: NavFix) -> list[ReportedState]:
        if not fix.valid:  # as of an echo sounder that found no bottom, which is not an altitude of 0
            return []
        mono_ns = fix.received.mono_ns
        for name in _QUANTITIES:
            value = getattr(fix, name)
            if not math.isnan(value):
                self._last[name] = value, mono_ns
        if math.isnan(fix.latitude_deg):
            return []
        fresh = {
            name: value for name, (value, at_ns) in self._last.items() if (mono_ns - at_ns) * _S_PER_NS <= _FIX_VALID_S
        }
        return [ReportedState(fix.received, fix.latitude_deg, fix.longitude_deg, **fresh)]


def _state(message: StateMessage, stamp: Stamp) -> ReportedState:
    return ReportedState(
        received=stamp,
        latitude_deg=message.latitude_deg,
        longitude_deg=message.longitude_deg,
        heading_rad=message.heading_rad % _TURN,
        pitch_rad=message.pitch_rad,
        roll_rad=message.roll_rad,
        depth_m=message.depth_m,
        altitude_m=message.altitude_m,
        speed_mps=message.speed_mps,
    )
