"""Run the live service."""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING

from auv_mcm.commands import Commands, add_config_option, command, read_config

if TYPE_CHECKING:
    from auv_mcm.clock import Clock
    from auv_mcm.settings.config import Config


def add(commands: Commands) -> None:
    """Add `auv-mcm run` to the command line."""
    parser = command(
        commands,
        "run",
        "run the live service until its source ends or SIGINT or SIGTERM arrives",
        "The source is service.source of the configuration: ports for the devices in its section ports, whose every "
        "byte\n"
        "is recorded beside the results; replay:///path/to/mission.xtf?speed=1 plays a recorded mission (speed: times\n"
        "real time, or max). A vehicle at a port receives contact reports and, where vehicle.command\n"
        "allows it, requests for further views. Contacts go to the console once they are on disk, in contacts.jsonl "
        "of\n"
        "a new session directory below service.output_directory; clutter stays off the console. Health lines go to\n"
        "standard error.\n"
        "A signal stops the source, works off what is queued and writes all results; a second one ends at once.\n"
        "A live session that was cut off goes on at the next start (service.resume_within_h): contacts keep their\n"
        "numbers.",
        [
            "auv-mcm run --config vehicle.yaml",
            "auv-mcm run --example > vehicle.yaml                   begin with ports",
            "auv-mcm run --interface --config vehicle.yaml          what goes in and out of each port, to the byte",
        ],
    )
    add_config_option(parser)
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--interface", action="store_true", help="print every message in and out, with its port and layout, and end"
    )
    instead.add_argument(
        "--example", action="store_true", help="print the ports of an example vehicle for a configuration, and end"
    )
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    if arguments.example or arguments.interface:
        from auv_mcm.shell.registry import PORTS_EXAMPLE, PORTS_INTERFACE, load

        sys.stdout.write(
            load(PORTS_EXAMPLE)() if arguments.example else load(PORTS_INTERFACE)(read_config(arguments.config))
        )
        return 0

    return run_service(read_config(arguments.config))


def run_service(config: Config, clock: Clock | None = None) -> int:
    """Serve with log lines on standard error and results named on standard output; clock: this computer's own if None.

    Raises AuvMcmError.
    """
    import logging

    from auv_mcm.clean_text import CleanFormatter
    from auv_mcm.shell.journal_stream import JournalFormatter, is_journal
    from auv_mcm.shell.serve import serve

    if is_journal(sys.stderr):
        formatter: CleanFormatter = JournalFormatter()
    else:
        formatter = CleanFormatter("%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%S")
        formatter.converter = time.gmtime
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    folder = serve(config, clock=clock)
    print(f"results: {folder}")
    return 0
