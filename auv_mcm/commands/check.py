"""The self-check."""

from __future__ import annotations

import argparse

from auv_mcm.commands import Commands, add_config_option, command, read_config


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "check",
        "check that this installation does what it should",
        "Looks at Python, packages and their versions, the C kernels against numpy, the models, the clock, the output\n"
        "directory and its room, the perception process and the configuration. With one, opens each of its ports and listens\n"
        "for 4 s: does the device that the configuration names speak there? Sends nothing, changes nothing, and leaves ports\n"
        "alone that another program uses. Each line says what, where and what to do. Exit code 5 if something failed; a\n"
        "warning is no failure.",
        ["auv-mcm check", "auv-mcm check --config vehicle.yaml"],
    )
    add_config_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.check import run_checks

    return run_checks(lambda: read_config(arguments.config), print)
