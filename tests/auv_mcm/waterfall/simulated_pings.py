"""A level sea floor under a straight track, as amplitudes of both sides, and the waterfall stage run over it."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.intake import PingBlock
from auv_mcm.records import VALID, EchoTrace, Ping, PoseTrack, Side, Tile, Transfer
from auv_mcm.settings.config import Config, WaterfallConfig
from auv_mcm.waterfall.waterfall import Waterfall
from tests.make.records import pose_of

ALTITUDE_M, RANGE_M, SPACING_M, STEP_M, PING_S = 6.0, 45.0, 0.03, 0.12, 0.1
FIRST_PING_M = 0.3
N_SAMPLES = round(RANGE_M / SPACING_M)
SLANT_M = (np.arange(N_SAMPLES) + 0.5) * SPACING_M
GROUND_M = np.sqrt(np.maximum(SLANT_M**2 - ALTITUDE_M**2, 0.0))
CONFIG = Config(waterfall=WaterfallConfig(row_spacing_m=STEP_M, column_spacing_m=0.06, tile_rows=256))


def mean_intensity() -> NDArray[np.float64]:
    """(n_samples,): Lambert's sea floor spreading with the cube of range over 1 m of ring-down and a dark water
    column."""
    sine = ALTITUDE_M / SLANT_M
    footprint = 1.0 / np.maximum(np.sqrt(np.maximum(1.0 - sine**2, 0.0)), 0.05)
    floor = np.where(sine < 1.0, sine**2 * footprint * (ALTITUDE_M / SLANT_M) ** 3, 0.0)
    return np.where(SLANT_M < 0.8, 100.0, floor + 1e-5)


def amplitudes(
    n_pings: int, *, looks: int = 1, seed: int = 0, factor: NDArray[np.float64] | float = 1.0
) -> NDArray[np.float64]:
    """Amplitude (2, n_pings, n_samples) of both sides; `factor` multiplies the mean intensity and broadcasts to that
    shape."""
    random = np.random.default_rng(seed)
    shape = (2, n_pings, N_SAMPLES)
    return np.sqrt(mean_intensity() * factor * random.gamma(looks, 1.0 / looks, shape))


def straight_poses(n_pings: int, first: int = 0) -> PoseTrack:
    index: NDArray[np.float64] = np.arange(first, first + n_pings, dtype=np.float64)
    place = {"latitude_deg": 43.0 + 1e-6 * index, "longitude_deg": 5.0, "depth_m": 10.0, "altitude_m": math.nan}
    return pose_of(n_pings, time_s=1.7e9 + PING_S * index, speed_mps=STEP_M / PING_S, **place)


def block_of(
    port: NDArray[Any] | None,
    starboard: NDArray[Any] | None,
    first: int = 0,
    along_m: NDArray[np.float64] | None = None,
) -> PingBlock:
    """Pings first, first + 1, ... of the given samples (n_pings, n_samples) per side."""

    def trace(samples: NDArray[Any] | None, ping: int) -> EchoTrace | None:
        return (
            None
            if samples is None
            else EchoTrace(samples=samples[ping], first_range_m=0.5 * SPACING_M, spacing_m=SPACING_M)
        )

    n_pings = next(samples.shape[0] for samples in (port, starboard) if samples is not None)
    poses = straight_poses(n_pings, first)
    pings = [
        Ping(number=first + i, time_s=float(poses.time_s[i]), port=trace(port, i), starboard=trace(starboard, i))
        for i in range(n_pings)
    ]
    distance = FIRST_PING_M + STEP_M * (first + np.arange(n_pings)) if along_m is None else along_m
    return PingBlock(pings, poses, distance, np.zeros(n_pings), np.zeros(n_pings))


class Run(NamedTuple):
    tiles: list[Tile]
    counters: Counter[str]

    def image(self, side: Side = "port") -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """All core rows of one side: intensity and where it is valid."""
        tiles = [tile for tile in self.tiles if tile.side == side]
        intensity = np.concatenate([tile.intensity[tile.core_start : tile.core_stop] for tile in tiles]).astype(
            np.float64
        )
        return intensity, (np.concatenate([tile.mask[tile.core_start : tile.core_stop] for tile in tiles]) & VALID) != 0

    @property
    def first_row(self) -> int:
        return self.tiles[0].first_row + self.tiles[0].core_start


def run(
    samples: NDArray[Any],
    *,
    config: Config = CONFIG,
    block: int = 32,
    transfer: Transfer | None = None,
    overlap_m: float = 6.0,
) -> Run:
    """The stage over samples (2, n_pings, n_samples) in blocks."""
    counters: Counter[str] = Counter()
    stage = Waterfall(config, transfer or Transfer("amplitude"), overlap_m, counters)
    tiles: list[Tile] = []
    for start in range(0, samples.shape[1], block):
        pings = slice(start, start + block)
        tiles += stage.add(block_of(samples[0, pings], samples[1, pings], start))
    return Run(tiles + stage.close_segment(), counters)


def row_of_ping(ping: int, first_row: int) -> int:
    """Row of the image that ping `ping` lies in."""
    return math.floor((FIRST_PING_M + STEP_M * ping) / STEP_M) - first_row


def decibels(ratio: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.asarray(10.0 * np.log10(ratio))
