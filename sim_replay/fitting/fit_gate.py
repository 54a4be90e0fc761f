"""Fit which places of a tile can become contacts: `auv-mcm calibrate gate`.

Simulated missions over the named scenes, but for those held out, are flown without the gate, by the cascade and by
contrasts alone. The log-odds that each detection ends with are forecast by least squares from its score, its contrast
and its range. The margin is the one that leaves in all but one in two hundred of the detections that would be reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.gate import Feature, Forecast, Gate, place_features
from auv_mcm.errors import UsageError
from auv_mcm.model_file import NONE
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Detector
from auv_mcm.settings.config import ContactsConfig
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.flights import flight_through, fly_through
from sim_replay.missions import reporting_everything, served_by
from sim_replay.simulator.scene_file import read_scene

FIRST_SEED: Final = 500  # rates are taken on seeds from 9100 on
LOST_SHARE: Final = 0.005
"""Share of the detections to report that the gate may drop on the missions that it is fitted on; chosen."""
_FAR_BELOW_NATS: Final = 2.0  # under the lowest log-odds reported; from there down a detection counts a tenth
_FAINT_WEIGHT: Final = 0.1  # of detections below _FAR_BELOW_NATS
_LOWEST_NATS: Final = -9.2  # p_mine 1e-4: how much less does not matter
_DIGITS: Final = 4  # decimals in the file

_CASCADE: Final[tuple[Feature, ...]] = ("cascade", "cascade_squared", "range", "range_squared", "cascade_by_range")
_CONTRAST: Final[tuple[Feature, ...]] = ("contrast", "contrast_by_range")


class PlaceOutcome(NamedTuple):
    """Pair what was known of a place before it was measured with the p_mine that its detection ended with."""

    scene: str
    ground_range_m: float
    altitude_m: float
    cascade_score: float
    contrast: float
    p_mine: float


def fit_gate(
    by_cascade: Sequence[PlaceOutcome], by_contrast: Sequence[PlaceOutcome], min_p_mine: float, fitted_on: str
) -> Gate:
    """Fit the two forecasts of a gate.

    Raises UsageError if there are fewer detections of `min_p_mine` or more than it takes to know the margin.
    """
    without_cascade: tuple[Feature, ...] = ("range", "range_squared", *_CONTRAST)
    return Gate(
        fitted_on=fitted_on,
        both=_fit(by_cascade, (*_CASCADE, *_CONTRAST), min_p_mine),
        contrast=_fit(by_contrast, without_cascade, min_p_mine),
    )


def outcomes_of(task: tuple[str, int, Detector], theatre: Theatre = USUAL) -> list[PlaceOutcome]:
    """Fly one mission through a scene, with a seed and a detector, and return what became of all detections."""
    name, seed, detector = task
    flight = flight_through(*theatre.carried(msgspec.structs.replace(read_scene(name), seed=seed), seed))
    pipeline = Pipeline(reporting_everything(served_by(detector, flight.config)))
    fly_through(flight.events, {name: pipeline})
    return [_outcome(name, view) for contact in pipeline.contacts for view in contact.views]


def calibrate_gate(
    seeds: Sequence[int], farm: Farm, show: Callable[[int, int], None] = lambda done, of: None, theatre: Theatre = USUAL
) -> Gate:
    """Fly missions with these seeds through the named scenes that are not held out, and fit the gate.

    Parameters
    ----------
    show
        Takes the missions flown so far, and how many there are.
    theatre
        What is flown; detections of its own odds, which have no gate yet.

    Raises
    ------
    UsageError
        As fit_gate does.
    """
    scenes = theatre.flown
    unfitted = theatre if theatre == USUAL else theatre.with_files(gate=NONE, background=NONE)
    detectors: tuple[Detector, ...] = get_args(Detector)
    tasks = [(name, seed, detector) for detector in detectors for name in scenes for seed in seeds]
    outcomes = list(run_tasks(partial(outcomes_of, theatre=unfitted), tasks, farm, lambda done: show(done, len(tasks))))
    found = {
        detector: [one for task, some in zip(tasks, outcomes, strict=True) if task[2] == detector for one in some]
        for detector in detectors
    }
    n_detections = sum(map(len, outcomes))
    fitted_on = (
        f"{n_detections} detections of simulated missions: {', '.join(scenes)}; seeds {', '.join(map(str, seeds))}"
    )
    return fit_gate(found["cascade"], found["contrast"], ContactsConfig().min_p_mine, fitted_on)


def _outcome(scene: str, view: Detection) -> PlaceOutcome:
    return PlaceOutcome(scene, view.ground_range_m, view.altitude_m, view.cascade_score, view.score, view.p_mine)


def _fit(outcomes: Sequence[PlaceOutcome], names: Sequence[Feature], min_p_mine: float) -> Forecast:
    features, p_mine = _features(outcomes)
    lowest = math.log(min_p_mine / (1.0 - min_p_mine))
    with np.errstate(divide="ignore"):
        log_odds = np.maximum(np.log(p_mine) - np.log1p(-p_mine), _LOWEST_NATS)
    reported = p_mine >= min_p_mine
    if np.count_nonzero(reported) * LOST_SHARE < 1.0:
        raise UsageError(
            f"{np.count_nonzero(reported)} detections to report are too few to know the margin. Fly more missions, "
            "with --seeds"
        )
    columns = np.column_stack([np.ones(len(p_mine)), *(features[name] for name in names)])
    root = np.sqrt(np.where(log_odds > lowest - _FAR_BELOW_NATS, 1.0, _FAINT_WEIGHT))
    found = np.linalg.lstsq(columns * root[:, None], log_odds * root, rcond=None)[0]
    offset, *weights = (round(float(value), _DIGITS) for value in found)
    forecast = Forecast(offset=offset, weights=dict(zip(names, weights, strict=True)), margin_nats=0.0)
    short = lowest - forecast.log_odds(features)[reported]
    margin = math.ceil(float(np.quantile(short, 1.0 - LOST_SHARE)) * 10.0**_DIGITS) / 10.0**_DIGITS
    return msgspec.structs.replace(forecast, margin_nats=margin)


def _features(outcomes: Sequence[PlaceOutcome]) -> tuple[Mapping[Feature, NDArray[np.float64]], NDArray[np.float64]]:
    columns = np.array([outcome[1:] for outcome in outcomes], dtype=np.float64)
    ground_range_m, altitude_m, cascade, contrast, p_mine = columns.T
    return place_features(ground_range_m, altitude_m, cascade=cascade, contrast=contrast), p_mine
