"""Measure the cost of the whole chain on one core, from file to contacts.

Per stage and at two mission lengths.

Processor time, medians over fresh processes. On a shared machine it moves by half; compare figures of one run only.
With --beside a second log, as of a busy scene beside a quiet one, both run in turn and the ratio of the two is printed
too.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.commands import Parser
from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import Config
from auv_mcm.skips import ALL_SKIPS, NO_SKIPS
from sim_replay.arguments import duration_min
from sim_replay.benches.log import add_log, given_or_flown
from sim_replay.logs.open_log import open_log
from sim_replay.logs.xtf_writer import write_xtf

_FRONT_END: Final = ("read", "intake", "waterfall")  # from stored samples to levelled tiles


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench chain`."""
    parser.add_argument("--minutes", type=duration_min, default=30.0, help="length of the tiled version (default 30)")
    parser.add_argument("--beside", type=Path, metavar="LOG", help="another log, whose processor time to compare with")
    add_log(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure the chain on a log, or on a mission that is flown for it."""
    with given_or_flown(arguments.log) as (log, folder):
        _bench(log, folder, arguments.minutes, arguments.repeat)
        if arguments.beside is not None:
            print("\n" + _beside(log, arguments.beside, arguments.repeat))
    return 0


def _bench(log: Path, folder: Path, minutes: float, repeat: int) -> None:
    long_log = folder / "tiled.xtf"
    write_xtf(long_log, tiled(log, minutes * 60.0), sample_type=stored_sample_type(log))
    runs = {"short": [_run_chain(log) for _ in range(repeat)], "long": [_run_chain(long_log) for _ in range(repeat)]}
    exhaustive = [_run_chain(log, "--exhaustive") for _ in range(repeat)]
    print(
        f"log: {log.name}, whole chain from file to contacts, one core, kernels: {runs['short'][0]['kernels']}, median "
        f"of {repeat}\n"
    )
    stages = list(runs["short"][0]["costs_s"])
    print(
        f"{'stage':<12}" + "".join(f"{name + ' ms':>12}{'us/ping':>10}{'ns/sample':>11}{'share':>8}" for name in runs)
    )
    for stage, parts in [*((stage, (stage,)) for stage in stages), ("front end", _FRONT_END), ("total", ())]:
        line = f"{stage:<12}"
        for results in runs.values():
            costs_s = [sum(r["costs_s"].get(part, 0.0) for part in parts) if parts else r["total_s"] for r in results]
            cost_s, total_s = statistics.median(costs_s), statistics.median(r["total_s"] for r in results)
            each = f"{cost_s / results[0]['pings'] * 1e6:>10.1f}{cost_s / results[0]['samples'] * 1e9:>11.1f}"
            line += f"{cost_s * 1e3:>12.1f}{each}{cost_s / total_s:>8.0%}"
        print(line)
    print(f"front end: {', '.join(_FRONT_END)}")
    print()
    for name, results in runs.items():
        speed = statistics.median(r["duration_s"] / r["total_s"] for r in results)
        memory_mb = statistics.median(r["peak_memory_mb"] for r in results)
        first = results[0]
        print(
            f"{name:<6} {first['duration_s']:8.1f} s of mission, {first['pings']:6d} pings, {first['contacts']:5d} "
            f"contacts: {speed:6.0f} x real time, peak memory {memory_mb:5.0f} MB"
        )
    saved = statistics.median(a["total_s"] / b["total_s"] for a, b in zip(exhaustive, runs["short"], strict=True))
    print(f"--exhaustive (no skip) takes {saved:.2f} times as long on the short log")


def _beside(log: Path, other: Path, repeat: int) -> str:
    pairs = [(_run_chain(log), _run_chain(other)) for _ in range(repeat)]
    ratio = statistics.median(ours["total_s"] / theirs["total_s"] for ours, theirs in pairs)
    ours_s, theirs_s = (statistics.median(pair[k]["total_s"] for pair in pairs) for k in range(2))
    return (
        f"processor time: {log} {ours_s:.2f} s, {other} {theirs_s:.2f} s, ratio {ratio:.2f}, median of {repeat} pairs"
    )


def _run_chain(log: Path, *options: str) -> dict[str, Any]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "sim_replay.benches.chain", str(log), *options]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise BadInputError(
            f"the chain failed on {log}: "
            f"{result.stderr.strip().splitlines()[-1] if result.stderr.strip() else 'no message'}"
        )
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer


def _chain(log: Path, exhaustive: bool) -> dict[str, Any]:
    """Run from file to contacts in this process, on one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from auv_mcm import kernels
    from auv_mcm.pipeline import Pipeline

    pipeline = Pipeline(Config(), without_skips=ALL_SKIPS if exhaustive else NO_SKIPS, timer=time.process_time)
    pings, samples, first_s, last_s, read_s = 0, 0, math.nan, math.nan, 0.0
    mark = start = time.process_time()
    for event in open_log(log, Config()):
        read_s += time.process_time() - mark
        if isinstance(event, Ping):
            first_s = event.time_s if pings == 0 else first_s
            last_s = event.time_s
            pings += 1
            samples += sum(trace.samples.size for trace in (event.port, event.starboard) if trace is not None)
        pipeline.feed(event)
        mark = time.process_time()
    pipeline.finish()
    return {
        "pings": pings,
        "samples": samples,
        "duration_s": last_s - first_s,
        "total_s": time.process_time() - start,
        "costs_s": {"read": read_s, **pipeline.costs_s},
        "contacts": len(pipeline.contacts),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "kernels": kernels.backend(),
    }


def tiled(log: Path, duration_s: float) -> Iterator[NavSample | Ping]:
    """Repeat the log end to end until `duration_s` is reached.

    Each copy is later in time and farther along its own line.
    """
    events = [event for event in open_log(log, Config()) if isinstance(event, NavSample | Ping)]
    times = [event.time_s for event in events if isinstance(event, Ping)]
    period_s = times[-1] - times[0] + statistics.median(np.diff(times).tolist())
    fixes = [event for event in events if isinstance(event, NavSample) and math.isfinite(event.latitude_deg)]
    step_deg = (
        (fixes[-1].latitude_deg - fixes[0].latitude_deg, fixes[-1].longitude_deg - fixes[0].longitude_deg)
        if fixes
        else (0.0, 0.0)
    )
    for copy in range(max(1, math.ceil(duration_s / period_s))):
        for event in events:
            if isinstance(event, Ping):
                yield msgspec.structs.replace(event, time_s=event.time_s + copy * period_s)
            else:
                yield msgspec.structs.replace(
                    event,
                    time_s=event.time_s + copy * period_s,
                    latitude_deg=event.latitude_deg + copy * step_deg[0],
                    longitude_deg=event.longitude_deg + copy * step_deg[1],
                )


def stored_sample_type(log: Path) -> Any:
    """Find the type of the samples of a log."""
    ping = next(event for event in open_log(log, Config()) if isinstance(event, Ping))
    trace = ping.port or ping.starboard
    assert trace is not None
    return str(trace.samples.dtype)


def main() -> int:
    """Run over a log in this process and print the result as JSON."""
    parser = Parser(prog="python -m sim_replay.benches.chain", description=main.__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--exhaustive", action="store_true")
    arguments = parser.parse_args()
    print(json.dumps(_chain(arguments.log, arguments.exhaustive)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
