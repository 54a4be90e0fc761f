"""Measure the cost and errors of confirmation on drawn regions: error beside time for every setting.

Shadows at -9 dB in single-look speckle, on 3 cm pixels of a synthetic aperture: objects of 0.5 to 2 m, shadows of 0.9
to 2.7 m. The rows of the segmentation go from the source paper's variant to ours one cause at a time, over the grain of
the speckle: where grains are single pixels the paper's variant works, and what breaks it is to take the pixels of one
grain for independent.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.confirm.mrf import edge_weights, segment
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.speckle import Correlation
from auv_mcm.kernels.trws import energy_of, icm, trws, trws_numpy
from sim_replay.benches.every_stage.drawn_regions import Drawing, aperture_drawings, draw_region
from sim_replay.benches.every_stage.paper_mrf import segment_as_paper
from sim_replay.scoring.overlap import overlap

Labels = NDArray[np.uint8]

_N_REGIONS: Final = 16
_SPREADS_PIXELS: Final = (0.0, 0.8, 1.1, 1.4)
_SWEEPS: Final = (1, 2, 3, 5, 10, 20)
_TRUE_LEVELS: Final = np.array([1.0, 10.0**-0.9, 8.0])
_INDEPENDENT: Final = edge_weights(1.0, (1, 1), Correlation(1.0, 1.0))


def add_arguments(_: argparse.ArgumentParser) -> None:
    """Add no options."""


def run(_: argparse.Namespace) -> int:
    """Print every table of this bench; returns the exit code."""
    print("\n".join(mrf_rows()))
    return 0


def mrf_rows() -> list[str]:
    """Measure the segmentation: against the source paper over the grain of speckle, and over the sweeps of TRW-S."""
    rows = [
        (
            f"shadow at -9 dB, medians over {_N_REGIONS} regions of 144 x 160 pixels; pieces: parts of shadow found "
            "and holes in the true one"
        ),
        f"{'grain':>6}  {'':<48}{'shadow IoU':>11}{'worst 1/8':>10}{'pieces':>8}{'highlight IoU':>14}{'ms':>8}",
    ]
    for spread in _SPREADS_PIXELS:
        grain = max(1.0, math.sqrt(2.0 * math.pi) * spread)
        for name, method in _METHODS.items():
            score = _score(method, aperture_drawings(_N_REGIONS, spread, seed=11))
            figures = (
                f"{score.shadow:>11.3f}{score.worst:>10.3f}{score.pieces:>8.0f}{score.highlight:>14.3f}{score.ms:>8.1f}"
            )
            rows.append(f"{grain:>4.1f}px  {name:<48}{figures}")
    rows += [
        "",
        (
            "128 x 128 cells, medians: "
            f"{'sweeps':>8}{'ms':>8}{'numpy / C':>11}{'gap %':>8}{'above best %':>14}{'shadow IoU':>12}"
        ),
    ]
    rows += [
        f"{'':<26}{knob.sweeps:>8}{knob.ms:>8.2f}{knob.ratio:>11.0f}{knob.gap_percent:>8.3f}{knob.excess_percent:>14.4f}{knob.shadow:>12.3f}"
        for knob in _sweeps_knob()
    ]
    return rows


class _Score(NamedTuple):
    shadow: float
    worst: float
    pieces: float
    highlight: float
    ms: float


class _Knob(NamedTuple):
    sweeps: int
    ms: float
    ratio: float
    gap_percent: float
    excess_percent: float
    shadow: float


def _score(method: Callable[[Region], Labels], drawings: Iterator[Drawing]) -> _Score:
    shadows, highlights, pieces, times = [], [], [], []
    for drawing in drawings:
        region, truth = draw_region(drawing)
        began = time.perf_counter()
        labels = method(region)
        times.append(1e3 * (time.perf_counter() - began))
        shadows.append(overlap(labels == SHADOW, truth == SHADOW))
        highlights.append(overlap(labels == HIGHLIGHT, truth == HIGHLIGHT))
        inside = ndimage.binary_erosion(truth == SHADOW, iterations=2)
        pieces.append(ndimage.label(labels == SHADOW)[1] + ndimage.label(inside & (labels != SHADOW))[1])
    return _Score(
        statistics.median(shadows),
        float(np.quantile(shadows, 0.125)),
        statistics.median(pieces),
        statistics.median(highlights),
        statistics.median(times),
    )


def _pixel_costs(region: Region) -> NDArray[np.float64]:
    """Return exponential laws with the true means, every pixel for itself."""
    return np.asarray(np.log(_TRUE_LEVELS) + region.intensity[:, :, None] / _TRUE_LEVELS)


def _pixels_by_icm(region: Region) -> Labels:
    costs = _pixel_costs(region)
    return icm(costs, _INDEPENDENT, costs.argmin(axis=2).astype(np.uint8), 8)[0]


def _pixels_by_trws(region: Region) -> Labels:
    return trws(_pixel_costs(region), _INDEPENDENT, 8).labels


_METHODS: Final[dict[str, Callable[[Region], Labels]]] = {
    "paper: Gauss and Rayleigh laws, ICM": lambda region: segment_as_paper(region).labels,
    "exponential laws, true means, ICM": _pixels_by_icm,
    "exponential laws, true means, TRW-S": _pixels_by_trws,
    "ours: blocks of a grain, EM, TRW-S, soft edges": lambda region: segment(region).labels,
}


def _sweeps_knob() -> Iterator[_Knob]:
    drawn = [draw_region(Drawing(spread_rows=0.0, spread_columns=0.0, seed=seed)) for seed in range(5)]
    costs = [_pixel_costs(region) for region, _ in drawn]
    best = [trws(cost, _INDEPENDENT, 100).energy for cost in costs]
    for sweeps in _SWEEPS:
        times, gaps, excesses, shadows = [], [], [], []
        for cost, minimum, (_, truth) in zip(costs, best, drawn, strict=True):
            found = trws(cost, _INDEPENDENT, sweeps)
            for _ in range(5):
                began = time.perf_counter()
                trws(cost, _INDEPENDENT, sweeps)
                times.append(time.perf_counter() - began)
            energy = energy_of(found.labels, cost, _INDEPENDENT)
            gaps.append(100.0 * (energy - found.lower_bound) / abs(energy))
            excesses.append(100.0 * (energy - minimum) / abs(minimum))
            shadows.append(overlap(found.labels == SHADOW, truth == SHADOW))
        began = time.perf_counter()
        trws_numpy(costs[0], _INDEPENDENT, sweeps)
        slow = time.perf_counter() - began
        fast = statistics.median(times)
        yield _Knob(
            sweeps, 1e3 * fast, slow / fast, *(statistics.median(values) for values in (gaps, excesses, shadows))
        )
