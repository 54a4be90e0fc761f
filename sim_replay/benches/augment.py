"""Measure what embedding targets costs, and whether embedded targets look like native ones.

auv-mcm bench augment   targets per minute, and how well a classifier separates embedded from native targets

Missions are simulated twice, with targets and without; into the second the same targets are embedded at the same
places. A logistic regression on plain image statistics of chips around them learns on some missions to separate them,
and is tried on the others. 50 %: it cannot. Only the sea floor, stones and sonar that the simulator has are judged.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.waterfall.ground import ground_edges_m, make_traces, mean_between
from sim_replay.arguments import count
from sim_replay.augment.background_log import Survey, read_survey, window_intensity
from sim_replay.augment.embed import embed
from sim_replay.augment.targets import EmbeddedTarget, Placement, TargetSpec, place_targets
from sim_replay.augment.track import PingTrack, track_of
from sim_replay.simulate import simulate
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.echo import floor_tables
from sim_replay.simulator.scene import EXACT, Lawnmower, Scene, SceneObject, TargetKind
from sim_replay.simulator.scene_file import read_scene
from sim_replay.simulator.world import SimulatedFloor

_FIRST_SEED: Final = 9300  # of missions that nothing was fitted on
_LEG_M: Final = 320.0  # m
_GRID_M: Final = 7.0  # places are this far apart at least
_ROCKS: Final = 12  # per mission
_KINDS: Final[tuple[TargetKind, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge", "box")
_CHIP_PINGS: Final = 14  # before and after the target
_CHIP_NEAR_M, _CHIP_FAR_M, _COLUMN_M = 1.5, 6.0, 0.1
_RIDGE: Final = 3.0  # penalty of a squared weight

Floats: TypeAlias = NDArray[np.float64]


class ChipStatistics(NamedTuple):
    """Hold statistics (n_chips, n_features) float64 of chips, whether each is embedded, and the mission it is from."""

    features: Floats
    embedded: NDArray[np.bool_]
    mission: NDArray[np.int64]


class ClassifierVerdict(NamedTuple):
    """Hold how well a classifier separates chips.

    accuracy: on missions it was not trained on; sigma: of the accuracy by chance.

    n_chips: it was tried on.
    """

    accuracy: float
    sigma: float
    n_chips: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench augment`."""
    parser.add_argument(
        "--scenes", nargs="+", default=["flat", "ripple"], help="named scenes or scene files (default flat ripple)"
    )
    parser.add_argument("--missions", type=count, default=4, help="missions per scene, at least 2 (default 4)")
    parser.add_argument("--targets", type=count, default=40, help="targets per mission (default 40)")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; returns the exit code."""
    print("scene        targets  embedded per minute   separated  (2 sigma)")
    for name in arguments.scenes:
        parts, n_targets, seconds = [], 0, 0.0
        for number in range(max(arguments.missions, 2)):
            with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
                chips, taken_s = mission_chips(
                    read_scene(name), _FIRST_SEED + number, arguments.targets, Path(folder), number
                )
            parts.append(chips)
            n_targets += int(chips.embedded.sum())
            seconds += taken_s
        joined = ChipStatistics(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        verdict = discriminate(joined)
        rate = 60.0 * n_targets / seconds
        print(
            f"{name:12s} {n_targets:7d}  {rate:19.0f}  {100.0 * verdict.accuracy:8.1f} %  ({200.0 * verdict.sigma:.1f} "
            "%)"
        )
    return 0


# --- the same targets, native and embedded ---


def mission_chips(scene: Scene, seed: int, n_targets: int, folder: Path, number: int) -> tuple[ChipStatistics, float]:
    """Cut chips of both kinds from one mission over a scene's floor.

    Return them with the time that embedding took, s.
    """
    plan = Lawnmower(heading_deg=20.0, n_legs=1, leg_m=_LEG_M)
    floor = replace(
        scene,
        seed=seed,
        scatter=(),
        objects=(),
        faults=(),
        navigation_error=EXACT,
        track=replace(scene.track, plan=plan),
    )
    rocks, targets = _rocks_and_targets(floor, seed, n_targets)
    with_targets = simulate(replace(floor, objects=(*rocks, *targets)), folder / "native")
    without = simulate(replace(floor, objects=rocks), folder / "bare")
    config = Config(sonar=SonarConfig(beam_width_deg=scene.sonar.beam_width_deg))
    native, bare = read_survey(with_targets.log, config), read_survey(without.log, config)
    track = track_of(bare, config)
    placements = _placements(floor, targets, track)
    start_s = time.perf_counter()
    done = embed(bare, track, placements, config, seed)
    taken_s = time.perf_counter() - start_s
    augmented_log = folder / "augmented.xtf"
    augmented_log.write_bytes(done.data)
    augmented = read_survey(augmented_log, config)
    rows = [statistics_of(chip(survey, track, one)) for survey in (native, augmented) for one in placements]
    embedded = np.repeat([False, True], len(placements))
    return ChipStatistics(np.array(rows), embedded, np.full(len(rows), number)), taken_s


def _rocks_and_targets(
    scene: Scene, seed: int, n_targets: int
) -> tuple[tuple[SceneObject, ...], tuple[SceneObject, ...]]:
    """Place rocks and targets on a grid along the only leg, each somewhere in its cell."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 0x42454E43])))
    farthest_m = 0.85 * math.sqrt(scene.sonar.range_m**2 - scene.track.altitude_m**2)
    nearest_m = 1.0 * scene.track.altitude_m
    along = np.arange(15.0, _LEG_M - 15.0, _GRID_M)
    across = np.arange(nearest_m, farthest_m - 0.5 * _GRID_M, _GRID_M)
    cells = [(a, side * c) for a in along for c in across for side in (-1.0, 1.0)]
    chosen = random.permutation(len(cells))[: _ROCKS + n_targets]
    places = [(cells[k][0] + random.uniform(0.0, 2.0), cells[k][1] + random.uniform(-1.0, 1.0)) for k in chosen]

    def scene_object(kind: TargetKind | None, place: tuple[float, float]) -> SceneObject:
        return SceneObject(
            kind=kind or "rock",
            leg=0,
            along_m=place[0],
            across_m=place[1],
            azimuth_deg=float(random.uniform(0.0, 360.0)),
            burial_m=float(random.uniform(0.0, 0.1)),
            strength_db=float(random.uniform(-22.0, -11.0)),
        )

    rocks = tuple(scene_object(None, place) for place in places[:_ROCKS])
    return rocks, tuple(scene_object(_KINDS[k % len(_KINDS)], place) for k, place in enumerate(places[_ROCKS:]))


def _placements(scene: Scene, targets: Sequence[SceneObject], track: PingTrack) -> tuple[Placement, ...]:
    """Describe the native targets as a spec would place them, with the contrast that they have on their floor."""
    world = SimulatedFloor(scene.world, scene.seed)
    tables = floor_tables(scene, world.covers)
    heading = math.radians(20.0)
    wanted = []
    for target in targets:
        assert target.along_m is not None
        assert target.across_m is not None
        assert target.strength_db is not None
        east = target.along_m * math.sin(heading) + target.across_m * math.cos(heading)
        north = target.along_m * math.cos(heading) - target.across_m * math.sin(heading)
        to_east, to_north, _ = track.frame.to_enu(scene.origin.latitude_deg, scene.origin.longitude_deg, 0.0)
        for ping, side, ground_range_m in track.looks(east + float(to_east), north + float(to_north))[:1]:
            height_m = float(track.first_return_m[ping])
            sine = height_m / math.hypot(height_m, ground_range_m)
            floor = float(tables[int(world.seabed_at(east, north)), int(sine * TABLE_SIZE)])
            wanted.append(
                EmbeddedTarget(
                    kind=target.kind,  # type: ignore[arg-type]  # one of _KINDS
                    side=side,
                    ping=int(track.number[ping]),
                    ground_range_m=ground_range_m,
                    azimuth_deg=target.azimuth_deg,
                    burial_m=target.burial_m,
                    contrast_db=target.strength_db - 10.0 * math.log10(floor),
                )
            )
    return place_targets(TargetSpec(targets=tuple(wanted)), track)


# --- separating them ---


def chip(survey: Survey, track: PingTrack, placement: Placement) -> Floats:
    """Cut the natural logarithm of the intensity around a target, less its median.

    (n_pings, n_columns) over ground range.
    """
    stretch, row = survey.stretches[int(track.stretch[placement.ping])], int(track.row[placement.ping])
    pings = slice(max(row - _CHIP_PINGS, 0), min(row + _CHIP_PINGS + 1, stretch.n_pings))
    trace = stretch.trace(row, placement.side)
    assert trace is not None
    intensity, valid = window_intensity(stretch, pings, placement.side, survey.transfer)
    traces = make_traces(intensity, valid, np.zeros(valid.shape, dtype=np.bool_), trace.first_range_m, trace.spacing_m)
    n_columns = math.ceil((placement.ground_range_m + _CHIP_FAR_M) / _COLUMN_M)
    # Native and bare pings are the same in geometry: one track serves both.
    ground = mean_between(
        traces, ground_edges_m(np.full(len(intensity), track.first_return_m[placement.ping]), n_columns, _COLUMN_M)
    )
    near = max(n_columns - round((_CHIP_NEAR_M + _CHIP_FAR_M) / _COLUMN_M), 0)
    logarithm = np.log(np.maximum(ground.intensity[:, near:], 1e-3))
    return np.asarray(logarithm - np.median(logarithm))


def statistics_of(image: Floats) -> Floats:
    """Compute plain statistics of an image, whole and middle: distribution, gradients, correlation, texture.

    Texture is taken at several scales.
    """
    middle = image[_CHIP_PINGS - 5 : _CHIP_PINGS + 6]
    values: list[float] = []
    for part in (image, middle):
        values += np.quantile(part, (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)).tolist()
        centred = part - part.mean()
        spread = float(centred.std()) + 1e-9
        values += [spread, float((centred**3).mean()) / spread**3, float((centred**4).mean()) / spread**4]
        for axis in (0, 1):
            step = np.abs(np.diff(part, axis=axis))
            values += [float(step.mean()), *np.quantile(step, (0.5, 0.9, 0.99)).tolist()]
            moved = np.moveaxis(centred, axis, 0)
            values += [float((moved[lag:] * moved[:-lag]).mean()) / spread**2 for lag in (1, 2, 4)]
        blurred = [part, *(gaussian_filter(part, sigma) for sigma in (0.7, 1.4, 2.8))]
        values += [float((fine - coarse).std()) for fine, coarse in pairwise(blurred)]
        box = uniform_filter(part, 3)
        values += [float(box.min()), float(box.max()), float((box < -1.5).mean()), float((box > 1.5).mean())]
        dark = part[box < -1.5]
        values += [float(dark.std()), float(dark.mean())] if dark.size > 8 else [0.0, 0.0]
    return np.array(values)


def discriminate(chips: ChipStatistics) -> ClassifierVerdict:
    """Compute the accuracy of a classifier of embedded and native chips; each mission is left out of its training."""
    right = 0
    for mission in np.unique(chips.mission):
        here = chips.mission == mission
        mean, spread = chips.features[~here].mean(axis=0), chips.features[~here].std(axis=0) + 1e-9
        weights = _logistic_regression((chips.features[~here] - mean) / spread, chips.embedded[~here])
        score = _with_one((chips.features[here] - mean) / spread) @ weights
        right += int(np.count_nonzero((score > 0.0) == chips.embedded[here]))
    accuracy = right / chips.embedded.size
    return ClassifierVerdict(accuracy, math.sqrt(0.25 / chips.embedded.size), chips.embedded.size)


def _logistic_regression(features: Floats, truth: NDArray[np.bool_]) -> Floats:
    """Fit weights, the last that of the constant, by Newton's method; squares of all others are penalised."""
    rows = _with_one(features)
    penalty = np.diag([_RIDGE] * features.shape[1] + [1e-6])
    weights = np.zeros(rows.shape[1])
    for _ in range(25):
        chance = 1.0 / (1.0 + np.exp(-np.clip(rows @ weights, -30.0, 30.0)))
        slope = rows.T @ (truth - chance) - penalty @ weights
        curvature = (rows * (chance * (1.0 - chance))[:, None]).T @ rows + penalty
        step = np.linalg.solve(curvature, slope)
        weights += step
        if float(np.abs(step).max()) < 1e-8:
            break
    return weights


def _with_one(features: Floats) -> Floats:
    return np.concatenate([features, np.ones((len(features), 1))], axis=1)
