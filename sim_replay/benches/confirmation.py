"""Measure the cost of confirming a detection, whole and step by step.

Processor time of each confirmation, the best of some repetitions in one process.
"""

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
from auv_mcm.classify.fit import Effort
from auv_mcm.classify.odds import MineOdds, shipped_odds
from auv_mcm.confirmation import ExaminationStep, Thoroughness, confirm_detection, evidence_of, examine, region_of
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Detector
from auv_mcm.settings.config import Config
from sim_replay.benches.log import add_log, given_or_flown
from sim_replay.logs.open_log import open_log

_STEPS: Final[tuple[ExaminationStep, ...]] = (
    "survey",
    "first contours",
    "field",
    "second contours",
    "solids",
    "features",
)
_WHOLE: Final = "whole look"
_QUANTILES: Final = (0.5, 0.9, 0.99)  # of the time of one confirmation, printed
_MOVED: Final = 0.01  # of p_mine
EFFORTS: Final = {
    "as it is": Effort(),
    "half the starts": Effort(n_starts=256),
    "6 walks of 10": Effort(n_walks=6),
    "12 steps of 16": Effort(n_steps=12),
    "2 fine walks of 3": Effort(n_fine_walks=2),
    "12 fine steps of 20": Effort(n_fine_steps=12),
    "half of everything": Effort(256, 6, 12, 6, 2, 14, 8),
}
"""Searches for solids that try less, by name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench confirmation`."""
    add_log(parser)
    parser.add_argument(
        "--efforts", action="store_true", help="measure how far p_mine moves with less search for solids"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure confirmation on a log, or on a mission that is flown for it."""
    with given_or_flown(arguments.log) as (log, _):
        _bench(log, arguments.repeat, arguments.efforts)
    return 0


def detections_looked_at(log: Path, config: Config) -> list[Detection]:
    """Collect the detections that a mission hands to confirmation and that are confirmed."""
    taken: list[Detection] = []
    beam_width_rad = config.sonar.beam_width_rad

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
    """Time one confirmation and each of its steps, s; the best of `repeat` times each."""
    if detection.surroundings is None:
        raise ValueError("a detection without surroundings cannot be looked at")
    beam_width_rad, odds = config.sonar.beam_width_rad, _odds_for(detection)
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


def p_mine_by_effort(detection: Detection, config: Config) -> list[float]:
    """Compute p_mine of one confirmation with each of EFFORTS."""
    if detection.surroundings is None:
        raise ValueError("a detection without surroundings cannot be looked at")
    beam_width_rad, odds = config.sonar.beam_width_rad, _odds_for(detection)
    region = region_of(detection, detection.surroundings, beam_width_rad)
    looks = (
        examine(detection, region, odds, config.confirm.min_p_mine, thoroughness=Thoroughness(effort=effort))
        for effort in EFFORTS.values()
    )
    return [odds.p_mine(evidence_of(look, odds)) for look in looks]


def _bench(log: Path, repeat: int, efforts: bool) -> None:
    config = Config()
    detections = detections_looked_at(log, config)
    costs = [look_costs_s(detection, config, repeat, time.process_time) for detection in detections]
    n_deep = sum("solids" in each for each in costs)
    print(
        f"log: {log.name}: {len(costs)} looks, {n_deep} of them through all steps, kernels in {kernels.backend()}, "
        "processor time, "
        f"best of {repeat} for each look\n"
    )
    print(f"{'step':<18}{'looks':>7}{'median ms':>11}{'p90 ms':>9}{'p99 ms':>9}")
    for step in (*_STEPS, _WHOLE):
        taken_ms = [1e3 * each[step] for each in costs if step in each]
        if taken_ms:
            median, high, highest = np.quantile(taken_ms, _QUANTILES).tolist()
            print(f"{step:<18}{len(taken_ms):>7}{median:>11.2f}{high:>9.2f}{highest:>9.2f}")
    if efforts and detections:
        p_mine = np.array([p_mine_by_effort(detection, config) for detection in detections])
        moved = np.abs(p_mine - p_mine[:, :1])
        print(
            f"\n{'search for solids':<22}{'looks moved by over ' + format(_MOVED, 'g'):>27}"
            f"{'p99 of moves':>14}{'largest':>9}"
        )
        for name, of_look in zip(EFFORTS, moved.T, strict=True):
            print(
                f"{name:<22}{np.mean(of_look > _MOVED):>27.1%}{np.quantile(of_look, 0.99):>14.3f}{of_look.max():>9.3f}"
            )
