"""Replay an archive of logs, each as a mission of its own, and find what several missions saw."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.clean_text import clean
from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config
from auv_mcm.errors import BadInputError
from sim_replay.arguments import count


def add(commands: Commands) -> None:
    """Add `auv-mcm batch` to the command line."""
    parser = command(
        commands,
        "batch",
        "replay an archive of logs, and find what is new, gone or seen again",
        "Replays every log below FOLDER, or in LIST, into DIR/missions/, as 'auv-mcm replay' does. Contacts of "
        "different\n"
        "missions are joined into objects: index.html and index.geojson say which are new, gone or seen again. A log "
        "that\n"
        "fails is reported there and stops no other; the exit code is then 3. Run the same command again to go on "
        "after an\n"
        "interruption: what was replayed with the same configuration is kept.",
        [
            "auv-mcm batch surveys --out results",
            "auv-mcm batch logs.txt --out results --config vehicle.yaml --workers 4",
            "auv-mcm batch surveys --out results --scheduler tcp://10.0.0.5:8786",
        ],
    )
    parser.add_argument(
        "source",
        metavar="FOLDER|LIST",
        type=Path,
        help="folder of logs (.xtf, .jsf, .sdf, .sl2, .son ...) and sessions, or a text file with a path a line",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder for the results")
    add_config_option(parser)
    parser.add_argument("--workers", metavar="N", type=count, default=2, help="logs replayed at once (default 2)")
    parser.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="replay on the cluster of this dask scheduler, whose workers see the same folders",
    )
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.batch.index import write_index
    from sim_replay.batch.missions import MISSIONS, MissionTask, locked, replay_missions
    from sim_replay.fitting.cascade.farm import Farm
    from sim_replay.logs.archive import logs_of

    config = None if arguments.config is None else read_config(arguments.config)
    logs, out = logs_of(arguments.source, arguments.out), arguments.out.absolute()
    with locked(out), Progress("batch") as progress:
        tasks = [MissionTask(log, out / MISSIONS / log.name, config) for log in logs]
        farm = Farm(arguments.workers, arguments.scheduler)
        outcomes = list(replay_missions(tasks, farm, lambda done: progress.show(done / len(tasks))))
        objects = write_index(out, outcomes, (config or read_config(None)).contacts)
    failed = [outcome for outcome in outcomes if outcome.failure]
    index = arguments.out / "index.html"
    done = {
        "logs": len(outcomes),
        "failed": [{"log": outcome.log.name, "why": outcome.failure} for outcome in failed],
        "objects": len(objects),
        "index": index,
    }
    logs_done = f"{len(outcomes)} log{'s' * (len(outcomes) > 1)}"
    words = [
        *(f"failed: {clean(outcome.log.name)}: {clean(outcome.failure)}" for outcome in failed),
        f"{logs_done}, {len(failed)} failed; {len(objects)} object{'s' * (len(objects) != 1)}",
        f"index: {index}",
    ]
    answer(done, words, as_json=arguments.json)
    return BadInputError.exit_code if failed else 0
