"""Replay a recorded mission through the chain."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config, whole
from auv_mcm.skips import ALL_SKIPS, SKIPS

_DESCRIPTION: Final = """\
Writes contacts.geojson, contacts.csv, contacts.kml, waypoints.geojson, coverage.geojson, summary.json,
report.html (one file, for any browser) and snippets/ (a picture per contact). Results of an earlier replay
in the same directory are replaced. Several logs are one mission, taken in order of time. EdgeTech (.jsf) and
SonarView (.svlog) logs go through the decoders of the live ports. Sonar images
(TIFF, PNG, npy, HDF5) need a sidecar, as the page 'Replay a SAS image' says. A session that
'auv-mcm run' recorded goes through the same decoders again, with the configuration it was recorded with unless
another is given; if it was cut off and went on, all its recordings are one mission."""
_EXAMPLES: Final = [
    "auv-mcm replay mission.xtf",
    "auv-mcm replay mission.xtf --out results",
    "auv-mcm replay leg1.xtf leg2.xtf --out results --config vehicle.yaml",
    "auv-mcm replay survey.jsf --out results",
    "auv-mcm replay port.tif starboard.tif --out results",
    "auv-mcm replay auv-mcm-out/latest --out results",
]


def add(commands: Commands) -> None:
    """Add `auv-mcm replay` to the command line."""
    parser = command(
        commands, "replay", "replay recorded missions and write contacts, maps and a report", _DESCRIPTION, _EXAMPLES
    )
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="+",
        type=Path,
        help=(
            "XTF, JSF, svlog, SDF, SL2, SL3 or SON file, sonar image, or a recorded session: its folder, a recording "
            "in it, an .mcap file; the format is recognised by content"
        ),
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="directory for the results, made if it is not there (default: LOG-results here, after the first log)",
    )
    add_config_option(parser)
    parser.add_argument(
        "--exhaustive",
        action="store_true",
        help="switch all skips off: everything is scored, measured and confirmed to the last step (many times slower)",
    )
    parser.add_argument(
        "--without-skip",
        action="append",
        choices=[skip.name for skip in SKIPS],
        metavar="NAME",
        help="switch one skip off, repeatable: " + "; ".join(f"{skip.name} ({skip.leaves_out})" for skip in SKIPS),
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=whole(1, 64),
        default=1,
        help="threads that share the work; the contacts are the same (default 1)",
    )
    parser.add_argument(
        "--speed",
        choices=("real", "max"),
        default="max",
        help="real: as fast as it was recorded; max: as fast as possible (default)",
    )
    parser.add_argument(
        "--chunk-bytes",
        metavar="N",
        type=whole(1, 1 << 28),
        default=1 << 18,
        help="read buffer; the contacts are the same (default 262144)",
    )
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.classify.beliefs import MINE_LIKE_P
    from sim_replay.closing_line import closing_line
    from sim_replay.logs.open_log import logs_config
    from sim_replay.logs.recorded import parse_speed
    from sim_replay.replay import replay
    from sim_replay.results_folder import default_results

    if arguments.out is None:
        arguments.out = default_results(arguments.logs)
    recorded = logs_config(arguments.logs) if arguments.config is None else None
    config = read_config(arguments.config) if recorded is None else recorded

    with Progress("replay") as progress:
        summary = replay(
            arguments.logs,
            arguments.out,
            config,
            without_skips=ALL_SKIPS if arguments.exhaustive else frozenset(arguments.without_skip or ()),
            threads=arguments.threads,
            chunk_bytes=arguments.chunk_bytes,
            speed=parse_speed(arguments.speed, "--speed"),
            progress=progress.show,
        )
    speed = f", {summary['times_real_time']:g} times real time" if summary["times_real_time"] else ""
    report = arguments.out / "report.html"
    words = [
        f"{summary['pings']} pings in {summary['duration_s']:.0f} s over {summary['distance_m']:.0f} m{speed}",
        (
            f"{summary['contacts']} contacts, {summary['contacts_mine_like']} of them with p_mine {MINE_LIKE_P:g} or "
            f"more; {summary['covered_km2']:g} km² covered"
        ),
        *map(notice_words, summary["notices"]),
        f"report: {report}",
        closing_line(summary),
    ]
    answer({**summary, "report": report}, words, as_json=arguments.json)
    return 0


def notice_words(notice: dict[str, str]) -> str:
    """Say a notice of a summary on a line."""
    place = f" ({notice['place']})" if notice["place"] and notice["place"] not in notice["text"] else ""
    return f"notice: {notice['text']}{place}"
