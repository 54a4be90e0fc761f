"""Define the `ports:` section of the configuration: the device at the end of each wire, its settings and mounting."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Final, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta

from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import find_device, find_plugins
from auv_mcm.settings.vehicle_settings import (
    VEHICLE_NAMES,
    BluefinSettings,
    CanSettings,
    ImcSettings,
    IverSettings,
    ReconSettings,
)

ArmLength: TypeAlias = Annotated[float, Meta(ge=-100.0, le=100.0)]
Sign: TypeAlias = Literal[1, -1]
Offset: TypeAlias = Annotated[float, Meta(ge=-180.0, le=180.0)]
Quantity: TypeAlias = Literal["position", "heading", "attitude", "depth", "altitude", "speed"]
QUANTITIES: Final[tuple[Quantity, ...]] = get_args(Quantity)

SonarName: TypeAlias = Literal["ping_protocol", "jsf", "sportscan"]
NavUnitName: TypeAlias = Literal["nmea0183", "pixse", "pd6", "water_linked", "nmea2000"]
SONAR_NAMES: Final[tuple[SonarName, ...]] = get_args(SonarName)
NAV_UNIT_NAMES: Final[tuple[NavUnitName, ...]] = get_args(NavUnitName)
DEVICE_NAMES: Final = (*SONAR_NAMES, *NAV_UNIT_NAMES, *VEHICLE_NAMES)
"""Devices that are built in; other packages add more, see `auv_mcm.settings.plugins`."""
DeviceKind: TypeAlias = Literal["sonar", "navigation", "vehicle"]
Sides: TypeAlias = Literal["as_told", "by_number", "swapped", "port", "starboard"]


class _Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    pass


class NavUnitSettings(_Settings, frozen=True, kw_only=True):
    """Set up one navigation unit.

    Signs come first, then offsets: measured on the vehicle = sign * reported + offset.
    """

    priority: Annotated[
        int, Meta(ge=0, le=99, description="of the units that deliver a quantity the lowest healthy one serves")
    ] = 1
    delivers: Annotated[tuple[Quantity, ...], Meta(description="quantities that are taken from this unit")] = QUANTITIES
    heading_sign: Sign = 1
    pitch_sign: Annotated[Sign, Meta(description="-1 for a unit whose pitch is positive bow down")] = 1
    roll_sign: Annotated[Sign, Meta(description="-1 for a unit whose roll is positive port down")] = 1
    heading_offset_deg: Annotated[
        Offset,
        Meta(
            description="added to its heading, degrees; of a unit that gives velocities along its own axes, how far "
            "clockwise these are turned from the vehicle's bow. A turned unit that gives both serves for one of them: "
            "see delivers"
        ),
    ] = 0.0
    pitch_offset_deg: Offset = 0.0
    roll_offset_deg: Offset = 0.0
    lever_arm_m: Annotated[
        tuple[ArmLength, ArmLength, ArmLength],
        Meta(description="antenna or head from the vehicle's navigation reference: forward, starboard, down, m"),
    ] = (0.0, 0.0, 0.0)
    latency_s: Annotated[
        float, Meta(ge=0.0, le=5.0, description="from the measurement to the first byte on the wire, s")
    ] = 0.0
    baud: Annotated[
        Annotated[int, Meta(ge=300, le=4_000_000)] | None,
        Meta(description="of its serial line, to take off the time on the wire; empty on networks and buses"),
    ] = None
    use_unit_time: Annotated[
        bool,
        Meta(
            description="take the times between measurements from the unit's own clock, which is free of the link's "
            "delays"
        ),
    ] = False
    gives_utc: Annotated[
        bool,
        Meta(
            description="nmea0183 only: UTC is that of its ZDA, sent each second, instead of this computer's; for one "
            "unit only"
        ),
    ] = False
    pulse_link: Annotated[
        str | None,
        Meta(
            description="where the unit's pulse at each full second comes in, e.g. pps:///dev/pps0; each ZDA then "
            "names the pulse before it"
        ),
    ] = None
    surface_only: Annotated[bool, Meta(description="a satellite receiver: its positions are refused under water")] = (
        False
    )
    position_sigma_m: Annotated[
        float, Meta(ge=0.0, le=1000.0, description="1-sigma per axis where the unit reports none, m")
    ] = 3.0
    heading_sigma_deg: Annotated[
        float, Meta(ge=0.0, le=45.0, description="1-sigma where the unit reports none, degrees")
    ] = 1.0
    speed_sigma_mps: Annotated[float, Meta(ge=0.0, le=5.0, description="1-sigma where the unit reports none, m/s")] = (
        0.05
    )
    valid_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="without a new value for longer than this a quantity is lost, s")
    ] = 1.5


class SonarPortConfig(_Settings, frozen=True, kw_only=True):
    """Set how a sonar is commanded to ping, at the start and whenever it comes back, and which sides it covers."""

    range_m: Annotated[
        Annotated[float, Meta(gt=0.0, le=1000.0)] | None,
        Meta(description="slant range to set, m; empty: no command is sent, and the sonar pings as others have set it"),
    ] = None
    gain: Annotated[
        Annotated[int, Meta(ge=0, le=100)] | None,
        Meta(description="the device's own index, percentage or dB; empty: automatic or as it is"),
    ] = None
    enabled: Annotated[bool, Meta(description="false: the sonar is commanded not to ping")] = True
    n_samples: Annotated[
        int, Meta(ge=1, le=12_000, description="per side and ping, where the device lets it be set")
    ] = 1200
    sound_speed_mps: Annotated[float, Meta(ge=1400.0, le=1600.0, description="for its ranges, m/s")] = 1500.0
    command_link: Annotated[
        str | None,
        Meta(
            description="a wire of its own for commands, as EdgeTech's TCP port 1600 beside 1601; empty: they go to "
            "link"
        ),
    ] = None
    ping_interval_s: Annotated[
        float, Meta(ge=0.02, le=10.0, description="between two pings of a sonar that pings only on request, s")
    ] = 0.2
    sides: Annotated[
        Sides,
        Meta(
            description="as_told, by_number (look angles do not count), swapped, or the one side that this port's head "
            "looks to, for heads on wires of their own"
        ),
    ] = "as_told"


class PortConfig(_Settings, frozen=True, kw_only=True):
    """Set up one wire and the device at its end."""

    name: Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,31}$", description="in messages, counters and recordings")]
    link: Annotated[
        str, Meta(description="the wire, e.g. serial:///dev/ttyUSB0?baud=115200 or tcp://192.168.2.92:51200")
    ]
    device: Annotated[str, Meta(examples=[*DEVICE_NAMES], description="what speaks there")]
    sonar: SonarPortConfig | None = None
    navigation: Annotated[
        NavUnitSettings | None,
        Meta(
            description="how the unit is mounted; of a sonar or vehicle: use the navigation it sends, mounted like this"
        ),
    ] = None
    imc: ImcSettings | None = None
    bluefin: BluefinSettings | None = None
    iver: IverSettings | None = None
    recon: ReconSettings | None = None
    vehicle_can: CanSettings | None = None
    options: Annotated[
        dict[str, Any] | None,
        Meta(description="settings of a vehicle's dialect that another package adds; its documentation lists them"),
    ] = None

    def __post_init__(self) -> None:
        try:
            kind = device_kind(self.device)
        except UsageError as error:
            raise ValueError(f"port '{self.name}': {error}") from error
        if self.sonar is not None and kind != "sonar":
            raise ValueError(f"port '{self.name}': section 'sonar' is for sonars, and '{self.device}' is not a sonar")
        unit = self.navigation
        if unit is not None and unit.gives_utc and self.device != "nmea0183":
            raise ValueError(
                f"port '{self.name}': navigation.gives_utc is for a device 'nmea0183', and this one is a "
                f"'{self.device}'"
            )
        if unit is not None and unit.pulse_link is not None and not unit.gives_utc:
            raise ValueError(
                f"port '{self.name}': navigation.pulse_link names a pulse that is not used: add gives_utc: true"
            )
        for name in VEHICLE_NAMES:
            if name != self.device and getattr(self, name) is not None:
                raise ValueError(
                    f"port '{self.name}': a section '{name}' is for a device '{name}', and this one is a "
                    f"'{self.device}'"
                )
        if self.options is not None and (kind != "vehicle" or self.device in VEHICLE_NAMES):
            text = f"port '{self.name}': a section 'options' is for a vehicle's dialect that another package adds"
            raise ValueError(f"{text}, and '{self.device}' is not one: remove it")


def device_kind(device: str) -> DeviceKind:
    """Return what kind of device a name stands for, built in or added by another package.

    Raises UsageError for an unknown name, with those that are known, and for a name that is added twice.
    """
    if device in SONAR_NAMES:
        return "sonar"
    if device in NAV_UNIT_NAMES:
        return "navigation"
    if device in VEHICLE_NAMES:
        return "vehicle"
    plugin = find_device(device)
    if plugin is not None and plugin.kind != "logs":
        return plugin.kind
    known = [*DEVICE_NAMES, *(plugin.name for plugin in find_plugins() if plugin.kind != "logs")]
    near = difflib.get_close_matches(device, known, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(
        f"device '{device}' is unknown ({hint}valid: {', '.join(known)}). Correct it, or install the package that adds "
        "it"
    )


def check_together(ports: tuple[PortConfig, ...]) -> None:
    """Check that ports can be used together. Raises ValueError if they cannot."""
    names = [port.name for port in ports]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two ports are called '{name}': give each a name of its own")
    at: dict[str, str] = {}
    for port in ports:
        kind, _, place = port.link.partition("?")[0].partition("://")
        if kind in ("serial", "slcan") and (other := at.setdefault(place, port.name)) != port.name:
            raise ValueError(
                f"the ports {other} and {port.name} are both at {place}, which one of them alone can open: correct one"
            )
    vehicles = [port.name for port in ports if device_kind(port.device) == "vehicle"]
    if len(vehicles) > 1:
        raise ValueError(
            f"the ports {' and '.join(vehicles)} are both a vehicle's: leave one of them, for there is one vehicle to "
            "talk to"
        )
    clocks = [port.name for port in ports if port.navigation is not None and port.navigation.gives_utc]
    if len(clocks) > 1:
        raise ValueError(f"the ports {' and '.join(clocks)} both have navigation.gives_utc: leave it to the better one")
    sonars = [port for port in ports if device_kind(port.device) == "sonar"]
    sides = sorted(port.sonar.sides if port.sonar is not None else "as_told" for port in sonars)
    if len(sonars) > 1 and sides != ["port", "starboard"]:
        raise ValueError(
            "several sonars: two heads on wires of their own need 'sides: port' and 'sides: starboard' in their "
            "sections 'sonar'; more, or two that look to both sides, are not used together"
        )
