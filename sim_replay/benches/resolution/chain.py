"""Fly one disc of sea floor with sonars of different resolution, from one aspect and from two, and let the chain look.

Objects, floor and track are those of `bench apertures`; only the sonar differs. Its aperture turns by the same angle at
every resolution, so that shadows are equally blurred.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim_replay.benches.apertures import (
    Flown,
    as_shipped,
    drawn_scene,
    events_of,
    judged,
    leg_through,
    scores_of,
    threshold,
)
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.thresholds import resampled
from sim_replay.simulator.aperture import Aperture
from sim_replay.simulator.navigation_error import NavigationModel
from sim_replay.simulator.scene import Scene, SyntheticAperture
from sim_replay.simulator.sea import Sea
from sim_replay.text_tables import share_cell

FIRST_SEED: Final = 25_100
"""On seeds from here on nothing was fitted or chosen."""
ONE: Final = "1 view"
TWO: Final = "2 views"
LIMIT_PER_KM2: Final = 2000.0
"""False alarms per km² at which Pd is stated, on a floor with one rock per 90 m²."""

_HEADINGS_DEG: Final = (0.0, 90.0)  # of the two passes
_TURN_S: Final = 120.0  # s between passes
_INTEGRATION_RAD: Final = 0.05  # 2.9 degrees: a shadow 2 m long is blurred by 10 cm
_PIXELS: Final = 1.2  # per resolution
_ABSORPTION_DB_PER_KM: Final = 70.0  # of 300 kHz, whatever the frequency: it must not decide on the noise
_SEED: Final = 5  # of missions drawn again, fixed so that reports repeat

Floats = NDArray[np.float64]


class Setting(NamedTuple):
    """Hold a resolution along and across the track, m, and the number of looks per pixel."""

    resolution_m: float
    looks: int = 1


SETTINGS: Final = (
    Setting(0.015),
    Setting(0.03),
    Setting(0.06),
    Setting(0.12),
    Setting(0.24),
    Setting(0.06, 4),
    Setting(0.12, 4),
)
"""What is flown where nothing else is asked for."""


def scene_at(setting: Setting, seed: int) -> Scene:
    """Draw a disc, and set the sonar to a resolution."""
    scene = drawn_scene(seed)
    resolution_m = setting.resolution_m
    wavelength_m = 2.0 * resolution_m * _INTEGRATION_RAD
    sonar = msgspec.structs.replace(
        scene.sonar,
        frequency_khz=scene.sonar.sound_speed_mps / wavelength_m / 1e3,
        n_samples=round(scene.sonar.range_m / (resolution_m / _PIXELS)),
        absorption_db_per_km=_ABSORPTION_DB_PER_KM,
        looks=setting.looks,
        synthetic_aperture=SyntheticAperture(
            along_track_resolution_m=resolution_m,
            range_resolution_m=resolution_m,
            pixels_per_resolution=_PIXELS,
            sub_apertures=1,
        ),
    )
    return msgspec.structs.replace(scene, sonar=sonar)


def fly(setting: Setting, seed: int) -> Flown:
    """Fly one mission, and let the chain look at its first pass and at both."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before would stay for long
    scene = scene_at(setting, seed)
    sea = Sea(scene)
    aperture = Aperture(sea)
    navigation = NavigationModel(scene.navigation_error, scene.origin, scene.seed)
    passes = []
    start_s = scene.track.start_time_s
    for number, heading_deg in enumerate(_HEADINGS_DEG):
        strip = aperture.strip(leg_through(heading_deg), number)
        poses = aperture.poses(strip, start_s, 0, strip.n_lines)
        samples = [navigation.reported(pose, sea.altitude_m(pose)) for pose in poses]
        passes.append(events_of(aperture, strip, start_s, samples, "full", 0.0))
        start_s = poses[-1].time_s + _TURN_S
    return Flown(
        tuple(one.kind for one in scene.objects),
        {ONE: judged(scene, passes[0]), TWO: judged(scene, passes[0] + passes[1])},
    )


def rows(flights: Sequence[Flown]) -> Iterator[list[str]]:
    """Yield per number of views: views, Pd, the share of the found that is named right, and mine or rock."""
    for system in (ONE, TWO):
        scores = scores_of(flights, system, as_shipped)
        above = threshold(scores, LIMIT_PER_KM2)
        found = np.concatenate(scores.targets) > above
        named = np.concatenate(scores.named) & found
        yield [
            system,
            share_cell(proportion(int(found.sum()), len(found))),
            share_cell(proportion(int(named.sum()), int(found.sum()))),
            mine_or_rock_cell(flights, system),
        ]


def mine_or_rock_cell(flights: Sequence[Flown], system: str) -> str:
    """Write how often a mine has the higher p_mine of a mine and a rock, with its interval by drawing missions anew."""
    pairs = [_odds_of_objects(flown, system) for flown in flights]
    # Mines are compared with the rocks of their own mission, so that missions can be drawn anew.
    wins = np.array([share_above(mines, rocks) for mines, rocks in pairs])
    share = resampled(lambda some: float(wins[some].mean()), len(pairs), seed=_SEED)
    return f"{share.value:.2f} ({share.low:.2f}-{share.high:.2f})"


def share_above(mines: Floats, rocks: Floats) -> float:
    """Compute the share of pairs in which the mine's value is higher, ties counted half."""
    above = np.sign(np.nan_to_num(mines, neginf=-1e9)[:, np.newaxis] - np.nan_to_num(rocks, neginf=-1e9))
    return float((0.5 * (above + 1.0)).mean())


def _odds_of_objects(flown: Flown, system: str) -> tuple[Floats, Floats]:
    """Give the log-odds of the likeliest contact of each mine and of each rock, -inf for none."""
    best = np.full(len(flown.kinds), -math.inf)
    seen = flown.systems[system]
    for views, on in zip(seen.views, seen.on, strict=True):
        if on >= 0:
            best[on] = max(best[on], as_shipped(views))
    is_rock = np.array([kind == "rock" for kind in flown.kinds])
    return best[~is_rock], best[is_rock]
