"""Run a long mission through the service, cut off on the way, and account for everything in the end.

The mission is flown at a multiple of real time; it waits where perception or a device is behind, so that a computer
that is slow for a moment loses nothing. At random moments all processes of the service are killed at once, and it is
started again while the devices go on. In the end

* memory and open files of either process must not have grown,
* no process, shared memory, temporary file or unexplained file may be left,
* every byte and ping that the devices sent must be accounted for, and every counter have a reason.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import SelfCheckError
from auv_mcm.shell.recovery import JOURNAL
from sim_replay.benches.watched_service import (
    FLOWN_MPS,
    HEALTH,
    LONGEST_LEG_M,
    SERVICE,
    STOPPING,
    TURN_M,
    console,
    read_mission,
    service_pid,
    simulate_mission,
)
from sim_replay.hil.run import RESULTS, run_scenario
from sim_replay.hil.verdict import Evidence
from sim_replay.logs.session_reader import Session

MAX_GROWTH: Final = 0.1
"""Share of its memory by which a process may have grown over the mission, at the lower end of the 95 % interval."""
_SAMPLE_S: Final = 0.5  # s between samples of memory
_ENDING_S: Final = 0.02  # the same while the service ends
_WARM: Final = 1.0 / 3.0  # share of each start in which caches fill, of which no growth is measured
_LONG: Final = 0.5  # share of the longest start that others must have to count: caches fill in the first minutes
_BLOCKS: Final = 8  # of the rest of each start, whose medians are one value each: memory is used for moments
_MIN_SAMPLES: Final = 2 * _BLOCKS  # of a start of which growth is measured
_MAX_ROWS: Final = 12  # of the table printed
_BYTES_PER_MB: Final = 1e6  # bytes per megabyte
_QUEUE_PINGS: Final = 4096  # the mission waits long before work is shed
_HEALTH_PERIOD_S: Final = 1.0  # s, so that the mission waits soon where perception is behind
_REMEMBER_S: Final = 6.0  # s of its own counters that the service may lose by a kill: it notes them every 5
_RECORD_S: Final = 1.0  # s of a recording that a kill may cost
_RESTARTED: Final = 0.5  # share of the mission with restarts: in the rest growth within one start shows
_SHIFT: Final = 0.3  # share of the time between two restarts by which each comes earlier or later, maximum
_TRACEBACK: Final = "Traceback (most recent call last):"
_OVERRUN: Final = "port.overrun"
_DEAD: Final = re.compile(r"Traceback|\bERROR\b|notice (?:intake_failed|decoder_failed|session_(?!resumed)\w+):")
_EXPECTED: Final = {  # counters of a sound run between these devices
    "ping.received": "the mission",
    "detect.*": "work of the detector",
    "confirm.*": "work of the closer look",
    "classify.*": "work of classification",
    "contacts.*": "work of fusion",
    "early.*": "work of early looks",
    "service.work_shed": "the computer was too slow for the speed of the mission",
    "budget.*": "less work on tiles, where it was shed",
    "navigation.time_repeated": "position and attitude of one instant come as messages of their own",
    "nav.thinned.*": "position and attitude of one instant come as messages of their own",
    "navigation.speed_unknown": "before the first message with a speed",
    "port.*.link.bytes_*": "traffic",
    "port.*.link.reads": "traffic",
    "port.*.link.opened": "one per start",
    "port.*.state_changes": "one per start",
    "port.*.messages": "traffic",
    "port.*.frames": "traffic",
    "port.nav.n2k.claims": "units on a bus name themselves",
    "port.nav.slcan.answers": "the adapter takes its commands",
    "port.nav.slcan.refusals": "the adapter is ordered to close first, as it may be open",
    "port.sonar.commands_sent": "settings of the sonar",
    "port.sonar.sonar.accepted": "settings of the sonar",
    "session.*_recorded": "the recording",
}
_OF_DAMAGE: Final = ("bytes_skipped", "refused.*", "lone_*")  # counters of messages that are not whole
_OF_RESTARTS: Final = {  # counters that a mission with restarts has as well
    **{f"port.*.{what}": "a start in the middle of a message" for what in _OF_DAMAGE},
    "port.*.*.bytes_skipped": "a start in the middle of a message",
    "port.*.*.refused.*": "a start in the middle of a message",
    "port.*.*.lone_*": "a start in the middle of a message",
    "ping.gap": "nothing was heard while the service was down",
    "navigation.heading_from_course": "pings around a start, where no unit's heading was heard",
    "navigation.speed_from_fixes": "pings around a start, where no unit's speed was heard",
}
_KINDS: Final = {  # files of a session that came to its end
    "contacts.jsonl": "the journal of contacts",
    "early.jsonl": "the journal of early contacts",
    "contacts.geojson": "results",
    "contacts.csv": "results",
    "contacts.kml": "results",
    "coverage.geojson": "results",
    "clearance.geojson": "results",
    "waypoints.geojson": "results",
    "clearance.*": "results",
    "summary.json": "results",
    "health.json": "the newest record of health",
    "health.jsonl": "the history of health",
    "snippets/*.png": "pictures of contacts",
    "recording*/*.mcap": "the recording, a folder per start",
}


class Sample(NamedTuple):
    """Hold what the service and its perception take at an instant, s after the first start; start: its number."""

    at_s: float
    start: int
    service_bytes: int
    perception_bytes: int
    service_files: int
    perception_files: int


class Watched(NamedTuple):
    """Hold what was seen of the processes until the stop, and while results were written.

    processes: id and time of the start of each that was seen. shared: names of shared memory that they had.
    """

    running: list[Sample]
    ending: list[Sample]
    processes: set[tuple[int, str]]
    shared: set[str]


class Slope(NamedTuple):
    """Hold a growth, and half of its 95 % interval."""

    middle: float
    half: float


class Account(NamedTuple):
    """Compare what went in with what came out. may_be_lost: how much of the difference has a reason; why: which."""

    what: str
    n_in: int
    n_out: int
    may_be_lost: int = 0
    why: str = ""

    @property
    def lost(self) -> int:
        """Return the difference."""
        return self.n_in - self.n_out

    @property
    def is_settled(self) -> bool:
        """Find whether the difference has a reason."""
        return 0 <= self.lost <= self.may_be_lost


def bench_long_mission(minutes: float, n_restarts: int, speed: float, seed: int, folder: Path) -> None:
    """Run a mission and print what it took. Raises SelfCheckError for whatever has grown, died, stayed or got lost."""
    way_m = minutes * 60.0 * FLOWN_MPS / speed
    n_turns = math.ceil((way_m + TURN_M) / (LONGEST_LEG_M + TURN_M)) - 1
    log, duration_s = simulate_mission(folder, (way_m - n_turns * TURN_M) / FLOWN_MPS * speed, FLOWN_MPS / speed)
    run_s = duration_s / speed
    random = np.random.Generator(np.random.PCG64(seed))
    shift = random.uniform(-_SHIFT, _SHIFT, n_restarts)
    moments = _RESTARTED / (n_restarts or 1) * (np.arange(1, n_restarts + 1) - 0.5 + shift)
    own = SERVICE["service"] | {"queue_pings": _QUEUE_PINGS, "health_period_s": _HEALTH_PERIOD_S}
    restarts_s = tuple((moments * run_s).tolist())
    read = read_mission(log, duration_s, speed, SERVICE | {"service": own}, 1.0, restarts_s, waits=True)
    temporary = folder / "temporary"
    temporary.mkdir()
    over = threading.Event()
    began_s = time.monotonic()
    with ThreadPoolExecutor(1) as pool, _temporary_files_in(temporary):
        watching = pool.submit(_watched, folder, over)
        try:
            evidence = run_scenario(read, folder, lambda line: print(line, file=sys.stderr, flush=True))
        finally:
            over.set()
        watched = watching.result()
    took_s = time.monotonic() - began_s
    print(
        f"{duration_s / 60.0:.1f} min of mission at {speed:g} times real time, in {took_s / 60.0:.1f} min; service, "
        f"perception and 2 devices as processes; killed and started again {len(evidence.restarts)} times\n"
    )
    problems = _growth(watched, duration_s / 3600.0)
    problems += _left(watched, temporary)
    problems += left_in_session((folder / RESULTS / "latest").resolve())
    problems += settled(accounts(evidence, (folder / RESULTS / "latest").resolve()))
    problems += [f"the counter {name} has no reason" for name in print_counters(evidence)]
    problems += _notices(evidence)
    problems += found_dead(evidence)
    if len(evidence.restarts) < n_restarts:
        problems.append(f"only {len(evidence.restarts)} of {n_restarts} restarts were made")
    print(f"\nproblems: {'; '.join(problems) or 'none'}")
    if problems:
        raise SelfCheckError(f"the mission did not pass: {'; '.join(problems)}")


def slope_of(at: NDArray[np.float64], values: NDArray[np.float64], groups: NDArray[np.int_]) -> Slope:
    """Fit one slope to values of several groups, each with a level of its own.

    Ordinary least squares; the interval is Student's, of the residuals.
    """
    from scipy.stats import t  # 0.6 s

    centred_at, centred = np.array(at), np.array(values)
    for group in np.unique(groups):
        centred_at[groups == group] -= at[groups == group].mean()
        centred[groups == group] -= values[groups == group].mean()
    weight = float(centred_at @ centred_at)
    n_free = len(at) - len(np.unique(groups)) - 1
    if n_free < 1 or weight == 0.0:
        return Slope(math.nan, math.nan)
    middle = float(centred_at @ centred) / weight
    variance = float(np.sum((centred - middle * centred_at) ** 2)) / n_free
    return Slope(middle, float(t.ppf(0.975, n_free)) * math.sqrt(variance / weight))


def accounts(evidence: Evidence, session: Path) -> list[Account]:
    """Compare what the devices sent, what was recorded, what was decoded and what perception had."""
    sonar, nav = (_device_counters(evidence, name) for name in ("sonar", "nav"))
    recorded = _recorded(session)
    counters = Counter(evidence.summary.get("counters", {}))
    n_pings = int(evidence.summary.get("pings", 0))
    mission_s = evidence.stopped_s or math.inf
    n_kills = len(evidence.restarts)
    down_s = sum(restart.ready_s - restart.killed_s for restart in evidence.restarts)
    in_kill = f"the last {_RECORD_S:g} s before each of {n_kills} kills"
    down_and_in_kill = f"the {down_s:.1f} s of the run in which the service was down, and {in_kill}"
    counted_in_kill = f"what was counted in the last {_REMEMBER_S:g} s before each of {n_kills} kills"

    def share(n_in: int, lost_s: float) -> int:
        return math.ceil(n_in * min(lost_s / mission_s, 1.0))

    def to_counters(what: str, n_in: int, name: str) -> Account:
        may_be_lost = share(n_in, _REMEMBER_S * n_kills)
        return Account(f"{what}: recorded, counted", n_in, counters[name], may_be_lost, counted_in_kill)

    n_frames = recorded.n_chunks["nav"]
    n_explained = counters["port.nav.n2k.messages"] + counters["port.nav.n2k.claims"]
    return [
        Account(
            "bytes of the sonar: taken by its port, recorded",
            sonar["port.sent"],
            recorded.n_bytes["sonar"],
            share(sonar["port.sent"], _RECORD_S * n_kills),
            in_kill,
        ),
        to_counters("bytes of the sonar", recorded.n_bytes["sonar"], "port.sonar.link.bytes_in"),
        Account(
            "CAN frames of navigation: sent, recorded",
            nav["device.messages"],
            n_frames,
            share(nav["device.messages"], down_s + _RECORD_S * n_kills),
            down_and_in_kill,
        ),
        to_counters("CAN frames of navigation", n_frames, "port.nav.slcan.frames"),
        Account("CAN frames: counted, messages and claims in them", counters["port.nav.slcan.frames"], n_explained),
        to_counters("bytes, both ways", recorded.n_bytes.total(), "session.bytes_recorded"),
        Account(
            "pings: sent, had by perception or dropped by the queue",
            sonar["device.events"],
            n_pings + counters["service.ping_dropped"],
            share(sonar["device.events"], down_s + _RECORD_S * n_kills),
            down_and_in_kill,
        ),
        Account("pings: had by perception, used", n_pings, counters["ping.received"]),
    ]


def print_counters(evidence: Evidence) -> list[str]:
    """Print all counters, and return the names of those that a sound run has no reason for."""
    unexplained = []
    expected = dict(_EXPECTED) | (_OF_RESTARTS if evidence.restarts else {})
    for name in evidence.reports:
        if _device_counters(evidence, name)[_OVERRUN]:
            expected |= {f"port.{name}.*.{what}": "messages that lost bytes on the line" for what in _OF_DAMAGE}
    print(f"{'count':>10}  {'counter':<36}reason")
    for name, n in sorted(evidence.summary.get("counters", {}).items()):
        why = next((why for pattern, why in expected.items() if fnmatchcase(name, pattern)), None)
        if why is None:
            unexplained.append(f"{name} {n}")
        print(f"{n:>10}  {name:<36}{why or 'UNEXPLAINED'}")
    for name in evidence.reports:
        counters = _device_counters(evidence, name)
        if n := counters["device.skipped"]:
            print(f"{n:>10}  events that the fake device '{name}' left out, since the computer was too slow")
        if n := counters["port.cut"]:
            print(f"{n:>10}  bytes that nobody read of the fake device '{name}', since the service was down")
        if n := counters[_OVERRUN]:
            print(
                f"{n:>10}  bytes that the line of the fake device '{name}' lost, since the computer was too slow to "
                "read them"
            )
    return unexplained


def found_dead(evidence: Evidence) -> list[str]:
    """List what did not live to the end of a run, with the evidence."""
    lines = [line.text for line in evidence.lines]
    dead = [] if evidence.exit_code == 0 else [f"the service ended with {evidence.exit_code}"]
    dead += [
        line if line != _TRACEBACK else _raised(lines[index + 1 :])
        for index, line in enumerate(lines)
        if _DEAD.search(line)
    ]
    live = lines[: next((index for index, line in enumerate(lines) if STOPPING in line), len(lines))]
    last = next((match for line in reversed(live) if (match := HEALTH.match(line))), None)
    if last is None:
        dead.append("there is no health line")
    elif down := [port for port in last[5].split(",") if not port.endswith(":up")]:
        dead.append(f"at the end these ports were not up: {', '.join(down)}")
    return dead


def _raised(lines: Sequence[str]) -> str:
    """Find the error that a traceback ends with, and where it was raised, given the lines behind its head."""
    n_frames = next((index for index, line in enumerate(lines) if not line.startswith(" ")), len(lines))
    places = [line.strip() for line in lines[:n_frames] if line.lstrip().startswith("File ")]
    return f"{' '.join(lines[n_frames : n_frames + 1])} ({', '.join(places[-1:])})"


def _device_counters(evidence: Evidence, name: str) -> Counter[str]:
    return next(
        (Counter(report.details) for report in evidence.reports.get(name, ()) if report.what == "counters"), Counter()
    )


class _Recorded(NamedTuple):
    """Count what is in recordings: bytes by port, both ways, and what was received by port, in chunks."""

    n_bytes: Counter[str]
    n_chunks: Counter[str]


def _recorded(session: Path) -> _Recorded:
    found = _Recorded(Counter(), Counter())
    for folder in sorted(session.glob("recording*")):
        for recorded in Session(folder):
            found.n_bytes[recorded.port if recorded.direction == "in" else "out"] += len(recorded.data)
            found.n_chunks[recorded.port] += recorded.direction == "in" and len(recorded.data) > 0
    return found


def settled(found: Sequence[Account]) -> list[str]:
    """Print the accounts, and return those whose difference has no reason."""
    print("accounts")
    for account in found:
        reason = f" ({account.may_be_lost} may be: {account.why})" if account.may_be_lost else ""
        print(f"  {account.what}: {account.n_in}, {account.n_out}; {account.lost} lost{reason}")
    print()
    return [
        f"{account.what}: {account.lost} lost, {account.may_be_lost} may be"
        for account in found
        if not account.is_settled
    ]


def _growth(watched: Watched, mission_h: float) -> list[str]:
    """Print memory and open files, and return what has grown."""
    running = watched.running
    if len(running) < _MIN_SAMPLES:
        raise SelfCheckError("the run was too short to measure memory over time; give more --minutes")
    print(f"{'s':>8}{'start':>7}{'service MB':>12}{'perception MB':>15}{'open files':>14}")
    for index in np.unique(np.linspace(0, len(running) - 1, _MAX_ROWS).astype(int)):
        sample = running[index]
        print(
            f"{sample.at_s:>8.1f}{sample.start:>7}{sample.service_bytes / _BYTES_PER_MB:>12.1f}"
            f"{sample.perception_bytes / _BYTES_PER_MB:>15.1f}"
            f"{f'{sample.service_files} + {sample.perception_files}':>14}"
        )
    if watched.ending:
        service_bytes, perception_bytes = (max(found[index] for found in watched.ending) for index in (2, 3))
        print(
            f"while the results were written: service at most {service_bytes / _BYTES_PER_MB:.1f} MB, perception "
            f"{perception_bytes / _BYTES_PER_MB:.1f} MB"
        )
    blocks = np.array(list(_medians(running)))
    at_h = blocks[:, 0] * mission_h / running[-1].at_s
    starts = blocks[:, 1].astype(int)
    problems = []
    for column, name, unit, scale in (
        (2, "memory of the service", " MB", _BYTES_PER_MB),
        (3, "memory of perception", " MB", _BYTES_PER_MB),
        (4, "open files of the service", "", 1.0),
        (5, "open files of perception", "", 1.0),
    ):
        values = blocks[:, column] / scale
        slope = slope_of(at_h, values, starts)
        print(f"{name}: {slope.middle:+.2f} ± {slope.half:.2f}{unit} an hour of mission")
        if (slope.middle - slope.half) * mission_h > MAX_GROWTH * float(np.median(values)):
            problems.append(f"{name} grows")
    print()
    return problems


def _medians(samples: Sequence[Sample]) -> Iterator[NDArray[np.float64]]:
    """Yield medians of the later part of each long start, in blocks."""
    longest = max(Counter(sample.start for sample in samples).values())
    for start in sorted({sample.start for sample in samples}):
        of_start = np.array([sample for sample in samples if sample.start == start], dtype=np.float64)
        if len(of_start) >= max(_MIN_SAMPLES, _LONG * longest):
            for part in np.array_split(of_start[int(len(of_start) * _WARM) :], _BLOCKS):
                yield np.median(part, axis=0)


def _left(watched: Watched, temporary: Path) -> list[str]:
    """Print what the processes left behind, and return it."""
    alive = [pid for pid, began in watched.processes if _began(pid) == began]
    shared = [name for name in sorted(watched.shared) if Path(name).exists()]
    files = [str(path.relative_to(temporary)) for path in sorted(temporary.rglob("*"))]
    print(
        f"left behind: {len(alive)} of {len(watched.processes)} processes, {len(shared)} of {len(watched.shared)} "
        f"pieces of shared memory, {len(files)} temporary files\n"
    )
    return (
        [f"process {pid} was left behind" for pid in alive]
        + [f"shared memory was left behind: {name}" for name in shared]
        + [f"a temporary file was left behind: {name}" for name in files]
    )


def left_in_session(session: Path) -> list[str]:
    """Print the files of a session by kind, and return those that have none."""
    kinds: dict[str, list[int]] = {}
    unknown = []
    for path in sorted(session.rglob("*")):
        if path.is_dir():
            if not any(path.iterdir()) and path.name != "snippets":
                unknown.append(f"{path.relative_to(session)}/")
            continue
        name = path.relative_to(session).as_posix()
        if (kind := next((kind for kind in _KINDS if fnmatchcase(name, kind)), None)) is None:
            unknown.append(name)
        else:
            kinds.setdefault(kind, []).append(path.stat().st_size)
    print(f"{'files':>6}{'MB':>10}  of the session")
    for kind, sizes in kinds.items():
        print(f"{len(sizes):>6}{sum(sizes) / _BYTES_PER_MB:>10.2f}  {kind}: {_KINDS[kind]}")
    print()
    problems = [f"a file of the session has no reason: {name}" for name in unknown]
    names = Counter(_ids(session / "contacts.geojson"))
    known = {json.loads(line)["contact"]["properties"]["id"] for line in (session / JOURNAL).read_bytes().splitlines()}
    if twice := [name for name, n in names.items() if n > 1]:
        problems.append(f"contacts are in the results twice: {', '.join(twice)}")
    if missing := sorted(set(names) - known):
        problems.append(f"contacts of the results are not in the journal: {', '.join(missing)}")
    return problems


def _ids(path: Path) -> list[str]:
    return [feature["properties"]["id"] for feature in json.loads(path.read_bytes())["features"]]


def _notices(evidence: Evidence) -> list[str]:
    """Print the notices by code, and return those that have no reason."""
    counted = Counter(notice["code"] for kind in ("notices", "remarks") for notice in evidence.summary.get(kind, ()))
    n_restarts = len(evidence.restarts)
    allowed = {
        "session_resumed": n_restarts,
        "port_up": (n_restarts + 1) * len(evidence.reports),
        "detect.cascade": n_restarts + 1,  # which one it is
        "service.work_shed": 1,
    }
    print("\nnotices: " + (", ".join(f"{code} {n}" for code, n in sorted(counted.items())) or "none"))
    problems = [f"notice {code} {n} times" for code, n in counted.items() if n > allowed.get(code, 0)]
    if counted["session_resumed"] < n_restarts:
        problems.append("not every restart went on with the session")
    return problems


@contextlib.contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Let the processes that are started meanwhile make their temporary files in a folder."""
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before


def _watched(folder: Path, over: threading.Event) -> Watched:
    watched = Watched([], [], set(), set())
    pid, start, began_s = None, 0, 0.0
    while not over.wait(_ENDING_S if watched.ending else _SAMPLE_S):
        if pid is None or not _is_service(pid, folder):
            pid = service_pid(folder)
            if pid is None:
                continue
            start += 1
            began_s = began_s or time.monotonic()
        with contextlib.suppress(FileNotFoundError, ProcessLookupError, PermissionError):  # it has ended
            children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()]
            perception = max(children, key=_resident_bytes, default=None)  # the other one tracks shared memory
            if perception is None:
                continue
            for process in (pid, *children):
                if began := _began(process):
                    watched.processes.add((process, began))
                    watched.shared.update(_shared(process))
            sample = Sample(
                time.monotonic() - began_s,
                start,
                _resident_bytes(pid),
                _resident_bytes(perception),
                _n_open(pid),
                _n_open(perception),
            )
            (watched.ending if STOPPING in console(folder) else watched.running).append(sample)
    return watched


def _is_service(pid: int, folder: Path) -> bool:
    with contextlib.suppress(OSError):
        return os.fsencode(folder / "service.yaml") in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    return False


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _n_open(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def _began(pid: int) -> str:
    """Return when a process began, in ticks after the start of the computer; empty for one that has ended."""
    with contextlib.suppress(OSError):
        state, *fields = Path(f"/proc/{pid}/stat").read_text("ascii", "replace").rpartition(")")[2].split()
        return "" if state == "Z" else fields[18]
    return ""


def _shared(pid: int) -> set[str]:
    """Return the names of files of shared memory that a process has mapped, those without a name left out."""
    maps = Path(f"/proc/{pid}/maps").read_text("utf-8", "replace")
    return {match[1] for match in re.finditer(r"(/dev/shm/\S+)$", maps, re.MULTILINE)}
