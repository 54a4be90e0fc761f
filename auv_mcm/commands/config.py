"""Explain, write and check the configuration."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from auv_mcm.commands import Commands, command, write_new


def add(commands: Commands) -> None:
    """Add `auv-mcm config` to the command line."""
    parser = command(
        commands,
        "config",
        "print or write the configuration with every key explained",
        "Every key may be left out of a configuration file; its default then holds.",
        [
            "auv-mcm config --write                  print all keys with meaning, range and default",
            "auv-mcm config --write vehicle.yaml     write them to a new file",
            "auv-mcm config --schema > schema.json   JSON Schema, for editors and scripts",
        ],
    )
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument(
        "--write", metavar="PATH", nargs="?", const="-", help="write YAML with comments to PATH, or print it"
    )
    action.add_argument("--schema", action="store_true", help="print the JSON Schema")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.settings.config import Config, config_schema, config_yaml

    text = config_schema() if arguments.schema else config_yaml(Config())
    if arguments.schema or arguments.write == "-":
        sys.stdout.write(text)
        return 0
    write_new(Path(arguments.write), text)
    return 0
