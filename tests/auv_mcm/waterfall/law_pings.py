"""Pings of plain speckle over a range profile, stored by recorders whose law is known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Ping

N_SAMPLES, BOTTOM = 1200, 200
RANGE_SAMPLES = np.arange(N_SAMPLES)
PROFILES = {
    "level": np.ones(N_SAMPLES),
    "spreading": (BOTTOM / np.maximum(RANGE_SAMPLES, BOTTOM)) ** 3,
    "rising": np.exp(RANGE_SAMPLES / 700.0),
}


def intensity_pings(looks: int, profile: str, seed: int = 0, n_pings: int = 128) -> NDArray[np.float64]:
    """Gamma speckle (n_pings, N_SAMPLES) over a range profile, 30 dB darker before the bottom."""
    random = np.random.default_rng(seed)
    mean = PROFILES[profile] * np.where(RANGE_SAMPLES < BOTTOM, 1e-3, 1.0)
    return mean * random.gamma(looks, 1.0 / looks, (n_pings, N_SAMPLES))


def decibels(intensity: NDArray[np.float64]) -> NDArray[np.float64]:
    return 10.0 * np.log10(intensity)


def log_counts(intensity: NDArray[np.float64], db_per_count: float, mean_count: float = 150.0) -> NDArray[np.uint8]:
    """8-bit logarithms, intensity 1 at mean_count."""
    return np.clip(np.rint(decibels(intensity) / db_per_count + mean_count), 0, 255).astype(np.uint8)


def pings(samples: NDArray[Any], first: int = 0, rate_hz: float = 10.0, **fields: Any) -> list[Ping]:
    """One-sided pings of (n_pings, n_samples) samples, numbered and timed from `first`."""
    return [
        Ping(
            number=first + k,
            time_s=1e9 + (first + k) / rate_hz,
            port=EchoTrace(samples=row, first_range_m=0.01, spacing_m=0.02),
            starboard=None,
            place=f"ping {first + k}",
            **fields,
        )
        for k, row in enumerate(samples)
    ]
