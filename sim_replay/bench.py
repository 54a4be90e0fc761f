"""Benches: what the chain costs, and what it finds for that.

auv-mcm bench waterfall [LOG]   the whole chain on one core, per stage, at two mission lengths
auv-mcm bench detect            cost per tile of the detector, and its rates on synthetic missions

Costs of the chain are medians over fresh processes, those of the detector over repetitions in one; rates are pooled over held-out
seeds. Times on a shared machine move by half; compare figures of one run only.
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
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.config import Config
from auv_mcm.errors import BadInputError
from auv_mcm.geodesy import LocalFrame
from auv_mcm.records import Contact, NavSample, Ping, Tile
from sim_replay.synthetic import SceneObject, SyntheticScene, demo_scene, lawnmower, synthetic_mission, truth
from sim_replay.xtf import XtfLog
from sim_replay.xtf_writer import write_xtf

_MATCH_GATE_M: Final = 2.0
_HELD_OUT_SEEDS: Final = range(7100, 7108)


def main(arguments: Sequence[str]) -> int:
    """Run a bench; returns the exit code."""
    parser = argparse.ArgumentParser(prog="auv-mcm bench", description="Measure cost and quality; medians over one run.")
    benches = parser.add_subparsers(dest="bench", required=True)
    waterfall = benches.add_parser("waterfall", help="the whole chain on one core, cost per stage, at two mission lengths")
    waterfall.add_argument("log", nargs="?", type=Path, help="an XTF log; without it a synthetic mission of about a minute")
    waterfall.add_argument("--minutes", type=float, default=30.0, help="length of the tiled version (default 30)")
    waterfall.add_argument("--repeat", type=int, default=5, help="repetitions per length (default 5)")
    detect = benches.add_parser("detect", help="cost of the detector per tile, and its rates on synthetic missions")
    detect.add_argument("log", nargs="?", type=Path, help="an XTF log for the costs; without it a synthetic mission")
    detect.add_argument("--repeat", type=int, default=5, help="repetitions of the costs (default 5)")
    detect.add_argument("--seeds", type=int, default=len(_HELD_OUT_SEEDS), help="synthetic missions for the rates (default 8)")
    chain = benches.add_parser("chain", help="one run over a log; prints JSON (what the waterfall bench starts)")
    chain.add_argument("log", type=Path)
    chain.add_argument("--exhaustive", action="store_true")
    chosen = parser.parse_args(arguments)
    if chosen.bench == "chain":
        print(json.dumps(_chain(chosen.log, chosen.exhaustive)))
        return 0
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        log = chosen.log
        if log is None:
            log = Path(folder) / "synthetic.xtf"
            write_xtf(log, synthetic_mission(demo_scene(1, 1)))
        if chosen.bench == "waterfall":
            _bench_waterfall(log, Path(folder), chosen.minutes, chosen.repeat)
        else:
            _bench_detect(log, chosen.repeat, chosen.seeds)
    return 0


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
    command = [sys.executable, "-m", "sim_replay.bench", "chain", str(log), *options]
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


def _bench_detect(log: Path, repeat: int, n_seeds: int) -> None:
    from auv_mcm.detect.measure import measure
    from auv_mcm.detect.prescreen import find_peaks, score_tile
    from auv_mcm.detect.stage import STEP_M
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
                measure(tile, tile_maps, peak, math.radians(config.sonar.beam_width_deg))
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
    print()
    _print_rates(n_seeds)


def rate_scene(seed: int) -> SyntheticScene:
    """One leg with targets of four kinds and mine-sized rocks at random places and aspects; sea floor and altitude vary with the seed."""
    random = np.random.default_rng(seed)
    objects = []
    for index in range(10):
        place = {
            "leg": 0,
            "along_m": 8.0 + 14.0 * index + float(random.uniform(0.0, 5.0)),
            "across_m": float(random.choice([-1.0, 1.0]) * random.uniform(6.0, 26.0)),
            "azimuth_deg": float(random.uniform(0.0, 180.0)),
            "highlight_db": float(random.uniform(3.0, 10.0)),
        }
        kind = ("cylinder", "sphere", "box", "box", "rock")[index % 5]
        sizes: dict[str, dict[str, float]] = {
            "cylinder": {"length_m": 1.8, "height_m": 0.5},
            "sphere": {"height_m": 0.7},
            "box": {"length_m": 1.0, "width_m": 0.8, "height_m": 0.42},
            "rock": {"length_m": float(random.uniform(0.4, 1.5)), "width_m": 0.6, "height_m": float(random.uniform(0.15, 0.5))},
        }
        fields: dict[str, Any] = {**place, **sizes[kind], "kind": kind, "is_target": kind != "rock"}
        objects.append(SceneObject(**fields))
    legs = lawnmower(50.0, -4.0, float(random.uniform(0.0, 360.0)), n_legs=1, length_m=156.0, spacing_m=40.0)
    return SyntheticScene(
        legs=legs,
        objects=tuple(objects),
        seed=seed,
        altitude_m=float(random.uniform(3.5, 8.0)),
        altitude_wave_m=0.3,
        texture_nu=float(random.choice([0.0, 8.0, 3.0])),
        texture_m=0.5,
        psf_sigma_samples=float(random.choice([0.0, 1.0])),
        noise_db=float(random.uniform(-25.0, -15.0)),
        n_samples=1024,
        ping_rate_hz=15.0,
    )


def _print_rates(n_seeds: int) -> None:
    thresholds = (0.2, 0.5, 0.8)
    found, targets, false_alarms, area_km2 = dict.fromkeys(thresholds, 0), 0, dict.fromkeys(thresholds, 0), 0.0
    bins: dict[int, list[bool]] = defaultdict(list)
    for seed in range(_HELD_OUT_SEEDS.start, _HELD_OUT_SEEDS.start + n_seeds):
        scene = rate_scene(seed)
        contacts, told = _contacts_of(scene), truth(scene)
        area_km2 += told["area_km2"]
        matched = _matches(contacts, told["objects"], scene)
        for thing, contact in zip(told["objects"], matched, strict=True):
            targets += thing["is_target"]
            for threshold in thresholds:
                found[threshold] += bool(thing["is_target"] and contact is not None and contact.p_mine >= threshold)
        real = {
            id(contact): bool(thing["is_target"]) for thing, contact in zip(told["objects"], matched, strict=True) if contact is not None
        }
        for contact in contacts:
            bins[min(int(contact.p_mine * 5.0), 4)].append(real.get(id(contact), False))
            for threshold in thresholds:
                false_alarms[threshold] += contact.p_mine >= threshold and not real.get(id(contact), False)
    print(
        f"synthetic missions: {n_seeds} held-out seeds, {targets} targets, {area_km2:.4f} km2; rocks called mines count as false alarms\n"
    )
    print(f"{'p_mine >=':<12}{'Pd':>8}{'false alarms per km2':>24}")
    for threshold in thresholds:
        print(f"{threshold:<12}{found[threshold] / max(targets, 1):>8.2f}{false_alarms[threshold] / area_km2:>24.0f}")
    print(f"\n{'p_mine':<12}{'contacts':>10}{'of them targets':>17}")
    for index in sorted(bins):
        print(f"{index / 5:.1f} - {(index + 1) / 5:.1f}{'':<3}{len(bins[index]):>10}{sum(bins[index]) / len(bins[index]):>17.2f}")


def _contacts_of(scene: SyntheticScene) -> tuple[Contact, ...]:
    from auv_mcm.pipeline import Pipeline

    pipeline = Pipeline(Config())
    for event in synthetic_mission(scene):
        pipeline.feed(event)
    pipeline.finish()
    return pipeline.contacts


def _matches(contacts: Iterable[Contact], objects: Sequence[dict[str, Any]], scene: SyntheticScene) -> list[Contact | None]:
    """Per true object its contact, one-to-one by least distance within the gate."""
    frame = LocalFrame(latitude_deg=scene.legs[0].latitude_deg, longitude_deg=scene.legs[0].longitude_deg, height_m=0.0)
    pairs = []
    for contact in contacts:
        place = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)
        for index, thing in enumerate(objects):
            distance_m = float(np.linalg.norm((place - frame.to_enu(thing["lat"], thing["lon"], 0.0))[:2]))
            if distance_m <= _MATCH_GATE_M + 0.5 * thing["length_m"]:
                pairs.append((distance_m, contact.id, index, contact))
    matched: list[Contact | None] = [None] * len(objects)
    used: set[str] = set()
    for _, contact_id, index, contact in sorted(pairs, key=lambda pair: pair[:3]):
        if matched[index] is None and contact_id not in used:
            matched[index] = contact
            used.add(contact_id)
    return matched


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
