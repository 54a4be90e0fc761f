"""List the sonars with a driver, by their names in the configuration.

Other packages add sonars through entry points of the group `auv_mcm.sonar`, each naming a `SonarDevice`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from auv_mcm.records import Notice
from auv_mcm.settings.config import SonarConfig
from auv_mcm.settings.plugins import Plugin, load_plugin
from drivers.clocks import MILLISECOND_COUNTER_S
from drivers.plugin_device import called, checked_decoder, device_plugin
from drivers.sonar import imagenex, jsf, ping_protocol
from drivers.sonar.sonar_decoder import SonarDecoder, SonarFrame, SonarReply, SonarSettings


class SonarDevice(NamedTuple):
    """Describe how to communicate with one kind of sonar.

    decoder: makes a decoder for one link or log. commands: what to send so that it pings as configured, () for nothing;
    raises UsageError for settings that the device cannot have. sets_range, sets_gain, sets_enable: what of the settings
    reaches the device. asked_per_ping: it pings only when the commands are sent, once for each time. counter_period_s:
    seconds after which its counter of time starts again at 0; None if it has none.
    """

    decoder: Callable[[SonarConfig], SonarDecoder]
    commands: Callable[[SonarSettings], tuple[bytes, ...]]
    sets_range: bool = True
    sets_gain: bool = True
    sets_enable: bool = True
    asked_per_ping: bool = False
    counter_period_s: float | None = None


SONARS: Final[Mapping[str, SonarDevice]] = MappingProxyType(
    {
        "ping_protocol": SonarDevice(
            lambda sonar: ping_protocol.PingDecoder(by_number=sonar.sides == "by_number", subsystem=sonar.subsystem),
            ping_protocol.commands,
            counter_period_s=MILLISECOND_COUNTER_S,
        ),
        "jsf": SonarDevice(lambda sonar: jsf.JsfDecoder(subsystem=sonar.subsystem), jsf.commands),
        "sportscan": SonarDevice(lambda sonar: imagenex.SportScanDecoder(), imagenex.commands, asked_per_ping=True),
    }
)


def sonar_named(name: str) -> SonarDevice:
    """Return the driver of a sonar, built in or of another package.

    Raises UsageError for an unknown name, and for a driver of another package that cannot be loaded.
    """
    if name in SONARS:
        return SONARS[name]
    return sonar_of(device_plugin("sonar", name, ", ".join(SONARS)))


def sonar_of(plugin: Plugin) -> SonarDevice:
    """Import the sonar of another package. Raises UsageError if it cannot be used."""
    device = load_plugin(plugin, SonarDevice)
    return device._replace(
        decoder=checked_decoder(plugin, device.decoder, SonarDecoder, SonarFrame, SonarReply, Notice),
        commands=lambda settings: _commands(plugin, device, settings),
    )


def _commands(plugin: Plugin, device: SonarDevice, settings: SonarSettings) -> tuple[bytes, ...]:
    return called(plugin, lambda: tuple(bytes(memoryview(command)) for command in device.commands(settings)))
