"""Benches: what the chain costs.

auv-mcm bench waterfall [LOG]   the whole chain on one core, per stage, at two mission lengths
auv-mcm bench detect [LOG]      cost of the detector per tile
auv-mcm bench simulate          cost of the simulator
auv-mcm bench scenes            what the chain finds in the named scenes
auv-mcm bench segmentation, snakes, shapes   parts of confirmation and classification: error beside time
auv-mcm bench beliefs           what one and two views make one believe, beside what the source paper prints
auv-mcm bench images            outlines and false confirmations on real pictures
auv-mcm bench froc              every detector, and the steps after it, on missions held out
auv-mcm bench cascade           speed and budgets of the trained cascade
auv-mcm bench inversion, augment   relief recovered from images, and targets put into it
auv-mcm bench framers           framing of device messages: speed, garbage, damage
auv-mcm bench ports             the service at a full serial line: start, processor time, how late pings are
auv-mcm bench soak              the service for long: memory, counters, tasks; what a kill costs
auv-mcm bench seabed            kinds of sea floor told apart, and what it costs
auv-mcm bench performance       predicted against realised detection, by sea floor and range
auv-mcm bench pfa               false alarms per km² and per decision
auv-mcm bench tours             plans of survey and second looks: how near to the optimum, in what time
auv-mcm bench adapt             replanning on the way beside a lawnmower laid beforehand, in simulated worlds
auv-mcm bench figure9           the source paper's examples of classical detection

Costs of the chain are medians over fresh processes, those of the detector over repetitions in one. Times on a shared machine move by
half; compare figures of one run only.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.config import Config
from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Ping, Tile
from sim_replay.benches.arguments import count, duration_min
from sim_replay.xtf import XtfLog
from sim_replay.xtf_writer import write_xtf

_SCENE: Final = "demo"
_ELSEWHERE: Final = {  # modules with add_arguments and run, imported if chosen
    "simulate": ("sim_replay.benches.simulate", "cost of the simulator"),
    "scenes": ("sim_replay.benches.scenes", "what the chain finds in the named scenes"),
    "segmentation": ("sim_replay.benches.segmentation", "Markov-field segmentation: error beside time"),
    "snakes": ("sim_replay.benches.snakes", "contours: error beside time"),
    "shapes": ("sim_replay.benches.shapes", "classification by shape: error beside time"),
    "beliefs": ("sim_replay.benches.beliefs", "beliefs in the classes of single objects, beside the source paper's"),
    "seabed": ("sim_replay.benches.seabed", "kinds of sea floor told apart, and what it costs"),
    "images": ("sim_replay.benches.real_images", "outlines and false confirmations on real pictures"),
    "cascade": ("sim_replay.benches.cascade", "the trained cascade: windows per second beside OpenCV's, budgets, equality of kernels"),
    "froc": ("sim_replay.benches.froc", "what each detector and each step finds on missions held out, at given rates of false alarms"),
    "inversion": ("sim_replay.benches.inversion", "relief and reflectivity recovered from images: error beside time"),
    "augment": ("sim_replay.benches.augment", "whether embedded targets can be told from simulated ones"),
    "framers": ("sim_replay.benches.framers", "framing of device messages: speed beside brping's, garbage, damage"),
    "ports": ("sim_replay.benches.ports", "the service at a full serial line: start, processor time, how late pings are"),
    "soak": ("sim_replay.benches.soak", "the service between fake devices for long: memory, counters, tasks; what a kill costs"),
    "performance": ("sim_replay.benches.performance", "predicted against realised detection, by sea floor and range, on missions held out"),
    "pfa": ("sim_replay.benches.pfa", "false alarms per km² and per decision"),
    "tours": ("sim_replay.benches.tours", "plans of survey and second looks: how near to the optimum, and in what time"),
    "adapt": ("sim_replay.benches.adapt", "whether replanning on the way takes less track than a lawnmower laid beforehand"),
    "figure9": ("sim_replay.benches.figure9", "the source paper's examples of classical detection, flown many times"),
}


def main(arguments: Sequence[str]) -> int:
    """Run a bench; returns the exit code."""
    parser = argparse.ArgumentParser(prog="auv-mcm bench", description="Measure cost and quality; medians over one run.")
    benches = parser.add_subparsers(dest="bench", required=True)
    waterfall = benches.add_parser("waterfall", help="the whole chain on one core, cost per stage, at two mission lengths")
    waterfall.add_argument("--minutes", type=duration_min, default=30.0, help="length of the tiled version (default 30)")
    detect = benches.add_parser("detect", help="cost of the detector per tile")
    for bench in (waterfall, detect):
        bench.add_argument("log", nargs="?", type=Path, help=f"an XTF log; without it the scene '{_SCENE}' is flown")
        bench.add_argument("--repeat", type=count, default=5, help="repetitions (default 5)")
    chain = benches.add_parser("chain", help="one run over a log; prints JSON (what the waterfall bench starts)")
    chain.add_argument("log", type=Path)
    chain.add_argument("--exhaustive", action="store_true")
    for name, (module, does) in _ELSEWHERE.items():
        bench = benches.add_parser(name, help=does)
        if name in arguments[:1]:
            chosen_module = importlib.import_module(module)
            chosen_module.add_arguments(bench)
            bench.set_defaults(run=chosen_module.run)
    chosen = parser.parse_args(arguments)
    if chosen.bench in _ELSEWHERE:
        return int(chosen.run(chosen))
    if chosen.bench == "chain":
        print(json.dumps(_chain(chosen.log, chosen.exhaustive)))
        return 0
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        log = chosen.log or _flown(Path(folder))
        if chosen.bench == "waterfall":
            _bench_waterfall(log, Path(folder), chosen.minutes, chosen.repeat)
        else:
            _bench_detect(log, chosen.repeat)
    return 0


def _flown(folder: Path) -> Path:
    """A log of a simulated mission."""
    from sim_replay.simulate import simulate
    from sim_replay.simulator.scene_file import read_scene

    return simulate(read_scene(_SCENE), folder).log


def _bench_waterfall(log: Path, folder: Path, minutes: float, repeat: int) -> None:
    long_log = folder / "tiled.xtf"
    write_xtf(long_log, _tiled(log, minutes * 60.0), sample_type=_sample_type(log))
    runs = {"short": [_run_chain(log) for _ in range(repeat)], "long": [_run_chain(long_log) for _ in range(repeat)]}
    exhaustive = [_run_chain(log, "--exhaustive") for _ in range(repeat)]
    print(f"log: {log.name}, whole chain from file to contacts, one core, kernels: {runs['short'][0]['kernels']}, median of {repeat}\n")
    stages = list(runs["short"][0]["costs_s"])
    print(f"{'stage':<12}" + "".join(f"{name + ' ms':>12}{'us/ping':>10}{'share':>8}" for name in runs))
    for stage in [*stages, "total"]:
        line = f"{stage:<12}"
        for results in runs.values():
            cost_s = statistics.median(r["total_s"] if stage == "total" else r["costs_s"].get(stage, 0.0) for r in results)
            total_s = statistics.median(r["total_s"] for r in results)
            line += f"{cost_s * 1e3:>12.1f}{cost_s / results[0]['pings'] * 1e6:>10.1f}{cost_s / total_s:>8.0%}"
        print(line)
    print()
    for name, results in runs.items():
        speed = statistics.median(r["duration_s"] / r["total_s"] for r in results)
        memory_mb = statistics.median(r["peak_memory_mb"] for r in results)
        first = results[0]
        print(
            f"{name:<6} {first['duration_s']:8.1f} s of mission, {first['pings']:6d} pings, {first['contacts']:5d} contacts: "
            f"{speed:6.0f} x real time, peak memory {memory_mb:5.0f} MB"
        )
    saved = statistics.median(a["total_s"] / b["total_s"] for a, b in zip(exhaustive, runs["short"], strict=True))
    print(f"--exhaustive (nothing skipped) takes {saved:.2f} times as long on the short log")


def _run_chain(log: Path, *options: str) -> dict[str, Any]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "sim_replay.benches.chain", "chain", str(log), *options]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise BadInputError(
            f"the chain failed on {log}: {result.stderr.strip().splitlines()[-1] if result.stderr.strip() else 'no message'}"
        )
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer


def _chain(log: Path, exhaustive: bool) -> dict[str, Any]:
    """File to contacts in this process, on one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from auv_mcm import kernels
    from auv_mcm.pipeline import Pipeline

    pipeline = Pipeline(Config(), exhaustive=exhaustive, timer=time.perf_counter)
    pings, first_s, last_s, read_s = 0, math.nan, math.nan, 0.0
    start = mark = time.perf_counter()
    for event in XtfLog(log, Config().sonar):
        read_s += time.perf_counter() - mark
        if isinstance(event, Ping):
            first_s = event.time_s if pings == 0 else first_s
            last_s = event.time_s
            pings += 1
        pipeline.feed(event)
        mark = time.perf_counter()
    pipeline.finish()
    total_s = time.perf_counter() - start
    return {
        "pings": pings,
        "duration_s": last_s - first_s,
        "total_s": total_s,
        "costs_s": {"read": read_s, **pipeline.costs_s},
        "contacts": len(pipeline.contacts),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "kernels": kernels.backend(),
    }


def _tiled(log: Path, duration_s: float) -> Iterator[NavSample | Ping]:
    """The log end to end until `duration_s` is reached, each copy later in time and farther along its own line."""
    events = [event for event in XtfLog(log, Config().sonar) if isinstance(event, NavSample | Ping)]
    times = [event.time_s for event in events if isinstance(event, Ping)]
    period_s = times[-1] - times[0] + statistics.median(np.diff(times).tolist())
    fixes = [event for event in events if isinstance(event, NavSample) and math.isfinite(event.latitude_deg)]
    step_deg = (fixes[-1].latitude_deg - fixes[0].latitude_deg, fixes[-1].longitude_deg - fixes[0].longitude_deg) if fixes else (0.0, 0.0)
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


def _sample_type(log: Path) -> Any:
    ping = next(event for event in XtfLog(log, Config().sonar) if isinstance(event, Ping))
    trace = ping.port or ping.starboard
    assert trace is not None
    return str(trace.samples.dtype)


def _bench_detect(log: Path, repeat: int) -> None:
    from auv_mcm.detect.candidates import STEP_M
    from auv_mcm.detect.measure import measure
    from auv_mcm.detect.prescreen import find_peaks, score_tile
    from auv_mcm.pipeline import Pipeline

    config = Config()
    pipeline = Pipeline(config)
    tiles = [event for source in XtfLog(log, config.sonar) for event in pipeline.feed(source) if isinstance(event, Tile)]
    tiles += [event for event in pipeline.finish() if isinstance(event, Tile)]
    costs: dict[str, list[float]] = defaultdict(list)
    n_peaks = 0
    for _ in range(repeat):
        marks = [time.perf_counter()]
        maps = [score_tile(tile) for tile in tiles]
        marks.append(time.perf_counter())
        peaks = [find_peaks(t, m, config.detect.p_false_alarm, STEP_M) for t, m in zip(tiles, maps, strict=True)]
        marks.append(time.perf_counter())
        for tile, tile_maps, tile_peaks in zip(tiles, maps, peaks, strict=True):
            for peak in tile_peaks:
                measure(tile, tile_maps.floor(peak.row, peak.column), peak, math.radians(config.sonar.beam_width_deg))
        marks.append(time.perf_counter())
        for step, cost_s in zip(("score every pixel", "find peaks", "measure peaks"), np.diff(marks).tolist(), strict=True):
            costs[step].append(cost_s)
        n_peaks = sum(map(len, peaks))
    pixels = sum(tile.mask.size for tile in tiles)
    print(f"log: {log.name}: {len(tiles)} tiles, {pixels / 1e6:.2f} million pixels, {n_peaks} peaks, median of {repeat}\n")
    print(f"{'step':<20}{'ms':>9}{'ns/pixel':>10}{'us/peak':>9}")
    for step, values in costs.items():
        cost_s = statistics.median(values)
        print(f"{step:<20}{cost_s * 1e3:>9.1f}{cost_s / pixels * 1e9:>10.1f}{cost_s / max(n_peaks, 1) * 1e6:>9.1f}")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
