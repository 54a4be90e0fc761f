"""Filter speckle before detection: what shadows and highlights lose, and what the chain finds then.

auv-mcm bench filters

The source paper (its section 2) smooths speckle before it segments. The first table filters pictures of mines with
truth, drawn as in `auv-mcm bench sas`: how bright the highlight and how dark the shadow remain against the floor, and
how well the chain's contours enclose them. The second filters the pings of simulated missions, along and across the
track, before the chain takes them as it ships. Its odds were fitted on pings that were not filtered, so that its p_mine
is a lower bound there.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable, Sequence
from typing import Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from auv_mcm.classify.fit import SOLIDS
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NavSample, Ping
from sim_replay.arguments import count
from sim_replay.missions import config_for
from sim_replay.scoring import ScoredMission, parse_contacts, parse_truth, score_missions
from sim_replay.scoring.overlap import overlap
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import read_scene
from sim_replay.studies.sas_objects import Drawn, contour_labels, draw
from sim_replay.text_tables import markdown, share_cell

Plane = NDArray[np.float32]
Filter = Callable[[Plane], Plane]

SCENES: Final = ("flat", "ripple", "mixed")
FIRST_SEED: Final = 92_300
"""On seeds from here on nothing was fitted or chosen."""
LIMITS_PER_KM2: Final = (10.0, 100.0)  # false alarms per km² at which Pd is printed
_RESOLUTION_M: Final = 0.05  # m, of the pictures
_KHZ: Final = 300.0  # of the pictures: 2.9 degrees of integration
_LEE: Final = 5  # pixels of the window on either axis, as is usual for it
_LEAST: Final = 1e-6  # of the mean: below it a logarithm says nothing
_EIGHT_BITS: Final = 255.0  # the range of the pictures that non-local means take
_SPAN: Final = 6.0  # nats of intensity in that range about the median: 26 dB


def mean_3(intensity: Plane) -> Plane:
    """Average over 3 by 3 pixels."""
    return np.asarray(cv2.blur(intensity, (3, 3)), dtype=np.float32)


def median_3(intensity: Plane) -> Plane:
    """Take the median of 3 by 3 pixels."""
    return np.asarray(cv2.medianBlur(intensity, 3), dtype=np.float32)


def median_5(intensity: Plane) -> Plane:
    """Take the median of 5 by 5 pixels."""
    return np.asarray(cv2.medianBlur(intensity, 5), dtype=np.float32)


def lee(intensity: Plane) -> Plane:
    """Filter by local statistics: J.-S. Lee, IEEE Trans. Pattern Anal. Mach. Intell. 2, 1980.

    Where the local variance is that of single-look speckle, the square of the mean, the mean is taken; where it is
    larger, the pixel is kept in proportion.
    """
    mean = uniform_filter(intensity.astype(np.float64), _LEE)
    variance = np.maximum(uniform_filter(intensity.astype(np.float64) ** 2, _LEE) - mean**2, 0.0)
    of_speckle = mean**2
    textured = np.maximum(variance - of_speckle, 0.0) / 2.0  # a single look: E[x^2] = 2 E[m^2]
    weight = textured / np.maximum(textured + of_speckle, _LEAST * float(mean.mean()) ** 2)
    return np.asarray(mean + weight * (intensity - mean), dtype=np.float32)


def bilateral(intensity: Plane) -> Plane:
    """Average logarithms of 5 by 5 pixels that differ by no more than speckle does."""
    # The logarithm of single-look speckle has a standard deviation of pi / sqrt(6) nats.
    smooth = cv2.bilateralFilter(_logarithm(intensity), 5, float(np.pi / np.sqrt(6.0)), 1.5)
    return np.asarray(np.exp(smooth), dtype=np.float32)


def non_local(intensity: Plane) -> Plane:
    """Average pixels whose surroundings look alike: A. Buades et al., CVPR 2005, on logarithms in 8 bits."""
    nats = _logarithm(intensity)
    middle = float(np.median(nats))
    grey = np.clip((nats - middle) / _SPAN + 0.5, 0.0, 1.0) * _EIGHT_BITS
    smooth = cv2.fastNlMeansDenoising(np.round(grey).astype(np.uint8), None, _EIGHT_BITS * 1.28 / _SPAN, 3, 9)
    return np.asarray(np.exp((smooth.astype(np.float32) / _EIGHT_BITS - 0.5) * _SPAN + middle), dtype=np.float32)


FILTERS: Final[dict[str, Filter]] = {
    "none": lambda intensity: intensity,
    "mean 3 x 3": mean_3,
    "median 3 x 3": median_3,
    "median 5 x 5": median_5,
    "Lee 5 x 5": lee,
    "bilateral 5 x 5": bilateral,
    "non-local means": non_local,
}


def _logarithm(intensity: Plane) -> Plane:
    least = _LEAST * float(intensity.mean()) + float(np.finfo(np.float32).tiny)
    return np.asarray(np.log(np.maximum(intensity, least)), dtype=np.float32)


# --- pictures with truth ---


def filtered(drawn: Drawn, smooth: Filter) -> Drawn:
    """Filter a picture."""
    intensity = smooth(drawn.region.intensity.astype(np.float32)).astype(np.float64)
    return drawn._replace(region=msgspec.structs.replace(drawn.region, intensity=intensity))


def levels_db(drawn: Drawn) -> tuple[float, float, float]:
    """Measure highlight and shadow against the floor, and the floor's speckle: dB, dB, standard deviation over mean."""
    intensity, truth = drawn.region.intensity, drawn.truth
    floor = intensity[truth == BACKGROUND]
    levels = [10.0 * float(np.log10(intensity[truth == label].mean() / floor.mean())) for label in (HIGHLIGHT, SHADOW)]
    return levels[0], levels[1], float(floor.std() / floor.mean())


def picture_rows(n: int) -> list[list[str]]:
    """Return a row per filter, of n objects of each class: medians."""
    drawn = [draw(solid, _RESOLUTION_M, _KHZ, 4 * number + k) for number in range(n) for k, solid in enumerate(SOLIDS)]
    rows = []
    for name, smooth in FILTERS.items():
        some = [filtered(one, smooth) for one in drawn]
        levels = np.array([levels_db(one) for one in some])
        labels = [contour_labels(one.region) for one in some]
        cells = [f"{value:.1f}" for value in np.median(levels[:, :2], axis=0)] + [f"{np.median(levels[:, 2]):.2f}"]
        for label in (HIGHLIGHT, SHADOW):
            shares = [overlap(each == label, one.truth == label) for each, one in zip(labels, some, strict=True)]
            cells.append(f"{statistics.median(shares):.2f} ({float(np.quantile(shares, 0.25)):.2f})")
        rows.append([name, *cells])
    return rows


# --- missions ---


def filtered_pings(pings: Sequence[Ping], smooth: Filter) -> list[Ping]:
    """Filter all pings of a mission, a side at a time, along and across the track; samples are kept as they are scaled.

    pings: all with both sides and as many samples.
    """
    sides = {}
    for side in ("port", "starboard"):
        traces = [getattr(ping, side) for ping in pings]
        amplitude = np.stack([trace.samples for trace in traces]).astype(np.float32)
        # Intensity is filtered; the root turns it back into what was recorded.
        smoothed = np.sqrt(np.maximum(smooth(amplitude**2), 0.0))
        sides[side] = [
            msgspec.structs.replace(trace, samples=samples) for trace, samples in zip(traces, smoothed, strict=True)
        ]
    return [
        msgspec.structs.replace(ping, port=port, starboard=starboard, transfer="amplitude")
        for ping, port, starboard in zip(pings, sides["port"], sides["starboard"], strict=True)
    ]


def mission_rows(n: int) -> list[list[str]]:
    """Return a row per filter: Pd of the chain over n missions in each scene, and false alarms at p_mine 0.2."""
    scored: dict[str, list[ScoredMission]] = {name: [] for name in FILTERS}
    for scene_name in SCENES:
        for seed in range(FIRST_SEED, FIRST_SEED + n):
            scene = msgspec.structs.replace(read_scene(scene_name), seed=seed)
            mission = Mission(scene)
            events = list(mission.events())
            pings = [event for event in events if isinstance(event, Ping)]
            truth = parse_truth(mission.truth(), scene_name)
            for name, smooth in FILTERS.items():
                numbered = iter(filtered_pings(pings, smooth))
                pipeline = Pipeline(config_for(scene))
                for event in events:
                    pipeline.feed(event if isinstance(event, NavSample) else next(numbered))
                pipeline.finish()
                contacts = parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), scene_name)
                scored[name].append(ScoredMission(contacts, truth, scene_name))
    rows = []
    for name, missions in scored.items():
        score = score_missions(missions)
        pds = [next(one for one in score.headlines if one.limit_per_km2 == limit).pd for limit in LIMITS_PER_KM2]
        rows.append([name, str(score.n_targets), *(share_cell(pd) for pd in pds)])
    return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench filters`."""
    parser.add_argument("--objects", type=count, default=8, help="pictures per class (default 8)")
    parser.add_argument("--missions", type=count, default=2, help="missions per scene (default 2)")


def run(chosen: argparse.Namespace) -> int:
    """Print both tables; returns the exit code."""
    header = ["filter", "highlight, dB", "shadow, dB", "speckle", "highlight enclosed", "shadow enclosed"]
    print(
        f"Medians of {4 * chosen.objects} pictures (lower quartile):\n\n"
        + markdown(header, picture_rows(chosen.objects))
    )
    print()
    header = ["filter", "targets", *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2)]
    print("The chain, intervals of 95 %:\n\n" + markdown(header, mission_rows(chosen.missions)))
    return 0
