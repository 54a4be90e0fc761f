"""Check the `ports:` of a configuration before anything is opened: addresses, commands, mounting of units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from msgspec import structs

from auv_mcm.errors import UsageError
from auv_mcm.records import Notice
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.settings.port_settings import NavUnitSettings, PortConfig, Sides, SonarPortConfig, device_kind
from drivers.links.uri import (
    CanAddress,
    LinkAddress,
    PulseAddress,
    SerialAddress,
    SlcanAddress,
    UdpAddress,
    parse_link_uri,
)
from drivers.navigation.nav_protocols import CAN_PROTOCOL
from drivers.navigation.nav_settings import NavMergeSettings
from drivers.sonar.sonar_decoder import SonarSettings
from drivers.sonar.sonars import sonar_named
from drivers.vehicle.guard import Guard
from drivers.vehicle.vehicles import VehicleSettings, vehicle_named, vehicle_settings_of

PULSE: Final = "pulse"
"""Device of a port that only marks when a second begins."""


class PortSettings(NamedTuple):
    """Describe one wire and the device at its end.

    baud: of a serial line, None where bytes take no time. sides: what a sonar looks to. commands: what to send so that
    it pings as configured; ask_every_s: and how often, None for once. unit: how the navigation from here is mounted,
    None if none is used. vehicle: the settings of a vehicle's dialect, None for other devices.
    """

    name: str
    device: str
    address: LinkAddress
    baud: int | None
    is_sonar: bool
    sides: Sides
    commands: tuple[bytes, ...]
    ask_every_s: float | None
    unit: NavUnitSettings | None
    vehicle: VehicleSettings | None = None

    @property
    def is_for_commands(self) -> bool:
        """Return whether a sonar takes commands here and sends its pings elsewhere."""
        return self.is_sonar and self.unit is None and self.name.endswith(".commands")

    @property
    def is_bus(self) -> bool:
        """Return whether it carries CAN frames instead of bytes."""
        return isinstance(self.address, CanAddress | SlcanAddress)


def read_ports(config: Config, *, sends: bool = True) -> tuple[PortSettings, ...]:
    """List the ports of a configuration; wires for commands are ports NAME.commands, for pulses NAME.pulse.

    sends: settings that no command would carry are refused. Raises UsageError, with the key's path, for a link or
    setting that its device cannot have, and for a fence that is no area.
    """
    Guard(config.vehicle)
    for index, port in enumerate(config.ports):
        if sends and port.sonar is not None and port.sonar.range_m is None:
            _refuse_unsent(port.sonar, f"ports[{index}].sonar")
    return tuple(
        served for index, port in enumerate(config.ports) for served in _ports(port, f"ports[{index}]", config.sonar)
    )


def open_to_all(ports: Iterable[PortSettings]) -> list[Notice]:
    """Report the UDP ports without a `peer`, which hear every sender: no protocol identifies the sender."""
    notices = []
    for port in ports:
        if isinstance(port.address, UdpAddress) and not port.address.peer_host:
            what = "move its position" if port.unit else "add or hide contacts"
            can = "pose as the vehicle: grant control, revoke it, and report a false position" if port.vehicle else what
            text = (
                f"port '{port.name}' ({port.address.place}) accepts every sender: anybody who can reach it can {can}. "
                "Add peer=HOST:PORT of the device to its link, so that others are refused."
            )
            notices.append(Notice(code="port_open_to_all", text=text, place=port.name))
    return notices


def without_sonar(ports: Sequence[PortSettings]) -> list[Notice]:
    """Report that no port has a sonar, so that a mission would find nothing."""
    if not ports or any(port.is_sonar for port in ports):
        return []
    names = ", ".join(port.name for port in ports)
    text = f"no sonar among the ports ({names}): nothing will be found. Add the sonar's port, or correct its device."
    return [Notice(code="no_sonar", text=text)]


def merge_settings(config: Config, ports: tuple[PortSettings, ...]) -> NavMergeSettings:
    """Return how the navigation of all ports becomes one track."""
    return NavMergeSettings(
        units={port.name: port.unit for port in ports if port.unit is not None},
        max_speed_mps=config.navigation.max_speed_mps,
        recover_s=config.navigation.recover_s,
        surface_depth_m=config.navigation.surface_depth_m,
    )


def _ports(port: PortConfig, key: str, sonar: SonarConfig) -> tuple[PortSettings, ...]:
    served = _port(port, key, sonar.subsystem)
    if served.unit is not None and served.unit.pulse_link is not None:
        return served, _pulse(served, served.unit.pulse_link, f"{key}.navigation.pulse_link")
    if port.sonar is None or port.sonar.command_link is None:
        return (served,)
    address = _address(port.sonar.command_link, f"{key}.sonar.command_link", port.device)
    commander = served._replace(name=f"{port.name}.commands", address=address, baud=_baud(address), unit=None)
    return served._replace(commands=(), ask_every_s=None), commander


def _port(port: PortConfig, key: str, subsystem: int | None) -> PortSettings:
    address = _address(port.link, f"{key}.link", port.device)
    baud = _baud(address)
    kind = device_kind(port.device)
    is_sonar, is_vehicle = kind == "sonar", kind == "vehicle"
    unit = port.navigation if is_sonar or is_vehicle else port.navigation or NavUnitSettings()
    if unit is not None and unit.baud is None:
        unit = structs.replace(unit, baud=baud)
    sonar = port.sonar or SonarPortConfig()
    commands, asked = _commands(port, sonar, key, subsystem) if is_sonar else ((), False)
    return PortSettings(
        name=port.name,
        device=port.device,
        address=address,
        baud=baud,
        is_sonar=is_sonar,
        sides=sonar.sides,
        commands=commands,
        ask_every_s=sonar.ping_interval_s if asked and commands else None,
        unit=unit,
        vehicle=vehicle_settings_of(port, key) if is_vehicle else None,
    )


def _refuse_unsent(sonar: SonarPortConfig, key: str) -> None:
    """Refuse what a person set and no command would carry."""
    as_it_is = SonarPortConfig()
    for name in ("enabled", "gain", "n_samples", "sound_speed_mps"):
        if getattr(sonar, name) != getattr(as_it_is, name):
            what = f"{name} is set" if sonar.enabled else "enabled is false"
            raise UsageError(f"{key}.{what}, but no command is sent without range_m: give the range as well")


def _pulse(unit: PortSettings, link: str, key: str) -> PortSettings:
    address = parse_link_uri(link, key)
    if not isinstance(address, PulseAddress):
        raise UsageError(f"{key} '{link}': not a source of pulses; use a pps:// link, e.g. pps:///dev/pps0")
    return unit._replace(name=f"{unit.name}.{PULSE}", device=PULSE, address=address, baud=None, unit=None)


def _address(link: str, key: str, device: str) -> LinkAddress:
    """Parse the address of a link that carries what the device speaks."""
    address = parse_link_uri(link, key)
    is_bus = isinstance(address, CanAddress | SlcanAddress)
    needs_bus = device == CAN_PROTOCOL or (device_kind(device) == "vehicle" and vehicle_named(device).is_bus)
    if is_bus != needs_bus or isinstance(address, PulseAddress):
        needed = "a slcan:// or socketcan:// link" if needs_bus else "a serial://, tcp:// or udp:// link"
        raise UsageError(f"{key} '{link}': a device '{device}' needs {needed}")
    return address


def _baud(address: LinkAddress) -> int | None:
    return address.baud if isinstance(address, SerialAddress) else None


def _commands(
    port: PortConfig, sonar: SonarPortConfig, key: str, subsystem: int | None
) -> tuple[tuple[bytes, ...], bool]:
    """Return the commands to send, and whether to send them for each ping."""
    device = sonar_named(port.device)
    if sonar.range_m is None:
        if device.asked_per_ping:
            raise UsageError(
                f"{key}.sonar.range_m is empty, but a '{port.device}' does not ping before its range is set: give one"
            )
        return (), False
    settings = SonarSettings(
        range_m=sonar.range_m,
        enabled=sonar.enabled,
        gain=sonar.gain,
        n_samples=sonar.n_samples,
        sound_speed_mps=sonar.sound_speed_mps,
        subsystem=subsystem,
    )
    try:
        return device.commands(settings), device.asked_per_ping
    except UsageError as error:
        raise UsageError(f"{key}.sonar: {error}") from error
