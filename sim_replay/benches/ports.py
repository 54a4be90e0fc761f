"""Measure what the service costs at a full serial line.

From its start to the first ping, processor time, and how late pings are.

auv-mcm bench ports [--only PART ...] [--seconds S] [--repeat N] [--baud BAUD]

A sonar sends both sides of its pings, or garbage, at the full rate of a pseudo-terminal's line. Bytes get there 64 at a
time, each such packet as soon as it is due, as from a USB adapter: a reader on an idle computer is then woken for each.
Figures are medians over runs, each of a new service; its perception's time is not counted, and in the last rows it is
kept busy. Compare figures of one computer only.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.errors import HardwareError
from auv_mcm.records import Ping
from drivers.port_intake import PortIntake
from drivers.sonar import ping_messages
from sim_replay.arguments import count
from sim_replay.benches.framers import made_profile
from sim_replay.logs.session_reader import Session, recorded_config

_N_SAMPLES: Final = 1200  # per ping, of a usual side-scan
_BITS_PER_BYTE: Final = 10  # 8N1
_PACKET_BYTES: Final = 64  # of USB at full speed
_SETTLE_S: Final = 1.0  # s before measuring, so that start-up is not counted
_SPARE_S: Final = 30.0  # of messages, for a service that is slow to start
_READY_S: Final = 60.0  # s for the service to start
_END_S: Final = 120.0  # until what is queued was worked off
_N_SORTED: Final = 1_000_000  # numbers sorted: the yardstick for the speed of the computer
_SPIKES: Final = (50.0, 99.0, 99.9, 100.0)  # percentiles printed
_POLL_S: Final = 0.01  # s between looks at the service's output
_PARTS: Final = ("start", "pings", "garbage", "latency")

_RUN: Final = ("-m", "auv_mcm", "run", "--config")
_WATCHED: Final = ("-m", "sim_replay.benches.ports_watched")


class StartUp(NamedTuple):
    """Hold seconds from the start of the process.

    ready: perception is there; decoded, taken: the first ping, by the service, by perception.
    """

    ready_s: float
    decoded_s: float
    taken_s: float


class Cost(NamedTuple):
    """Hold processor time of a service's own process. share: of a core, all threads. wake_ups_hz: of its event loop."""

    share: float
    wake_ups_hz: float


class Latency(NamedTuple):
    """Hold the time from a ping's last byte at the port until it was queued for perception, ms at _SPIKES.

    perception_share: of a core, meanwhile. waited_share: of the time, in which the service's event loop waited for a
    core, as it does where other programs run. n_lost: bytes, of a bench that was itself kept from running; pings next
    to them come late.
    """

    n_pings: int
    spikes_ms: tuple[float, ...]
    perception_share: float
    waited_share: float
    n_lost: int


class PacedLine:
    """Play the far end of a serial line at a pseudo-terminal.

    Messages leave at the line's rate, in packets, while it is entered.

    sent_s: by message, the instant of the monotonic clock just before its last byte was there to be read. n_lost: bytes
    that nobody took.
    """

    def __init__(self, messages: Sequence[bytes], baud: int) -> None:
        self._stream = b"".join(messages)
        self._ends = list(accumulate(map(len, messages)))
        self._bytes_per_s = baud / _BITS_PER_BYTE
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self.sent_s: list[float] = []
        self.n_lost = 0

    def __enter__(self) -> PacedLine:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _send(self) -> None:
        start_s, done = time.monotonic(), 0
        while done < len(self._stream) and not self._over.is_set():
            packet = self._stream[done : done + _PACKET_BYTES]
            done += len(packet)
            now_s, due_s = time.monotonic(), start_s + done / self._bytes_per_s
            if now_s < due_s:
                time.sleep(due_s - now_s)
                now_s = time.monotonic()
            while len(self.sent_s) < len(self._ends) and self._ends[len(self.sent_s)] <= done:
                self.sent_s.append(now_s)
            try:
                n_taken = os.write(self._master, packet)
            except BlockingIOError:
                n_taken = 0
            self.n_lost += len(packet) - n_taken


class Served:
    """Run a service as a process of its own, in a group with all that it starts, and time its output."""

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        self.folder = folder
        self.begun_s = time.monotonic()
        self._process = subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0
        )
        self._lines: list[tuple[float, str]] = []
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    @property
    def pid(self) -> int:
        """Return the process id of the service."""
        return self._process.pid

    def said_s(self, text: str) -> float:
        """Return the instant of the monotonic clock at which a line was printed.

        Raises HardwareError if it never was.
        """
        deadline_s = time.monotonic() + _READY_S
        while time.monotonic() < deadline_s:
            running = self._process.poll() is None
            for at_s, line in self._lines:
                if text in line:
                    return at_s
            if not running:
                break
            time.sleep(_POLL_S)
        raise HardwareError(
            f"the service did not say '{text.strip()}', but: {' / '.join(line for _, line in self._lines[-3:])}"
        )

    def stop(self) -> None:
        """End it in order. Raises HardwareError if it does not end."""
        self._process.terminate()
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            raise HardwareError(f"the service did not end within {_END_S:g} s; see {self.folder}") from None
        if code:
            raise HardwareError(f"the service ended with {code}: {' / '.join(line for _, line in self._lines[-3:])}")

    def kill(self) -> None:
        """End it and all that it started, if they still run."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._reading.join()
        assert self._process.stderr is not None
        self._process.stderr.close()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._lines.append((time.monotonic(), line.rstrip("\n")))


@contextmanager
def served(line: PacedLine, folder: Path, baud: int, *, watched: bool = False) -> Iterator[Served]:
    """Start a new service at a line.

    watched: perception is busy, and `queued.json` is written, as of `ports_watched`.
    """
    folder.mkdir()
    config = folder / "service.yaml"
    settings = {
        "service": {"source": "ports", "output_directory": str(folder / "results")},
        "ports": [{"name": "sonar", "link": f"serial://{line.path}?baud={baud}", "device": "ping_protocol"}],
    }
    config.write_bytes(msgspec.yaml.encode(settings))
    service = Served((*_WATCHED, str(config), str(folder / "queued.json")) if watched else (*_RUN, str(config)), folder)
    try:
        yield service
    finally:
        service.kill()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench ports`."""
    parser.add_argument(
        "--only",
        nargs="+",
        choices=_PARTS,
        default=_PARTS,
        metavar="PART",
        help=f"what to measure: {', '.join(_PARTS)}",
    )
    parser.add_argument("--seconds", type=count, default=15, help="length of each run, s (default 15)")
    parser.add_argument("--repeat", type=count, default=3, help="runs of each kind (default 3)")
    parser.add_argument(
        "--baud",
        type=int,
        default=921_600,
        choices=(115_200, 230_400, 460_800, 921_600),
        help="baud rate of the line (default 921600)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; returns the exit code. Raises HardwareError for a service that does not do what it should."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a bench that is ended ends its service, too
    baud, seconds, repeat = int(arguments.baud), int(arguments.seconds), int(arguments.repeat)
    kinds = {kind: messages for part in arguments.only for kind, messages in _TRAFFIC.get(part, {}).items()}
    with tempfile.TemporaryDirectory(prefix="auv-mcm-ports-") as name:
        folders = (Path(name) / str(number) for number in range(1_000_000))
        print(
            f"a sort of a million numbers by numpy takes {_sort_ms():.1f} ms of a core; {repeat} runs of each kind at "
            f"{baud} baud\n",
            flush=True,
        )
        if "start" in arguments.only:
            _print_starts([start_up(next(folders), baud) for _ in range(repeat)])
        for kind, messages in kinds.items():
            chunks = messages(round((seconds + _SPARE_S) * baud / _BITS_PER_BYTE))
            costs = [cost(chunks, seconds, next(folders), baud) for _ in range(repeat)]
            share, wake_ups_hz = (statistics.median(figures) for figures in zip(*costs, strict=True))
            print(f"{kind:<34}{100.0 * share:>8.1f} % of a core, woken {wake_ups_hz:.0f} times a second", flush=True)
        if "latency" in arguments.only:
            _print_latencies([latency(seconds, next(folders), baud) for _ in range(repeat)])
    return 0


def _print_starts(starts: Sequence[StartUp]) -> None:
    for word, taken in zip(
        ("perception is ready", "first ping decoded", "first ping taken by perception"),
        zip(*starts, strict=True),
        strict=True,
    ):
        print(f"{word:<34}{statistics.median(taken):>8.2f} s after the start of the process", flush=True)


def _print_latencies(runs: Sequence[Latency]) -> None:
    for at, spikes_ms in zip(_SPIKES, zip(*(run.spikes_ms for run in runs), strict=True), strict=True):
        print(f"{f'last byte to queue, {at:g} %':<34}{statistics.median(spikes_ms):>8.2f} ms")
    share = statistics.median(run.perception_share for run in runs)
    waited = statistics.median(run.waited_share for run in runs)
    print(f"{sum(run.n_pings for run in runs)} pings, while perception took {100.0 * share:.0f} % of a core", end="")
    print(
        f" and the service waited for one {100.0 * waited:.1f} % of the time; {sum(run.n_lost for run in runs)} bytes "
        "lost by the bench"
    )


def start_up(folder: Path, baud: int) -> StartUp:
    """Start a service at a sonar that is sending already."""
    with PacedLine(pings(round(_SPARE_S * baud / _BITS_PER_BYTE)), baud) as line, served(line, folder, baud) as service:
        ready_s, taken_s = service.said_s("ready: "), service.said_s("first ping: ")
        time.sleep(_SETTLE_S)
        service.stop()
    return StartUp(
        ready_s - service.begun_s,
        _first_decoded_s(folder / "results/latest/recording") - service.begun_s,
        taken_s - service.begun_s,
    )


def cost(messages: Sequence[bytes], seconds: float, folder: Path, baud: int) -> Cost:
    """Measure what a service takes with these messages on the line."""
    with PacedLine(messages, baud) as line, served(line, folder, baud) as service:
        service.said_s("ready: ")
        time.sleep(_SETTLE_S)
        begun_s, begun_cpu_s, n_before = time.monotonic(), _cpu_s(service.pid), _n_wake_ups(service.pid)
        time.sleep(seconds)
        took_s = time.monotonic() - begun_s
        return Cost((_cpu_s(service.pid) - begun_cpu_s) / took_s, (_n_wake_ups(service.pid) - n_before) / took_s)


def latency(seconds: float, folder: Path, baud: int) -> Latency:
    """Measure how late pings are in the queue of a service whose perception is busy."""
    with (
        PacedLine(pings(round((seconds + _SPARE_S) * baud / _BITS_PER_BYTE)), baud) as line,
        served(line, folder, baud, watched=True) as service,
    ):
        service.said_s("ready: ")
        time.sleep(_SETTLE_S)
        begun_s, n_lost_before = time.monotonic(), line.n_lost
        perception = _children(service.pid)
        begun_cpu_s, begun_wait_s = sum(map(_cpu_s, perception)), _waited_s(service.pid)
        time.sleep(seconds)
        took_s = time.monotonic() - begun_s
        share, waited_share = (
            (sum(map(_cpu_s, perception)) - begun_cpu_s) / took_s,
            (_waited_s(service.pid) - begun_wait_s) / took_s,
        )
        n_lost = line.n_lost - n_lost_before
        service.stop()
    queued_s = {int(number): at_s for number, at_s in json.loads((folder / "queued.json").read_bytes()).items()}
    late_s = [
        at_s - line.sent_s[2 * number + 1]
        for number, at_s in queued_s.items()
        if line.sent_s[2 * number + 1] >= begun_s
    ]
    return Latency(len(late_s), tuple((1e3 * np.percentile(late_s, _SPIKES)).tolist()), share, waited_share, n_lost)


def pings(n_bytes: int) -> list[bytes]:
    """Make about so many bytes of pings, a message for each of their two sides."""
    random = np.random.Generator(np.random.PCG64(1))
    profiles = [made_profile(side, _N_SAMPLES, random) for side in range(2)]
    size = len(ping_messages.encode(profiles[0]))
    period_ms = 2 * size * _BITS_PER_BYTE / 921.6
    return [
        ping_messages.encode(profiles[k % 2]._replace(ping_number=k // 2, timestamp_ms=round(k // 2 * period_ms)))
        for k in range(n_bytes // (2 * size) * 2)
    ]


def _noise(n_bytes: int) -> list[bytes]:
    return [np.random.Generator(np.random.PCG64(1)).bytes(n_bytes)]


def _beginnings(n_bytes: int) -> list[bytes]:
    return [ping_messages.SYNC * (n_bytes // len(ping_messages.SYNC))]


def _promises(n_bytes: int) -> list[bytes]:
    """Make headers of long messages that never come."""
    head = ping_messages.HEADER.pack(ping_messages.SYNC, 1000, ping_messages.ASCII_TEXT, 0, 0)
    return [head * (n_bytes // len(head))]


GARBAGE: Final[dict[str, Callable[[int], list[bytes]]]] = {
    "garbage: noise": _noise,
    "garbage: beginnings of messages": _beginnings,
    "garbage: headers of messages": _promises,
}
_TRAFFIC: Final[dict[str, dict[str, Callable[[int], list[bytes]]]]] = {"pings": {"pings": pings}, "garbage": GARBAGE}


def _first_decoded_s(recording: Path) -> float:
    """Find the instant of the monotonic clock at which the bytes came that completed the first ping."""
    session = Session(recording)
    intake = PortIntake(recorded_config(session))
    for port, direction, stamp, data in session:
        if direction == "in" and any(isinstance(event, Ping) for event in intake.feed(port, data, stamp)):
            return stamp.mono_ns / 1e9
    raise HardwareError(f"{recording} has no ping: the service heard none")


def _cpu_s(pid: int) -> float:
    """Read the processor time that a process has taken, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _waited_s(pid: int) -> float:
    """Read for how long the main thread of a process could have run, but had no core."""
    return int(Path(f"/proc/{pid}/schedstat").read_text("ascii").split()[1]) / 1e9


def _n_wake_ups(pid: int) -> int:
    """Count how often the main thread of a process has gone to sleep, to be woken."""
    return int(re.findall(r"\nvoluntary_ctxt_switches:\s+(\d+)", Path(f"/proc/{pid}/status").read_text("ascii"))[0])


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()]


def _sort_ms() -> float:
    """Measure how fast a core is now, ms for a sort.

    Others that share its caches, and whoever runs this virtual computer, make every wake-up dearer.
    """
    values = np.random.Generator(np.random.PCG64(1)).random(_N_SORTED)
    times = []
    for _ in range(5):
        begun_s = time.thread_time()
        np.sort(values)
        times.append(time.thread_time() - begun_s)
    return 1e3 * statistics.median(times)
