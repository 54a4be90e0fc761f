"""Describe recorded logs before anything is replayed."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from auv_mcm.clean_text import clean, clean_lines
from auv_mcm.commands import Commands, Progress, add_config_option, command, read_config
from auv_mcm.commands.tables import show_table
from auv_mcm.errors import AuvMcmError

if TYPE_CHECKING:
    from auv_mcm.settings.config import Config

Row = tuple[str, str]


def add(commands: Commands) -> None:
    """Add `auv-mcm info` to the command line."""
    parser = command(
        commands,
        "info",
        "say what a recorded log holds, and what a replay would use",
        "Reads each log from end to end, looks for nothing in it and writes nothing. Says format, channels,\n"
        "frequency, samples and what they are, range, pings and their rate, gaps, navigation against the track,\n"
        "altitude against the first return of the sea floor, the clock, what a replay would use and leave out, and\n"
        "every notice that it would raise. A folder stands for the recordings of a session, or for the logs in it.\n"
        "Exit code 3 if no log can be read.",
        ["auv-mcm info mission.xtf", "auv-mcm info auv-mcm-out/latest", "auv-mcm info survey.jsf --json"],
    )
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="+",
        type=Path,
        help="XTF, JSF, svlog, SDF, SL2, SL3 or SON file, sonar image, recorded session, or a folder of logs",
    )
    parser.add_argument("--json", action="store_true", help="write JSON: an object with a list 'logs'")
    add_config_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.log_info import describe
    from sim_replay.logs.open_log import logs_config

    given = None if arguments.config is None else read_config(arguments.config)
    infos: list[dict[str, Any]] = []
    last: AuvMcmError | None = None
    paths = [path for log in arguments.logs for path in _logs_in(log)]
    with Progress("info") as progress:
        for number, path in enumerate(paths):
            try:
                config: Config = given or logs_config([path]) or read_config(None)
                share = lambda fraction, done=number: progress.show((done + fraction) / len(paths))  # noqa: E731
                infos.append(describe(path, config, share))
            except AuvMcmError as error:
                infos.append({"path": str(path), "error": str(error)})
                last = error
    mission = _mission_notices([path for path in paths if path.is_file()], given or read_config(None))
    if arguments.json:
        print(json.dumps({"logs": infos, "notices": mission}, indent=2, allow_nan=False))
    else:
        for info in infos:
            _show(info)
        for notice in mission:
            print(f"notice: {notice['text']}")
    if last is not None and all("error" in info for info in infos):
        return last.exit_code
    return 0


def _logs_in(path: Path) -> list[Path]:
    """List the recordings of a session's folder, or the logs in another folder; else the path itself."""
    from sim_replay.logs.open_log import find_format, is_session
    from sim_replay.logs.session_parts import recordings_of

    if not path.is_dir() or is_session(path):
        return [path]
    if recordings := recordings_of(path):
        return recordings
    found = []
    for file in sorted(path.iterdir()):
        try:
            find_format(file)
        except AuvMcmError:
            continue
        found.append(file)
    return found or [path]  # which is said of it, and costs no other


def _mission_notices(paths: list[Path], config: Config) -> list[dict[str, str]]:
    """List what a replay of all the files as one mission would say of leaving out whole logs."""
    from sim_replay.logs.recorded import RecordedMission

    if len(paths) < 2:
        return []
    try:
        mission = RecordedMission(paths, config)
    except AuvMcmError:
        return []  # said of each log
    return [{"code": notice.code, "text": notice.text, "place": notice.place} for notice in mission.notices]


def _show(info: dict[str, Any]) -> None:
    """Print one log."""
    if "error" in info:
        print(f"{clean(info['path'])}\n  {clean_lines(info['error'])}\n")
        return
    rows = [(name, clean(text)) for name, text in _rows(info)]
    title = clean(info["path"])
    show_table(title, (), rows)
    print()


def _rows(info: dict[str, Any]) -> Iterator[Row]:
    pings, clock, navigation = info["pings"], info["clock"], info["navigation"]
    khz = "" if info["frequency_khz"] is None else f", {info['frequency_khz']:g} kHz"
    if len(info["frequencies_khz"]) > 1:
        khz += f" of {' and '.join(f'{each:g}' for each in info['frequencies_khz'])}"
    yield "format", f"{info['title']}, {info['bytes'] / 1e6:.1f} MB{khz}"
    if info["channels"]:
        yield "channels", info["channels"]
    for side, found in info["sides"].items():
        yield side, "none" if found is None else _side_words(found)
    yield "samples", info["transfer"] or "what they are is not known before a replay"
    rate = "" if pings["rate_per_s"] is None else f", {pings['rate_per_s']:g} a second"
    yield "pings", f"{pings['count']} in {pings['duration_s']:g} s{rate}"
    gaps = pings["gaps"]
    yield "gaps", "none" if not gaps["count"] else _gap_words(gaps)
    if pings["sound_speed_mps"]:
        yield "sound speed", " to ".join(f"{speed:g}" for speed in sorted(set(pings["sound_speed_mps"]))) + " m/s"
    yield "clock", f"{clock['first']} to {clock['last']}, {clock['steps_back']} steps back"
    for name, quantity in navigation["quantities"].items():
        yield name, _quantity_words(quantity, navigation["sources"].get(name, ""))
    yield "track", f"{_or_unknown(navigation['track_m'], 'm')}; {_speed_words(navigation['speed_mps'])}"
    yield "heading - course", _or_unknown(navigation["heading_minus_course_deg"], "degrees, median")
    altitude = info["altitude"]
    yield (
        "altitude",
        f"stated {_or_unknown(altitude['stated_m'], 'm')}, first return {_or_unknown(altitude['first_return_m'], 'm')}",
    )
    used = info["used"]
    for line in info["bottom_line"]:
        by = f" by {line['by']}" if line.get("by") else ""
        corrected = f"corrected by hand{by} over {used.get('bottom_corrected', 0)} pings"
        yield "bottom line", f"{corrected if line['used'] else 'not used'}: {line['path']}"
    yield "a replay uses", f"{used['pings']} pings, {used['pings_with_position']} of them with a position"
    counted = ", ".join(f"{name} {count}" for name, count in info["left_out"].items())
    yield "counts", counted or "nothing is left out or mended"
    for notice in info["notices"]:
        yield "notice", f"{notice['text']}" + (f" ({notice['place']})" if notice["place"] else "")
    for remark in info["remarks"]:
        yield "remark", remark["text"]


def _side_words(found: dict[str, Any]) -> str:
    more = f", {found['layouts']} layouts" if found["layouts"] > 1 else ""
    return (
        f"{found['pings']} pings of {found['samples']} samples ({found['sample_type']}), {found['spacing_m']:g} m "
        f"apart to {found['range_m']:g} m{more}"
    )


def _gap_words(gaps: dict[str, Any]) -> str:
    longest = ", ".join(f"{gap['seconds']:g} s after {gap['after']}" for gap in gaps["longest"][:3])
    return f"{gaps['count']} longer than {gaps['longer_than_s']:g} s: {longest}"


def _quantity_words(quantity: dict[str, Any] | None, source: str) -> str:
    if quantity is None:
        return "none"
    rate = "" if quantity["rate_per_s"] is None else f", {quantity['rate_per_s']:g} a second"
    gap = "" if quantity["longest_gap_s"] is None else f", longest gap {quantity['longest_gap_s']:g} s"
    return f"{quantity['count']}{rate}{gap}" + (f", from {source}" if source else "")


def _speed_words(speed: dict[str, Any]) -> str:
    return f"speed stated {_or_unknown(speed['stated'], 'm/s')}, by positions {_or_unknown(speed['track'], 'm/s')}"


def _or_unknown(number: float | None, unit: str) -> str:
    return "unknown" if number is None else f"{number:g} {unit}"
