"""Measure the cost of the cooperating snakes for their contours, and which false alarms of the detector they reject.

auv-mcm bench snakes            contour error beside time, for schedules from coarse to fine
auv-mcm bench snakes --scenes   also detections on simulated missions: rejected clutter and lost targets, by reason
auv-mcm bench snakes --odds     also what the chain hands on to confirmation, rejected by the odds after contours
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.reasons import bearing
from auv_mcm.confirm import snake_rules
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import COARSE, FINE, Contours, converge, snake_settings
from auv_mcm.confirmation import examine, region_of, without_confirmation
from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.kernels import snake, snake_twin
from auv_mcm.kernels.snake_descent import Schedule
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Tile
from auv_mcm.settings.config import Config
from sim_replay.benches.every_stage.drawn_contours import DrawnRegion, drawn_pair, random_start
from sim_replay.missions import config_for, reporting_everything, unconfirmed
from sim_replay.scoring.overlap import overlap
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import read_scene

Mask: TypeAlias = NDArray[np.bool_]
Label: TypeAlias = Literal["target", "clutter"]

ODDS_SCENES: Final = ("ripple", "seagrass", "flat", "mixed")
HELD_OUT_SEEDS: Final = tuple(range(31, 37))  # the rules were set on seeds from 11 to 23
SCHEDULES: Final[dict[str, tuple[Schedule, Schedule]]] = {
    "4 nodes": (COARSE, ((4, 1.0, 20),)),
    "8 nodes": (COARSE, ((8, 3.0, 20), (8, 1.0, 20), (0, 0.0, 1), (0, 1.0, 10))),
    "16 nodes (default)": (COARSE, FINE),
    "16 nodes, no pruning": (COARSE, FINE[:-2]),
    "24 nodes": (COARSE, (*FINE[:-2], (24, 1.0, 20), *FINE[-2:])),
}

_SHAPE: Final = (128, 128)
_DETECTION_P: Final = 1e-6
_LOST: Final = 0.02  # of targets
_ALL: Final = 100_000
_BESIDE_M: Final = 0.75  # from the middle of a target's end to a detection of it
_CLEAR_M: Final = 3.0


class SnakeRow(NamedTuple):
    """Hold one schedule's results: intersection over union of shadow and highlight, and medians of time and proposals
    for one pair.
    """

    schedule: str
    shadow_iou: float
    shadow_iou_5th: float
    highlight_iou: float
    pair_ms: float
    n_proposed: float


class SceneRow(NamedTuple):
    """One scene: clutter rejected of all and targets lost of all, the same if any broken rule rejected, and how often
    each reason spoke against clutter.
    """

    scene: str
    n_clutter: int
    n_rejected: int
    n_clutter_breaking: int
    n_targets: int
    n_lost: int
    n_targets_breaking: int
    reasons: Counter[str]


class Handed(NamedTuple):
    """Hold a detection that the chain hands on to confirmation. p_detector, p_contours: p_mine before and after its
    contours. explained: it carries a code that speaks against a mine.
    """

    label: Label
    p_detector: float
    p_contours: float
    explained: bool


class OddsRow(NamedTuple):
    """One scene's clutter below the p_mine that all but _LOST of its targets reach: after contours, with a reason
    given, and by p_detector alone.
    """

    scene: str
    n_clutter: int
    n_rejected: int
    n_explained: int
    n_by_detector: int
    n_targets: int
    n_lost: int


def snake_rows(n_images: int = 10, n_starts: int = 5) -> list[SnakeRow]:
    """Return the contour error beside the time for one pair, per schedule."""
    drawings = [drawn_pair(seed) for seed in range(100, 100 + n_images)]
    return [_row(name, drawings, n_starts, *schedules) for name, schedules in SCHEDULES.items()]


def _row(name: str, drawings: list[DrawnRegion], n_starts: int, coarse: Schedule, fine: Schedule) -> SnakeRow:
    shadow_iou, highlight_iou, pair_s, proposed = [], [], [], []
    for number, drawn in enumerate(drawings):
        table = snake.window_row_sums(drawn.region.intensity, drawn.region.valid).table
        settings = region_settings(drawn.region)
        for k in range(n_starts):
            start = random_start(drawn, 1000 * number + k)
            began = time.perf_counter()
            moved = snake.move_pair(table, settings, np.array(coarse + fine), start.highlight, start.shadow)
            pair_s.append(time.perf_counter() - began)
            proposed.append(moved.n_proposed)
            contours = converge(drawn.region, start, coarse=coarse, fine=fine)
            shadow_iou.append(overlap(snake_rules.contour_mask(contours.shadow, _SHAPE), drawn.shadow))
            highlight_iou.append(overlap(snake_rules.contour_mask(contours.highlight, _SHAPE), drawn.highlight))
    return SnakeRow(
        schedule=name,
        shadow_iou=statistics.median(shadow_iou),
        shadow_iou_5th=float(np.quantile(shadow_iou, 0.05)),
        highlight_iou=statistics.median(highlight_iou),
        pair_ms=statistics.median(pair_s) * 1e3,
        n_proposed=statistics.median(proposed),
    )


def region_settings(region: Region, correlation_px: float = 1.0) -> snake_twin.Settings:
    """Return the criterion's settings for a region."""
    return snake_settings(region, snake.window_row_sums(region.intensity, region.valid).table, correlation_px)


def twin_ratio(n_images: int = 2) -> float:
    """Return how many times longer the Python twin takes for one pair than the C kernel."""
    if snake.c_kernel() is None:
        return 1.0
    ratios = []
    for seed in range(n_images):
        drawn = drawn_pair(seed)
        table = snake.window_row_sums(drawn.region.intensity, drawn.region.valid).table
        start, settings, schedule = random_start(drawn, seed), region_settings(drawn.region), np.array(COARSE + FINE)
        marks = [time.perf_counter()]
        for mover in (snake.move_pair, snake_twin.move_pair):
            mover(table, settings, schedule, np.rint(start.highlight), np.rint(start.shadow))
            marks.append(time.perf_counter())
        ratios.append((marks[2] - marks[1]) / (marks[1] - marks[0]))
    return statistics.median(ratios)


def scene_rows(
    scenes: Sequence[str] = ("ripple", "seagrass", "flat", "mixed"), seeds: Sequence[int] = HELD_OUT_SEEDS
) -> Iterator[SceneRow]:
    """Return the fate of the detector's detections on simulated missions.

    A target is the best detection of one in each pass, where it lay abeam; clutter lies clear of every object. All
    else, such as rocks and second detections of a target, counts for neither.
    """
    for name in scenes:
        judged = [found for seed in seeds for found in _judged(name, seed)]
        clutter = [contours for label, contours in judged if label == "clutter"]
        targets = [contours for label, contours in judged if label == "target"]
        yield SceneRow(
            scene=name,
            n_clutter=len(clutter),
            n_rejected=sum(c.rejected for c in clutter),
            n_clutter_breaking=sum(map(_breaks_rules, clutter)),
            n_targets=len(targets),
            n_lost=sum(c.rejected for c in targets),
            n_targets_breaking=sum(map(_breaks_rules, targets)),
            reasons=Counter(code for c in clutter for code in c.reasons if code in snake_rules.REJECTING),
        )


def odds_row(name: str, seeds: Sequence[int] = HELD_OUT_SEEDS) -> OddsRow:
    """Count what the odds after contours reject of all that the chain's detector hands on, at the threshold that loses
    no more targets than _LOST. Raises UsageError if no target was detected.
    """
    handed = [each for seed in seeds for each in _handed_on(name, seed)]
    targets, clutter = ([each for each in handed if each.label == label] for label in ("target", "clutter"))
    if not targets:
        raise UsageError(f"no target was detected in {name} with seeds {seeds[0]} to {seeds[-1]}: give more seeds")
    min_kept = _min_kept([each.p_contours for each in targets])
    rejected = [each for each in clutter if each.p_contours < min_kept]
    by_detector = _min_kept([each.p_detector for each in targets])
    return OddsRow(
        scene=name,
        n_clutter=len(clutter),
        n_rejected=len(rejected),
        n_explained=sum(each.explained for each in rejected),
        n_by_detector=sum(each.p_detector < by_detector for each in clutter),
        n_targets=len(targets),
        n_lost=sum(each.p_contours < min_kept for each in targets),
    )


def _min_kept(p_targets: Sequence[float]) -> float:
    """Return the highest threshold below which no more than _LOST of them lie."""
    return sorted(p_targets)[math.floor(_LOST * len(p_targets))]


def _handed_on(name: str, seed: int) -> list[Handed]:
    scene = msgspec.structs.replace(read_scene(name), seed=seed)
    config = reporting_everything(config_for(scene))
    config = msgspec.structs.replace(
        config, confirm=msgspec.structs.replace(config.confirm, min_p_mine=0.0, max_per_tile=_ALL)
    )
    odds, beam_width_rad = shipped_odds("cascade"), config.sonar.beam_width_rad
    detections: list[Detection] = []
    looked: list[tuple[float, float, bool]] = []

    def look(detection: Detection) -> Detection:
        p_detector = p_contours = without_confirmation(detection, odds, "").p_mine
        reasons = detection.reasons
        if detection.surroundings is not None:
            found = examine(detection, region_of(detection, detection.surroundings, beam_width_rad), odds, math.inf)
            p_contours, reasons = found.p_contours, (*reasons, *found.contours.reasons)
        detections.append(detection)
        looked.append((p_detector, p_contours, any(bearing(code) == "against" for code in reasons)))
        return detection

    mission, pipeline = Mission(scene), Pipeline(config, look=look)
    for event in mission.events():
        pipeline.feed(event)
    pipeline.finish()
    labels = label_detections(detections, mission.truth()["objects"], scene.track.speed_mps)
    return [Handed(label, *each) for label, each in zip(labels, looked, strict=True) if label is not None]


def _breaks_rules(contours: Contours) -> bool:
    return not snake_rules.REJECTING.isdisjoint(contours.reasons)


def _judged(name: str, seed: int) -> Iterator[tuple[Label, Contours]]:
    config = unconfirmed(Config())
    config = msgspec.structs.replace(config, detect=msgspec.structs.replace(config.detect, p_false_alarm=_DETECTION_P))
    scene = msgspec.structs.replace(read_scene(name), seed=seed)
    mission, pipeline, odds = Mission(scene), Pipeline(config), shipped_odds("contrast")
    tiles = [event for source in mission.events() for event in pipeline.feed(source) if isinstance(event, Tile)]
    tiles += [event for event in pipeline.finish() if isinstance(event, Tile)]
    detections = [detection for tile in tiles for detection in detect_tile(tile, config).detections]
    labels = label_detections(detections, mission.truth()["objects"], scene.track.speed_mps)
    beam_width_rad = config.sonar.beam_width_rad
    for detection, label in zip(detections, labels, strict=True):
        if label is not None and detection.surroundings is not None:
            yield (
                label,
                examine(detection, region_of(detection, detection.surroundings, beam_width_rad), odds, 0.0).contours,
            )


def label_detections(
    detections: Sequence[Detection], objects: Sequence[dict[str, Any]], speed_mps: float
) -> list[Label | None]:
    """Label each detection by the objects of truth.json; None for those that count for neither."""
    labels: list[Label | None] = []
    latitude, longitude = (
        np.array([scene_object[key] for scene_object in objects], dtype=np.float64) for key in ("lat", "lon")
    )
    clear_m = _CLEAR_M + 0.5 * np.array(
        [max(scene_object["length_m"], scene_object["width_m"]) for scene_object in objects], dtype=np.float64
    )
    for detection in detections:
        frame = LocalFrame(latitude_deg=detection.latitude_deg, longitude_deg=detection.longitude_deg)
        distance_m = np.hypot(*frame.to_enu(latitude, longitude, np.zeros(len(objects))).T[:2])
        labels.append("clutter" if (distance_m > clear_m).all() else None)
    # In time and range, which errors of navigation do not touch.
    time_s, ground_range_m = (np.array([getattr(d, key) for d in detections]) for key in ("time_s", "ground_range_m"))
    score, side = np.array([d.score for d in detections]), np.array([d.side for d in detections])
    for scene_object in objects:
        for look in scene_object["looks"] if scene_object["is_target"] else ():
            along_m = (time_s - datetime.fromisoformat(look["time"]).timestamp()) * speed_mps
            reach_m = _BESIDE_M + 0.5 * max(scene_object["length_m"], scene_object["width_m"])
            near = (side == look["side"]) & (np.hypot(along_m, ground_range_m - look["ground_range_m"]) <= reach_m)
            if near.any():
                labels[int(np.where(near, score, -np.inf).argmax())] = "target"
    return labels


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench snakes`."""
    parser.add_argument(
        "--scenes", action="store_true", help="also fly simulated missions and judge what the detector finds there"
    )
    parser.add_argument(
        "--odds", action="store_true", help="also fly them and judge what the odds after contours reject"
    )


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code."""
    print(
        f"one pair on {_SHAPE[0]} x {_SHAPE[1]} pixels, -10 dB, single look; the Python twin takes {twin_ratio():.0f} "
        "times as long\n"
    )
    print(f"{'schedule':<22}{'shadow IoU':>11}{'5 %':>7}{'highlight':>11}{'pair ms':>9}{'proposals':>11}")
    for row in snake_rows():
        print(
            f"{row.schedule:<22}{row.shadow_iou:>11.3f}{row.shadow_iou_5th:>7.3f}{row.highlight_iou:>11.3f}"
            f"{row.pair_ms:>9.2f}{row.n_proposed:>11.0f}"
        )
    if chosen.scenes:
        print(f"\n{'':<10}{'clutter':>9}{'rejected':>10}{'breaking':>10}{'targets':>9}{'lost':>8}{'breaking':>10}")
        for scene in scene_rows():
            clutter, targets = max(scene.n_clutter, 1), max(scene.n_targets, 1)
            reasons = ", ".join(f"{code} {number}" for code, number in scene.reasons.most_common(6))
            print(
                f"{scene.scene:<10}{scene.n_clutter:>9}{scene.n_rejected / clutter:>10.1%}"
                f"{scene.n_clutter_breaking / clutter:>10.1%}{scene.n_targets:>9}{scene.n_lost / targets:>8.1%}"
                f"{scene.n_targets_breaking / targets:>10.1%}  "
                f"{reasons}",
                flush=True,
            )
    if chosen.odds:
        print(f"\n{'':<10}{'handed on':>11}{'rejected':>10}{'reason':>10}{'detector':>10}{'targets':>9}{'lost':>8}")
        for judged in map(odds_row, ODDS_SCENES):
            shares = (judged.n_rejected / max(judged.n_clutter, 1), judged.n_explained / max(judged.n_rejected, 1))
            by_detector, lost = judged.n_by_detector / max(judged.n_clutter, 1), judged.n_lost / judged.n_targets
            print(
                f"{judged.scene:<10}{judged.n_clutter:>11}{shares[0]:>10.1%}{shares[1]:>10.1%}{by_detector:>10.1%}"
                f"{judged.n_targets:>9}{lost:>8.1%}",
                flush=True,
            )
    return 0
