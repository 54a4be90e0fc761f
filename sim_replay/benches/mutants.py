"""Run damaged logs through the real command: none may crash it, hang it, exhaust its memory, or corrupt its results.

auv-mcm bench mutants LOG... [--mutants N] [--seed N] [--pings N] [--keep DIR]

Every mutant is replayed by a process of its own. It passes if that ends with code 0 or 3 within 20 s of processor time
and 400 MB, without a traceback or a failed tile, and if what it writes is strict JSON with finite numbers and every
contact lies near a position of the log, within three of its sigmas. A log without side scan passes with code 3. Exit
code 5 if a mutant fails.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import resource
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import AuvMcmError, BadInputError, SelfCheckError
from auv_mcm.geometry.geodesy import geodetic_to_ecef
from auv_mcm.records import NavSample
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import SonarConfig
from sim_replay.arguments import count
from sim_replay.benches.mutations import CHANGES, JUMPS, mutated, split
from sim_replay.logs.xtf import XtfLog

MAX_CPU_S: Final = 20.0  # s of processor time of one replay, beyond which it fails
MAX_RSS_MB: Final = 400.0  # MB of memory of one replay, beyond which it fails
GOOD_CODES: Final = (0, 3)  # exit codes: done, and bad input data

# from the nearest position of the log: twice the greatest range of the shared logs and seconds of track
_NEAR_M: Final = 200.0
_SIGMAS: Final = 3.0
_PROGRESS: Final = 50  # mutants per line of progress
_COMBINED: Final = 4  # every so many mutants combine two kinds
# spares the computer where a mutant takes all; numpy and OpenCV reserve 2 GB that they do not use
_ADDRESS_SPACE_BYTES: Final = 6 << 30
_PRELOADED: Final = ("auv_mcm.pipeline", "sim_replay.replay", "sim_replay.logs.recorded")  # once, not by every process


class Mutant(NamedTuple):
    """Hold the outcome of one damaged log.

    code: negative if a signal ended the process; cpu_s and rss_mb are NaN then. failures: why it does not pass, empty
    if it does.
    """

    number: int
    log: str
    kinds: tuple[str, ...]
    code: int | None
    cpu_s: float
    rss_mb: float
    failures: tuple[str, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench mutants`."""
    parser.add_argument("logs", metavar="LOG", nargs="+", type=Path, help="XTF log to damage")
    parser.add_argument("--mutants", metavar="N", type=count, default=300, help="damaged logs in all (default 300)")
    parser.add_argument("--seed", metavar="N", type=count, default=1, help="seed of the damage (default 1)")
    parser.add_argument(
        "--pings",
        metavar="N",
        type=count,
        default=461,
        help="maximum packets of each log, from its start (default 461)",
    )
    parser.add_argument("--keep", metavar="DIR", type=Path, help="folder for mutants that fail, with their results")


def run(arguments: argparse.Namespace) -> int:
    """Replay all mutants and print; returns the exit code.

    Raises BadInputError for a log that cannot be read, and SelfCheckError if a mutant fails.
    """
    mutants: list[Mutant] = []
    logs = {path: _bytes_of(path) for path in arguments.logs}
    with tempfile.TemporaryDirectory(prefix="auv-mcm-mutants-") as scratch:
        for number in range(arguments.mutants):
            random = np.random.default_rng((arguments.seed, number))
            path, kinds = arguments.logs[int(random.integers(len(arguments.logs)))], kinds_of(number)
            data = mutated(split(logs[path], arguments.pings), kinds, random)
            mutant = judge_mutant(number, path.name, kinds, data, Path(scratch), arguments.keep)
            mutants.append(mutant)
            if mutant.failures:
                print(f"FAILED {number} of {mutant.log}, {' + '.join(kinds)}: {'; '.join(mutant.failures)}", flush=True)
            if len(mutants) % _PROGRESS == 0:
                print(f"{len(mutants)} of {arguments.mutants}", flush=True)
    for line in table(mutants):
        print(line)
    failed = sum(bool(mutant.failures) for mutant in mutants)
    if failed:
        raise SelfCheckError(f"{failed} of {len(mutants)} damaged logs did not pass")
    return 0


def _bytes_of(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read()
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}") from error


def kinds_of(number: int) -> tuple[str, ...]:
    """Choose the damage of a mutant: every second one has a navigation jump, every fourth two kinds of damage."""
    names, jumps = list(CHANGES), list(JUMPS)
    first = jumps[number // 2 % len(jumps)] if number % 2 else names[number // 2 % len(names)]
    if number % _COMBINED:
        return (first,)
    second = names[(7 * number // _COMBINED + 3) % len(names)]
    return (first,) if second == first else (first, second)


def judge_mutant(
    number: int, log: str, kinds: tuple[str, ...], data: bytes, scratch: Path, keep: Path | None = None
) -> Mutant:
    """Replay one damaged log in a process of its own and judge the outcome."""
    path, out, console, usage = (scratch / name for name in ("mutant.xtf", "out", "console.txt", "usage.json"))
    path.write_bytes(data)
    usage.unlink(missing_ok=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_PRELOADED))
    process = context.Process(target=_replay, args=(path, out, console, usage))
    process.start()
    process.join()
    code = process.exitcode
    said = console.read_text("utf-8", "replace")
    cpu_s, rss_mb = json.loads(usage.read_text()) if usage.exists() else (math.nan, math.nan)
    failures = []
    if code not in GOOD_CODES:
        failures.append(f"exit code {code}")
    if "Traceback" in said:
        failures.append(said.strip().splitlines()[-1])
    if cpu_s > MAX_CPU_S:
        failures.append(f"{cpu_s:.1f} s of processor time")
    if rss_mb > MAX_RSS_MB:
        failures.append(f"{rss_mb:.0f} MB")
    if code == 0:
        failures += wrong_results(out, path)
    if failures and keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        path.replace(keep / f"mutant-{number}.xtf")
        console.replace(keep / f"mutant-{number}.txt")
    return Mutant(number, log, kinds, code, cpu_s, rss_mb, tuple(failures))


def _replay(path: Path, out: Path, console: Path, usage: Path) -> None:
    """Run the command in this process, within the limits.

    What it prints goes to `console`, what it cost to `usage`.
    """
    from auv_mcm.cli import main

    resource.setrlimit(resource.RLIMIT_CPU, (round(MAX_CPU_S) + 1, round(MAX_CPU_S) + 2))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE_BYTES, _ADDRESS_SPACE_BYTES))
    with console.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    try:
        code = main(["replay", str(path), "--out", str(out)])
    finally:
        used = resource.getrusage(resource.RUSAGE_SELF)
        usage.write_text(json.dumps((used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)))
    sys.exit(code)


def wrong_results(out: Path, log: Path) -> list[str]:
    """List impossible results.

    Numbers that are not finite, failed tiles, contacts far from every position of the log.
    """
    read: dict[str, Any] = {}
    for name in ("contacts.geojson", "coverage.geojson", "waypoints.geojson", "clearance.geojson", "summary.json"):
        try:
            read[name] = json.loads((out / name).read_text("utf-8"), parse_constant=_refuse)
        except (OSError, ValueError) as error:
            return [f"{name}: {error}"]
    wrong = [f"{name} is {n}" for name, n in read["summary.json"]["counters"].items() if name.startswith("pipeline.")]
    fixes_m = _fixes_m(log)
    for feature in read["contacts.geojson"]["features"]:
        if feature["geometry"] is None:
            continue
        longitude, latitude = feature["geometry"]["coordinates"][:2]
        if not (-180.0 <= longitude <= 180.0 and -90.0 <= latitude <= 90.0):
            wrong.append(f"{feature['properties']['id']} lies at {latitude}, {longitude}")
            continue
        away_m = float(
            np.sqrt(((fixes_m - geodetic_to_ecef(latitude, longitude, 0.0)) ** 2).sum(axis=1).min(initial=math.inf))
        )
        if away_m > _NEAR_M + _SIGMAS * (feature["properties"]["sigma_m"] or 0.0):
            wrong.append(f"{feature['properties']['id']} lies {away_m:.0f} m from every position of the log, with "
                "sigma_m "
                         f"{feature['properties']['sigma_m']}")  # fmt: skip
            break
    return wrong


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _fixes_m(log: Path) -> NDArray[np.float64]:
    """Read the Earth-centred positions of a log, m, (n, 3)."""
    fixes = []
    try:
        for event in XtfLog(log, SonarConfig()):
            if (
                isinstance(event, NavSample)
                and math.isfinite(event.latitude_deg)
                and math.isfinite(event.longitude_deg)
            ):
                fixes.append((event.latitude_deg, event.longitude_deg))
    except AuvMcmError:
        pass
    latitude, longitude = np.array(fixes, dtype=np.float64).reshape(-1, 2).T
    return geodetic_to_ecef(latitude, longitude, 0.0)


def table(mutants: Sequence[Mutant]) -> list[str]:
    """Lay out a line per kind of damage, a combined mutant under its first, and one of all together."""
    by_kind: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in mutants:
        by_kind[mutant.kinds[0]].append(mutant)
    lines = [f"{'damage':36}{'mutants':>8}{'code 0':>8}{'code 3':>8}{'failed':>8}{'most CPU s':>12}{'most MB':>9}"]
    for name, group in [*by_kind.items(), ("all", list(mutants))]:
        n_codes = [sum(mutant.code == code for mutant in group) for code in GOOD_CODES]
        failed = sum(bool(mutant.failures) for mutant in group)
        ended = [mutant for mutant in group if mutant.cpu_s == mutant.cpu_s]
        most = (
            max((mutant.cpu_s for mutant in ended), default=math.nan),
            max((mutant.rss_mb for mutant in ended), default=math.nan),
        )
        lines.append(f"{name:36}{len(group):8}{n_codes[0]:8}{n_codes[1]:8}{failed:8}{most[0]:12.1f}{most[1]:9.0f}")
    return lines
