"""Kill a batch on its way, go on, and compare its results with those of a run that nobody disturbed.

The archive is made of short simulated logs, a few scenes over and over at later times, some of them damaged: empty, cut
off inside the header, and not a log at all. Killed is the whole process group, with SIGKILL, once a share of the
missions is there. Compared is every file but the three that hold the time of the replay.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm.commands import whole
from auv_mcm.errors import BadInputError, HardwareError, SelfCheckError
from auv_mcm.records import NavSample, Ping
from auv_mcm.shell.recovery import SUMMARY
from sim_replay.batch.missions import MISSIONS
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from sim_replay.text_tables import markdown

_N_SCENES: Final = 4  # simulated; the logs repeat them
_STEP_S: Final = 3600.0  # s between two logs
_HEADER_BYTES: Final = 1024  # of XTF
_TIMED: Final = frozenset({SUMMARY, "report.html", ".lock"})  # files that hold how long the replay took, or nothing
_POLL_S: Final = 0.05  # s between two looks at how many missions are there
_DAMAGES: Final[tuple[bytes | int, ...]] = (0, _HEADER_BYTES - 24, b"nonsense" * 100)  # kept bytes, or what is there


class Undone(NamedTuple):
    """Hold what a kill met: missions that were there, and seconds since the run before began."""

    n_missions: int
    after_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench archive`."""
    parser.add_argument("--logs", metavar="N", type=whole(2, 10_000), default=200, help="logs (default 200)")
    parser.add_argument("--damaged", metavar="N", type=whole(0, 10_000), default=10, help="of them (default 10)")
    parser.add_argument("--kills", metavar="N", type=whole(0, 100), default=2, help="on the way (default 2)")
    parser.add_argument("--workers", metavar="N", type=whole(1, 64), default=2, help="processes (default 2)")


def run(arguments: argparse.Namespace) -> int:
    """Run both batches, compare and print. Raises SelfCheckError if a byte differs."""
    with tempfile.TemporaryDirectory() as folder:
        archive, calm, killed = (Path(folder) / name for name in ("archive", "calm", "killed"))
        archive.mkdir()
        make_archive(archive, arguments.logs, arguments.damaged)
        begun_s = time.monotonic()
        _finish(_started(archive, calm, arguments.workers), arguments.damaged)
        calm_s = time.monotonic() - begun_s
        undone: list[Undone] = []
        n_good = arguments.logs - arguments.damaged
        for kill in range(arguments.kills):
            undone.append(kill_at(archive, killed, arguments.workers, n_good * (kill + 1) // (arguments.kills + 1)))
        begun_s = time.monotonic()
        _finish(_started(archive, killed, arguments.workers), arguments.damaged)
        last_s = time.monotonic() - begun_s
        differing = differences(calm, killed)
        n_files = len(_content(calm))
    print(
        markdown(
            ("logs", "damaged", "killed after missions", "undisturbed s", "killed runs s", "files", "differ"),
            [
                [
                    str(arguments.logs),
                    str(arguments.damaged),
                    ", ".join(str(one.n_missions) for one in undone) or "never",
                    f"{calm_s:.0f}",
                    " + ".join(f"{seconds:.0f}" for seconds in (*(one.after_s for one in undone), last_s)),
                    str(n_files),
                    str(len(differing)),
                ]
            ],
        )
    )
    if differing:
        raise SelfCheckError(f"{len(differing)} files differ from those of an undisturbed run, {differing[0]} first")
    return 0


def make_archive(folder: Path, n_logs: int, n_damaged: int) -> None:
    """Write the logs; those that are damaged lie evenly among the others."""
    scenes = [tuple(_events(seed)) for seed in range(1, _N_SCENES + 1)]
    damaged = {(2 * index + 1) * n_logs // (2 * n_damaged): index for index in range(n_damaged)}
    for number in range(n_logs):
        path = folder / f"{number:05d}.xtf"
        later_s = number * _STEP_S
        events = scenes[number % _N_SCENES]
        write_xtf(path, (msgspec.structs.replace(event, time_s=event.time_s + later_s) for event in events))
        if (index := damaged.get(number)) is not None:
            what = _DAMAGES[index % len(_DAMAGES)]
            path.write_bytes(path.read_bytes()[:what] if isinstance(what, int) else what)


def _events(seed: int) -> list[NavSample | Ping]:
    sphere = SceneObject(kind="sphere", leg=0, along_m=2.5, across_m=8.0)
    scene = Scene(
        seed=seed,
        sonar=Sonar(range_m=16.0, n_samples=320, ping_rate_hz=15.0, beam_lines=3),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=6.0), altitude_m=4.0),
        objects=(sphere,) if seed % 2 else (),
    )
    return list(Mission(scene).events())


def _started(archive: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "auv_mcm", "batch", str(archive), "--out", str(out), "--workers", str(workers)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def _finish(process: subprocess.Popen[bytes], n_damaged: int) -> None:
    expected = BadInputError.exit_code if n_damaged else 0
    if (code := process.wait()) != expected:
        raise HardwareError(f"auv-mcm batch ended with exit code {code}, not {expected}. Run it by itself to see why")


def kill_at(archive: Path, out: Path, workers: int, n_missions: int) -> Undone:
    """Start a batch and kill it once so many missions are there. Raises HardwareError if it ends before."""
    begun_s = time.monotonic()
    process = _started(archive, out, workers)
    while (n_found := _n_missions(out)) < n_missions:
        if process.poll() is not None:
            raise HardwareError(
                f"the batch ended after {n_found} missions, before it could be killed: give more --logs"
            )
        time.sleep(_POLL_S)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return Undone(_n_missions(out), time.monotonic() - begun_s)


def _n_missions(out: Path) -> int:
    return sum(1 for _ in (out / MISSIONS).glob(f"*/{SUMMARY}"))


def differences(one: Path, other: Path) -> list[str]:
    """List the files that are not in both folders, or hold other bytes; those with the time of a replay left out."""
    mine, others = _content(one), _content(other)
    return sorted(name for name in mine.keys() | others.keys() if mine.get(name) != others.get(name))


def _content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in _TIMED
    }
