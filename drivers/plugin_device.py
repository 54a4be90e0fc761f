"""Use devices that other packages add: check what their code returns, and report what it raises as a person can use
it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, TypeVar, cast

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import Plugin, find_device, remedy
from auv_mcm.settings.port_settings import DeviceKind
from drivers.plugin_records import check_record, clean_counters, own_samples

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
    except (Exception, SystemExit) as error:  # code of others raises whatever it likes
        raise UsageError(f"{plugin}: failed with {error!r}. {remedy(plugin)}") from error


def checked_decoder(plugin: Plugin, make: Callable[..., T], expected: Any, *items: type) -> Callable[..., T]:
    """Wrap a maker of decoders as `checked` does, and its decoders so that they give whole `items` alone."""
    make_checked = checked(plugin, make, expected)
    return lambda *arguments: cast(T, _CheckedDecoder(make_checked(*arguments), items))


class _CheckedDecoder:
    """Call a decoder of a plug-in. Raises TypeError for what its interface does not allow it to return."""

    def __init__(self, decoder: Any, items: tuple[type, ...]) -> None:
        self._decoder, self._items = decoder, items

    @property
    def counters(self) -> Counter[str]:
        return clean_counters(self._decoder.counters)

    @property
    def bus_counters(self) -> Counter[str]:
        return clean_counters(self._decoder.bus_counters)

    def feed(self, data: Any, stamp: Stamp) -> list[Any]:
        return self._checked(lambda: self._decoder.feed(data, stamp))

    def finish(self) -> list[Any]:
        return self._checked(self._decoder.finish)

    def _checked(self, work: Callable[[], Any]) -> list[Any]:
        try:
            given = [*work()]
        except SystemExit as error:
            raise RuntimeError(f"it called sys.exit({error.code!r})") from error
        for item in given:
            check_record(item, *self._items)
        return [own_samples(item) if hasattr(item, "starboard") else item for item in given]
