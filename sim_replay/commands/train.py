"""Train the detector's cascade."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config, whole
from auv_mcm.errors import UsageError
from sim_replay.arguments import check_new

_MAX_COUNT = 1_000_000  # a larger number is a slip: the training would run for years


def add(commands: Commands) -> None:
    """Add `auv-mcm train` to the command line."""
    parser = command(
        commands,
        "train",
        "train the detector's cascade from simulated missions and augmented logs",
        "Renders labelled tiles as a YAML file says, or takes those of a folder, and writes a model file for "
        "'detect.model'. Without a SPEC the set that ships is rendered. The same files and seeds give the same bytes "
        "on one platform. --all fits all that follows the detector as well, on missions with the SPEC's scenes and "
        "sonars, and compares it with what ships on the split 'test'; --network leaves the detector as it ships and "
        "fits what separates mines from stones, in a fraction of the time. A run that was interrupted goes on.",
        [
            "auv-mcm train --out model.json",
            "auv-mcm train theatre.yaml --out model.json --tiles tiles",
            "auv-mcm train theatre.yaml --all --config vehicle.yaml --out theatre",
            "auv-mcm train theatre.yaml --network --out theatre",
            "auv-mcm train theatre.yaml --out model.json --scheduler tcp://10.0.0.1:8786",
        ],
    )
    parser.add_argument(
        "spec", nargs="?", type=Path, metavar="SPEC", help="YAML file: what to render (default: the set that ships)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="new file for the model, JSON; with --all or --network a folder",
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help="fit odds, gate, background and detection performance too, and write a configuration that names them",
    )
    parser.add_argument(
        "--network",
        action="store_true",
        help="train the network that verifies detections, and fit what goes by it; the detector as it ships",
    )
    add_config_option(parser)
    parser.add_argument(
        "--tiles",
        type=Path,
        metavar="DIR",
        help="folder of the tiles; rendered into it unless it holds those of the spec",
    )
    parser.add_argument("--kind", choices=("soft",), default="soft", help=argparse.SUPPRESS)
    parser.add_argument(
        "--stumps", metavar="N", type=whole(1, _MAX_COUNT), help="stumps (default: as the model that ships)"
    )
    parser.add_argument(
        "--workers",
        metavar="N",
        type=whole(1, _MAX_COUNT),
        default=2,
        help="tasks at once on this computer (default 2)",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="run the tasks on a dask cluster, tcp://HOST:PORT")
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.fitting.cascade.farm import Farm
    from sim_replay.fitting.cascade.train_cascade import train_model
    from sim_replay.fitting.cascade.trainer import N_STUMPS

    started_s = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - started_s:6.0f} s  {line}", file=sys.stderr, flush=True)

    farm, n_stumps = Farm(arguments.workers, arguments.scheduler), arguments.stumps or N_STUMPS
    config = read_config(arguments.config)

    def train(out: Path) -> None:
        tiles, sonar = arguments.tiles, config.sonar
        train_model(arguments.spec, out, tiles=tiles, n_stumps=n_stumps, farm=farm, say=say, sonar=sonar)

    if arguments.all and arguments.network:
        raise UsageError("--all trains the network too: give one of --all and --network")
    if not (arguments.all or arguments.network):
        check_new(arguments.out)
        train(arguments.out)
        answer({"model": arguments.out}, [f"model: {arguments.out}"], as_json=arguments.json)
        return 0
    from auv_mcm.safe_files import read_regular
    from sim_replay.fitting.fit_theatre import CONFIG, fit_theatre
    from sim_replay.fitting.theatre import read_theatre

    if arguments.spec is None:
        raise UsageError(
            "--all and --network need a SPEC that names scenes, sonars and augmented lines: see docs/how-to"
        )
    options = f"--theatre {arguments.spec}"
    theatre = read_theatre(arguments.spec, config, options)
    spec, out, alone = read_regular(arguments.spec), arguments.out, arguments.network
    if n_stumps != N_STUMPS and not alone:
        spec += f"\n# {n_stumps} stumps\n".encode()  # a folder of others is not gone on in
    tables = fit_theatre(theatre, config, spec, out, train, farm, _watched, network_alone=alone)
    made = arguments.out / CONFIG
    answer({"config": made, "judged": tables.splitlines()}, [tables, f"configuration: {made}"], as_json=arguments.json)
    return 0


@contextmanager
def _watched(step: str) -> Iterator[Callable[[int, int], None]]:
    with Progress(step) as progress:
        yield lambda done, of: progress.show(done / max(of, 1))
