"""Measure the cost of contrasts per tile, and of measuring what they find.

Processor time, medians over repetitions in one process.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from auv_mcm.detect.candidates import STEP_M
from auv_mcm.detect.contrasts import contrasts
from auv_mcm.detect.measure import measure
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Tile
from auv_mcm.settings.config import Config
from sim_replay.benches.log import add_log, given_or_flown
from sim_replay.logs.open_log import open_log


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench detect`."""
    add_log(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure detection on a log, or on a mission that is flown for it."""
    with given_or_flown(arguments.log) as (log, _):
        _bench(log, arguments.repeat)
    return 0


def _bench(log: Path, repeat: int) -> None:
    config = Config()
    pipeline = Pipeline(config)
    tiles = [event for source in open_log(log, config) for event in pipeline.feed(source) if isinstance(event, Tile)]
    tiles += [event for event in pipeline.finish() if isinstance(event, Tile)]
    costs: dict[str, list[float]] = defaultdict(list)
    n_peaks = 0
    for _ in range(repeat):
        marks = [time.process_time()]
        weighed = [contrasts(tile, config.detect.p_false_alarm) for tile in tiles]
        marks.append(time.process_time())
        peaks = [contrast.peaks(STEP_M) for contrast in weighed]
        marks.append(time.process_time())
        for tile, contrast, tile_peaks in zip(tiles, weighed, peaks, strict=True):
            for peak in tile_peaks:
                measure(tile, contrast.floor(peak.row, peak.column), peak, config.sonar.beam_width_rad)
        marks.append(time.process_time())
        for step, cost_s in zip(
            ("weigh contrasts", "find peaks", "measure peaks"), np.diff(marks).tolist(), strict=True
        ):
            costs[step].append(cost_s)
        n_peaks = sum(map(len, peaks))
    pixels = sum(tile.mask.size for tile in tiles)
    print(
        f"log: {log.name}: {len(tiles)} tiles, {pixels / 1e6:.2f} million pixels, {n_peaks} peaks, processor time, "
        f"median of {repeat}\n"
    )
    print(f"{'step':<20}{'ms':>9}{'ns/pixel':>10}{'us/peak':>9}")
    for step, values in costs.items():
        cost_s = statistics.median(values)
        print(f"{step:<20}{cost_s * 1e3:>9.1f}{cost_s / pixels * 1e9:>10.1f}{cost_s / max(n_peaks, 1) * 1e6:>9.1f}")
