"""Check probabilities: events predicted with probability p should come true in p of the cases."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from sim_replay.scoring.intervals import Proportion, proportion

RELIABILITY_EDGES: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)
"""Lower edges of the table: most contacts lie near 0, where bins of a tenth carry no information."""


def calibration_error(probability: ArrayLike, came_true: ArrayLike, n_bins: int = 10) -> float:
    """Compute the expected calibration error: |mean probability - share that came true| per bin of [0, 1].

    Bins are weighted by their counts.

    After M. Naeini, G. Cooper and M. Hauskrecht, AAAI 2015.

    Parameters
    ----------
    probability
        (n,) float64.
    came_true
        (n,) bool.

    Raises
    ------
    ValueError
        If there are none, not as many of one as of the other, or a probability is not in [0, 1].
    """
    p, true = np.asarray(probability, dtype=np.float64), np.asarray(came_true, dtype=np.bool_)
    if p.ndim != 1 or p.shape != true.shape or not p.size:
        raise ValueError(
            f"there must be as many probabilities as outcomes, one or more of each, got shapes {p.shape} and "
            f"{true.shape}"
        )
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise ValueError(f"probabilities must lie in [0, 1], got {p[~((p >= 0.0) & (p <= 1.0))][0]}")
    bins = np.minimum((p * n_bins).astype(np.intp), n_bins - 1)
    excess = np.bincount(bins, weights=p - true, minlength=n_bins)
    return float(np.abs(excess).sum() / p.size)


class ReliabilityBin(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the contacts with p_mine in [low, high): their mean p_mine, and the share of them that lay on mines."""

    low: float
    high: float
    mean_p_mine: float
    on_mines: Proportion


class Calibration(msgspec.Struct, frozen=True, kw_only=True):
    """Measure how far p_mine holds over contacts. error: `calibration_error` in ten bins, None without contacts."""

    error: float | None
    bins: tuple[ReliabilityBin, ...]


def calibration(p_mine: ArrayLike, on_mine: ArrayLike) -> Calibration:
    """Compare predictions with what came true.

    Parameters
    ----------
    p_mine
        (n,) float64.
    on_mine
        (n,) bool.

    Raises
    ------
    ValueError
        As calibration_error does.
    """
    p, true = np.asarray(p_mine, dtype=np.float64), np.asarray(on_mine, dtype=np.bool_)
    if not p.size:
        return Calibration(error=None, bins=())
    number = np.searchsorted(RELIABILITY_EDGES, p, side="right") - 1
    bins = []
    for place, (low, high) in enumerate(pairwise((*RELIABILITY_EDGES, 1.0))):
        inside = number == place
        if inside.any():
            on_mines = proportion(int(np.count_nonzero(true[inside])), int(np.count_nonzero(inside)))
            bins.append(ReliabilityBin(low=low, high=high, mean_p_mine=float(p[inside].mean()), on_mines=on_mines))
    return Calibration(error=calibration_error(p, true), bins=tuple(bins))
