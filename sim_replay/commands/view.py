"""Open logs, results or a session in a browser, to look at, judge and measure."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.commands import Commands, add_config_option, command, whole


def add(commands: Commands) -> None:
    """Add `auv-mcm view` to the command line."""
    parser = command(
        commands,
        "view",
        "open a log, results or a session in a browser: waterfall, map, contacts to judge and measure",
        "Serves one page at this computer until Ctrl-C. Name logs, or a folder of logs, to see them at once: they "
        "share one map, and are replayed meanwhile into a folder named after the first one, LOG-results. Or name a "
        "folder with the results of a replay, or a session of 'auv-mcm run', finished or running; with --live, it may "
        "begin later and is the last one below service.output_directory unless it is named. The waterfall is "
        "made anew from the logs or the recording. What is judged is appended to verdicts.jsonl "
        "in the folder of the results.",
        [
            "auv-mcm view mission.xtf",
            "auv-mcm view surveys",
            "auv-mcm view results",
            "auv-mcm view --live",
            "auv-mcm view --live out-demo/hil/clean/results/latest",
        ],
    )
    parser.add_argument(
        "paths",
        metavar="LOG|FOLDER",
        nargs="*",
        type=Path,
        help="logs, a folder of logs, results of a replay, or a session",
    )
    parser.add_argument("--live", action="store_true", help="follow a session that runs or is about to begin")
    parser.add_argument(
        "--log",
        metavar="LOG",
        action="append",
        type=Path,
        help="log for the waterfall, repeatable; needed where logs have moved without their results",
    )
    parser.add_argument(
        "--port", metavar="N", type=whole(0, 65535), default=0, help="port of the page (default: any that is free)"
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        default="127.0.0.1",
        help="address to listen at (default 127.0.0.1, this computer alone); whoever reaches it can look and judge",
    )
    parser.add_argument("--chart", metavar="FILE", type=Path, help="GeoTIFF to show below the map: a sea chart, depths")
    parser.add_argument("--by", metavar="NAME", default="", help="who judges (default: your user name)")
    parser.add_argument("--open", action="store_true", help="open the page in the default browser")
    add_config_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.view.show import show

    return show(
        arguments.paths,
        live=arguments.live,
        logs=arguments.log or [],
        config_path=arguments.config,
        host=arguments.host,
        port=arguments.port,
        by=arguments.by,
        chart_path=arguments.chart,
        open_browser=arguments.open,
    )
