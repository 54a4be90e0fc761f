"""Show how the service is."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

from auv_mcm.commands import Commands, add_config_option, command, read_config

if TYPE_CHECKING:
    from auv_mcm.shell.health.record import Health

_RUNTIME: Final = Path("/run/auv-mcm")  # the unit's RuntimeDirectory
_WATCH_S: Final = 1.0  # s between two looks
_HOME_AND_CLEAR: Final = "\x1b[H\x1b[J"  # ECMA-48: to the first line, and erase from there


def add(commands: Commands) -> None:
    """Add `auv-mcm status` to the command line."""
    parser = command(
        commands,
        "status",
        "show how the running service is",
        "Reads the newest record of health, health.json: of the session named, or of the service that systemd runs, or "
        "of\n"
        "the last session below service.output_directory. Each line is a part with its state (boot, normal, degraded,\n"
        "fault), the reasons and what was measured; below is what each reason means and what to do. Exit code 4 for a\n"
        "fault, and for a record that is too old because the service does not run or hangs.",
        [
            "auv-mcm status",
            "auv-mcm status --watch                                  again each second, until Ctrl-C",
            "auv-mcm status auv-mcm-out/latest --json",
        ],
    )
    parser.add_argument("session", metavar="SESSION", nargs="?", type=Path, help="folder of a session")
    add_config_option(parser)
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--json", action="store_true", help="print the record as JSON on one line")
    how.add_argument("--watch", action="store_true", help="show it again each second, until Ctrl-C")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.shell.health.files import read_health

    path = _path(arguments)
    health = read_health(path)
    if arguments.json:
        sys.stdout.buffer.write(health.to_json() + b"\n")
        return _exit_code(health)
    if arguments.watch:
        _watch(path)
    print(_shown(health))
    return _exit_code(health)


def _watch(path: Path) -> NoReturn:
    """Show the record each second, until interrupted. Raises what reading it raises."""
    from auv_mcm.shell.health.files import read_health

    while True:
        print(_HOME_AND_CLEAR + _shown(read_health(path)), flush=True)
        time.sleep(_WATCH_S)


def _path(arguments: argparse.Namespace) -> Path:
    """Find the record to show."""
    from auv_mcm.shell.health.files import HEALTH
    from auv_mcm.shell.latest_session import latest_session

    if arguments.session is not None:
        return Path(arguments.session) / HEALTH
    if arguments.config is None and (_RUNTIME / HEALTH).exists():
        return _RUNTIME / HEALTH
    return latest_session(Path(read_config(arguments.config).service.output_directory)) / HEALTH


def _shown(health: Health) -> str:
    from auv_mcm.shell.health.text import health_table

    now_s = time.time()
    text = health_table(health, now_s - health.utc_s)
    if health.is_late(now_s):
        text += (
            f"\n\nTHIS IS OLD: a record is due each {health.period_s:g} s. The service does not run, or hangs: "
            "systemctl status auv-mcm"
        )
    return text


def _exit_code(health: Health) -> int:
    from auv_mcm.errors import HardwareError

    return HardwareError.exit_code if health.is_late(time.time()) or health.state == "fault" else 0
