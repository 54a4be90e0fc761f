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
from drivers.vehicle.dialect import ReportedState, VehicleMessage, fix_of
from drivers.vehicle.imc_codec import LAYOUTS, decode
from drivers.vehicle.imc_messages import ImcMessage, PlanState, RefState
from drivers.vehicle.imc_wire import ANYONE, ImcGrammar, ImcPacket

PLAN_ID: Final = "auv_mcm"
"""Name of the payload's plan."""

VEHICLE_TYPES: Final = frozenset({2, 3})  # Announce.sys_type: under water, on the surface
_ANOTHER_AFTER_S: Final = 60.0  # s of silence of a vehicle that is not named, until another takes its place; chosen
_ABORTS_S: Final = 2.0  # s after an Abort in which a report may still be of the plan that it ends
_FAILURE: Final = 2  # PlanControlState.last_outcome: not ended by itself
_IDLE: Final = "the vehicle flies no plan"
_MAX_HEARD: Final = 4  # vehicles named in a doubt: two suffice for it, and anybody may send thousands
_MAX_OFFSET_M: Final = 1e5  # m from the reference: more is damage


class ImcReceived(NamedTuple):
    """Hold a message and its header. time_s: UTC seconds since 1970 by the sender's clock."""

    message: ImcMessage
    source: int
    destination: int
    time_s: float


class FollowedVehicle:
    """Choose whom to follow: the vehicle that is named, or the first one heard until it is silent and another speaks.

    number: its IMC address, None before it is heard.
    """

    def __init__(self, named: int) -> None:
        """named: the address configured, 0 for none."""
        self._named = named or None
        self._all: dict[int, None] = {}  # vehicles heard, where none is named
        self._aborted_s = -math.inf
        self._withheld = ""  # why it is not asked, until it flies a plan of its own
        self._flew = self._flies_ours = self._flies_own = False  # any plan was reported to run; which one runs
        self._plan_before = self._sent_on = ""  # plans of the vehicle: before the payload's, and in its place
        self.is_left = False  # by the payload, which ends its own plan
        self.restart()

    def restart(self) -> None:
        """Forget whom to follow, as on a wire that was opened again."""
        self.number, self._heard_s = self._named, -math.inf

    def hear(self, source: int, message: ImcMessage, now_s: float, to: int = ANYONE) -> None:
        """Take a message of any source but the payload. to: whom it is addressed to."""
        if isinstance(message, imc.Abort) and to in (ANYONE, self.number):
            self._aborted_s, self._withheld = now_s, "an Abort came"
        elif source == self.number:
            self._hear_plan(message, now_s)
        if self._named is None and is_vehicle(message):
            if len(self._all) < _MAX_HEARD:
                self._all[source] = None
            if now_s - self._heard_s > _ANOTHER_AFTER_S:
                self.number = source
        if source == self.number:
            self._heard_s = now_s

    def _hear_plan(self, message: ImcMessage, now_s: float) -> None:
        """Find out whether the vehicle may be started: it flies, or is idle since the payload's own plan."""
        if isinstance(message, imc.FollowRefState) and message.state == RefState.TIMEOUT:
            self._flies_ours = False
        if not isinstance(message, imc.PlanControlState):
            return
        if message.state in (PlanState.BLOCKED, PlanState.READY):
            flew_ours = self._flies_ours and not self.is_left
            if (flew_ours or self._flies_own) and message.last_outcome == _FAILURE:
                self._withheld = f"the {'payload' if flew_ours else 'vehicle'}'s plan was stopped on board"
            elif not self._flew:
                self._withheld = self._withheld or _IDLE
            self._flies_ours = self._flies_own = False
        elif message.plan_id == PLAN_ID:
            self._flew, self._flies_ours, self._flies_own = True, True, False
            self._withheld = self._withheld if self._withheld != _IDLE else ""
        elif message.state == PlanState.EXECUTING and now_s - self._aborted_s >= _ABORTS_S:
            self._take_own_plan(message.plan_id)

    def _take_own_plan(self, plan_id: str) -> None:
        """Take the plan of its own that the vehicle flies; one that took the place of the payload's is left alone."""
        if self._flies_ours and not self.is_left and self._plan_before not in ("", plan_id):
            self._sent_on = plan_id
        if plan_id == self._sent_on:
            self._withheld = f"the vehicle was sent on plan {plan_id} instead"
        else:
            self._withheld = self._sent_on = ""
            self._plan_before = plan_id
        self._flew, self._flies_ours, self._flies_own = True, False, True

    @property
    def may_be_asked(self) -> bool:
        """Check whether a vehicle is known that may be asked for control."""
        return self.number is not None and not self.why_not

    @property
    def why_not(self) -> str:
        """Say why the vehicle is not asked for control, "" where it may be."""
        again = f"control is requested once it flies {'another' if self._sent_on else 'a plan of its own'}"
        return self.doubt or (f"{self._withheld}: {again}" if self._withheld else "")

    @property
    def doubt(self) -> str:
        """Say why none of several vehicles is asked for control, "" where it is clear whom to ask."""
        if len(self._all) < 2:
            return ""
        heard = " and ".join(f"0x{number:04X} ({number})" for number in self._all)
        return (
            f"vehicles {heard} are heard, and imc.vehicle_id names none: one is followed until silent for "
            f"{_ANOTHER_AFTER_S:g} s, none is asked for control. Set vehicle_id to the one that carries the payload."
        )


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


def is_vehicle(message: ImcMessage) -> bool:
    """Check whether only a vehicle sends this message."""
    return isinstance(message, imc.EstimatedState) or (
        isinstance(message, imc.Announce) and message.sys_type in VEHICLE_TYPES
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
