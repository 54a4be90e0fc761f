"""Hold messages of LSTS's Inter-Module Communication protocol (IMC 5.4) as typed records.

Fields stand in the order of the wire, with its units: radians, metres, m/s, seconds. Only messages with a use here are
there; the layouts are those of IMC.xml. Two messages are the payload's own, with ids of the range for third parties
(1000 and above), because IMC has none for a contact: MineContact (1700) and its answer MineContactTaken (1701).
"""

from __future__ import annotations

import enum
from typing import TypeAlias

import msgspec

from auv_mcm.records import NAN


class EntityStatus(enum.IntEnum):
    """Name the states of EntityState (IMC.xml)."""

    BOOT = 0
    NORMAL = 1
    FAULT = 2
    ERROR = 3
    FAILURE = 4


class OpMode(enum.IntEnum):
    """Name the modes of VehicleState (IMC.xml)."""

    SERVICE = 0
    CALIBRATION = 1
    ERROR = 2
    MANEUVER = 3
    EXTERNAL = 4
    BOOT = 5


class ZUnits(enum.IntEnum):
    """Name what a vertical coordinate is measured from (IMC.xml)."""

    NONE = 0
    DEPTH = 1
    ALTITUDE = 2
    HEIGHT = 3


class RefFlag(enum.IntFlag):
    """Name the bits of Reference for what it commands (IMC.xml)."""

    LOCATION = 0x01
    SPEED = 0x02
    Z = 0x04
    RADIUS = 0x08
    START_POINT = 0x10
    DIRECT = 0x20
    MANDONE = 0x80


class RefState(enum.IntEnum):
    """Name the states of FollowRefState (IMC.xml)."""

    WAIT = 1
    GOTO = 2
    LOITER = 3
    HOVER = 4
    ELEVATOR = 5
    TIMEOUT = 6


class Proximity(enum.IntFlag):
    """Name the bits of FollowRefState for how near its goal the vehicle is (IMC.xml)."""

    FAR = 0x01
    XY_NEAR = 0x02
    Z_NEAR = 0x04
    XY_UNREACHABLE = 0x08
    Z_UNREACHABLE = 0x10


class PlanType(enum.IntEnum):
    """Name what a PlanControl is: a request or an answer (IMC.xml)."""

    REQUEST = 0
    SUCCESS = 1
    FAILURE = 2
    IN_PROGRESS = 3


class PlanOp(enum.IntEnum):
    """Name what a PlanControl requests (IMC.xml)."""

    START = 0
    STOP = 1
    LOAD = 2
    GET = 3


class PlanState(enum.IntEnum):
    """Name the states of PlanControlState (IMC.xml)."""

    BLOCKED = 0
    READY = 1
    INITIALIZING = 2
    EXECUTING = 3


class Message(msgspec.Struct, frozen=True):
    """Hold a message of IMC."""


class Heartbeat(Message, frozen=True):
    """Signal every second that the sender is alive."""


class Abort(Message, frozen=True):
    """Stop whatever goes on."""


class EntityState(Message, frozen=True):
    """Hold the state of an entity. state: 0 boot, 1 normal, 2 fault, 3 error, 4 failure."""

    state: int
    flags: int = 0
    description: str = ""


class Announce(Message, frozen=True):
    """Announce a system, every ten seconds.

    sys_type: 2 under water, 3 on the surface, others are no vehicles that carry us.
    """

    sys_name: str
    sys_type: int
    owner: int = 0xFFFF
    lat: float = 0.0
    lon: float = 0.0
    height: float = 0.0
    services: str = ""


class EstimatedState(Message, frozen=True):
    """Hold where the vehicle estimates itself: x north, y east, z down: offsets of the vehicle from lat, lon, height.

    vx north, vy east, vz down: over ground. Negative depth or alt: not known.
    """

    lat: float
    lon: float
    height: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    phi: float = 0.0
    theta: float = 0.0
    psi: float = 0.0
    u: float = 0.0
    v: float = 0.0
    w: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    p: float = 0.0
    q: float = 0.0
    r: float = 0.0
    depth: float = -1.0
    alt: float = -1.0


class VehicleState(Message, frozen=True):
    """Hold what the vehicle does. op_mode: 0 service, 1 calibration, 2 error, 3 manoeuvre, 4 external, 5 boot.

    maneuver_type: its message id, 65535 for none.
    """

    op_mode: int
    error_count: int = 0
    error_ents: str = ""
    maneuver_type: int = 0xFFFF
    maneuver_stime: float = 0.0
    maneuver_eta: int = 0xFFFF
    control_loops: int = 0
    flags: int = 0
    last_error: str = ""
    last_error_time: float = 0.0


class DesiredZ(Message, frozen=True):
    """Command a depth, altitude or height. z_units: 1 depth, 2 altitude, 3 height."""

    value: float
    z_units: int


class DesiredSpeed(Message, frozen=True):
    """Command a speed. speed_units: 0 m/s, 1 rpm, 2 %."""

    value: float
    speed_units: int = 0


class FollowReference(Message, frozen=True):
    """Follow references: a manoeuvre that goes where control_src says, until it has been silent for `timeout` s.

    control_ent: 255 for any entity of it.
    """

    control_src: int
    control_ent: int
    timeout: float
    loiter_radius: float = 0.0
    altitude_interval: float = 0.0


class Reference(Message, frozen=True):
    """Order a place to go to.

    flags, what of it counts: 1 location, 2 speed, 4 z, 8 radius, 0x10 start point, 0x20 direct; 0x80 the manoeuvre is
    done.
    """

    flags: int
    speed: DesiredSpeed | None = None
    z: DesiredZ | None = None
    lat: float = 0.0
    lon: float = 0.0
    radius: float = 0.0


class FollowRefState(Message, frozen=True):
    """Hold how far the vehicle follows. state: 1 wait, 2 goto, 3 loiter, 4 hover, 5 elevator, 6 timeout.

    proximity: 1 far, 2 near in the plane, 4 near in depth, 8 and 16 out of reach.
    """

    control_src: int
    control_ent: int
    reference: Reference | None
    state: int
    proximity: int


class PlanManeuver(Message, frozen=True):
    """Hold a manoeuvre of a plan."""

    maneuver_id: str
    data: FollowReference | None
    start_actions: tuple[ImcMessage, ...] = ()
    end_actions: tuple[ImcMessage, ...] = ()


class PlanTransition(Message, frozen=True):
    """Hold what leads from one manoeuvre to the next."""

    source_man: str
    dest_man: str
    conditions: str = ""
    actions: tuple[ImcMessage, ...] = ()


class PlanSpecification(Message, frozen=True):
    """Hold a plan."""

    plan_id: str
    description: str = ""
    vnamespace: str = ""
    variables: tuple[ImcMessage, ...] = ()
    start_man_id: str = ""
    maneuvers: tuple[PlanManeuver, ...] = ()
    transitions: tuple[PlanTransition, ...] = ()
    start_actions: tuple[ImcMessage, ...] = ()
    end_actions: tuple[ImcMessage, ...] = ()


class PlanStatistics(Message, frozen=True):
    """Hold the time, way and fuel of a plan, as text. type: 0 of what it will take, 1 of so far, 2 of all."""

    plan_id: str
    type: int = 0
    properties: int = 0
    durations: str = ""
    distances: str = ""
    actions: str = ""
    fuel: str = ""


class PlanControl(Message, frozen=True):
    """Request something of a plan, or answer.

    type: 0 request, 1 success, 2 failure, 3 in progress. op: 0 start, 1 stop, 2 load, 3 get.
    """

    type: int
    op: int
    request_id: int
    plan_id: str
    flags: int = 0
    arg: ImcMessage | None = None
    info: str = ""


class PlanControlState(Message, frozen=True):
    """Hold what the plans do. state: 0 blocked, 1 ready, 2 initializing, 3 executing."""

    state: int
    plan_id: str = ""
    plan_eta: int = -1
    plan_progress: float = -1.0
    man_id: str = ""
    man_type: int = 0xFFFF
    man_eta: int = -1
    last_outcome: int = 0


class Target(Message, frozen=True):
    """Report something seen at a place. z_units: 0 z says nothing, 1 depth. cog, sog: its course and speed."""

    label: str
    lat: float
    lon: float
    z: float = 0.0
    z_units: int = 0
    cog: float = 0.0
    sog: float = 0.0


class MineContact(Message, frozen=True):
    """Report a contact in full; a message of our own.

    What is not known is NaN; masses of belief in the order of `classification`'s numbers.

    session, number, revision: of the run, of the contact in it, of this report of it; the same three again are a
    repetition. time: UTC of the first view, seconds since 1970. sigma: semi-major axis of the position's error ellipse,
    1-sigma. classification: 0 cylinder, 1 sphere, 2 truncated cone, 3 wedge, 4 clutter, 5 unknown.
    """

    session: int
    number: int
    revision: int
    time: float
    lat: float
    lon: float
    sigma: float
    depth: float
    p_mine: float
    classification: int
    views: int
    length: float = NAN
    width: float = NAN
    height: float = NAN
    length_sigma: float = NAN
    width_sigma: float = NAN
    height_sigma: float = NAN
    belief_cylinder: float = 0.0
    belief_sphere: float = 0.0
    belief_truncated_cone: float = 0.0
    belief_wedge: float = 0.0
    belief_clutter: float = 0.0
    belief_unknown: float = 0.0


class MineContactTaken(Message, frozen=True):
    """Answer every MineContact, also a repeated one; a message of our own.

    taken: 1 it is, 0 it is refused, for this reason.
    """

    session: int
    number: int
    revision: int
    taken: int
    reason: str = ""


ImcMessage: TypeAlias = (
    Heartbeat
    | Abort
    | EntityState
    | Announce
    | EstimatedState
    | VehicleState
    | DesiredZ
    | DesiredSpeed
    | FollowReference
    | Reference
    | FollowRefState
    | PlanManeuver
    | PlanTransition
    | PlanSpecification
    | PlanControl
    | PlanControlState
    | PlanStatistics
    | Target
    | MineContact
    | MineContactTaken
)
