"""Use devices that other packages add: check what their code returns, and report what it raises as a person can use
it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import Plugin, find_device, remedy
from auv_mcm.settings.port_settings import DeviceKind

T = TypeVar("T")


def device_plugin(kind: DeviceKind, name: str, built_in: str) -> Plugin:
    """Find a device of another package. built_in: the names that are built in, for the message.

    Raises UsageError if no package adds such a device, or several do.
    """
    plugin = find_device(name)
    if plugin is None or plugin.kind != kind:
        what = {"sonar": "sonar", "navigation": "navigation protocol", "vehicle": "vehicle's dialect"}[kind]
        raise UsageError(f"unknown {what} '{name}'. Known: {built_in}, and what other packages add")
    return plugin


def checked(plugin: Plugin, make: Callable[..., T], expected: Any) -> Callable[..., T]:
    """Wrap a maker of a plug-in so that it returns an object with every member of `expected`, or raises UsageError.

    expected: a class, or a protocol that can be checked at run time.
    """

    def make_checked(*arguments: object) -> T:
        made = called(plugin, make, *arguments)
        if isinstance(made, expected):
            return made
        missing = [member for member in dir(expected) if not member.startswith("_") and not hasattr(made, member)]
        lacks = f", which lacks {', '.join(missing)}" if missing else ""
        needed = f"{expected.__module__}.{expected.__qualname__}"
        raise UsageError(f"{plugin}: returned a {type(made).__name__}{lacks}, not a {needed}. {remedy(plugin)}")

    return make_checked


def called(plugin: Plugin, work: Callable[..., T], *arguments: object) -> T:
    """Call a plug-in's code. Raises UsageError, its own or one that names what else it raised."""
    try:
        return work(*arguments)
    except UsageError:
        raise
    except Exception as error:  # code of others raises whatever it likes
        raise UsageError(f"{plugin}: failed with {error!r}. {remedy(plugin)}") from error
