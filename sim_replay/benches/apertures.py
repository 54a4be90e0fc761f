"""Measure what sub-apertures of one pass are worth beside further passes, on simulated synthetic aperture images.

auv-mcm bench apertures                     flies, judges and prints
auv-mcm bench apertures --missions 4        fewer missions

A disc of sea floor is passed through its middle in five directions, 36 degrees apart. The first pass is seen whole, as
3 and as 5 sub-apertures; 3 and 5 passes are seen whole. Every system gives contacts of the chain as it ships, under
`sonar.kind: sas`. Judged is what the first pass can see, so that others add views and no ground. Nothing in the chain
was fitted on these scenes.
"""

from __future__ import annotations

import argparse
import gc
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.detect.belief import odds_of
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detection, NavSample, Ping
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.arguments import count
from sim_replay.benches.progress import counted
from sim_replay.missions import reporting_everything
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.thresholds import resampled, threshold_at
from sim_replay.simulator.aperture import Aperture, Strip, View
from sim_replay.simulator.navigation_error import NavigationModel
from sim_replay.simulator.plan import Leg, local_frame
from sim_replay.simulator.scene import (
    Lawnmower,
    NavigationError,
    Ripples,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    SyntheticAperture,
    Track,
    World,
)
from sim_replay.simulator.sea import Sea
from sim_replay.text_tables import columns, markdown, share_cell

Floats = NDArray[np.float64]
Rule = Callable[[Sequence[Detection]], float]

FIRST_SEED: Final = 24_100  # on seeds from here on nothing was fitted or chosen
SYSTEMS: Final = ("1 pass", "3 sub-apertures", "5 sub-apertures", "3 passes", "5 passes")
LIMITS_PER_KM2: Final = (500.0, 2000.0)  # false alarms per km² on a floor with one rock per 90 m²

_HEADINGS_DEG: Final = (0.0, 72.0, 144.0, 36.0, 108.0)  # the first three are spread as well as three of five can be
_RADIUS_M: Final = 32.0  # of the disc
_NADIR_M: Final = 8.0  # ground range from which the first pass is judged: 45 degrees of grazing and less
_BEYOND_M: Final = 3.0  # by which legs outrun the disc
_APART_M: Final = 4.2  # m between objects: farther than the longest shadow and the gate
_GATE_M: Final = 2.0  # from a contact to what it lies on, as in `auv-mcm score`
_TURN_S: Final = 120.0  # between passes
_ALTITUDE_M: Final = 9.0  # m above the floor: a quarter of the range
_TARGETS: Final = ("cylinder", "sphere", "truncated_cone", "wedge")
_N_EACH: Final = 5  # of each kind of target, per mission
_N_ROCKS: Final = 24  # per mission
_STREAM: Final = 0x41504552  # keeps these random numbers apart from others of the same seed
# Integrates over 7 degrees with resolution below: sub-apertures of 12 and 20 cm, near the chain's rows of 12 cm.
_SONAR: Final = Sonar(frequency_khz=150.0, range_m=36.0, n_samples=1000, noise_db=-18.0)
_RESOLUTION_M: Final = 0.04  # m, along and across the track


class Judged(NamedTuple):
    """Hold what a system makes of a mission: the views of each contact on judged ground, and what it lies on.

    on: index of the object, -1 for bare floor.
    """

    views: tuple[tuple[Detection, ...], ...]
    kinds: tuple[str, ...]
    on: tuple[int, ...]


class Flown(NamedTuple):
    """Hold one mission: the kinds of the objects judged, targets first, and what each system makes of it."""

    kinds: tuple[str, ...]
    systems: dict[str, Judged]


def drawn_scene(seed: int) -> Scene:
    """Draw a disc of sea floor with mines and rocks within reach of the first pass."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, _STREAM])))
    places: list[tuple[float, float]] = []
    kinds = [kind for kind in _TARGETS for _ in range(_N_EACH)] + ["rock"] * _N_ROCKS
    while len(places) < len(kinds):
        east, north = random.uniform(-_RADIUS_M, _RADIUS_M, 2).tolist()
        is_seen = math.hypot(east, north) < _RADIUS_M - 1.0 and abs(east) > _NADIR_M + 1.0
        if is_seen and all(math.dist((east, north), place) > _APART_M for place in places):
            places.append((east, north))
    objects = tuple(_drawn(kind, place, random) for kind, place in zip(kinds, places, strict=True))
    ripples = Ripples(wavelength_m=0.7, height_m=0.08, direction_deg=float(random.uniform(0.0, 360.0)), defects=0.4)
    return Scene(
        seed=seed,
        world=World(
            depth_m=30.0,
            relief_rms_m=0.08,
            patch_m=30.0,
            seabeds=(
                Seabed(type="sand", share=0.5),
                Seabed(type="gravel", share=0.25),
                Seabed(type="rippled_sand", share=0.25, ripples=ripples),
            ),
        ),
        objects=objects,
        sonar=msgspec.structs.replace(_SONAR, synthetic_aperture=_aperture(1)),
        track=Track(altitude_m=_ALTITUDE_M, plan=Lawnmower(n_legs=1, leg_m=1.0)),
        navigation_error=NavigationError(position_sigma_m=0.3, heading_bias_sigma_deg=0.2, altitude_bias_percent=1.0),
    )


def _drawn(kind: Any, place: tuple[float, float], random: np.random.Generator) -> SceneObject:
    sizes: dict[str, Any] = {}
    if kind == "rock":
        sizes = {
            "length_m": float(random.uniform(0.5, 2.0)),
            "width_m": float(random.uniform(0.4, 1.0)),
            "height_m": float(random.uniform(0.3, 0.6)),
        }
    elif kind == "sphere":
        sizes = {"width_m": float(random.uniform(0.6, 1.0))}
    return SceneObject(
        kind=kind,
        east_m=place[0],
        north_m=place[1],
        azimuth_deg=float(random.uniform(0.0, 360.0)),
        strength_db=float(random.uniform(-24.0, -11.0)),
        burial_m=float(random.uniform(0.0, 0.1)),
        **sizes,
    )


def _aperture(n_parts: int) -> SyntheticAperture:
    return SyntheticAperture(
        along_track_resolution_m=_RESOLUTION_M,
        range_resolution_m=_RESOLUTION_M,
        pixels_per_resolution=1.2,
        sub_apertures=n_parts,
    )


def fly(seed: int) -> Flown:
    """Fly one mission through all directions, and let every system look at it."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before would stay for long
    scene = drawn_scene(seed)
    sea = Sea(scene)
    whole = Aperture(sea)
    parted = {n: Aperture(_with_parts(sea, n)) for n in (3, 5)}
    navigation = NavigationModel(scene.navigation_error, scene.origin, scene.seed)
    passes: list[list[NavSample | Ping]] = []
    squinted: dict[int, list[NavSample | Ping]] = {3: [], 5: []}
    start_s = scene.track.start_time_s
    for number, heading_deg in enumerate(_HEADINGS_DEG):
        strip = whole.strip(leg_through(heading_deg), number)
        poses = whole.poses(strip, start_s, 0, strip.n_lines)
        samples = [navigation.reported(pose, sea.altitude_m(pose)) for pose in poses]
        passes.append(events_of(whole, strip, start_s, samples, "full", 0.0))
        if number == 0:
            for n, aperture in parted.items():
                for view in range(n):
                    squinted[n] += events_of(aperture, strip, start_s, samples, view, aperture.squint_rad(view))
        start_s = poses[-1].time_s + _TURN_S
    heard = {
        "1 pass": passes[0],
        "3 sub-apertures": squinted[3],
        "5 sub-apertures": squinted[5],
        "3 passes": [event for one in passes[:3] for event in one],
        "5 passes": [event for one in passes for event in one],
    }
    return Flown(
        tuple(one.kind for one in scene.objects), {name: judged(scene, events) for name, events in heard.items()}
    )


def _with_parts(sea: Sea, n_parts: int) -> Sea:
    scene = sea.scene
    sonar = msgspec.structs.replace(scene.sonar, synthetic_aperture=_aperture(n_parts))
    return Sea(msgspec.structs.replace(scene, sonar=sonar))


def leg_through(heading_deg: float) -> Leg:
    """Lay a leg through the middle of the disc."""
    heading, half_m = math.radians(heading_deg), _RADIUS_M + _BEYOND_M
    return Leg(-half_m * math.sin(heading), -half_m * math.cos(heading), heading, 2.0 * half_m)


def events_of(
    aperture: Aperture, strip: Strip, start_s: float, samples: Sequence[NavSample], view: View, squint_rad: float
) -> list[NavSample | Ping]:
    """List the lines of a pass, each after its sample of navigation."""
    events: list[NavSample | Ping] = []
    for first in range(0, strip.n_lines, 256):  # lines at once: bounds memory
        n_lines = min(256, strip.n_lines - first)
        poses = aperture.poses(strip, start_s, first, n_lines)
        intensity = aperture.intensity(strip, first, n_lines, view)
        pings = aperture.sea.record(intensity, poses, first)
        for sample, ping in zip(samples[first : first + n_lines], pings, strict=True):
            events += [
                sample,
                msgspec.structs.replace(ping, altitude_m=sample.altitude_m, squint_rad=squint_rad),
            ]
    return events


def judged(scene: Scene, events: Sequence[NavSample | Ping]) -> Judged:
    """Give the chain what was received, and sort its contacts on judged ground."""
    pipeline = Pipeline(reporting_everything(Config(sonar=SonarConfig(kind="sas"))))
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    frame = local_frame(scene.origin)
    kept: list[tuple[Contact, int]] = []
    for contact in pipeline.contacts:
        east, north, _ = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)
        if math.hypot(east, north) >= _RADIUS_M or abs(east) <= _NADIR_M:
            continue
        gaps_m = [math.dist((east, north), (one.east_m or 0.0, one.north_m or 0.0)) for one in scene.objects]
        nearest = int(np.argmin(gaps_m))
        kept.append((contact, nearest if gaps_m[nearest] <= _GATE_M else -1))
    return Judged(
        tuple(contact.views for contact, _ in kept),
        tuple(contact.mine_kind for contact, _ in kept),
        tuple(on for _, on in kept),
    )


# --- what the views of one contact say together ---


def as_shipped(views: Sequence[Detection]) -> float:
    """Weigh a contact as the chain does, in log-odds of a mine."""
    return odds_of(fuse(views, _prior()).p_mine)


def most_mine_like(views: Sequence[Detection]) -> float:
    """Weigh a contact by its most mine-like view alone."""
    return max(odds_of(view.p_mine) for view in views)


def mean_of_views(views: Sequence[Detection]) -> float:
    """Weigh a contact by the mean evidence of its views."""
    return float(np.mean([odds_of(view.p_mine) for view in views]))


def independent(views: Sequence[Detection]) -> float:
    """Weigh a contact by the sum of evidence, as if its views had nothing in common."""
    return _prior() + sum(odds_of(view.p_mine) - _prior() for view in views)


RULES: Final[dict[str, Rule]] = {
    "as shipped": as_shipped,
    "most mine-like view": most_mine_like,
    "mean": mean_of_views,
    "sum, as if independent": independent,
}


def _prior() -> float:
    return shipped_odds("cascade").prior


# --- rates ---


class Scores(NamedTuple):
    """Hold per mission the log-odds of targets, -inf for none, whether each is named right, and of false alarms."""

    targets: list[Floats]
    named: list[NDArray[np.bool_]]
    false_alarms: list[Floats]


def scores_of(flights: Sequence[Flown], system: str, rule: Rule) -> Scores:
    """Give every target its likeliest contact; all contacts on nothing or on rocks are false alarms."""
    scores = Scores([], [], [])
    for flown in flights:
        seen, n_targets = flown.systems[system], sum(kind != "rock" for kind in flown.kinds)
        best, named = np.full(n_targets, -math.inf), np.zeros(n_targets, dtype=np.bool_)
        wrong: dict[int, float] = {}
        for number, (views, kind, on) in enumerate(zip(*seen, strict=True)):
            odds = rule(views)
            if 0 <= on < n_targets:
                if odds > best[on]:
                    best[on], named[on] = odds, kind == flown.kinds[on]
            else:
                place = -1 - number if on < 0 else on  # several on a rock are one
                wrong[place] = max(odds, wrong.get(place, -math.inf))
        scores.targets.append(best)
        scores.named.append(named)
        scores.false_alarms.append(np.array([*wrong.values()]))
    return scores


def threshold(scores: Scores, limit_per_km2: float) -> float:
    """Find the lowest log-odds with no more false alarms above it than allowed."""
    return threshold_at(np.concatenate(scores.false_alarms), limit_per_km2 * area_km2() * len(scores.targets))


def area_km2() -> float:
    """Compute the ground judged per mission: the disc without the strip below the first pass."""
    half, ratio = _NADIR_M * math.sqrt(_RADIUS_M**2 - _NADIR_M**2), math.asin(_NADIR_M / _RADIUS_M)
    return 1e-6 * (math.pi * _RADIUS_M**2 - 2.0 * (half + _RADIUS_M**2 * ratio))


def rows(flights: Sequence[Flown], rule: Rule, limit_per_km2: float) -> Iterator[list[str]]:
    """Yield per system: Pd, the share found and named right, the gain in Pd over one pass, and the views per target."""
    base = _found(flights, SYSTEMS[0], rule, limit_per_km2)
    for system in SYSTEMS:
        found = _found(flights, system, rule, limit_per_km2)
        n_found, n_named, n = (int(found[:, k].sum()) for k in range(3))
        views = [
            len({(view.squint_rad, view.time_s) for view in one})
            for flown in flights
            for one, on in zip(flown.systems[system].views, flown.systems[system].on, strict=True)
            if on >= 0 and flown.kinds[on] != "rock"
        ]
        yield [
            system,
            share_cell(proportion(n_found, n)),
            share_cell(proportion(n_named, n_found)) if n_found else "-",
            "" if system == SYSTEMS[0] else _gain(found, base),
            f"{np.mean(views):.1f}",
        ]


def _found(flights: Sequence[Flown], system: str, rule: Rule, limit_per_km2: float) -> NDArray[np.int64]:
    """Count per mission targets above the threshold, those of them named right, and all, (n_missions, 3)."""
    scores = scores_of(flights, system, rule)
    above = threshold(scores, limit_per_km2)
    return np.array(
        [
            (np.count_nonzero(best > above), np.count_nonzero((best > above) & named), len(best))
            for best, named in zip(scores.targets, scores.named, strict=True)
        ]
    )


def _gain(found: NDArray[np.int64], base: NDArray[np.int64]) -> str:
    """Write the difference of two Pd over the same missions, with its interval by drawing missions anew."""
    more, of = found[:, 0] - base[:, 0], found[:, 2]
    return str(resampled(lambda some: float(more[some].sum() / of[some].sum()), len(found), seed=_STREAM))


def dependence(flights: Sequence[Flown], system: str) -> float:
    """Correlate the evidence of two views of one target, over all pairs of views of a system; NaN for none."""
    pairs = [
        (odds_of(one.p_mine), odds_of(other.p_mine))
        for flown in flights
        for views, on in zip(flown.systems[system].views, flown.systems[system].on, strict=True)
        if on >= 0 and flown.kinds[on] != "rock"
        for one in views
        for other in views
        if one is not other
    ]
    return float(np.corrcoef(np.array(pairs).T)[0, 1]) if pairs else math.nan


def report(flights: Sequence[Flown], *, in_markdown: bool) -> str:
    """Write the tables."""
    table = markdown if in_markdown else columns
    n_targets = sum(kind != "rock" for flown in flights for kind in flown.kinds)
    n_rocks, judged_km2 = len(flights) * _N_ROCKS, len(flights) * area_km2()
    parts = [f"{len(flights)} missions, {n_targets} targets, {n_rocks} rocks, {judged_km2:.3f} km² judged"]
    header = [
        "system",
        "Pd",
        "named right, of those found",
        "gain in Pd over one pass",
        "views per target",
    ]
    for limit in LIMITS_PER_KM2:
        parts.append(f"At {limit:g} false alarms per km²:\n\n" + table(header, list(rows(flights, as_shipped, limit))))
    ruled = [[name, *(_pd_cell(flights, system, rule) for system in SYSTEMS[1:])] for name, rule in RULES.items()]
    parts.append(
        f"Pd at {LIMITS_PER_KM2[-1]:g} false alarms per km², by how views are fused:\n\n"
        + table(["rule", *SYSTEMS[1:]], ruled)
    )
    shares = [[system, f"{dependence(flights, system):.2f}"] for system in SYSTEMS[1:]]
    parts.append("Correlation of evidence between two views of a target:\n\n" + table(["system", "rho"], shares))
    return "\n\n".join(parts)


def _pd_cell(flights: Sequence[Flown], system: str, rule: Rule) -> str:
    found = _found(flights, system, rule, LIMITS_PER_KM2[-1])
    return share_cell(proportion(int(found[:, 0].sum()), int(found[:, 2].sum())))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench apertures`."""
    parser.add_argument("--missions", type=count, default=8, help="missions flown (default 8)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of the first mission (default {FIRST_SEED})"
    )
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code."""
    flights = []
    progress = counted(arguments.missions)
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.missions):
        flights.append(fly(seed))
        progress(len(flights))
    print(report(flights, in_markdown=arguments.markdown))
    return 0
