"""Simulate the computer of a vehicle that speaks IMC as DUNE does: its plan engine and FollowReference manoeuvre.

As there, references from any source but the manoeuvre's are ignored silently, each accepted one is answered by
FollowRefState, and when none has come within the time-out that is reported once and the manoeuvre fails. After an
Abort, or a plan stopped on board, it idles until a person starts a plan; whoever asks for one meanwhile gets it. Two
points differ: after any other plan it goes on with its own, as under a mission supervisor, and it takes MineContact
(1700) and answers MineContactTaken (1701).
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Final

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample
from drivers.framing import Framer
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import Command, ContactReport, GoTo, Vertical
from drivers.vehicle.imc_codec import LAYOUTS, decode, number_of
from drivers.vehicle.imc_contact import report_from_imc
from drivers.vehicle.imc_messages import (
    EntityStatus,
    ImcMessage,
    OpMode,
    PlanOp,
    PlanState,
    PlanType,
    Proximity,
    RefFlag,
    RefState,
    ZUnits,
)
from drivers.vehicle.imc_wire import ANY_ENTITY, ANYONE, ImcGrammar, ImcPacket, packed, to_wire

ADDRESS: Final = 0x001E  # of the vehicle on IMC
PLAN_ID: Final = "survey"  # its own
OPERATOR: Final = 0x4001  # of the console that a person aborts from
PLACE_RADIUS_M: Final = 5.0  # m within which the vehicle reports a place as reached

_ENTITY: Final = 38  # that sends for the vehicle
_FOLLOW_REFERENCE: Final = number_of(imc.FollowReference)
_GOTO: Final = 450  # the manoeuvre of its own plan
_NO_MANEUVER: Final = 0xFFFF  # maneuver_type of none
_FAILURE: Final = 2  # PlanControlState.last_outcome: ended before it was done
_TOLERANCE_M: Final = 15.0  # DUNE's, horizontal
_VERTICAL_TOLERANCE_M: Final = 2.0  # m of depth within which it is near
_SECOND_S: Final = 1.0  # s between heartbeats and states
_ANNOUNCE_S: Final = 10.0  # s between announcements
_UNDER_WATER: Final = 2  # Announce.sys_type
_CPU_USAGE: Final = ImcPacket(7, b"\x21", ADDRESS)  # of the many messages that are nothing to the payload


class FakeImc:
    """Simulate IMC as `FakeController[bytes]`.

    counters, besides the protocol's: vehicle.targets (Target messages taken).
    """

    def __init__(self) -> None:
        self.willing = True
        self._counters: Counter[str] = Counter()
        self._reports: list[ContactReport] = []
        self._known: set[tuple[int, int, int]] = set()
        self._health: list[str] = []
        self._framer = Framer(ImcGrammar())
        self._forget()

    def _forget(self) -> None:
        self._framer.finish()
        self._booting = False
        self._aborts: list[bytes] = []  # of the console, which the payload hears as well
        self._idles = False
        self._known.clear()
        self._frame: LocalFrame | None = None
        self._pose: NavSample | None = None
        self._arrived = False
        self._plan_id = PLAN_ID
        self._follow: imc.FollowReference | None = None
        self._reference: imc.Reference | None = None  # flown, merged with earlier ones
        self._following = RefState.WAIT
        self._reference_s = 0.0  # when the last one came
        self._second_s = self._announce_s = -math.inf
        self._outbox: list[ImcMessage] = []

    @property
    def counters(self) -> Counter[str]:
        refused = sum(n for name, n in self._framer.counters.items() if name.startswith("imc.refused."))
        return self._counters + Counter({"vehicle.nonsense": refused})

    @property
    def in_control(self) -> bool:
        return self._follow is not None

    @property
    def command(self) -> Command | None:
        reference = self._reference
        if reference is None or reference.speed is None or reference.z is None:
            return None
        vertical = Vertical("altitude" if reference.z.z_units == ZUnits.ALTITUDE else "depth", reference.z.value)
        return GoTo(
            math.degrees(reference.lat), math.degrees(reference.lon), vertical, reference.speed.value, PLACE_RADIUS_M
        )

    def take_reports(self) -> list[ContactReport]:
        reports, self._reports = self._reports, []
        return reports

    def take_health(self) -> list[str]:
        health, self._health = self._health, []
        return health

    def power_up(self, now_s: float) -> None:
        self._forget()
        self._booting = True

    def revoke(self, now_s: float) -> None:
        if self._follow is not None:
            self._end("another plan was started")

    @property
    def is_idle(self) -> bool:
        return self._idles and self._follow is None

    def abort(self, now_s: float) -> None:
        time_s = 0.0 if self._pose is None else self._pose.time_s
        self._aborts.append(packed(imc.Abort(), OPERATOR, entity=_ENTITY, time_s=time_s))
        self._idle("aborted")

    def stop_plan(self, now_s: float) -> None:
        self._idle("plan stopped on board")

    def start_plan(self, now_s: float) -> None:
        self._idles, self._plan_id, self._follow, self._reference = False, PLAN_ID, None, None
        self._outbox += [self._plan_state(), self._vehicle_state()]

    def connected(self, now_s: float) -> None:
        self._framer.finish()
        self._second_s = self._announce_s = -math.inf

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[bytes]:
        self._pose, self._arrived = pose, arrived
        if self._follow is not None and self._follow.timeout > 0.0 and now_s - self._reference_s > self._follow.timeout:
            self._counters["vehicle.commands_expired"] += 1
            self._following = RefState.TIMEOUT
            self._outbox.append(self._follow_state(Proximity.FAR))
            self._end("reference source timed out")
        if now_s - self._announce_s >= _ANNOUNCE_S:
            self._announce_s = now_s
            self._outbox.append(imc.Announce("fake-auv", _UNDER_WATER))
        outgoing = [self._estimated(pose)]
        wires = []
        if now_s - self._second_s >= _SECOND_S:
            self._second_s = now_s
            outgoing += [imc.Heartbeat(), self._vehicle_state(), self._plan_state()]
            self._booting = False
            wires = [_wire_of_cpu(pose.time_s)]
        messages, self._outbox = [*self._outbox, *outgoing], []
        aborts, self._aborts = self._aborts, []
        return [*aborts, *(self._wired(message) for message in messages), *wires]

    def heard(self, data: bytes, now_s: float) -> list[bytes]:
        for framed in self._framer.feed(data):
            packet = framed.message
            if packet.number not in LAYOUTS or packet.destination not in (ADDRESS, ANYONE) or packet.source == ADDRESS:
                continue
            try:
                self._take(decode(packet.number, packet.payload, packet.order), packet, now_s)
            except ValueError:
                self._counters["vehicle.nonsense"] += 1
        messages, self._outbox = self._outbox, []
        return [self._wired(message) for message in messages]

    def _take(self, message: ImcMessage, packet: ImcPacket, now_s: float) -> None:
        match message:
            case imc.PlanControl(type=PlanType.REQUEST):
                self._control(message, now_s)
            case imc.Reference():
                self._refer(message, packet, now_s)
            case imc.MineContact():
                self._contact(message)
            case imc.Target():
                self._counters["vehicle.targets"] += 1
            case imc.EntityState():
                self._health.append(f"{EntityStatus(message.state).name.lower()}: {message.description}")
            case imc.Abort():
                self._idle("aborted")
            case _:
                pass

    def _control(self, message: imc.PlanControl, now_s: float) -> None:
        if message.op == PlanOp.START:
            self._start(message, now_s)
        elif message.op == PlanOp.STOP and self._follow is not None:
            self._reply(message, "plan stopped")
            self._end("plan stopped")
        elif message.op == PlanOp.STOP:
            # DUNE would stop whatever runs, here the vehicle's own plan.
            self._counters["vehicle.commands_refused"] += 1
            self._reply(message, "no plan of yours is running", failed=True)

    def _start(self, message: imc.PlanControl, now_s: float) -> None:
        plan = message.arg
        maneuvers = plan.maneuvers if isinstance(plan, imc.PlanSpecification) else ()
        follow = next((maneuver.data for maneuver in maneuvers if maneuver.maneuver_id == _start_of(plan)), None)
        if follow is None or not self.willing:
            self._counters["vehicle.commands_refused"] += 1
            self._reply(message, "the payload may not command now" if follow else "plan load failed", failed=True)
            return
        self._reply(message, "plan loaded")
        self._reply(message, "executing maneuver")
        self._plan_id, self._follow, self._reference = message.plan_id, follow, None
        self._following, self._reference_s = RefState.WAIT, now_s
        self._outbox += [self._plan_state(), self._follow_state(Proximity.FAR)]

    def _refer(self, message: imc.Reference, packet: ImcPacket, now_s: float) -> None:
        follow = self._follow
        if follow is None or follow.control_src not in (packet.source, ANYONE):
            self._counters["vehicle.commands_refused"] += 1
            return
        if follow.control_ent not in (packet.source_entity, ANY_ENTITY):
            self._counters["vehicle.commands_refused"] += 1
            return
        if message.flags & RefFlag.MANDONE:
            self._end("maneuver terminated by reference source")
            return
        old = imc.Reference(0, lat=math.nan) if self._reference is None else self._reference
        place = message if message.flags & RefFlag.LOCATION else old
        speed = message.speed if message.flags & RefFlag.SPEED and message.speed else old.speed
        z = message.z if message.flags & RefFlag.Z and message.z else old.z
        if speed is None or z is None or not _can_be_flown(place, speed, z):
            self._counters["vehicle.commands_refused"] += 1
            return
        new = imc.Reference(message.flags, speed, z, place.lat, place.lon, message.radius)
        if (new.lat, new.lon) != (old.lat, old.lon):
            self._arrived = False
        self._reference, self._reference_s = new, now_s
        self._counters["vehicle.commands_accepted"] += 1
        self._following = RefState.LOITER if self._arrived else RefState.GOTO
        self._outbox.append(self._follow_state(self._proximity(new)))

    def _proximity(self, reference: imc.Reference) -> Proximity:
        if self._pose is None or reference.z is None:
            return Proximity.FAR
        frame = LocalFrame(latitude_deg=self._pose.latitude_deg, longitude_deg=self._pose.longitude_deg)
        east_m, north_m, _ = frame.to_enu(math.degrees(reference.lat), math.degrees(reference.lon), 0.0).tolist()
        now_m = self._pose.altitude_m if reference.z.z_units == ZUnits.ALTITUDE else self._pose.depth_m
        near = Proximity(0)
        if math.hypot(east_m, north_m) < _TOLERANCE_M + abs(reference.radius):
            near |= Proximity.XY_NEAR
        if abs(now_m - reference.z.value) < _VERTICAL_TOLERANCE_M:
            near |= Proximity.Z_NEAR
        return near or Proximity.FAR

    def _contact(self, message: imc.MineContact) -> None:
        key = (message.session, message.number, message.revision)
        try:
            report = report_from_imc(message)
        except ValueError as error:
            self._outbox.append(imc.MineContactTaken(*key, 0, str(error)))
            raise
        if key in self._known:
            self._counters["vehicle.reports_repeated"] += 1
        else:
            self._known.add(key)
            self._counters["vehicle.reports"] += 1
            self._reports.append(report)
        self._outbox.append(imc.MineContactTaken(*key, 1))

    def _end(self, why: str) -> None:
        """Return to its own plan, or to idling."""
        if self._follow is None:
            return
        self._plan_id, self._follow, self._reference, self._arrived = PLAN_ID, None, None, False
        self._outbox += [self._plan_state(), self._vehicle_state(why)]

    def _idle(self, why: str) -> None:
        """Stop whatever runs, and start nothing by itself."""
        self._idles = True
        self._follow, self._reference, self._arrived = None, None, False
        self._outbox += [self._plan_state(), self._vehicle_state(why)]

    def _reply(self, message: imc.PlanControl, text: str, *, failed: bool = False) -> None:
        self._outbox.append(
            imc.PlanControl(
                PlanType.FAILURE if failed else PlanType.SUCCESS,
                message.op,
                message.request_id,
                message.plan_id,
                arg=None if failed or message.op != PlanOp.START else imc.PlanStatistics(message.plan_id),
                info=text,
            )
        )

    def _follow_state(self, proximity: Proximity) -> imc.FollowRefState:
        assert self._follow is not None, "reported only while the manoeuvre runs"
        return imc.FollowRefState(
            self._follow.control_src, self._follow.control_ent, self._reference, self._following, proximity
        )

    def _plan_state(self) -> imc.PlanControlState:
        if self.is_idle:
            return imc.PlanControlState(PlanState.READY, self._plan_id, last_outcome=_FAILURE)
        return imc.PlanControlState(PlanState.EXECUTING, self._plan_id, man_type=self._maneuver)

    def _vehicle_state(self, why: str = "") -> imc.VehicleState:
        mode = OpMode.SERVICE if self.is_idle else OpMode.MANEUVER
        return imc.VehicleState(OpMode.BOOT if self._booting else mode, maneuver_type=self._maneuver, last_error=why)

    @property
    def _maneuver(self) -> int:
        own = _NO_MANEUVER if self._idles else _GOTO
        return own if self._follow is None else _FOLLOW_REFERENCE

    def _estimated(self, pose: NavSample) -> ImcMessage:
        """Report the pose as DUNE does: offsets from where it was started."""
        if self._frame is None:
            self._frame = LocalFrame(latitude_deg=pose.latitude_deg, longitude_deg=pose.longitude_deg)
        depth_m = pose.depth_m if math.isfinite(pose.depth_m) else 0.0
        east_m, north_m, up_m = self._frame.to_enu(pose.latitude_deg, pose.longitude_deg, -depth_m).tolist()
        return imc.EstimatedState(
            math.radians(self._frame.latitude_deg),
            math.radians(self._frame.longitude_deg),
            x=north_m,
            y=east_m,
            z=-up_m,
            phi=pose.roll_rad,
            theta=pose.pitch_rad,
            psi=pose.heading_rad,
            u=pose.speed_mps,
            vx=pose.speed_mps * math.cos(pose.heading_rad),
            vy=pose.speed_mps * math.sin(pose.heading_rad),
            depth=pose.depth_m,
            alt=pose.altitude_m if math.isfinite(pose.altitude_m) else -1.0,
        )

    def _wired(self, message: ImcMessage) -> bytes:
        return packed(message, ADDRESS, entity=_ENTITY, time_s=0.0 if self._pose is None else self._pose.time_s)


def _start_of(plan: ImcMessage | None) -> str | None:
    return plan.start_man_id if isinstance(plan, imc.PlanSpecification) else None


def _can_be_flown(place: imc.Reference, speed: imc.DesiredSpeed, z: imc.DesiredZ) -> bool:
    """Accept a place on Earth, metres per second, and a depth or an altitude."""
    on_earth = abs(place.lat) <= 0.5 * math.pi and abs(place.lon) <= math.pi
    return (
        on_earth
        and speed.speed_units == 0
        and 0.0 < speed.value < math.inf
        and z.z_units in (ZUnits.DEPTH, ZUnits.ALTITUDE)
        and 0.0 <= z.value < math.inf
    )


def _wire_of_cpu(time_s: float) -> bytes:
    return to_wire(_CPU_USAGE._replace(time_s=time_s))
