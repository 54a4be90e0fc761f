"""Run the service for long, and to a sudden end: memory, counters and tasks over a mission, and what SIGKILL costs.

auv-mcm bench soak [--minutes MIN] [--speed X]   the real service between fake devices: memory, counters, tasks
auv-mcm bench soak --minutes MIN --restarts N    the same, cut off N times on the way and started again at once
auv-mcm bench soak --stops N [--seed N]          stopped N times under load: within 5 s, with everything on disk
auv-mcm bench soak --kills N [--seed N]          killed N times: at most a second of the recording and no announced
                                                 contact may be lost
auv-mcm bench soak --restarts N [--seed N]       cut off N times in every way and started again: the same contacts in
                                                 the end, each announced once
auv-mcm bench soak --joined N --recording SESSION
                                                 a recording cut N times as kills and power cuts do: the joined replay
                                                 is the undisturbed mission
auv-mcm bench soak --rising                      at twice the ping rate each time, until pings are lost

Service, perception and devices are processes of their own on virtual ports, as of auv-mcm hil. Exit code 5 if anything
has died or is lost.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.errors import HardwareError, SelfCheckError, UsageError
from auv_mcm.records import Ping
from sim_replay.arguments import count, duration_min
from sim_replay.benches.joined import joined_outcomes
from sim_replay.benches.long_mission import bench_long_mission
from sim_replay.benches.restarts import WAYS, Cut, cut_off, keep_mission
from sim_replay.benches.rising_rate import RATES_HZ, at_rising_rates
from sim_replay.benches.stops import MAX_STOP_S, StopOutcome, stopped
from sim_replay.benches.watched_service import (
    FLOWN_MPS,
    SERVICE,
    health,
    read_mission,
    said,
    service_pid,
    simulate_mission,
)
from sim_replay.hil.announced import CONTACT, not_in_journal
from sim_replay.hil.run import RESULTS, SERVICE_LOG, run_scenario
from sim_replay.hil.scenario import Read
from sim_replay.logs.open_log import open_log
from sim_replay.logs.session_reader import Session, recorded_config

MAX_LOST_S: Final = 1.0
"""What a recording may lack at its end."""

_MINUTES: Final = 5.0  # of a mission, where none are given
_KILL_LEG_M: Final = 180.0  # contacts come half-way, so that devices still send when the service is killed
_KILL_SPEED: Final = 4.0  # times real time, of missions that end in a kill
_RESTARTED_S, _RESTARTED_MPS = 200.0, 3.0  # mission of sessions that are cut off: 600 m
_CUTS_PER_SESSION: Final = 20  # one in 30 m: each comes before the tile of the one before has ended
_AFTER_CONTACT_S: Final = 1.0  # s from an announced contact to the kill, maximum
_SETTLE_S: Final = 0.5  # between `ready` and the first bytes
_PATIENCE_S: Final = 60.0  # for the last contacts of a mission, on a computer that has much else to do
_HASTY: Final[dict[str, Any]] = {  # contacts come soon, and the service reports its progress often
    **SERVICE,
    "service": {"source": "ports", "health_period_s": 0.5},
    "waterfall": {"tile_rows": 64},
}


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
    parser.add_argument("--minutes", type=duration_min, help="length of the mission (default 5)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--restarts", type=count, help="cut the service off so often and start it again; with --minutes in one mission"
    )
    what.add_argument("--stops", type=count, help="request the service to stop so often, at random moments under load")
    what.add_argument("--kills", type=count, help="kill the service so often instead, at random moments")
    what.add_argument("--joined", type=count, help="cut a recording so often and compare its joined replay")
    what.add_argument("--rising", action="store_true", help="raise the ping rate until pings are lost")
    parser.add_argument(
        "--speed", type=int, choices=range(3, 25), default=6, help="speed of the mission, times real time (default 6)"
    )
    parser.add_argument("--recording", type=Path, help="session whose recording --joined cuts")
    parser.add_argument("--seed", type=count, default=1, help="seed of the moments of the kills (default 1)")


def run(arguments: argparse.Namespace) -> int:
    """Run the parts chosen and print; returns the exit code.

    Raises SelfCheckError for a task that died, or more lost than may be; UsageError for options that contradict.
    """
    if arguments.minutes is not None and (
        arguments.kills is not None or arguments.stops is not None or arguments.rising
    ):
        raise UsageError("--kills, --stops and --rising have missions of their own length: leave --minutes out")
    if (arguments.joined is None) != (arguments.recording is None):
        raise UsageError("--joined and --recording go together: name the session whose recording is cut")
    with tempfile.TemporaryDirectory(prefix="auv-mcm-soak-") as name:
        if arguments.restarts is not None and arguments.minutes is None:
            _bench_restarts(arguments.restarts, arguments.seed, Path(name))
        elif arguments.stops is not None:
            _bench_stops(arguments.stops, arguments.seed, Path(name))
        elif arguments.joined is not None:
            _bench_joined(arguments.recording, arguments.joined, arguments.seed, Path(name))
        elif arguments.kills is not None:
            _bench_kills(arguments.kills, arguments.seed, Path(name))
        elif arguments.rising:
            _bench_rising(Path(name))
        else:
            minutes, n_restarts = arguments.minutes or _MINUTES, arguments.restarts or 0
            bench_long_mission(minutes, n_restarts, float(arguments.speed), arguments.seed, Path(name))
    return 0


def killed(n_kills: int, seed: int, folder: Path) -> Iterator[KillOutcome]:
    """Run and kill the service n_kills times; every other time right after a contact was announced.

    Then most is at stake.

    Raises HardwareError for a run that ends before its kill.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    log, duration_s = simulate_mission(folder, _KILL_LEG_M / FLOWN_MPS * _KILL_SPEED, FLOWN_MPS / _KILL_SPEED)
    read = read_mission(log, duration_s, _KILL_SPEED, _HASTY, _PATIENCE_S)
    for index in range(n_kills):
        after_contact = index % 2 == 1
        wait_s = float(random.uniform(0.0, _AFTER_CONTACT_S if after_contact else _SETTLE_S + duration_s / _KILL_SPEED))
        yield _kill(read, folder / f"kill-{index}", "contact C" if after_contact else " ready: ", wait_s)


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


def _bench_joined(recording: Path, n_cuts: int, seed: int, folder: Path) -> None:
    outcomes = []
    for outcome in joined_outcomes(recording, n_cuts, seed, folder):
        outcomes.append(outcome)
        print(
            f"session {len(outcomes)}: {outcome.n_kills} kills, {outcome.n_power_cuts} power cuts, "
            f"{outcome.n_events} events, {outcome.n_contacts} contacts: "
            f"{'; '.join(outcome.problems) or 'as its undisturbed twin'}",
            flush=True,
        )
    n_kills, n_power_cuts = (sum(getattr(one, name) for one in outcomes) for name in ("n_kills", "n_power_cuts"))
    n_bad = sum(bool(one.problems) for one in outcomes)
    print(f"\n{n_kills} kills and {n_power_cuts} power cuts in {len(outcomes)} sessions, {n_bad} not as undisturbed")
    if n_bad:
        raise SelfCheckError(f"the joined replay of {n_bad} sessions is not that of their undisturbed twins")


def _bench_restarts(n_cuts: int, seed: int, folder: Path) -> None:
    """Cut sessions off, some twenty times each, and print what each way cost."""
    log, _ = simulate_mission(folder, _RESTARTED_S, _RESTARTED_MPS)
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


def _bench_stops(n_stops: int, seed: int, folder: Path) -> None:
    print(f"{'stop':>4}{'after s':>9}{'beside':>8}{'took s':>8}{'queued':>8}{'pings':>7}  {'':<10}problems")
    stops: list[StopOutcome] = []
    for stop in stopped(n_stops, seed, folder):
        stops.append(stop)
        print(
            f"{len(stops):>4}{stop.at_s:>9.2f}{stop.n_burners:>8}{stop.took_s:>8.2f}{stop.n_queued:>8}{stop.n_pings:>7}"
            f"  {'cut short' if stop.is_cut_short else '':<10}{'; '.join(stop.problems) or 'none'}",
            flush=True,
        )
    for n_burners in sorted({stop.n_burners for stop in stops}):
        took_s = [stop.took_s for stop in stops if stop.n_burners == n_burners]
        print(f"beside {n_burners} burners: half within {np.median(took_s):.2f} s, all within {max(took_s):.2f} s")
    print(f"load of this computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    if n_bad := sum(bool(stop.problems) for stop in stops):
        raise SelfCheckError(f"{n_bad} of {n_stops} stops took more than {MAX_STOP_S:g} s or left something out")


def _bench_rising(folder: Path) -> None:
    """Print what each ping rate came to, and what gave first. Raises SelfCheckError for a loss that nobody reported."""
    header = ("pings a second", "sent", "taken", "less work", "dropped", "waiting", "loop late, ms", "service %")
    print("  ".join((*header, "perception %", "reported")))
    gave = []
    for row in at_rising_rates(RATES_HZ, folder):
        cells = (
            f"{row.rate_hz:g}",
            f"{row.n_sent}",
            f"{row.n_taken}",
            f"{row.n_less_work}",
            f"{row.n_dropped}",
            f"{row.n_waiting}",
            f"{1e3 * row.late_s:.0f}",
            *(f"{100.0 * share:.0f}" for share in row.shares),
        )
        widths = [len(name) for name in (*header, "perception %")]
        print(
            "  ".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)),
            ", ".join(row.reported) or "nothing",
            sep="  ",
            flush=True,
        )
        if row.gave:
            gave.append(f"at {row.rate_hz:g} pings a second {row.gave}")
        if (row.n_dropped or row.n_less_work) and not row.reported:
            raise SelfCheckError(f"at {row.rate_hz:g} pings a second {row.gave}, and nothing reported it")
    print(f"\n{'; '.join(gave) or 'nothing gave'}")
    print(f"load of this computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


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
    reported = [n_pings for at_s, n_pings in health(console) if at_s <= struck.utc_s - MAX_LOST_S]
    return KillOutcome(
        at_s=struck.after_ready_s,
        lost_s=struck.mono_s - max((recorded.stamp.mono_ns for recorded in heard), default=0) / 1e9,
        n_bytes=sum(len(recorded.data) for recorded in heard),
        n_pings=len(pings),
        n_pings_reported=max(reported, default=0),
        n_holes=n_holes,
        n_contacts=sum(CONTACT.match(line) is not None for line in console),
        not_in_journal=not_in_journal(console, (results / "contacts.jsonl").read_bytes()),
    )


class _Struck(NamedTuple):
    after_ready_s: float
    mono_s: float
    utc_s: float


def _strike(folder: Path, awaited: str, wait_s: float, over: threading.Event) -> _Struck | None:
    """Wait for the text, then wait_s, then kill. None if the run was over before."""
    if not said(folder, " ready: ", over):
        return None
    ready_s = time.monotonic()
    if not said(folder, awaited, over) or over.wait(wait_s) or (pid := service_pid(folder)) is None:
        return None
    struck = _Struck(time.monotonic() - ready_s, time.monotonic(), time.time())
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    return struck
