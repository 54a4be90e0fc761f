"""Check the drivers, vehicle dialects and log readers that other packages add."""

from __future__ import annotations

from collections.abc import Iterator

from auv_mcm.errors import UsageError
from auv_mcm.settings.plugins import GROUPS, find_plugins, plugin_problem
from auv_mcm.settings.port_settings import DEVICE_NAMES
from auv_mcm.shell.check.finding import Finding
from auv_mcm.shell.registry import PLUGIN_LOADERS, load


def plugin_findings() -> Iterator[Finding]:
    """Import every plug-in that is installed, and list it.

    One that cannot be used is a warning, for it may not be needed.
    """
    plugins = find_plugins()
    if not plugins:
        yield Finding("plug-ins", "ok", "none installed")
    for plugin in plugins:
        name, what = f"plug-in {plugin.name}", f"{GROUPS[plugin.kind]}, {plugin.package}, {plugin.target}"
        if problem := plugin_problem(plugin, DEVICE_NAMES):
            yield Finding(name, "warning", f"{what}: {problem}")
            continue
        try:
            load(PLUGIN_LOADERS[plugin.kind])(plugin)
        except (UsageError, ImportError) as error:
            yield Finding(name, "warning", str(error))
        else:
            yield Finding(name, "ok", what)
