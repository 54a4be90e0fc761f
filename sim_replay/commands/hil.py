"""Run the real service between fake devices that fail on demand."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from auv_mcm.commands import Commands, add_json_option, answer, command
from auv_mcm.commands.tables import show_table
from auv_mcm.errors import SelfCheckError, UsageError


def add(commands: Commands) -> None:
    """Add `auv-mcm hil` to the command line."""
    parser = command(
        commands,
        "hil",
        "run the service between fake devices with faults, and judge what it does",
        "A SCENARIO is a YAML file or the name of one that ships with the package (--list). It says which devices are "
        "at which\n"
        "virtual ports, what goes wrong when, and what is expected of the service then. Service and devices run as "
        "processes\n"
        "of their own, and all are gone when the command ends. One line per expectation, verdict.json for scripts and "
        "junit.xml\n"
        "for CI servers; exit code 5 if any is not met.",
        [
            "auv-mcm hil --list",
            "auv-mcm hil clean",
            "auv-mcm hil sonar_replug my-scenario.yaml --out hil",
            "auv-mcm hil --all                                     every scenario that ships, 20 minutes in all",
        ],
    )
    parser.add_argument(
        "scenarios", metavar="SCENARIO", nargs="*", help="YAML file, or name of a scenario that ships with the package"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("hil-out"),
        help="logs and results, a directory per scenario (default hil-out)",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--list", action="store_true", help="list the scenarios that ship with the package")
    instead.add_argument("--all", action="store_true", help="run all of them, one after the other")
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.hil.scenario import read_scenario, shipped

    if arguments.list:
        about = {name: read_scenario(name).scenario.about for name in shipped()}
        if arguments.json:
            answer({"scenarios": about}, (), as_json=True)
        else:
            show_table("", (), list(about.items()))
        return 0
    if arguments.all and arguments.scenarios:
        raise UsageError("--all runs every scenario that ships: leave the SCENARIO names out")
    names = shipped() if arguments.all else arguments.scenarios
    if not names:
        raise UsageError("a SCENARIO is needed; 'auv-mcm hil --list' shows those that ship with the package")

    from auv_mcm.shell.whole_files import write_file, write_json
    from sim_replay.hil.run import run_scenario  # needs the bench extra, which a list does not
    from sim_replay.hil.verdict import as_junit, judge, table_rows

    failed = []
    for read in [read_scenario(name) for name in names]:
        folder = arguments.out / read.name
        if not arguments.json:
            print(f"{read.name}: {read.scenario.about}")
        _say(f"{read.scenario.run_s:g} s of mission")
        evidence = run_scenario(read, folder, _say)
        verdicts = [judge(expectation, evidence) for expectation in read.scenario.expectations]
        if arguments.json:
            passed = all(verdict.passed for verdict in verdicts)
            found = {"scenario": read.name, "passed": passed, "expectations": [one._asdict() for one in verdicts]}
            answer(found, (), as_json=True)
        else:
            colours = {"passed": "green", "FAILED": "red"}
            show_table("", ("", "Test", "Expected", "Found"), table_rows(verdicts), colours)
            print(flush=True)
        write_json(folder / "verdict.json", [verdict._asdict() for verdict in verdicts])
        write_file(folder / "junit.xml", as_junit(read.name, verdicts))
        if not all(verdict.passed for verdict in verdicts):
            failed.append(
                f"{read.name} ({sum(not verdict.passed for verdict in verdicts)} of {len(verdicts)}; see {folder})"
            )
    if failed:
        raise SelfCheckError(f"expectations were not met: {', '.join(failed)}")
    return 0


def _say(line: str) -> None:
    print(f"  {line}", file=sys.stderr, flush=True)
