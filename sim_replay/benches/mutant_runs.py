"""Run a command of this program over a damaged file in a process of its own, within limits of time and memory."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import resource
import sys
import threading
import time
from collections.abc import Sequence
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Final, NamedTuple

MAX_CPU_S: Final = 20.0  # s of processor time of one run, beyond which it fails
MAX_WALL_S: Final = 30.0  # s of wall clock asleep, beyond which it is ended and fails

# spares the computer where a mutant takes all; numpy and OpenCV reserve 2 GB that they do not use
_ADDRESS_SPACE_BYTES: Final = 6 << 30
# Loaded once, not by every process; the last three read images.
_PRELOADED: Final = (
    *("auv_mcm.cli", "jinja2", "drivers.port_intake"),
    *("auv_mcm.pipeline", "sim_replay.replay", "sim_replay.logs.recorded", "sim_replay.simulator.scene_file"),
    *("sim_replay.logs.image_log", "sim_replay.logs.image_tiff", "sim_replay.logs.image_hdf5"),
)
_LOOK_S: Final = 1.0  # between looks at how long a run has waited
# A process gives its exit code once. Starting another asks all that run for theirs, and whoever comes second gets 255.
_ASKING: Final = threading.Lock()


class Ended(NamedTuple):
    """Hold how a run ended: its exit code, negative if a signal ended it, what it printed, and what it cost.

    cpu_s and rss_mb are NaN if a signal ended it. asleep_s: of wall clock, without using a processor.
    """

    code: int | None
    said: str
    cpu_s: float
    rss_mb: float
    asleep_s: float

    def failures(self, good_codes: Sequence[int], max_rss_mb: float) -> list[str]:
        """List what it did that no input may lead to."""
        failures = []
        if self.asleep_s > MAX_WALL_S:
            failures.append(f"still waiting after {self.asleep_s:.0f} s of wall clock")
        elif self.code not in good_codes:
            failures.append(f"exit code {self.code}")
        if "Traceback" in self.said:
            failures.append(self.said.strip().splitlines()[-1])
        if self.cpu_s > MAX_CPU_S:
            failures.append(f"{self.cpu_s:.1f} s of processor time")
        if self.rss_mb > max_rss_mb:
            failures.append(f"{self.rss_mb:.0f} MB")
        return failures


def run_command(arguments: Sequence[str], folder: Path, scratch: Path) -> Ended:
    """Run `auv-mcm` in a folder; `scene FILE` reads a scene and does no more.

    Parameters
    ----------
    arguments
        Of the command line.
    folder
        The working directory of the run.
    scratch
        Where it keeps what it prints, and what it costs.
    """
    console, usage = scratch / "console.txt", scratch / "usage.json"
    usage.unlink(missing_ok=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_PRELOADED))
    process = context.Process(target=_run, args=(list(arguments), folder, console, usage))
    with _ASKING:
        process.start()
    asleep_s, used_s, looked_s = 0.0, 0, time.monotonic()
    while _code(process) is None and asleep_s <= MAX_WALL_S:
        wait([process.sentinel], _LOOK_S)
        before_s, looked_s = looked_s, time.monotonic()
        before_used_s = used_s
        is_asleep, used_s = _asleep(process)
        if is_asleep and used_s == before_used_s:
            asleep_s += looked_s - before_s
    if _code(process) is None:
        process.kill()
        wait([process.sentinel])
    said = console.read_text("utf-8", "replace") if console.exists() else ""
    cpu_s, rss_mb = json.loads(usage.read_text()) if usage.exists() else (math.nan, math.nan)
    return Ended(_code(process), said, cpu_s, rss_mb, asleep_s)


def _code(process: BaseProcess) -> int | None:
    """Ask a process for its exit code; None while it runs."""
    with _ASKING:
        return process.exitcode


def _asleep(process: BaseProcess) -> tuple[bool, int]:
    """Look whether a process sleeps, and what processor time it has used, in ticks; neither once it has ended.

    Waiting for the disk or for a processor is not sleep: a loaded computer makes no run fail.
    """
    try:
        text = Path(f"/proc/{process.pid}/stat").read_text("ascii", "replace")
    except OSError:
        return False, 0
    state, *fields = text.rpartition(")")[2].split()
    return state == "S", int(fields[10]) + int(fields[11])


def _run(arguments: list[str], folder: Path, console: Path, usage: Path) -> None:
    """Run the command in this process, within the limits.

    What it prints goes to `console`, what it cost to `usage`.
    """
    resource.setrlimit(resource.RLIMIT_CPU, (round(MAX_CPU_S) + 1, round(MAX_CPU_S) + 2))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE_BYTES, _ADDRESS_SPACE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with console.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    try:
        code = _read_scene(arguments[1]) if arguments[0] == "scene" else _main(arguments)
    finally:
        used = resource.getrusage(resource.RUSAGE_SELF)
        usage.write_text(json.dumps((used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)))
    sys.exit(code)


def _main(arguments: list[str]) -> int:
    from auv_mcm.cli import main

    return main(arguments)


def _read_scene(path: str) -> int:
    """Read a scene as the command line does: flying a damaged one may rightly take hours."""
    from auv_mcm.clean_text import clean_lines
    from auv_mcm.errors import AuvMcmError
    from sim_replay.simulator.scene_file import read_scene

    try:
        read_scene(path)
    except AuvMcmError as error:
        print(clean_lines(f"auv-mcm: {error}"), file=sys.stderr)
        return error.exit_code
    return 0
