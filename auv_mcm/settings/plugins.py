"""Find the devices and log formats that other packages add through entry points.

A package adds one with a line in its pyproject.toml and nothing else:

    [project.entry-points."auv_mcm.sonar"]
    my_sonar = "my_package.my_sonar:SONAR"

| group | the object that the line names | a configuration names it by |
|---|---|---|
| `auv_mcm.sonar` | a `drivers.sonar.sonars.SonarDevice` | `device:` of a port |
| `auv_mcm.navigation` | makes a `drivers.navigation.nav_decoder.NavDecoder`, given the port's name | `device:` of a
port |
| `auv_mcm.vehicle` | a `drivers.vehicle.vehicles.VehicleKind` | `device:` of a port |
| `auv_mcm.logs` | a `sim_replay.logs.log_reader.LogReader` | nothing: a log is recognised by its content |

Names that are not built in are looked up here, and only then is the list of installed packages read. A plug-in is
imported only if a configuration names it or, for a log, if no built-in format is recognised. A built-in name always
means the built-in device.
"""

from __future__ import annotations

import functools
import re
import sys
from typing import Any, Final, Literal, NamedTuple, TypeAlias, TypeVar

from auv_mcm.errors import UsageError

T = TypeVar("T")

PluginKind: TypeAlias = Literal["sonar", "navigation", "vehicle", "logs"]
GROUPS: Final[dict[PluginKind, str]] = {
    "sonar": "auv_mcm.sonar",
    "navigation": "auv_mcm.navigation",
    "vehicle": "auv_mcm.vehicle",
    "logs": "auv_mcm.logs",
}
"""Entry-point groups; all but `logs` share one set of names, the values of `device:`."""

NAME_PATTERN: Final = r"^[a-z][a-z0-9_]{0,31}$"
"""Names that a plug-in can have, as those of ports: they stand in counters, messages and recordings."""


_RESERVED: Final = ("pulse",)  # the device of a wire on which a unit's pulses come in


class Plugin(NamedTuple):
    """Name one entry point. target: `module:attribute`. package: name and version of the package that adds it."""

    kind: PluginKind
    name: str
    target: str
    package: str

    def __str__(self) -> str:
        return f"{self.name} ({GROUPS[self.kind]}) of {self.package}"


def find_plugins() -> tuple[Plugin, ...]:
    """List the plug-ins of all installed packages by kind and name. Imports none of them."""
    return _installed(tuple(sys.path))


def plugin_problem(plugin: Plugin, built_in: tuple[str, ...]) -> str:
    """Explain why a plug-in cannot be used by its name: what is wrong and what to do; empty if it can.

    built_in: names of the built-in devices.
    """
    if plugin.name in built_in and plugin.kind != "logs":
        return f"'{plugin.name}' is a built-in device, which is used instead. Give the plug-in another name"
    if plugin.name in _RESERVED or not re.match(NAME_PATTERN, plugin.name):
        return f"'{plugin.name}' is not a valid name. Use a small letter, then at most 31 small letters, digits and '_'"
    same = [
        other
        for other in find_plugins()
        if other.name == plugin.name and (other.kind == "logs") == (plugin.kind == "logs")
    ]
    if len(same) > 1:
        return (
            f"'{plugin.name}' is added more than once: {'; '.join(map(str, same))}. Uninstall all but one of these "
            "packages"
        )
    return ""


def find_device(name: str) -> Plugin | None:
    """Find the device that another package adds by this name, None if no package does.

    Call it for names that are not built in. Raises UsageError if the name is added twice.
    """
    found = next((plugin for plugin in find_plugins() if plugin.name == name and plugin.kind != "logs"), None)
    if found is not None and (problem := plugin_problem(found, ())):
        raise UsageError(f"device {problem}")
    return found


def load_plugin(plugin: Plugin, expected: type[T]) -> T:
    """Import the object that a plug-in names.

    Raises UsageError if the import fails, or if the object is not of the expected type.
    """
    loaded = import_plugin(plugin)
    if not isinstance(loaded, expected):
        needed = f"{expected.__module__}.{expected.__qualname__}"
        raise UsageError(
            f"{plugin}: {plugin.target} is of type {type(loaded).__name__}, not {needed}. {remedy(plugin)}"
        )
    return loaded


def import_plugin(plugin: Plugin) -> Any:
    """Import the object that a plug-in names, of any type. Raises UsageError if that fails."""
    from importlib.metadata import EntryPoint

    try:
        return EntryPoint(plugin.name, plugin.target, GROUPS[plugin.kind]).load()
    except (Exception, SystemExit) as error:  # code of others raises whatever it likes
        reason = str(error).splitlines()[0] if str(error) else "no reason given"
        text = f"{plugin}: {plugin.target} cannot be imported ({type(error).__name__}: {reason}). {remedy(plugin)}"
        raise UsageError(text) from error


def remedy(plugin: Plugin) -> str:
    """Say what a person can do about a plug-in that does not work."""
    return f"Update or uninstall {plugin.package}, or report it to its makers"


@functools.lru_cache(maxsize=1)
def _installed(path: tuple[str, ...]) -> tuple[Plugin, ...]:
    """List the plug-ins found on a module search path; packages do not change while a process runs."""
    from importlib.metadata import entry_points  # 23 ms of processor time, paid only where a plug-in may be meant

    found = []
    for kind, group in GROUPS.items():
        for entry in entry_points(group=group):
            package = "a package without a name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
            found.append(Plugin(kind, entry.name, entry.value, package))
    return tuple(sorted(set(found)))
