"""Side-scan logs of a level floor in white speckle, for tests that put targets into them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, NavSample, Ping
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.logs.xtf_writer import write_xtf
from tests.make.records import nav_of

N_SAMPLES = 480
SPACING_M = 0.05
ALTITUDE_M = 4.0
STEP_M = 0.1
N_PINGS = 160
HEADING_RAD = math.radians(30.0)
FLOOR_COUNTS, NOISE_COUNTS = 3000.0, 200.0
START_S = 1_700_000_000.0

CONFIG = Config(sonar=SonarConfig(transfer="amplitude", port_order="far_to_near", beam_width_deg=0.3))

Shading = Callable[[NDArray[np.float64], int], NDArray[np.float64]]


def level(ground_m: NDArray[np.float64], ping: int) -> NDArray[np.float64]:
    """A floor that echoes alike everywhere."""
    return np.ones_like(ground_m)


def mission(
    shading: Shading = level,
    *,
    full_scale: float = 32767.0,
    to_counts: Callable[[NDArray[np.float64]], NDArray[np.float64]] = np.sqrt,
    dtype: str = "uint16",
    n_pings: int = N_PINGS,
    turn_rate_rad_s: float = 0.0,
    seed: int = 1,
) -> Iterator[NavSample | Ping]:
    """Straight north-north-east, a sample of navigation before each ping. shading: of the floor's intensity over ground
    range, by ping."""
    random = np.random.Generator(np.random.PCG64(seed))
    slant_m = (np.arange(N_SAMPLES) + 0.5) * SPACING_M
    ground_m = np.sqrt(np.maximum(slant_m**2 - ALTITUDE_M**2, 0.0))
    way_m = 0.0
    for number in range(n_pings):
        heading = HEADING_RAD + turn_rate_rad_s * 0.1 * number
        traces = []
        for _ in range(2):
            mean = np.where(slant_m < ALTITUDE_M, 0.0, FLOOR_COUNTS**2 * shading(ground_m, number)) + NOISE_COUNTS**2
            counts = to_counts(mean * random.exponential(size=N_SAMPLES))
            counts[: round(0.3 / SPACING_M)] = full_scale
            samples = np.rint(np.clip(counts, 0.0, full_scale)).astype(dtype)
            traces.append(EchoTrace(samples=samples, first_range_m=0.5 * SPACING_M, spacing_m=SPACING_M))
        time_s = START_S + 0.1 * number
        yield nav_of(
            time_s,
            latitude_deg=43.0 + way_m * math.cos(HEADING_RAD) / 111_111.0,
            longitude_deg=5.5 + way_m * math.sin(HEADING_RAD) / (111_320.0 * math.cos(math.radians(43.0))),
            heading_rad=heading,
            altitude_m=ALTITUDE_M,
            speed_mps=STEP_M / 0.1,
        )
        yield Ping(number=number, time_s=time_s, port=traces[0], starboard=traces[1], altitude_m=ALTITUDE_M)
        way_m += STEP_M


def written(
    path: Path,
    events: Iterator[NavSample | Ping] | None = None,
    *,
    sample_type: SampleType = "uint16",
    far_to_near: bool = True,
) -> Path:
    write_xtf(path, mission() if events is None else events, sample_type=sample_type, port_far_to_near=far_to_near)
    return path
