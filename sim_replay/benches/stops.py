"""Stop the service with SIGTERM at random moments of a busy mission: how long it takes, and that all is on disk.

The mission is flown at twelve times real time and does not wait, so that pings queue up where perception is behind.
Beside every other stop processes burn all processors.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.errors import HardwareError
from auv_mcm.records import Ping
from auv_mcm.shell.event_spool import read_events
from auv_mcm.shell.recovery import JOURNAL, RECORDING, STATE, SUMMARY
from sim_replay.benches.watched_service import (
    FLOWN_MPS,
    SERVICE,
    read_mission,
    said,
    service_pid,
    simulate_mission,
)
from sim_replay.hil.announced import not_in_journal
from sim_replay.hil.run import RESULTS, run_scenario
from sim_replay.hil.scenario import Read
from sim_replay.hil.verdict import Evidence
from sim_replay.logs.open_log import open_log
from sim_replay.logs.session_reader import Session, recorded_config

MAX_STOP_S: Final = 5.0
"""s from SIGTERM to the end: `service.stop_within_s` as it is without a configuration."""
_SPEED: Final = 12.0  # times real time
_WAY_M: Final = 300.0  # m, of one leg: 25 s at 12 m/s
_STOP_S: Final = (2.0, 22.0)  # s from `ready` to the stop: with and without contacts, at all states of a tile
_BURNERS: Final = 4  # processes for each processor
_POLL_S: Final = 0.01  # s between looks whether it has ended
_PATIENCE_S: Final = 60.0  # s, after which it is given up
_QUEUED: Final = re.compile(r" stopping: (\d+) pings still queued")
_CUT_SHORT: Final = "the stop came before all was worked off"
_HASTY: Final[dict[str, Any]] = {
    **SERVICE,
    "service": {"source": "ports", "stop_within_s": MAX_STOP_S},
    "waterfall": {"tile_rows": 64},
}


class StopOutcome(NamedTuple):
    """Hold what a stop took, and what is on disk behind it.

    n_burners: processes that burned processors beside it. n_queued: pings that waited when the stop came. is_cut_short:
    not all was worked off, and the next start goes on. n_unkept: pings in the recording that are neither in the results
    nor among the events for the next start. not_in_journal: lines that announced contacts which the journal lacks.
    """

    at_s: float
    n_burners: int
    took_s: float
    exit_code: int | None
    n_queued: int
    is_cut_short: bool
    n_pings: int
    n_unkept: int
    not_in_journal: tuple[str, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """List what must not be, in words; empty if nothing."""
        found = []
        if not self.took_s <= MAX_STOP_S:
            found.append(f"the stop took {self.took_s:.2f} s, more than {MAX_STOP_S:g} s")
        if self.exit_code != 0:
            found.append(f"the service ended with {self.exit_code}")
        if self.n_unkept:
            found.append(f"{self.n_unkept} pings are in the recording alone")
        found += [f"announced but not in {JOURNAL}: {line}" for line in self.not_in_journal]
        return tuple(found)


def stopped(n_stops: int, seed: int, folder: Path) -> Iterator[StopOutcome]:
    """Run and stop the service n_stops times, every other time beside burners.

    Raises HardwareError for a run that ends before its stop.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    log, duration_s = simulate_mission(folder, _WAY_M / FLOWN_MPS * _SPEED, FLOWN_MPS / _SPEED)
    read = read_mission(log, duration_s, _SPEED, _HASTY, _PATIENCE_S)
    for index in range(n_stops):
        n_burners = _BURNERS * (os.cpu_count() or 1) if index % 2 else 0
        yield _stop(read, folder / f"stop-{index}", float(random.uniform(*_STOP_S)), n_burners)


def _stop(read: Read, folder: Path, after_s: float, n_burners: int) -> StopOutcome:
    over = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        stopping = pool.submit(_terminate, folder, after_s, n_burners, over)
        try:
            evidence = run_scenario(read, folder, lambda line: None)
        finally:
            over.set()
        took_s = stopping.result()
    if took_s is None:
        raise HardwareError(
            f"the service ended (exit code {evidence.exit_code}) before it could be stopped; see {folder}"
        )
    console = [line.text for line in evidence.lines]
    session = (folder / RESULTS / "latest").resolve()
    recording = Session(session / RECORDING)
    events = open_log(session / RECORDING, recorded_config(recording))
    numbers = [event.number for event in events if isinstance(event, Ping)]
    return StopOutcome(
        at_s=after_s,
        n_burners=n_burners,
        took_s=took_s,
        exit_code=evidence.exit_code,
        n_queued=max((int(match[1]) for line in console if (match := _QUEUED.search(line))), default=0),
        is_cut_short=any(_CUT_SHORT in line for line in console),
        n_pings=len(numbers),
        n_unkept=_n_unkept(session, evidence, numbers),
        not_in_journal=not_in_journal(console, (session / JOURNAL).read_bytes()),
    )


def _n_unkept(session: Path, evidence: Evidence, numbers: Sequence[int]) -> int:
    """Count the pings of a recording that are neither worked off nor kept for the next start."""
    if (session / SUMMARY).exists() and not (session / STATE).exists():
        return len(numbers) - int(evidence.summary["pings"])
    kept = [spooled.event.number for spooled in read_events(session / STATE) if isinstance(spooled.event, Ping)]
    newest = max(kept, default=-1)
    return sum(number > newest for number in numbers)


def _terminate(folder: Path, after_s: float, n_burners: int, over: threading.Event) -> float | None:
    """Stop the service after_s after `ready`; return the time until it has ended, s. None if it had before."""
    if not said(folder, " ready: ", over):
        return None
    with _burning(n_burners):
        if over.wait(after_s) or (pid := service_pid(folder)) is None:
            return None
        stopped_s = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
        while not over.is_set() and Path(f"/proc/{pid}").exists():
            time.sleep(_POLL_S)
        return time.monotonic() - stopped_s


@contextlib.contextmanager
def _burning(n_burners: int) -> Iterator[None]:
    """Burn processors meanwhile."""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n_burners)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
