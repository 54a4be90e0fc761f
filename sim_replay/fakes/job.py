"""Read the job of a fake device: its name, its wire, the mission it plays, and its timed faults."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

from auv_mcm.errors import UsageError
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitName, SonarName
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from auv_mcm.settings.vehicle_settings import VEHICLE_NAMES, VehicleName
from drivers.links.uri import BAUD_RATES, CAN_BITRATES
from sim_replay.fakes.faults import FaultRates

Seconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=3600.0)]
DeviceName: TypeAlias = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
LinkKind: TypeAlias = Literal["serial", "slcan", "tcp", "udp"]
CAN_DEVICES: Final = ("nmea2000", "vehicle_can")


class _Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class _Fault(_Record, frozen=True, kw_only=True, tag_field="do"):
    """Time a fault. at_s: after the run's start, or, of a vehicle, after it first granted control. for_s: how long,
    empty for until the end; times are real ones, whatever the mission's speed.
    """

    at_s: Seconds
    after: Literal["start", "grant"] = "start"
    for_s: Annotated[float, Meta(gt=0.0, le=3600.0)] | None = None


class Unplug(_Fault, frozen=True, kw_only=True, tag="unplug"):
    """Pull the cable; the device goes on and notices nothing."""


class PowerOff(_Fault, frozen=True, kw_only=True, tag="power_off"):
    """Pull cable and power: the device forgets its settings, and its counters start again from 0."""


class Stall(_Fault, frozen=True, kw_only=True, tag="stall"):
    """Pass nothing in either direction, without a signal to either end."""


class Garbage(_Fault, frozen=True, kw_only=True, tag="garbage"):
    """Send random bytes between all messages, as fast as the wire carries them; 1 MB/s on a network."""


class Damage(_Fault, frozen=True, kw_only=True, tag="damage"):
    """Flip, lose and repeat bytes and messages."""

    rates: FaultRates


class WrongBaud(_Fault, frozen=True, kw_only=True, tag="wrong_baud"):
    """Send at another rate than the right one; the host reads what a UART makes of it."""

    baud: int


class ClockStep(_Fault, frozen=True, kw_only=True, tag="clock_step"):
    """Set the device's clocks, counter and UTC, ahead by by_s."""

    by_s: Annotated[float, Meta(ge=-1e6, le=1e6)]


class Freeze(_Fault, frozen=True, kw_only=True, tag="freeze"):
    """Repeat the last navigation sample, times and all. Navigation only."""


class Offset(_Fault, frozen=True, kw_only=True, tag="offset"):
    """Add an offset to the reported navigation. Navigation and vehicles only."""

    east_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0
    north_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0
    heading_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 0.0


class Revoke(_Fault, frozen=True, kw_only=True, tag="revoke"):
    """Revoke control and do not grant it again before the fault ends. Vehicles only."""


class Abort(_Fault, frozen=True, kw_only=True, tag="abort"):
    """Abort whatever goes on, as a person does, and start the vehicle's plan when the fault ends. IMC only."""


class StopPlan(_Fault, frozen=True, kw_only=True, tag="stop_plan"):
    """Stop whatever plan runs, as a person does on board, and start its own when the fault ends. IMC only."""


class Nonsense(_Fault, frozen=True, kw_only=True, tag="nonsense"):
    """Repeat every message, cut short or changed. Vehicles only."""


class Misreport(_Fault, frozen=True, kw_only=True, tag="misreport"):
    """Report a depth or an altitude that is wrong, or no altitude, as without bottom lock. Vehicles only."""

    depth_by_m: Annotated[float, Meta(ge=-1e4, le=1e4)] = 0.0
    altitude_by_m: Annotated[float, Meta(ge=-1e4, le=1e4)] = 0.0
    no_altitude: bool = False


class Flood(_Fault, frozen=True, kw_only=True, tag="flood"):
    """Send, from the device's own address and besides its messages, the input that costs its decoder the maximum."""

    bytes_per_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 100_000.0


Fault: TypeAlias = (
    Unplug
    | PowerOff
    | Stall
    | Garbage
    | Damage
    | WrongBaud
    | ClockStep
    | Freeze
    | Offset
    | Revoke
    | Abort
    | StopPlan
    | Nonsense
    | Misreport
    | Flood
)


class Device(_Record, frozen=True, kw_only=True):
    """Describe a device at the end of a wire. baud: its own rate; host_baud: the rate the host assumes, if another.
    silent_s: of the link.

    beside: a navigation unit of a vehicle on the same wire as its controller.
    """

    device: SonarName | NavUnitName | VehicleName
    link: LinkKind = "serial"
    beside: NavUnitName | None = None
    baud: int = 115_200
    host_baud: int | None = None
    bus_bitrate: int = 250_000
    silent_s: Annotated[float, Meta(gt=0.0, le=3600.0)] | None = None
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        if (self.link == "slcan") != (self.device in CAN_DEVICES):
            raise ValueError(f"a device '{self.device}' does not go with a link '{self.link}'")
        bauds = [self.baud, self.host_baud, *(fault.baud for fault in self.faults if isinstance(fault, WrongBaud))]
        for baud in bauds:
            if baud is not None and baud not in BAUD_RATES:
                raise ValueError(
                    f"a rate of {baud} baud is not standard; give one of {', '.join(map(str, BAUD_RATES))}"
                )
        if self.bus_bitrate not in CAN_BITRATES:
            raise ValueError(
                f"a bus of {self.bus_bitrate} bit/s is not standard; give one of {', '.join(map(str, CAN_BITRATES))}"
            )
        serial = self.link in ("serial", "slcan")
        for fault in self.faults:
            if _changes_nothing(fault, self.baud):
                raise ValueError(f"a fault '{fault.__struct_config__.tag}' changes nothing. Say by how much")
            if isinstance(fault, WrongBaud) and not serial:
                raise ValueError(f"a link '{self.link}' has no baud rate that could be wrong")
            of_unit = isinstance(fault, Freeze) or (isinstance(fault, Offset) and not self.is_vehicle)
            if of_unit and (self.is_sonar or self.is_vehicle):
                raise ValueError(
                    f"a device '{self.device}' is not a navigation unit; freeze needs one, and offset one or a "
                    "vehicle. Remove the fault"
                )
            if isinstance(fault, Abort | StopPlan) and self.device != "imc":
                raise ValueError(
                    f"a device '{self.device}' cannot be aborted: abort and stop_plan need 'imc'. Remove the fault"
                )
            if not self.is_vehicle and (isinstance(fault, Revoke | Nonsense | Misreport) or fault.after == "grant"):
                raise ValueError(
                    f"a device '{self.device}' is not a vehicle; revoke, nonsense, misreport and 'after: grant' need "
                    "one. Remove the fault"
                )
        if self.beside is not None and (not self.is_vehicle or (self.beside in CAN_DEVICES) != (self.link == "slcan")):
            raise ValueError(
                f"a unit '{self.beside}' cannot share the wire of a device '{self.device}' on a link '{self.link}'"
            )

    @property
    def is_sonar(self) -> bool:
        """Find whether the device is a sonar."""
        return self.device in SONAR_NAMES

    @property
    def is_vehicle(self) -> bool:
        """Find whether the device is a vehicle."""
        return self.device in VEHICLE_NAMES


def _changes_nothing(fault: Fault, baud: int) -> bool:
    """Find whether a fault is as good as none on a device of this rate: a run with it would show nothing."""
    match fault:
        case Damage(rates=rates):
            return rates in (FaultRates(), FaultRates(delay=rates.delay), FaultRates(delay_s=rates.delay_s))
        case WrongBaud():
            return fault.baud == baud
        case ClockStep():
            return not fault.by_s
        case Offset():
            return not (fault.east_m or fault.north_m or fault.heading_deg)
        case Misreport():
            return not (fault.depth_by_m or fault.altitude_by_m or fault.no_altitude)
    return False


class Job(_Record, frozen=True, kw_only=True):
    """Describe one device of one run.

    folder: where its port appears; log or scene: the mission; speed: times real time. waits: the mission waits where
    the device is late; otherwise it leaves out what is too late.
    """

    name: DeviceName
    device: Device
    folder: str
    log: str | None = None
    scene: str | None = None
    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    waits: bool = False


class VehicleJob(_Record, frozen=True, kw_only=True):
    """Describe a vehicle of one run, with all aboard, in the world of a scene; one of the devices is its controller."""

    devices: dict[DeviceName, Device]
    folder: str
    scene: str
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0

    def __post_init__(self) -> None:
        if (n_vehicles := sum(device.is_vehicle for device in self.devices.values())) != 1:
            raise ValueError(
                f"`devices` has {n_vehicles} controllers of vehicles: a vehicle has one, one of "
                f"{', '.join(VEHICLE_NAMES)}"
            )


def read_job(path: Path) -> Job | VehicleJob:
    """Read a job from a YAML file: a vehicle's if it names `devices`.

    Raises UsageError with the path of a key that is not understood.
    """
    data = load_mapping(
        read_text(path, "job of a fake device"), str(path), "expected keys such as 'name:' and 'device:'"
    )
    kind: type[Job] | type[VehicleJob] = VehicleJob if "devices" in data else Job
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise UsageError(f"{path}: {explain_validation_error(error, kind, data)}") from error
