"""Run damaged files through the real command: none may crash it, hang it, exhaust its memory, or corrupt its results.

auv-mcm bench mutants LOG... [--mutants N] [--seed N] [--pings N] [--keep DIR]
auv-mcm bench mutants --all [--mutants N] [--seed N] [--jobs N] [--keep DIR]

Every mutant is read by a process of its own: XTF logs of yours, or with --all a small file of every format and of all
that a person writes by hand (configuration, scene, mine list, sidecar, track), and files that only look like one. It
passes if that ends with code 0 or 3, also 2 for what is written by hand, within 20 s of processor time, 30 s of wall
clock asleep (a loaded computer makes none fail) and 1 GB, 400 MB for XTF logs of yours, without a traceback or a failed
tile, and if what it writes is strict JSON with finite numbers and every contact lies near a position of the log, within
three of its sigmas. A log without side scan passes with code 3. Exit code 5 if a mutant fails.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import AuvMcmError, BadInputError, SelfCheckError, UsageError
from auv_mcm.geometry.geodesy import geodetic_to_ecef
from auv_mcm.records import NavSample
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config
from sim_replay.arguments import count
from sim_replay.benches.mutant_files import BYTES, SEALED, TEXT, damage
from sim_replay.benches.mutant_runs import run_command
from sim_replay.benches.mutant_seeds import Seed, write_seeds
from sim_replay.benches.mutant_traps import traps_of
from sim_replay.benches.mutations import CHANGES, JUMPS, mutated, split
from sim_replay.logs.open_log import open_log

MAX_RSS_MB: Final = 400.0  # MB of memory of one replay of a log of yours, beyond which it fails
MAX_ANY_RSS_MB: Final = 1000.0  # MB of any other mutant: a picture that cannot be read in parts takes 512
GOOD_CODES: Final = (0, 3)  # exit codes: done, and bad input data
_GOOD_BY_HAND: Final = (0, 2, 3)  # of what people write, whose mistakes are bad usage
_BY_HAND: Final = ("configuration", "scene", "mine list")

# from the nearest position of the log: twice the greatest range of the shared logs and seconds of track
_NEAR_M: Final = 200.0
_SIGMAS: Final = 3.0
_PROGRESS: Final = 50  # mutants per line of progress
_COMBINED: Final = 4  # every so many mutants combine two kinds
_SHARE: Final = 0.5  # of the mutants of a format that has a way of its own to be damaged
_DEFAULT, _DEFAULT_ALL = 300, 3000  # mutants; with --all a hundred or more of each seed
_MAX_KEPT_BYTES: Final = 1 << 28  # of a file of a mutant that is kept: the sparse one is larger
_SEED_PINGS: Final = 461  # more than a seed has


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
    parser.add_argument("logs", metavar="LOG", nargs="*", type=Path, help="XTF log to damage")
    parser.add_argument("--all", action="store_true", help="damage files of every format instead")
    parser.add_argument(
        "--mutants",
        metavar="N",
        type=count,
        help=f"damaged files in all (default {_DEFAULT}, with --all {_DEFAULT_ALL})",
    )
    parser.add_argument("--jobs", metavar="N", type=count, default=1, help="run so many at a time (default 1)")
    parser.add_argument("--seed", metavar="N", type=count, default=1, help="seed of the damage (default 1)")
    parser.add_argument(
        "--pings",
        metavar="N",
        type=count,
        default=461,
        help="maximum packets of each log, from its start (default 461)",
    )
    parser.add_argument("--keep", metavar="DIR", type=Path, help="folder for mutants that fail, with what they printed")


def run(arguments: argparse.Namespace) -> int:
    """Run all mutants and print; returns the exit code.

    Raises UsageError for neither logs nor --all, BadInputError for a log that cannot be read, and SelfCheckError if a
    mutant fails.
    """
    if bool(arguments.logs) == arguments.all:
        raise UsageError("name XTF logs to damage, or give --all for files of every format")
    n_mutants = arguments.mutants or (_DEFAULT_ALL if arguments.all else _DEFAULT)
    mutants: list[Mutant] = []
    with tempfile.TemporaryDirectory(prefix="auv-mcm-mutants-") as scratch:
        judged = _judge_all if arguments.all else _judge_logs
        for mutant in judged(arguments, n_mutants, Path(scratch)):
            mutants.append(mutant)
            if mutant.failures:
                print(
                    f"FAILED {mutant.number} of {mutant.log}, {' + '.join(mutant.kinds)}: {'; '.join(mutant.failures)}",
                    flush=True,
                )
            if len(mutants) % _PROGRESS == 0:
                print(f"{len(mutants)} of {n_mutants}", flush=True)
    for line in table(mutants, by_log=arguments.all):
        print(line)
    failed = sum(bool(mutant.failures) for mutant in mutants)
    if failed:
        what = "files" if arguments.all else "logs"
        raise SelfCheckError(f"{failed} of {len(mutants)} damaged {what} did not pass")
    return 0


def _judge_logs(arguments: argparse.Namespace, n_mutants: int, scratch: Path) -> Iterator[Mutant]:
    logs = {path: _bytes_of(path) for path in arguments.logs}
    for number in range(n_mutants):
        random = np.random.default_rng((arguments.seed, number))
        path, kinds = arguments.logs[int(random.integers(len(arguments.logs)))], kinds_of(number)
        data = mutated(split(logs[path], arguments.pings), kinds, random)
        yield judge_mutant(number, path.name, kinds, data, scratch, arguments.keep)


def _judge_all(arguments: argparse.Namespace, n_mutants: int, scratch: Path) -> Iterator[Mutant]:
    cases = cases_of(write_seeds(scratch / "seeds"), n_mutants, arguments.seed)
    with ThreadPoolExecutor(arguments.jobs) as pool:
        yield from pool.map(lambda case: judge_case(case, scratch / f"run-{case.number}", arguments.keep), cases)


def _bytes_of(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}") from error


class Case(NamedTuple):
    """Hold what is done to a seed: write damages the file whose path it gets; refused: it must not be taken."""

    number: int
    seed: Seed
    kinds: tuple[str, ...]
    write: Callable[[Path], None]
    refused: bool


def cases_of(seeds: Sequence[Seed], n_mutants: int, seed: int) -> list[Case]:
    """Plan the mutants of all seeds: first every trap, then damage drawn from the seed, format by format."""
    cases: list[Case] = []
    for one in seeds:
        for name, trap in traps_of(one).items():
            cases.append(Case(len(cases), one, (name,), trap.write, trap.refused))
    for number in range(len(cases), n_mutants):
        cases.append(_drawn(number, seeds[number % len(seeds)], np.random.default_rng((seed, number))))
    return cases[:n_mutants]


def _drawn(number: int, seed: Seed, random: np.random.Generator) -> Case:
    """Draw damage for a seed, in a way of its format where there is one."""
    data = (seed.folder / seed.file).read_bytes()
    own, kinds = random.random() < _SHARE, kinds_of(number)
    if own and seed.name == "XTF":
        damaged = mutated(split(data, _SEED_PINGS), kinds, random)
    elif own and (sealed := SEALED.get(Path(seed.file).suffix)) is not None:
        damaged, kinds = sealed(data, random), ("what a checksum guards",)
    else:
        changes = BYTES if seed.role in ("log", "image") else TEXT
        name = list(changes)[int(random.integers(len(changes)))]
        damaged, kinds = damage(data, random, changes[name]), (name,)
    return Case(number, seed, kinds, lambda path: _overwrite(path, damaged), refused=False)


def _overwrite(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def judge_case(case: Case, scratch: Path, keep: Path | None = None) -> Mutant:
    """Damage a copy of a seed, run the command that reads it in a process of its own, and judge the outcome."""
    seed, folder = case.seed, scratch / "files"
    shutil.copytree(seed.folder, folder)
    case.write(folder / seed.file)
    ended = run_command(seed.arguments or ("scene", seed.file), folder, scratch)
    failures = ended.failures(_GOOD_BY_HAND if seed.role in _BY_HAND else GOOD_CODES, MAX_ANY_RSS_MB)
    if case.refused and ended.code == 0:
        failures.append("it was taken, and must be refused")
    elif ended.code == 0 and seed.arguments:
        failures += wrong_results(folder / "out", folder / seed.arguments[1])
    if failures and keep is not None:
        shutil.rmtree(keep / f"mutant-{case.number}", ignore_errors=True)
        shutil.copytree(scratch, keep / f"mutant-{case.number}", ignore=_irregular, symlinks=True)
    shutil.rmtree(scratch)
    return Mutant(case.number, seed.name, case.kinds, ended.code, ended.cpu_s, ended.rss_mb, tuple(failures))


def _irregular(folder: str, names: list[str]) -> list[str]:
    """List pipes, which cannot be copied, and files that are larger than any that a mutant needs."""
    paths = (Path(folder) / name for name in names)
    return [path.name for path in paths if path.is_fifo() or (path.is_file() and path.stat().st_size > _MAX_KEPT_BYTES)]


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
    """Replay one damaged XTF log in a process of its own and judge the outcome."""
    path, out = scratch / "mutant.xtf", scratch / "out"
    path.write_bytes(data)
    ended = run_command(("replay", str(path), "--out", str(out)), scratch, scratch)
    failures = ended.failures(GOOD_CODES, MAX_RSS_MB)
    if ended.code == 0:
        failures += wrong_results(out, path)
    if failures and keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        path.replace(keep / f"mutant-{number}.xtf")
        (keep / f"mutant-{number}.txt").write_text(ended.said, "utf-8")
    return Mutant(number, log, kinds, ended.code, ended.cpu_s, ended.rss_mb, tuple(failures))


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
        for event in open_log(log, Config()):
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


def table(mutants: Sequence[Mutant], *, by_log: bool = False) -> list[str]:
    """Lay out a line per kind of damage, a combined mutant under its first, or per log, and one of all together."""
    groups: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in mutants:
        groups[mutant.log if by_log else mutant.kinds[0]].append(mutant)
    codes = _GOOD_BY_HAND if by_log else GOOD_CODES
    counted = "".join(f"{f'code {code}':>8}" for code in codes)
    title = "file" if by_log else "damage"
    lines = [f"{title:36}{'mutants':>8}{counted}{'failed':>8}{'most CPU s':>12}{'most MB':>9}"]
    for name, group in [*groups.items(), ("all", list(mutants))]:
        n_codes = "".join(f"{sum(mutant.code == code for mutant in group):8}" for code in codes)
        failed = sum(bool(mutant.failures) for mutant in group)
        ended = [mutant for mutant in group if mutant.cpu_s == mutant.cpu_s]
        most = (
            max((mutant.cpu_s for mutant in ended), default=math.nan),
            max((mutant.rss_mb for mutant in ended), default=math.nan),
        )
        lines.append(f"{name:36}{len(group):8}{n_codes}{failed:8}{most[0]:12.1f}{most[1]:9.0f}")
    return lines
