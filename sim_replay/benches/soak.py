"""Run the service for long, and to a sudden end: memory, counters and tasks over a mission, and what SIGKILL costs.

auv-mcm bench soak [--minutes MIN] [--speed X]   the real service between fake devices: memory, counters, tasks
auv-mcm bench soak --kills N [--seed N]          killed N times: at most a second of the recording and no announced
                                                 contact may be lost
auv-mcm bench soak --restarts N [--seed N]       cut off N times in every way and started again: the same contacts in
                                                 the end, each announced once

Service, perception and devices are processes of their own on virtual ports, as of auv-mcm hil. Exit code 5 if anything
has died or is lost.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.errors import HardwareError, SelfCheckError
from auv_mcm.records import Ping
from sim_replay.arguments import count, duration_min
from sim_replay.benches.restarts import WAYS, Cut, cut_off, keep_mission
from sim_replay.fakes.job import Device
from sim_replay.hil.run import RESULTS, SERVICE_LOG, run_scenario
from sim_replay.hil.scenario import ExitCode, Expectation, Read, Scenario
from sim_replay.hil.verdict import Evidence
from sim_replay.logs.open_log import open_log
from sim_replay.logs.session_reader import Session, recorded_config
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import read_scene

MAX_LOST_S: Final = 1.0
"""What a recording may lack at its end."""

_FLOWN_MPS: Final = 12.0  # at a multiple of real time; faster, no navigation unit could report it
_LONGEST_LEG_M: Final = 300.0  # m of a leg
_TARGET_EVERY_M: Final = 15.0  # m of a leg between targets
_KILL_LEG_M: Final = 180.0  # contacts come half-way, so that devices still send when the service is killed
_KILL_SPEED: Final = 4.0  # times real time, of missions that end in a kill
_RESTARTED_S, _RESTARTED_MPS = 200.0, 3.0  # mission of sessions that are cut off: 600 m
_CUTS_PER_SESSION: Final = 20  # one in 30 m: each comes before the tile of the one before has ended
_AFTER_CONTACT_S: Final = 1.0  # s from an announced contact to the kill, maximum
_SETTLE_S: Final = 0.5  # between `ready` and the first bytes
_POLL_S: Final = 0.02  # s between looks at the service's output
_SAMPLE_S: Final = 0.5  # s between samples of memory
_MAX_ROWS: Final = 12  # of the table printed
_PATIENCE_S: Final = 60.0  # for the last contacts of a mission, on a computer that has much else to do
_BYTES_PER_MB: Final = 1e6  # bytes per megabyte
_HEALTH: Final = re.compile(
    r"^(\S+)Z INFO health pings=(\d+) .*contacts=(\d+) clutter=(\d+) .*ports=(\S+)", re.MULTILINE
)
_TRACEBACK: Final = "Traceback (most recent call last):"
_OVERRUN: Final = "port.overrun"
_STOPPING: Final = " INFO stopping: "
_CONTACT: Final = re.compile(r"^contact (\S+) (?:new|updated): (\S+), p_mine (\S+), (\S+) (\S+), (\d+) views$")
_DEAD: Final = re.compile(
    r"Traceback|\bERROR\b|perception has taken no ping|notice (?:intake_failed|decoder_failed|session_\w+):"
)
_SERVICE: Final[dict[str, Any]] = {
    "service": {"source": "ports"},
    "ports": [
        {"name": "sonar", "link": "{sonar}", "device": "ping_protocol", "sonar": {"range_m": 30, "n_samples": 400}},
        {"name": "nav", "link": "{nav}", "device": "nmea2000"},
    ],
}
_HASTY: Final[dict[str, Any]] = {  # contacts come soon, and the service reports its progress often
    **_SERVICE,
    "service": {"source": "ports", "health_period_s": 0.5},
    "waterfall": {"tile_rows": 64},
}
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


class Memory(NamedTuple):
    """Hold resident memory, at an instant of the run.

    n_contacts: known by then, clutter included, as the last health line had it.
    """

    at_s: float
    service_bytes: int
    perception_bytes: int
    n_contacts: int


class Watched(NamedTuple):
    """Hold the memory of a run until its stop was requested.

    Holds also the maximum of either process while results are written.
    """

    memory: list[Memory]
    ending: list[Memory]


class KillOutcome(NamedTuple):
    """Hold what was left of a service that was killed.

    lost_s: from the last recorded byte to the kill. n_pings: in the recording; n_pings_reported: that the service had
    reported a second before the kill. n_holes: messages missing or damaged within the recording. n_contacts: announced
    on the console; not_in_journal: those of them that contacts.jsonl lacks.
    """

    at_s: float
    lost_s: float
    n_bytes: int
    n_pings: int
    n_pings_reported: int
    n_holes: int
    n_contacts: int
    not_in_journal: tuple[str, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """List what must not be, in words; empty if nothing."""
        found = []
        if not self.lost_s <= MAX_LOST_S:
            found.append(f"the last {self.lost_s:.2f} s of the recording are lost, more than {MAX_LOST_S:g} s")
        if self.n_holes:
            found.append(f"{self.n_holes} messages are missing within the recording")
        if self.n_pings < self.n_pings_reported:
            found.append(
                f"the recording has {self.n_pings} pings, but {self.n_pings_reported} were reported a second before"
            )
        found += [f"announced but not in contacts.jsonl: {line}" for line in self.not_in_journal]
        return tuple(found)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench soak`."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--minutes", type=duration_min, default=5.0, help="length of the mission (default 5)")
    what.add_argument("--restarts", type=count, help="cut the service off so often and start it again")
    what.add_argument("--kills", type=count, help="kill the service so often instead, at random moments")
    parser.add_argument(
        "--speed", type=int, choices=range(3, 13), default=6, help="speed of the mission, times real time (default 6)"
    )
    parser.add_argument("--seed", type=count, default=1, help="seed of the moments of the kills (default 1)")


def run(arguments: argparse.Namespace) -> int:
    """Run the parts chosen and print; returns the exit code.

    Raises SelfCheckError for a task that died, or more lost than may be.
    """
    with tempfile.TemporaryDirectory(prefix="auv-mcm-soak-") as name:
        if arguments.restarts is not None:
            _bench_restarts(arguments.restarts, arguments.seed, Path(name))
        elif arguments.kills is not None:
            _bench_kills(arguments.kills, arguments.seed, Path(name))
        else:
            _bench_soak(arguments.minutes, float(arguments.speed), Path(name))
    return 0


def killed(n_kills: int, seed: int, folder: Path) -> Iterator[KillOutcome]:
    """Run and kill the service n_kills times; every other time right after a contact was announced.

    Then most is at stake.

    Raises HardwareError for a run that ends before its kill.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    log, duration_s = _mission(folder, _KILL_LEG_M / _FLOWN_MPS * _KILL_SPEED, _FLOWN_MPS / _KILL_SPEED)
    read = _read(log, duration_s, _KILL_SPEED, _HASTY, _PATIENCE_S)
    for index in range(n_kills):
        after_contact = index % 2 == 1
        wait_s = float(random.uniform(0.0, _AFTER_CONTACT_S if after_contact else _SETTLE_S + duration_s / _KILL_SPEED))
        yield _kill(read, folder / f"kill-{index}", "contact C" if after_contact else " ready: ", wait_s)


def not_in_journal(console: Sequence[str], journal: bytes) -> tuple[str, ...]:
    """List the console's lines of contacts which no whole line of contacts.jsonl holds with the same figures."""
    held = []
    for record in journal.split(b"\n")[:-1]:  # what has no end was cut off, and never announced
        feature = json.loads(record)["contact"]
        held.append((feature["properties"], feature["geometry"]["coordinates"]))
    missing = []
    for line in console:
        if (matched := _CONTACT.match(line)) is None:
            continue
        contact_id, classification, *figures = matched.groups()
        p_mine, latitude_deg, longitude_deg = map(float, figures[:3])
        if not any(
            properties["id"] == contact_id
            and properties["class"] == classification
            and math.isclose(properties["p_mine"], p_mine, abs_tol=0.0051)
            and math.isclose(place[1], latitude_deg, abs_tol=2e-7)
            and math.isclose(place[0], longitude_deg, abs_tol=2e-7)
            for properties, place in held
        ):
            missing.append(line)
    return tuple(missing)


def _bench_kills(n_kills: int, seed: int, folder: Path) -> None:
    print(f"{'kill':>4}{'after s':>9}{'lost s':>8}{'bytes':>9}{'pings':>7}{'reported':>10}{'contacts':>10}  problems")
    kills = []
    for kill in killed(n_kills, seed, folder):
        kills.append(kill)
        print(
            f"{len(kills):>4}{kill.at_s:>9.2f}{kill.lost_s:>8.2f}{kill.n_bytes:>9}{kill.n_pings:>7}"
            f"{kill.n_pings_reported:>10}{kill.n_contacts:>10}  {'; '.join(kill.problems) or 'none'}",
            flush=True,
        )
    n_bad = sum(bool(kill.problems) for kill in kills)
    print(
        f"\nlost at most {max(kill.lost_s for kill in kills):.2f} s; {sum(kill.n_contacts for kill in kills)} lines "
        "announced contacts"
    )
    if n_bad:
        raise SelfCheckError(f"{n_bad} of {n_kills} kills cost more than they may; the table says what")


def _bench_restarts(n_cuts: int, seed: int, folder: Path) -> None:
    """Cut sessions off, some twenty times each, and print what each way cost."""
    log, _ = _mission(folder, _RESTARTED_S, _RESTARTED_MPS)
    mission = folder / "mission"
    n_events = keep_mission(log, mission)
    n_sessions = math.ceil(n_cuts / _CUTS_PER_SESSION)
    cuts: list[Cut] = []
    problems: list[str] = []
    for index in range(n_sessions):
        n_here = n_cuts // n_sessions + (index < n_cuts % n_sessions)
        session = cut_off(mission, n_events, n_here, seed + index, folder / f"session-{index}")
        print(
            f"session {index + 1} of {n_sessions}: {len(session.cuts)} cuts, {session.n_contacts} contacts, "
            f"{'; '.join(session.problems) or 'as undisturbed'}",
            flush=True,
        )
        cuts += session.cuts
        problems += session.problems
    print(f"\n{'way':<12}{'cuts':>6}{'ready s, median':>17}{'max':>7}{'events lost, max':>18}{'s, max':>8}")
    for way in WAYS:
        of_way = [cut for cut in cuts if cut.way == way]
        ready_s = np.array([cut.ready_s for cut in of_way])
        n_lost = max((cut.n_lost for cut in of_way), default=0)
        known = ready_s[np.isfinite(ready_s)]
        middle, most = (float(np.median(known)), float(known.max())) if known.size else (math.nan, math.nan)
        lost_s = max((cut.lost_s for cut in of_way), default=0.0)
        print(f"{way:<12}{len(of_way):>6}{middle:>17.2f}{most:>7.2f}{n_lost:>18}{lost_s:>8.2f}")
    print(f"\nload of this computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    if problems:
        raise SelfCheckError(f"sessions that were cut off are not as undisturbed: {'; '.join(problems)}")


def _kill(read: Read, folder: Path, awaited: str, wait_s: float) -> KillOutcome:
    """Kill the service wait_s after a text came up in its log, and look at what is left."""
    over = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        striking = pool.submit(_strike, folder, awaited, wait_s, over)
        try:
            evidence = run_scenario(read, folder, lambda line: None)
        finally:
            over.set()
        struck = striking.result()
    if struck is None or evidence.exit_code != -signal.SIGKILL:
        raise HardwareError(
            f"the service ended (exit code {evidence.exit_code}) before it could be killed; see {folder / SERVICE_LOG}"
        )
    results = folder / RESULTS / "latest"
    session = Session(results / "recording")
    heard = [recorded for recorded in session if recorded.direction == "in"]
    holes = ("session.messages_missing", "session.chunks_damaged", "session.chunks_lost")
    n_holes = sum(session.counters[name] for name in holes)
    pings = [event for event in open_log(results / "recording", recorded_config(session)) if isinstance(event, Ping)]
    console = [line.text for line in evidence.lines]
    reported = [n_pings for at_s, n_pings in _health(console) if at_s <= struck.utc_s - MAX_LOST_S]
    return KillOutcome(
        at_s=struck.after_ready_s,
        lost_s=struck.mono_s - max((recorded.stamp.mono_ns for recorded in heard), default=0) / 1e9,
        n_bytes=sum(len(recorded.data) for recorded in heard),
        n_pings=len(pings),
        n_pings_reported=max(reported, default=0),
        n_holes=n_holes,
        n_contacts=sum(_CONTACT.match(line) is not None for line in console),
        not_in_journal=not_in_journal(console, (results / "contacts.jsonl").read_bytes()),
    )


class _Struck(NamedTuple):
    after_ready_s: float
    mono_s: float
    utc_s: float


def _strike(folder: Path, awaited: str, wait_s: float, over: threading.Event) -> _Struck | None:
    """Wait for the text, then wait_s, then kill. None if the run was over before."""
    if not _said(folder, " ready: ", over):
        return None
    ready_s = time.monotonic()
    if not _said(folder, awaited, over) or over.wait(wait_s) or (pid := _service_pid(folder)) is None:
        return None
    struck = _Struck(time.monotonic() - ready_s, time.monotonic(), time.time())
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    return struck


def _said(folder: Path, text: str, over: threading.Event) -> bool:
    """Wait until a line of the service's output contains a text; False if the run was over before."""
    while not over.wait(_POLL_S):
        with contextlib.suppress(FileNotFoundError):
            if text in _console(folder):
                return True
    return False


def _bench_soak(minutes: float, speed: float, folder: Path) -> None:
    log, duration_s = _mission(folder, minutes * 60.0, _FLOWN_MPS / speed)
    read = _read(log, duration_s, speed, _SERVICE, patience_s=1.0)
    over = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        watching = pool.submit(_watched_memory, folder, over)
        try:
            evidence = run_scenario(read, folder, lambda line: print(line, file=sys.stderr, flush=True))
        finally:
            over.set()
        watched = watching.result()
    print(
        f"{duration_s / 60.0:.1f} min of mission at {speed:g} times real time; service, perception and 2 devices as "
        "processes\n"
    )
    _print_memory(watched.memory, speed)
    if watched.ending:
        service_bytes, perception_bytes = (max(found[index] for found in watched.ending) for index in (1, 2))
        print(
            f"while the results were written: service at most {service_bytes / _BYTES_PER_MB:.1f} MB, "
            f"perception {perception_bytes / _BYTES_PER_MB:.1f} MB\n"
        )
    unexplained = print_counters(evidence)
    dead = found_dead(evidence)
    print(f"\nunexplained: {', '.join(unexplained) or 'none'}")
    print(f"died: {'; '.join(dead) or 'nothing'}")
    if dead:
        raise SelfCheckError(f"not all of the service lived to the end: {'; '.join(dead)}")


def _print_memory(memory: Sequence[Memory], speed: float) -> None:
    if len(memory) < 4:
        raise SelfCheckError("the run was too short to measure memory over time; give more --minutes")
    print(f"{'s':>8}{'service MB':>12}{'perception MB':>15}{'contacts':>10}")
    for index in np.unique(np.linspace(0, len(memory) - 1, _MAX_ROWS).astype(int)):
        at_s, service_bytes, perception_bytes, n_contacts = memory[index]
        service_mb, perception_mb = service_bytes / _BYTES_PER_MB, perception_bytes / _BYTES_PER_MB
        print(f"{at_s:>8.1f}{service_mb:>12.1f}{perception_mb:>15.1f}{n_contacts:>10}")
    # The first half fills caches. Medians, since memory that is used for a moment comes and goes.
    late = np.array(
        [
            np.median(part, axis=0)
            for part in np.array_split(np.asarray(memory[len(memory) // 2 :]), _MAX_ROWS)
            if len(part)
        ]
    )
    mission_h = (late[:, 0] - late[0, 0]) * speed / 3600.0
    service, perception, contacts = np.polynomial.polynomial.polyfit(mission_h, late[:, 1:], 1)[1]
    print(
        f"slope over the second half, per hour of mission: service {service / _BYTES_PER_MB:+.1f} MB, "
        f"perception {perception / _BYTES_PER_MB:+.1f} MB, {contacts:+.0f} contacts"
    )
    if contacts > 0.0:
        print(f"per contact: service {service / contacts:+.0f} bytes, perception {perception / contacts:+.0f} bytes")
    print()


def print_counters(evidence: Evidence) -> list[str]:
    """Print all counters, and return the names of those that a sound run has no reason for."""
    unexplained = []
    counters_of = {
        name: report.details
        for name, reports in evidence.reports.items()
        for report in reports
        if report.what == "counters"
    }
    expected = dict(_EXPECTED)
    for name, counters in counters_of.items():
        if counters.get(_OVERRUN, 0):
            expected |= {
                f"port.{name}.*.{what}": "messages that lost bytes on the line"
                for what in ("bytes_skipped", "refused.*", "lone_*")
            }
    print(f"{'count':>10}  {'counter':<36}reason")
    for name, n in sorted(evidence.summary.get("counters", {}).items()):
        why = next((why for pattern, why in expected.items() if fnmatchcase(name, pattern)), None)
        if why is None:
            unexplained.append(f"{name} {n}")
        print(f"{n:>10}  {name:<36}{why or 'UNEXPLAINED'}")
    for name, counters in counters_of.items():
        if n := counters.get("device.skipped", 0):
            print(f"{n:>10}  events that the fake device '{name}' left out, since the computer was too slow")
        if n := counters.get(_OVERRUN, 0):
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
    live = lines[: next((index for index, line in enumerate(lines) if _STOPPING in line), len(lines))]
    last = next((match for line in reversed(live) if (match := _HEALTH.match(line))), None)
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


def _watched_memory(folder: Path, over: threading.Event) -> Watched:
    watched = Watched([], [])
    if not _said(folder, " ready: ", over) or (pid := _service_pid(folder)) is None:
        return watched
    begun_s = time.monotonic()
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
        while not over.wait(_SAMPLE_S if not watched.ending else _POLL_S):
            console = _console(folder)
            children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()]
            perception_bytes = max(map(_resident_bytes_or_0, children), default=0)  # the other one tracks shared memory
            found = Memory(time.monotonic() - begun_s, _resident_bytes(pid), perception_bytes, _n_contacts(console))
            (watched.ending if _STOPPING in console else watched.memory).append(found)
    return watched


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _resident_bytes_or_0(pid: int) -> int:
    """Read the resident memory, bytes; 0 for a process that has ended."""
    try:
        return _resident_bytes(pid)
    except (FileNotFoundError, ProcessLookupError):
        return 0


def _console(folder: Path) -> str:
    """Read what the service has printed so far. Raises FileNotFoundError before it has begun."""
    return (folder / SERVICE_LOG).read_text("utf-8", "replace")


def _n_contacts(console: str) -> int:
    matched = list(_HEALTH.finditer(console))
    return int(matched[-1][3]) + int(matched[-1][4]) if matched else 0


def _service_pid(folder: Path) -> int | None:
    """Find the process that serves the configuration in the folder."""
    configuration = os.fsencode(folder / "service.yaml")
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if configuration in path.read_bytes().split(b"\0"):
                return int(path.parent.name)
    return None


def _health(console: Sequence[str]) -> Iterator[tuple[float, int]]:
    """Read UTC and pings taken of each health line."""
    for line in console:
        if (match := _HEALTH.match(line)) is not None:
            yield datetime.fromisoformat(match[1]).replace(tzinfo=UTC).timestamp(), int(match[2])


def _mission(folder: Path, duration_s: float, vehicle_mps: float) -> tuple[Path, float]:
    """Simulate a log of flat sand with targets on either side all along, about so long; return its real duration, s."""
    way_m = duration_s * vehicle_mps
    n_legs = math.ceil(way_m / _LONGEST_LEG_M)
    leg_m = way_m / n_legs
    scene = {
        "name": "soak",
        "world": {"depth_m": 18, "relief_rms_m": 0.02, "patch_m": 40, "seabeds": [{"type": "sand"}]},
        "sonar": {"frequency_khz": 450, "range_m": 30, "n_samples": 400, "ping_rate_hz": 10},
        "track": {
            "altitude_m": 5,
            "speed_mps": vehicle_mps,
            "plan": {"pattern": "lawnmower", "heading_deg": 35, "n_legs": n_legs, "leg_m": leg_m, "spacing_m": 70},
        },
        "objects": [
            {"kind": "cylinder", "leg": leg, "along_m": along_m, "across_m": 14 * (-1) ** index, "azimuth_deg": 35}
            for leg in range(n_legs)
            for index, along_m in enumerate(np.arange(5.0, leg_m, _TARGET_EVERY_M).tolist())
        ],
    }
    path = folder / "soak.yaml"
    path.write_bytes(msgspec.yaml.encode(scene))
    simulated = simulate(read_scene(str(path)), folder)
    return simulated.log, simulated.duration_s


def _read(log: Path, duration_s: float, speed: float, service: dict[str, Any], patience_s: float) -> Read:
    """Follow the run of a mission to its end, and patience_s more."""
    scenario = Scenario(
        about="a long run",
        log=str(log.resolve()),
        speed=speed,
        run_s=duration_s / speed + patience_s,
        devices={
            "sonar": Device(device="ping_protocol", link="serial", baud=4_000_000),
            "nav": Device(device="nmea2000", link="slcan", baud=4_000_000, bus_bitrate=1_000_000),
        },
        service=service,
        expectations=(Expectation(test="ends when stopped", expected=ExitCode()),),
    )
    return Read("soak", log.parent, scenario)
