"""Cost of confirming a detection, whole and step by step: processor time of each look, the best of some repetitions in one process."""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm import kernels
from auv_mcm.classify.odds import MineOdds, shipped_odds
from auv_mcm.confirmation import ExaminationStep, confirm_detection, examine, region_of
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Detector
from auv_mcm.settings.config import Config
from sim_replay.benches.log import add_log, given_or_flown
from sim_replay.logs.open_log import open_log

_STEPS: Final[tuple[ExaminationStep, ...]] = ("survey", "first contours", "field", "second contours", "solids", "features")
_WHOLE: Final = "whole look"
_QUANTILES: Final = (0.5, 0.9, 0.99)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log(parser)


def run(arguments: argparse.Namespace) -> int:
    with given_or_flown(arguments.log) as (log, _):
        _bench(log, arguments.repeat)
    return 0


def detections_looked_at(log: Path, config: Config) -> list[Detection]:
    """Collect the detections that a mission hands to confirmation and that get a close look."""
    taken: list[Detection] = []
    beam_width_rad = math.radians(config.sonar.beam_width_deg)

    def look(detection: Detection) -> Detection:
        confirmed = confirm_detection(detection, beam_width_rad, _odds_for(detection), config.confirm)
        if confirmed.confirmation is not None:
            taken.append(detection)
        return confirmed

    pipeline = Pipeline(config, look=look)
    for event in open_log(log, config):
        pipeline.feed(event)
    pipeline.finish()
    return taken


def look_costs_s(detection: Detection, config: Config, repeat: int, clock: Callable[[], float]) -> dict[str, float]:
    """Time one look and each step that it takes, s; the best of `repeat` times each."""
    if detection.surroundings is None:
        raise ValueError("a detection without surroundings cannot be looked at")
    beam_width_rad, odds = math.radians(config.sonar.beam_width_deg), _odds_for(detection)
    costs: dict[str, float] = {}
    for _ in range(repeat):
        spent: dict[str, float] = defaultdict(float)
        mark = clock()
        confirm_detection(detection, beam_width_rad, odds, config.confirm)
        spent[_WHOLE] = clock() - mark
        region = region_of(detection, detection.surroundings, beam_width_rad)
        mark = clock()

        def done(step: ExaminationStep, spent: dict[str, float] = spent) -> None:
            nonlocal mark
            now = clock()
            spent[step] += now - mark
            mark = now

        examine(detection, region, odds, config.confirm.min_p_mine, done)
        costs = {step: min(cost_s, costs.get(step, math.inf)) for step, cost_s in spent.items()}
    return costs


@functools.cache
def _odds_of(detector: Detector) -> MineOdds:
    return shipped_odds(detector)


def _odds_for(detection: Detection) -> MineOdds:
    return _odds_of("contrast" if math.isnan(detection.cascade_score) else "cascade")


def _bench(log: Path, repeat: int) -> None:
    config = Config()
    detections = detections_looked_at(log, config)
    costs = [look_costs_s(detection, config, repeat, time.process_time) for detection in detections]
    n_deep = sum("solids" in each for each in costs)
    print(
        f"log: {log.name}: {len(costs)} looks, {n_deep} of them through all steps, kernels in {kernels.backend()}, processor time, "
        f"best of {repeat} for each look\n"
    )
    print(f"{'step':<18}{'looks':>7}{'median ms':>11}{'p90 ms':>9}{'p99 ms':>9}")
    for step in (*_STEPS, _WHOLE):
        taken_ms = [1e3 * each[step] for each in costs if step in each]
        if taken_ms:
            median, high, highest = np.quantile(taken_ms, _QUANTILES).tolist()
            print(f"{step:<18}{len(taken_ms):>7}{median:>11.2f}{high:>9.2f}{highest:>9.2f}")
