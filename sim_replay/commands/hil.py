"""Run the real service between fake devices that fail on demand."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from auv_mcm.commands import Commands, add_json_option, answer, command
from auv_mcm.commands.tables import show_table
from auv_mcm.errors import HardwareError, SelfCheckError, UsageError

if TYPE_CHECKING:
    from sim_replay.hil.scenario import Read


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

    failed, absent = [], []
    reads = [read_scenario(name) for name in names]
    if twice := [name for name, n in Counter(read.name for read in reads).items() if n > 1]:
        raise UsageError(f"'{twice[0]}' is given twice, and each writes to {arguments.out / twice[0]}: rename a file")
    for read in reads:
        folder = arguments.out / read.name
        if not arguments.json:
            print(f"{read.name}: {read.scenario.about}")
        try:
            passed = _passed(read, folder, as_json=arguments.json)
        except HardwareError as error:  # of one scenario, which is to cost no other
            absent.append(f"{read.name}: {error}")
            continue
        if not all(passed):
            failed.append(f"{read.name} ({passed.count(False)} of {len(passed)}; see {folder})")
    if absent:
        raise HardwareError("; ".join(absent + failed))
    if failed:
        raise SelfCheckError(f"expectations were not met: {', '.join(failed)}")
    return 0


def _passed(read: Read, folder: Path, *, as_json: bool) -> list[bool]:
    """Run a scenario and answer with its verdicts; return which passed. Raises HardwareError if it did not come up."""
    from auv_mcm.shell.whole_files import make_directory, write_file, write_json
    from sim_replay.hil.run import JUNIT, VERDICT, run_scenario  # needs the bench extra, which a list does not
    from sim_replay.hil.verdict import Verdict, as_junit, judged, table_rows
    from sim_replay.results_folder import kept_alone

    _say(f"{read.scenario.run_s:g} s of mission")
    with kept_alone(make_directory(folder)):  # or one run is judged by what another has written
        began_s, mono_s = time.time(), time.monotonic()
        absent = None
        try:
            verdicts = judged(read.scenario.expectations, run_scenario(read, folder, _say))
        except HardwareError as error:
            absent = error
            found = " ".join(str(error).split())
            verdicts = [Verdict("the run takes place", "the service and its devices come up", found, passed=False)]
        passed = [verdict.passed for verdict in verdicts]
        outcomes = [verdict._asdict() for verdict in verdicts]
        if as_json:
            answer({"scenario": read.name, "passed": all(passed), "expectations": outcomes}, (), as_json=True)
        else:
            colours = {"passed": "green", "FAILED": "red"}
            show_table("", ("", "Test", "Expected", "Found"), table_rows(verdicts), colours)
            print(flush=True)
        write_json(folder / VERDICT, outcomes)
        write_file(folder / JUNIT, as_junit(read.name, verdicts, began_s, time.monotonic() - mono_s))
    if absent is not None:
        raise absent
    return passed


def _say(line: str) -> None:
    print(f"  {line}", file=sys.stderr, flush=True)
