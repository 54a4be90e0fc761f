"""The self-check."""

from __future__ import annotations

import argparse

from auv_mcm.commands import Commands, add_config_option, command, read_config


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "check",
        "check that this installation does what it should",
        "Looks at Python, packages, the C kernels against numpy, shared memory, the perception process, the output\n"
        "directory and the configuration. Changes nothing. Exit code 5 if something failed; a warning is no failure.",
        ["auv-mcm check", "auv-mcm check --config vehicle.yaml"],
    )
    add_config_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.shell.check import run_checks

    return run_checks(lambda: read_config(arguments.config), print)
