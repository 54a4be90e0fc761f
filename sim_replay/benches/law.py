"""Measure what recorders are taken for whose law, looks, correlation and texture of speckle are drawn at random.

auv-mcm bench law                  draws floors, stores each in seven ways, prints how far each picture is stretched
auv-mcm bench law --fit            fits the logistic regression of `auv_mcm/waterfall/sample_law.py` to the draws
auv-mcm bench law --log LOG ...    what recorded logs are taken for

Each drawn floor is simulated once, in linear units: looks, correlation over samples and pings, gamma (K-distributed
intensity) or log-normal texture, and noise that fills shadows. Every recorder stores those same echoes, and some smooth
and decimate what they stored. The coefficients were fitted on seeds below FIRST_SEED.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import BLOCK_PINGS
from auv_mcm.records import EchoTrace, Ping
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.waterfall.floor_speckle import FloorSpeckle, floor_speckle
from auv_mcm.waterfall.law_watch import law_of_pings, measure_block
from auv_mcm.waterfall.sample_law import SampleLaw, law_measures, sample_law
from sim_replay.arguments import count
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.logs.recorded import open_mission
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import SampleRecorder
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns, markdown

FIRST_SEED: Final = 7101  # the coefficients were fitted on floors of lower seeds
FLOORS: Final = ("flat", "ripple", "rough", "seagrass", "mixed")
N_PINGS: Final = 256  # per floor: what the first verdict is made from
_PENALTY: Final = 0.002  # of the regression, which separates all draws: it bounds the coefficients. Chosen
_SLOWLY: Final = (1.0, 20.0)  # samples and pings that texture reaches over

Texture = Literal["none", "gamma", "log-normal"]


class Store(NamedTuple):
    """State how a recorder stores intensity: as counts, factor * intensity ** exponent, or as a logarithm.

    db_per_count is None unless it stores logarithms.
    """

    name: str
    bits: int
    factor: float
    exponent: float = math.nan
    db_per_count: float | None = None

    @property
    def is_linear(self) -> bool:
        """Check whether a power of the echo is stored."""
        return self.db_per_count is None


STORES: Final = (
    Store("amplitude, 16 bits", 16, 3000.0, 0.5),
    Store("amplitude, 8 bits", 8, 35.0, 0.5),
    Store("intensity", 16, 1000.0, 1.0),
    Store("amplitude^0.7", 16, 1000.0, 0.35),
    Store("log of 0.2 dB", 8, 150.0, db_per_count=0.2),
    Store("log of 0.35 dB", 8, 140.0, db_per_count=0.35),
    Store("log of 0.5 dB", 8, 120.0, db_per_count=0.5),
)
"""Recorders of one mission; factor: of logarithms the count of intensity 1."""


class DrawnFloor(NamedTuple):
    """Describe the speckle of a drawn floor.

    correlation: samples that one resolution cell covers. along_track_m: distance over which speckle stays correlated
    from ping to ping. texture_cv: standard deviation over mean of the texture; texture_reach: (pings, samples).
    noise: mean intensity that fills shadows. smoothed: samples that each recorder averages and decimates by, in the
    order of STORES.
    """

    scene: str
    looks: int
    correlation: float
    along_track_m: float
    texture: Texture
    texture_cv: float
    texture_reach: tuple[float, float]
    noise: float
    smoothed: tuple[int, ...]


class JudgedRecorder(NamedTuple):
    """State what one recorder of one drawn floor was taken for.

    stretched: decibels read for each decibel of echo, NaN where linear samples were taken for logarithms or the other
    way round.
    """

    floor: DrawnFloor
    store: Store
    speckle: FloorSpeckle
    law: SampleLaw
    stretched: float


def draw_floor(seed: int) -> DrawnFloor:
    """Draw the floor of a seed."""
    random = np.random.default_rng([seed, 0x4C4157])
    textures: tuple[Texture, ...] = ("none", "gamma", "log-normal")
    return DrawnFloor(
        scene=FLOORS[seed % len(FLOORS)],
        looks=int(random.choice([1, 1, 2, 4, 8])),
        correlation=float(random.uniform(0.7, 5.0)),
        along_track_m=float(random.choice([0.0, 0.0, 0.1, 0.3])),
        texture=textures[int(random.integers(3))],
        texture_cv=float(random.uniform(0.2, 1.0)),
        texture_reach=(float(random.uniform(*_SLOWLY)), float(random.uniform(*_SLOWLY))),
        noise=10.0 ** (float(random.uniform(-30.0, -6.0)) / 10.0),
        smoothed=tuple(random.choice([1, 1, 2, 3], len(STORES)).tolist()),
    )


def floor_intensity(floor: DrawnFloor, seed: int, n_pings: int = N_PINGS) -> NDArray[np.float64]:
    """Simulate intensity (n_pings, 2, n_samples) of the first pings; 1 where the plain floor is in mid-range."""
    scene = read_scene(floor.scene)
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0, full_scale=65535)
    sonar = msgspec.structs.replace(
        scene.sonar,
        looks=floor.looks,
        range_resolution_m=floor.correlation * scene.sonar.range_m / scene.sonar.n_samples,
        speckle_along_track_m=floor.along_track_m,
        recorder=recorder,
    )
    scene = msgspec.structs.replace(scene, seed=seed, sonar=sonar)
    heard = (event for event in Mission(scene).events() if isinstance(event, Ping))
    amplitude = [
        [trace.samples for trace in (ping.port, ping.starboard) if trace is not None] for ping in islice(heard, n_pings)
    ]
    intensity = np.square(np.array(amplitude, dtype=np.float64))
    random = np.random.default_rng([seed, 0x544558])
    for side in range(intensity.shape[1]):
        intensity[:, side] *= _texture(floor, intensity[:, side].shape, random)
    return np.asarray(intensity + floor.noise * random.gamma(floor.looks, 1.0 / floor.looks, intensity.shape))


def _texture(floor: DrawnFloor, shape: tuple[int, ...], random: np.random.Generator) -> NDArray[np.float64] | float:
    """Draw a texture of mean 1: gamma makes intensity K-distributed."""
    if floor.texture == "none":
        return 1.0
    from scipy.ndimage import gaussian_filter
    from scipy.special import gammaincinv, ndtr

    field = gaussian_filter(random.standard_normal(shape), floor.texture_reach, mode="wrap")
    field /= field.std()
    if floor.texture == "log-normal":
        sigma = math.sqrt(math.log1p(floor.texture_cv**2))
        return np.asarray(np.exp(sigma * field - 0.5 * sigma**2))
    shape_parameter = floor.texture_cv**-2
    return np.asarray(gammaincinv(shape_parameter, ndtr(field)) / shape_parameter)


def stored(intensity: NDArray[np.float64], store: Store, smoothed: int = 1) -> NDArray[Any]:
    """Store intensity (..., n_samples) as counts, averaged and decimated by `smoothed` after it was stored."""
    if store.db_per_count is None:
        counts = store.factor * intensity**store.exponent
    else:
        counts = store.factor + 10.0 * np.log10(np.maximum(intensity, 1e-30)) / store.db_per_count
    counts = np.rint(np.clip(counts, 0.0, float(2**store.bits - 1)))
    n_samples = counts.shape[-1] // smoothed * smoothed
    counts = counts[..., :n_samples].reshape(*counts.shape[:-1], -1, smoothed).mean(axis=-1)
    dtype = np.uint8 if store.bits == 8 else np.uint16
    return np.asarray(np.rint(counts), dtype=dtype)


def pings_of(samples: NDArray[Any], rate_hz: float = 14.0) -> list[Ping]:
    """Make pings of (n_pings, 2, n_samples) samples."""
    return [
        Ping(
            number=number,
            time_s=1.7e9 + number / rate_hz,
            port=EchoTrace(samples=port, first_range_m=0.025, spacing_m=0.05),
            starboard=EchoTrace(samples=starboard, first_range_m=0.025, spacing_m=0.05),
        )
        for number, (port, starboard) in enumerate(samples)
    ]


def judge_recorder(floor: DrawnFloor, store: Store, samples: NDArray[Any]) -> JudgedRecorder:
    """Read the law from samples (n_pings, 2, n_samples) as the chain does."""
    pings = pings_of(samples)
    blocks = [measure_block(pings[first : first + BLOCK_PINGS]) for first in range(0, len(pings), BLOCK_PINGS)]
    speckle = floor_speckle(blocks)
    law = sample_law(speckle)
    stretched = math.nan
    if store.db_per_count is None and law.transfer.kind != "log":
        stretched = law.transfer.intensity_power * store.exponent
    elif store.db_per_count is not None and law.transfer.kind == "log":
        stretched = law.transfer.db_per_count / store.db_per_count
    return JudgedRecorder(floor, store, speckle, law, stretched)


def judged_floor(seed: int) -> list[JudgedRecorder]:
    """Judge all recorders of the floor of a seed."""
    floor = draw_floor(seed)
    intensity = floor_intensity(floor, seed)
    return [
        judge_recorder(floor, store, stored(intensity, store, smoothed))
        for store, smoothed in zip(STORES, floor.smoothed, strict=True)
    ]


def fit_law(judged: Sequence[JudgedRecorder]) -> NDArray[np.float64]:
    """Fit the coefficients of linear against logarithmic, (4,): offset, skewness, spread, growth."""
    x = np.array([(1.0, *law_measures(one.speckle)) for one in judged])
    is_linear = np.array([float(one.store.is_linear) for one in judged])
    coefficients = np.zeros(x.shape[1])
    for _ in range(100):  # Newton's method with a ridge; settles in some twenty
        probability = 1.0 / (1.0 + np.exp(-x @ coefficients))
        weight = probability * (1.0 - probability) + 1e-9
        information = x.T @ (x * weight[:, None]) + _PENALTY * np.eye(x.shape[1])
        gradient = x.T @ (is_linear - probability) - _PENALTY * coefficients
        coefficients = coefficients + np.linalg.solve(information, gradient)
    return coefficients


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench law`."""
    parser.add_argument("--floors", type=count, default=60, help="floors that are drawn (default 60)")
    parser.add_argument("--first-seed", type=count, default=FIRST_SEED, help=f"of floors (default {FIRST_SEED})")
    parser.add_argument("--fit", action="store_true", help="print coefficients fitted to these floors as well")
    parser.add_argument("--workers", type=count, default=2, help="processes (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument(
        "--log", type=Path, action="append", metavar="LOG", help="recorded log to judge instead, repeatable"
    )


def run(arguments: argparse.Namespace) -> int:
    """Draw and judge, or read logs; returns the exit code. Raises BadInputError for a log that cannot be read."""
    if arguments.log is not None:
        for path in arguments.log:
            pings = [event for event in open_mission([path], Config()).events() if isinstance(event, Ping)]
            law = law_of_pings(pings, SonarConfig())
            print(f"{path}: {law.transfer}, log-odds for linear {law.linear_nats:+.1f} from {law.n_regions} regions")
        return 0
    seeds = list(range(arguments.first_seed, arguments.first_seed + arguments.floors))
    judged: list[JudgedRecorder] = []
    for done, some in enumerate(run_tasks(judged_floor, seeds, Farm(arguments.workers)), 1):
        judged += some
        print(f"\r{done} of {len(seeds)} floors", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print_table(judged, markdown if arguments.markdown else columns)
    if arguments.fit:
        print("coefficients: " + ", ".join(f"{value:.2f}" for value in fit_law(judged)))
    return 0


def print_table(
    judged: Sequence[JudgedRecorder], laid_out: Callable[[Sequence[str], Sequence[Sequence[str]]], str]
) -> None:
    """Print how recorders were read. laid_out: writes the table."""
    header = ("", "recorders", "taken for the other kind", "left open", "stretched by, 5 %", "median", "95 %")
    groups: list[tuple[str, list[JudgedRecorder]]] = [("all", list(judged))]
    for key in (
        lambda one: one.store.name,
        lambda one: f"{one.floor.looks} looks",
        lambda one: f"texture {one.floor.texture}",
        lambda one: one.floor.scene,
    ):
        names = dict.fromkeys(key(one) for one in judged)
        groups += [(name, [one for one in judged if key(one) == name]) for name in names]
    rows = []
    for name, some in groups:
        wrong = sum(one.law.is_sure and math.isnan(one.stretched) for one in some)
        left_open = sum(not one.law.is_sure for one in some)
        stretched = [one.stretched for one in some if not math.isnan(one.stretched)]
        cells = [f"{value:.2f}" for value in np.quantile(stretched, (0.05, 0.5, 0.95))] if stretched else ["-"] * 3
        rows.append((name, str(len(some)), str(wrong), str(left_open), *cells))
    print(laid_out(header, rows))
