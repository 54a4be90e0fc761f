"""Name what the payload uses of drivers and bench, as `module:name`; each is imported on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from auv_mcm.settings.plugins import PluginKind

SOURCES: Final[dict[str, str]] = {
    "ports": "drivers.port_source:open_source",
    "replay": "sim_replay.logs.recorded:open_source",
}
"""Openers of sources, by the scheme of `service.source`."""

RECORDER: Final = "drivers.recording.start_recording:start_recording"
READ_PORTS: Final = "drivers.ports:read_ports"
PORTS_EXAMPLE: Final = "drivers.describe:example_text"
PORTS_INTERFACE: Final = "drivers.describe:interface_text"
PORT_CHECK: Final = "drivers.port_check:port_findings"
BENCH_CHECK: Final = "sim_replay.bench_check:bench_findings"
DESCRIBE_LOG: Final = "sim_replay.logs.open_log:describe_log"
LOG_DOUBT: Final = "sim_replay.logs.open_log:kind_doubt"

PLUGIN_LOADERS: Final[dict[PluginKind, str]] = {
    "sonar": "drivers.sonar.sonars:sonar_of",
    "navigation": "drivers.navigation.nav_protocols:nav_maker_of",
    "vehicle": "drivers.vehicle.vehicles:vehicle_of",
    "logs": "sim_replay.logs.log_reader:reader_of",
}
"""What imports and checks a plug-in of each kind."""

COMMANDS: Final[dict[str, str]] = {
    "replay": "sim_replay.commands.replay:add",
    "info": "sim_replay.commands.info:add",
    "view": "sim_replay.commands.view:add",
    "batch": "sim_replay.commands.batch:add",
    "export": "sim_replay.commands.export:add",
    "report": "sim_replay.commands.report:add",
    "verdicts": "sim_replay.commands.verdicts:add",
    "run": "auv_mcm.commands.run:add",
    "status": "auv_mcm.commands.status:add",
    "simulate": "sim_replay.commands.simulate:add",
    "augment": "sim_replay.commands.augment:add",
    "score": "sim_replay.commands.score:add",
    "train": "sim_replay.commands.train:add",
    "calibrate": "sim_replay.commands.calibrate:add",
    "check": "auv_mcm.commands.check:add",
    "config": "auv_mcm.commands.config:add",
    "hil": "sim_replay.commands.hil:add",
    "bench": "sim_replay.commands.bench:add",
}
"""Subcommands in the order of the help. Those of the bench are absent where `sim_replay` is not installed."""

COMPLETION: Final = "sim_replay.completion:completion"
COMMAND_GROUPS: Final = {
    "look at missions": ("info", "view", "replay", "report", "verdicts", "export", "batch"),
    "on the vehicle": ("run", "status", "check", "config"),
    "simulate and test": ("simulate", "score", "augment", "hil"),
    "fit and measure, for those who change the models": ("train", "calibrate", "bench"),
}
"""Subcommands by purpose, as the help lists them."""


def load(name: str) -> Any:
    """Import the object that `module:name` names. Raises ModuleNotFoundError or AttributeError."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)
