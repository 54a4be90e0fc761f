"""Measure what the chain's work costs on this computer."""

from __future__ import annotations

import argparse
import importlib.util
import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

from auv_mcm.commands import Commands, add_config_option, command, read_config, write_new
from auv_mcm.errors import UsageError
from sim_replay.arguments import check_new

_BUDGET: Final = (
    "Measures what each unit of the chain's work costs on one core: stored samples, pixels, comparisons of the "
    "cascade, peaks measured, moves of contours, hypotheses on solids. --write puts these prices and the duty into a "
    "configuration. A mission counts its work by them and never looks at a clock. Run it on the vehicle's computer, "
    "with nothing else running; it takes half a minute. --speed is for the summary of what the duty buys; a mission "
    "goes by its own speed. The mission that is timed is simulated, for which the bench has to be installed; or give "
    "--log: what your own sonar recorded does as well where it shows many objects. Of what it does not show, the "
    "price in the configuration stays."
)


def add_budget(kinds: Commands) -> None:
    """Add `auv-mcm calibrate budget` to the command line."""
    parser = command(
        kinds,
        "budget",
        "measure what the chain's work costs on this computer",
        _BUDGET,
        ["auv-mcm calibrate budget --config vehicle.yaml --speed 2.0 --duty 0.25 --write calibrated.yaml"],
    )
    add_budget_options(parser, required=True)
    parser.set_defaults(command=_run_budget)


def add_budget_options(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add what the budget takes. required: of the speed."""
    add_config_option(parser)
    parser.add_argument(
        "--speed", metavar="M/S", type=_between(0.0, 100.0), required=required, help="highest speed over ground, m/s"
    )
    parser.add_argument(
        "--duty",
        metavar="SHARE",
        type=_between(0.0, 1.0),
        default=0.25,
        help="budget.duty: of one core's time (default 0.25)",
    )
    parser.add_argument(
        "--write", metavar="FILE", type=Path, help="new file for the configuration with those prices and that duty"
    )
    parser.add_argument(
        "--log", metavar="LOG", type=Path, help="measure on the beginning of a log, such as a session's recording"
    )


def run_budget_or_ask(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> int:
    """Measure the budget if there is a speed; without one nothing was chosen."""
    if arguments.speed is None:
        parser.error(
            "choose what to calibrate: background, budget, gate, odds, performance, seabed, sizes or verifier; or give "
            "--speed for the budget"
        )
    return _run_budget(arguments)


def _run_budget(arguments: argparse.Namespace) -> int:
    import msgspec

    from auv_mcm.settings.config import config_yaml
    from sim_replay.fitting.measure_prices import look_work, measure_prices, price_words

    config = read_config(arguments.config)
    check_new(arguments.write, "--write")
    if arguments.log is None and importlib.util.find_spec("scipy") is None:
        raise UsageError(
            "the mission that is timed is simulated, which needs the package scipy: python -m pip install "
            "'auv-mcm[bench]', or give --log a recording of this payload"
        )
    found = measure_prices(config, log=arguments.log)
    for name, n_units in found.n_units.items():
        if n_units == 0:
            print(f"no {name} in {arguments.log}: their prices stay as they were")
    budget = msgspec.structs.replace(found.prices, duty=arguments.duty)
    for name in budget.__struct_fields__:
        print(f"budget.{name}: {getattr(budget, name):g}")
    print(look_work(found.n_units))
    print(price_words(budget, config, arguments.speed, arguments.duty))
    if arguments.write is not None:
        write_new(arguments.write, config_yaml(msgspec.structs.replace(config, budget=budget)))
    return 0


def _between(low: float, high: float) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not low < number <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number above {low:g} and up to {high:g}")
        return number

    return parse
