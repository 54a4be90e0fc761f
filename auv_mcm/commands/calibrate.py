"""A detector's budget for this computer."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

from auv_mcm.commands import Commands, add_config_option, command, read_config, write_new
from auv_mcm.errors import UsageError

_SIDES: Final = 2


def add(commands: Commands) -> None:
    parser = command(
        commands,
        "calibrate",
        "measure this computer and write the detector's budget that it can afford",
        "Measures how many comparisons of the trained cascade one core makes in a second, where nothing is rejected early, and\n"
        "sets detect.max_evaluations_per_tile so that detection takes at most the share of the time that --duty allows, at the\n"
        "highest speed over ground. Run it on the vehicle's computer, with nothing else running.",
        [
            "auv-mcm calibrate --speed 2.0 --duty 0.25",
            "auv-mcm calibrate --config vehicle.yaml --speed 2.0 --duty 0.25 --write calibrated.yaml",
        ],
    )
    add_config_option(parser)
    parser.add_argument("--speed", metavar="M/S", type=_between(0.0, 100.0), required=True, help="highest speed over ground, m/s")
    parser.add_argument("--duty", metavar="SHARE", type=_between(0.0, 1.0), default=0.25, help="of one core's time (default 0.25)")
    parser.add_argument("--write", metavar="FILE", type=Path, help="new file for the configuration with that budget")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    import msgspec

    from auv_mcm.config import config_yaml
    from auv_mcm.detect.cascade.choose import configured_model
    from auv_mcm.detect.cascade.speed import budget_for, measure_speed

    config = read_config(arguments.config)
    model = configured_model(config)
    if model is None:
        raise UsageError("detect.model is none: contrasts alone have no budget to calibrate")
    grid = config.waterfall
    period_s = grid.tile_rows * grid.row_spacing_m / arguments.speed / _SIDES
    evaluations_per_s = measure_speed(model, grid.row_spacing_m, grid.column_spacing_m)
    budget = budget_for(evaluations_per_s, period_s, arguments.duty)
    print(f"{evaluations_per_s / 1e6:.0f} million comparisons per second; a tile every {period_s:.1f} s at {arguments.speed:g} m/s")
    print(f"detect.max_evaluations_per_tile: {budget}")
    if arguments.write is not None:
        detect = msgspec.structs.replace(config.detect, max_evaluations_per_tile=budget)
        text = config_yaml(msgspec.structs.replace(config, detect=detect))
        write_new(arguments.write, text)
    return 0


def _between(low: float, high: float) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not low < number <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is no number above {low:g} and up to {high:g}")
        return number

    return parse
