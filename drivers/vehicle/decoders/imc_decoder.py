"""Decode IMC packets to messages and the vehicle's state."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, NamedTuple

from auv_mcm.clock import Stamp
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.framing import StampedFramer
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import FollowedVehicle
from drivers.vehicle.dialect import ReportedState, VehicleMessage, fix_of
from drivers.vehicle.imc_codec import LAYOUTS, decode
from drivers.vehicle.imc_messages import ImcMessage
from drivers.vehicle.imc_wire import ImcGrammar, ImcPacket

_MAX_OFFSET_M: Final = 1e5  # m from the reference: more is damage


class ImcReceived(NamedTuple):
    """Hold a message and its header. time_s: UTC seconds since 1970 by the sender's clock."""

    message: ImcMessage
    source: int
    destination: int
    time_s: float


class ImcDecoder:
    """Decode an IMC vehicle, and others on its network.

    Fixes are those of the vehicle that is followed, see `FollowedVehicle`.

    counters: those of the framer, imc.other_messages (kinds not known here), imc.other_source (the payload's own),
    imc.refused.payload.
    """

    def __init__(self, settings: ImcSettings, port: str) -> None:
        """port: name that fixes carry."""
        self._own_id = settings.source_id
        self._vehicle = FollowedVehicle(settings.vehicle_id)
        self._port = port
        self._framer = StampedFramer(ImcGrammar())
        self.bus_counters: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters

    def feed(self, data: bytes, stamp: Stamp) -> list[VehicleMessage]:
        """Decode a chunk; see `VehicleDecoder.feed`."""
        framed = self._framer.feed(data, stamp)
        return [self._message(packet, at)._replace(of_vehicle=self._is_of_vehicle(packet)) for packet, at, _ in framed]

    def _is_of_vehicle(self, packet: ImcPacket) -> bool:
        return packet.source != self._own_id if self._vehicle.number is None else packet.source == self._vehicle.number

    def _message(self, packet: ImcPacket, received: Stamp) -> VehicleMessage:
        if packet.source == self._own_id:
            self.counters["imc.other_source"] += 1  # what we sent ourselves, on a wire that many hear
            return VehicleMessage(None, received)
        if packet.number not in LAYOUTS:
            self.counters["imc.other_messages"] += 1
            return VehicleMessage(None, received)
        try:
            message = decode(packet.number, packet.payload, packet.order)
        except ValueError:
            self.counters["imc.refused.payload"] += 1
            return VehicleMessage(None, received)
        self._vehicle.hear(packet.source, message, 1e-9 * received.mono_ns)
        record = ImcReceived(message, packet.source, packet.destination, packet.time_s)
        if not isinstance(message, imc.EstimatedState):
            return VehicleMessage(record, received)
        state = _state_of(message, received)
        return VehicleMessage(
            record, received, state, (fix_of(self._port, state),) if packet.source == self._vehicle.number else ()
        )


def _state_of(message: imc.EstimatedState, received: Stamp) -> ReportedState:
    """Return the state. The position is lat, lon, height displaced by x, y, z; impossible values are NaN."""
    latitude_deg, longitude_deg = NAN, NAN
    offsets_m = (message.y, message.x, -message.z)
    place = (message.lat, message.lon, message.height)
    believed = abs(message.lat) <= 0.5 * math.pi and abs(message.lon) <= math.pi and abs(message.height) < _MAX_OFFSET_M
    if believed and all(abs(offset) < _MAX_OFFSET_M for offset in offsets_m):
        frame = LocalFrame(latitude_deg=math.degrees(place[0]), longitude_deg=math.degrees(place[1]), height_m=place[2])
        latitude_deg, longitude_deg = (float(angle) for angle in frame.to_geodetic(offsets_m)[:2])
    return ReportedState(
        received,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=_finite(message.psi) % math.tau,
        pitch_rad=_finite(message.theta),
        roll_rad=_finite(message.phi),
        depth_m=message.depth if 0.0 <= message.depth < math.inf else NAN,
        altitude_m=message.alt if 0.0 <= message.alt < math.inf else NAN,
        speed_mps=_finite(math.hypot(message.vx, message.vy)),
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else NAN
