"""Measure what one run of the chain over one mission does not show: the worst tile, a long replay's memory, the rest.

The worst tile is of a drawn floor with an object every 3 m along the track and every 4 m across.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.confirmation import confirm_detection
from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, EchoTrace, NavSample, Ping
from auv_mcm.settings.config import Config
from sim_replay.benches.run_time.latency import first_waits
from sim_replay.benches.run_time.lines import BenchMission, repeated
from sim_replay.benches.run_time.measure import measure_settings, timed, times_real_time
from sim_replay.benches.run_time.points import ChainSetting
from sim_replay.logs.open_log import open_log

WITHOUT_KERNELS: Final = {"AUV_MCM_KERNELS": "numpy"}
LONG_S: Final = 2400.0
"""Duration of the mission whose replay's memory is measured, s."""
N_PINGS: Final = 1536
"""Of the drawn floor: three tiles and a half."""
_RANGE_M, _N_SAMPLES, _ALTITUDE_M, _SPEED_MPS, _RATE_HZ = 50.0, 1024, 5.0, 2.0, 14.0
_REPLAY: Final = (
    "import sys; from auv_mcm.cli import main; code = main(['replay', *sys.argv[1:]])\n"
    "hwm = next(line for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
    "sys.stdout.write('\\n' + hwm.split()[1]); sys.exit(code)"
)
"""Replay a log as the command does, then print its peak memory, kB."""


class Apart(NamedTuple):
    """Hold figures of single runs; None for what was not measured.

    look_ms: median and 99 % of an examination, from cutting its region to the solids. worst_tile_s: processor time for
    what 30 s of track give at once. replay_mb: peak memory of `auv-mcm replay` over
    LONG_S. numpy_speed: times real time without the C kernels. announced: share of views on targets announced in time.
    """

    look_ms: tuple[float, float] | None = None
    worst_tile_s: float | None = None
    replay_mb: float | None = None
    numpy_speed: float | None = None
    announced: float | None = None


def measure_apart(
    default: ChainSetting, flat: BenchMission, scenes: Sequence[BenchMission], folder: Path, show: Callable[[str], None]
) -> Apart:
    """Measure all of them: memory and numpy on flat, announcements on scenes."""
    show(f"{flat.name}: examinations, then a floor of objects")
    look_ms = examination_ms(flat)
    worst_s = worst_tile_s(N_PINGS)
    long = repeated(flat, LONG_S, folder)
    show(f"{long.name}, replayed")
    command = [sys.executable, "-c", _REPLAY, str(long.log), "--out", str(folder / "long")]
    output, _ = timed(command, long.name, folder / "long.err", {})
    show(f"{flat.name} without kernels, then waits for announcements")
    slow = measure_settings([default], [flat], 1, folder, environment=WITHOUT_KERNELS)[0].runs[flat.name]
    waits = [wait for line in scenes for wait in first_waits(line)]
    in_time = sum(wait.is_in_time for wait in waits) / len(waits) if waits else None
    return Apart(look_ms, worst_s, int(output.split()[-1]) / 1024.0, times_real_time(slow), in_time)


def examination_ms(line: BenchMission) -> tuple[float, float]:
    """Take the processor time of every examination of a mission; returns median and 99 %, ms."""
    spent_ms: list[float] = []
    model, _ = fitting(configured_model(line.config), line.config)
    odds = shipped_odds("contrast" if model is None else "cascade")

    def look(detection: Detection) -> Detection:
        began_s = time.process_time()
        done = confirm_detection(detection, line.config.sonar.beam_width_rad, odds, line.config.confirm)
        if done.confirmation is not None:
            spent_ms.append(1e3 * (time.process_time() - began_s))
        return done

    pipeline = Pipeline(line.config, look=look)
    for event in open_log(line.log, line.config):
        pipeline.feed(event)
    pipeline.finish()
    median_ms, most_ms = np.quantile(spent_ms, [0.5, 0.99]).tolist()
    return median_ms, most_ms


def worst_tile_s(n_pings: int) -> float:
    """Feed a drawn floor of objects to the chain; returns the processor time of the dearest ping, s."""
    pipeline, dearest_s = Pipeline(Config()), 0.0
    for event in crowded_events(n_pings):
        began_s = time.process_time()
        pipeline.feed(event)
        dearest_s = max(dearest_s, time.process_time() - began_s)
    return dearest_s


def crowded_events(n_pings: int) -> Iterator[NavSample | Ping]:
    """Yield navigation and pings of a straight line over the drawn floor."""
    random = np.random.Generator(np.random.PCG64(7))
    spacing_m, row_m = _RANGE_M / _N_SAMPLES, _SPEED_MPS / _RATE_HZ
    home = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)
    floor = np.ones((n_pings, _N_SAMPLES))
    for near_m in np.arange(_ALTITUDE_M + 4.0, _RANGE_M - 6.0, 4.0):
        shadow_m = min(0.4 * near_m / (_ALTITUDE_M - 0.4), 3.0)  # of an object 0.4 m high and as long
        first, behind, end = (round(at_m / spacing_m) for at_m in (near_m, near_m + 0.4, near_m + 0.4 + shadow_m))
        for start_m in np.arange(0.0, n_pings * row_m, 3.0):
            rows = slice(round(start_m / row_m), round((start_m + 1.0) / row_m))
            floor[rows, first:behind], floor[rows, behind:end] = 15.0, 0.05
    floor[:, : round(_ALTITUDE_M / spacing_m)] = 1e-3  # water, 30 dB below
    port, starboard = (
        (1000.0 * np.sqrt(floor * random.exponential(1.0, floor.shape))).astype(np.uint16) for _ in range(2)
    )
    for number in range(n_pings):
        time_s = 1_780_000_000.0 + number / _RATE_HZ
        latitude, longitude, _ = home.to_geodetic(np.array([[0.0, row_m * number, 0.0]]))
        yield NavSample(
            time_s=time_s,
            latitude_deg=float(latitude[0]),
            longitude_deg=float(longitude[0]),
            heading_rad=0.0,
            depth_m=10.0,
            altitude_m=_ALTITUDE_M,
            speed_mps=_SPEED_MPS,
        )
        left, right = (
            EchoTrace(samples=side[number], first_range_m=0.5 * spacing_m, spacing_m=spacing_m)
            for side in (port, starboard)
        )
        yield Ping(number=number, time_s=time_s, port=left, starboard=right, transfer="amplitude")
