"""Cut a mission off again and again, at random moments and in every way, and compare what it comes to in the end.

Each session is one simulated mission. It is cut off several times: all processes killed, the service or perception
alone, perception stopped, all at the moment of a contact or of a checkpoint, or all together with what a power cut
leaves: the newest file of events torn at a random byte behind what was synced, and a torn line in the journal. The
service is started again each time, some pings later, and goes on.

The rule: a session that was cut off gives byte for byte the contacts and the coverage of one that was fed the same
events without a break, each contact is announced once per change, and a kill loses no more than `MAX_LOST_S` of events
(of a power cut: `MAX_LOST_IN_CUT_S`). Events that come while nothing runs are given to neither.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from auv_mcm.errors import HardwareError
from auv_mcm.settings.config import Config, ServiceConfig, config_yaml
from auv_mcm.shell.checkpoint import newest_checkpoint
from auv_mcm.shell.event_spool import EventSpool, read_events
from auv_mcm.shell.recovery import JOURNAL, STATE
from sim_replay.fakes.kept_mission import COUNT, SYNCED
from sim_replay.logs.open_log import open_log

Way: TypeAlias = Literal["all", "service", "perception", "hang", "contact", "checkpoint", "power"]
WAYS: Final[tuple[Way, ...]] = get_args(Way)
READY_S: Final = 3.0
"""s from the start of a service that goes on to `ready`, on a computer that has nothing else to do."""
MAX_LOST_S: Final = 0.5
"""s of real time of which events may be lost by a kill. They wait in memory for a tenth of it; the rest is for a
computer that has much else to do."""
MAX_LOST_IN_CUT_S: Final = 1.5
"""The same of a power cut: they are synced after half a second."""
_GOES_ON: Final[tuple[Way, ...]] = ("perception", "hang")  # ways that the service outlives
_SKIPPED_EVENTS: Final = 60  # that come while nothing runs, maximum
_SOON_EVENTS: Final = 500  # given, for which a contact or a file is waited for: a tile's
_ALL_EVENTS: Final = 1 << 62  # more than any mission has
_QUEUE_PINGS: Final = 32  # so that what was given is not far ahead of what perception has
_POLL_S: Final = 0.002  # s between two looks at how far a run is
_PATIENCE_S: Final = 300.0  # s for a run to come to its next kill, on a computer that has much else to do
_CHECKPOINT_S: Final = 0.5  # s, so that there are some between two kills
_CONTACT: Final = re.compile(r"^contact (\S+) (new|updated)")


class Cut(NamedTuple):
    """Hold what one cut cost. ready_s: from the start to `ready` of the run that went on, NaN where none had to.

    n_lost: events that were given and are gone; lost_s: real time in which they came.
    """

    way: Way
    n_given: int
    ready_s: float
    n_lost: int
    lost_s: float


class Session(NamedTuple):
    """Hold a session that was cut off. problems: in words, what must not be."""

    cuts: list[Cut]
    n_contacts: int
    problems: tuple[str, ...]


def keep_mission(log: Path, folder: Path) -> int:
    """Write the events of a log to a folder, for `kept_mission`; return how many."""
    folder.mkdir()
    spool = EventSpool(folder)
    for number, event in enumerate(open_log(log, Config()), 1):
        spool.append(event)
        if number % 1000 == 0:  # far below what it may hold in memory
            spool.flush()
    spool.close()
    if spool.n_lost:
        raise HardwareError(f"{folder}: the disk does not take the mission. Make room on it.")
    return spool.last


def cut_off(mission: Path, n_events: int, n_cuts: int, seed: int, folder: Path) -> Session:
    """Run one session with n_cuts cuts, in ways and at moments that the seed decides, and compare it."""
    random = np.random.Generator(np.random.PCG64(seed))
    folder.mkdir()
    moments = sorted(random.integers(n_events // 20, n_events * 19 // 20, n_cuts).tolist())
    ways = [WAYS[index % len(WAYS)] for index in random.permutation(n_cuts)]
    run = _Run(mission, 0, folder)
    cuts: list[Cut] = []
    fed: list[tuple[int, int]] = []  # events (first, last] that came to perception
    said: list[str] = []
    problems: list[str] = []
    n_before = 0  # numbers given by runs before
    try:
        for moment, way in zip(moments, ways, strict=True):
            n_more = n_events - 1 - run.first  # one is kept back, so that the mission does not end
            run.wait_for(min(max(moment - run.first, 1), n_more), n_more, way)
            n_given = run.n_given
            if run.has_ended:
                last = "\n".join(run.lines[-20:])
                raise HardwareError(f"the service ended before it was cut off:\n{last}")
            run.strike(way)
            if way in _GOES_ON:
                cuts.append(Cut(way, run.first + n_given, float("nan"), 0, 0.0))
                continue
            n_given = run.n_given
            said += run.lines
            state = run.session / STATE
            if way == "power":
                _tear(run.session, *run.synced, random)
            n_kept = max([newest_checkpoint(state), *(spooled.number for spooled in read_events(state))]) - n_before
            fed.append((run.first, run.first + n_kept))
            lost_s = run.since(n_kept)
            if lost_s > (MAX_LOST_IN_CUT_S if way == "power" else MAX_LOST_S):
                problems.append(f"{way}: {lost_s:.2f} s of events are lost")
            first = min(run.first + n_given + int(random.integers(0, _SKIPPED_EVENTS)), n_events - 1)
            n_before += n_kept
            run = _Run(mission, first, folder)
            cuts.append(Cut(way, first, run.ready_s, max(n_given - n_kept, 0), lost_s))
        code = run.end()
        said += run.lines
        fed.append((run.first, n_events))
    finally:
        run.kill()
    if code:
        problems.append(f"the service ended with {code}")
    reference = _reference(mission, fed, folder)
    return Session(cuts, *_compared(run.session, reference, said, problems))


class _Run:
    """Run the service once, from event `first` of the mission on."""

    def __init__(self, mission: Path, first: int, folder: Path) -> None:
        self.first = first
        self._history: deque[tuple[float, int]] = deque([(0.0, 0)])  # s, events given by then
        self._struck_s = 0.0
        self.lines: list[str] = []
        self._results = folder / "results"
        self._given = folder / "given"
        self._given.write_bytes(COUNT.pack(0) + COUNT.pack(0))
        config = folder / "service.yaml"
        config.write_text(
            config_yaml(Config(service=ServiceConfig(output_directory=str(self._results), queue_pings=_QUEUE_PINGS)))
        )
        started_s = time.monotonic()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "sim_replay.fakes.kept_mission"]
            + [str(part) for part in (config, mission, first, self._given, _CHECKPOINT_S)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._is_ready = threading.Event()
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()
        if not self._is_ready.wait(_PATIENCE_S) or self._process.poll() is not None:
            raise HardwareError("the service did not come up:\n" + "\n".join(self.lines[-20:]))
        self.ready_s = time.monotonic() - started_s

    @property
    def n_given(self) -> int:
        """Count the events that were given so far."""
        n_given = int(COUNT.unpack_from(self._given.read_bytes())[0])
        if n_given != self._history[-1][1]:
            self._history.append((time.monotonic(), n_given))
        return n_given

    def since(self, n_given: int) -> float:
        """Give the time before the strike in which more events than so many were given, s."""
        return self._struck_s - min((at_s for at_s, n in self._history if n > n_given), default=self._struck_s)

    @property
    def synced(self) -> tuple[str, int]:
        """Return the name of the file of events that was synced last, and its bytes then."""
        noted = self._given.with_name("given.synced").read_bytes()
        name, n_bytes = SYNCED.unpack(noted) if noted else (b"", 0)
        return name.rstrip(b"\0").decode(), n_bytes

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    @property
    def session(self) -> Path:
        return (self._results / "latest").resolve()

    def _allow(self, n_events: int) -> None:
        with self._given.open("r+b") as file:
            file.seek(COUNT.size)
            file.write(COUNT.pack(n_events))

    def wait_for(self, n_given: int, n_most: int, way: Way) -> None:
        """Wait until so many events were given and, by way, for a contact or for a file being written, if soon.

        n_most: events that may be given at most.
        """
        until_s = time.monotonic() + _PATIENCE_S
        n_most = min(n_given + _SOON_EVENTS, n_most)
        self._allow(n_most)
        n_lines = -1
        while time.monotonic() < until_s and self._process.poll() is None:
            if self.n_given >= n_most:
                return
            if self.n_given >= n_given:
                n_lines = len(self.lines) if n_lines < 0 else n_lines
                has_contact = any(map(_CONTACT.match, self.lines[n_lines:]))
                is_writing = way != "checkpoint" or any((self.session / STATE).glob(".*.new"))
                if is_writing and (has_contact or way != "contact"):
                    return
            time.sleep(_POLL_S)

    def strike(self, way: Way) -> None:
        """End what is to end."""
        self._struck_s = time.monotonic()
        if way in _GOES_ON:
            for pid in self._children():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGSTOP if way == "hang" else signal.SIGKILL)
        elif way == "service":
            self._process.kill()
            self._process.wait()
            self._reading.join()
        else:
            self.kill()

    def kill(self) -> None:
        """End all processes at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._reading.join()

    def end(self) -> int:
        """Let the mission come to its end; return the exit code."""
        self._allow(_ALL_EVENTS)
        return self._process.wait(_PATIENCE_S)

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout:
            for line in self._process.stdout:
                self.lines.append(line.rstrip("\n"))
                if line.startswith("ready: "):
                    self._is_ready.set()
        self._is_ready.set()

    def _children(self) -> list[int]:
        """List the perception processes."""
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        return [pid for pid in map(int, children) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def _tear(session: Path, synced_name: str, synced_bytes: int, random: np.random.Generator) -> None:
    """Leave of the files what a power cut may: what was not synced ends anywhere."""
    path = max((session / STATE).glob("events-*.bin"))
    first_byte = synced_bytes if path.name == synced_name else 0
    os.truncate(path, int(random.integers(first_byte, path.stat().st_size + 1)))
    with (session / JOURNAL).open("ab") as file:
        file.write(b'{"time":"2026-01-01T00:00:00Z","event":12,"cont'[: int(random.integers(0, 40))])
    (session / STATE / ".torn.new").write_bytes(bytes(100))


def _reference(mission: Path, fed: list[tuple[int, int]], folder: Path) -> Path:
    """Serve the same events without a break; return the session's folder."""
    kept = folder / "fed"
    kept.mkdir()
    spool = EventSpool(kept)
    for first, last in fed:
        for number, spooled in enumerate(read_events(mission, first, last)):
            spool.append(spooled.event)
            if number % 1000 == 0:
                spool.flush()
    spool.close()
    (folder / "undisturbed").mkdir()
    run = _Run(kept, 0, folder / "undisturbed")
    try:
        run.end()
    finally:
        run.kill()
    return run.session


def _compared(session: Path, reference: Path, said: list[str], problems: list[str]) -> tuple[int, tuple[str, ...]]:
    """Compare a session with its reference; return the number of contacts, and the problems."""
    for name in ("contacts.geojson", "contacts.csv", "coverage.geojson", "clearance.geojson"):
        if (session / name).read_bytes() != (reference / name).read_bytes():
            problems.append(f"{name} differs")
    announced = [_announced(folder) for folder in (session, reference)]
    if announced[0] != announced[1]:
        problems.append(f"{len(announced[0])} changes of contacts were announced instead of {len(announced[1])}")
    new = Counter(match[1] for line in said if (match := _CONTACT.match(line)) and match[2] == "new")
    problems += [f"{name} was announced as new {count} times" for name, count in new.items() if count > 1]
    problems += [line for line in said if line.startswith("Traceback")]
    if (session / STATE).exists():
        problems.append(f"{STATE} was left behind")
    return len(json.loads((session / "contacts.geojson").read_bytes())["features"]), tuple(problems)


def _announced(session: Path) -> list[str]:
    """List what the journal holds, without the times."""
    return [json.dumps(json.loads(line)["contact"]) for line in (session / JOURNAL).read_bytes().splitlines()]
