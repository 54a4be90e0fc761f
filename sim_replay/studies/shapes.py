"""Measure how often the class of a solid is found, how well its size, and in what time, for more and fewer hypotheses.

auv-mcm bench shapes [--objects N]
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.classify.fit import SOLIDS, Effort, ShapeFits, fit_shapes, hypotheses_of
from auv_mcm.classify.likelihood import beam_of, image_row_sums
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import shape_costs, shape_costs_numpy
from sim_replay.arguments import count
from sim_replay.benches.every_stage.rendered_solids import CORRELATION_AREA, SIZES, best_class, draw_object

EFFORTS: Final = {
    "quarter": Effort(160, 4, 10, 6, 2, 10, 6),
    "half": Effort(320, 6, 14, 6, 2, 16, 8),
    "default": Effort(),
    "double": Effort(1280, 14, 24, 8, 4, 28, 10),
}


class ShapeRow(NamedTuple):
    """Hold one effort's results. accuracy: share of classes right, from single views and from pairs. size_error: root
    mean square over all sizes of the right class, relative. cpu_ms: median per region; n_hypotheses likewise.
    numpy_ratio: time of the numpy twin over that of C.
    """

    effort: str
    accuracy: float
    accuracy_of_two: float
    size_error: float
    cpu_ms: float
    n_hypotheses: int
    numpy_ratio: float


def shape_rows(n_objects: int = 24, seed: int = 5) -> list[ShapeRow]:
    """Return a row per effort over the same objects of all classes in turn."""
    drawn = [draw_object(SOLIDS[index % len(SOLIDS)], seed + index) for index in range(n_objects)]
    ratio = numpy_ratio(drawn[0].views[0])
    rows = []
    for name, effort in EFFORTS.items():
        times, counts, errors = [], [], []
        right, right_of_two = 0, 0
        for scene_object in drawn:
            both: list[ShapeFits] = []
            for region in scene_object.views:
                start = time.thread_time()
                both.append(fit_shapes(region, None, CORRELATION_AREA, effort=effort))
                times.append(time.thread_time() - start)
                counts.append(both[-1].n_hypotheses)
            right += sum(best_class([fits]) == scene_object.solid for fits in both)
            right_of_two += best_class(both) == scene_object.solid
            for fit in (fit for fits in both for fit in fits.fits if fit.solid == scene_object.solid):
                found = np.array([getattr(fit.best.shape, name) for name in SIZES[scene_object.solid]])
                errors += (found / scene_object.sizes_m - 1.0).tolist()
        rows.append(
            ShapeRow(
                effort=name,
                accuracy=right / (2 * n_objects),
                accuracy_of_two=right_of_two / n_objects,
                size_error=math.sqrt(statistics.fmean(error * error for error in errors)),
                cpu_ms=1e3 * statistics.median(times),
                n_hypotheses=int(statistics.median(counts)),
                numpy_ratio=ratio,
            )
        )
    return rows


def numpy_ratio(region: Region, n: int = 64) -> float:
    """Time of the numpy twin over that of C for the costs of n cylinders, each weighed with a pencil and with the
    beam."""
    image = image_row_sums(region, CORRELATION_AREA)
    assert image is not None
    middle = np.array(
        [region.row * image.row_spacing_m, image.first_ground_range_m + region.column * image.column_spacing_m]
    )
    points = np.column_stack(
        (np.tile(middle, (n, 1)), np.full((n, 2), (0.27, 2.0)), np.linspace(-1.5, 1.5, n), np.zeros(n))
    )
    hypotheses = hypotheses_of("cylinder", points)
    cost_s = []
    for function in (shape_costs_numpy, shape_costs):
        best_s = math.inf
        for _ in range(3):
            start = time.thread_time()
            function("cylinder", hypotheses, image)
            function("cylinder", hypotheses, image, beam_of(region))
            best_s = min(best_s, time.thread_time() - start)
        cost_s.append(best_s)
    return cost_s[0] / cost_s[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench shapes`."""
    parser.add_argument("--objects", type=count, default=24, help="objects drawn, two views each (default 24)")


def run(chosen: argparse.Namespace) -> int:
    """Print the table; returns the exit code."""
    print(
        f"{'effort':<10}{'hypotheses':>11}{'cpu ms':>9}{'one view':>10}{'two views':>11}"
        f"{'size error':>12}{'numpy / C':>11}"
    )
    for row in shape_rows(chosen.objects):
        print(
            f"{row.effort:<10}{row.n_hypotheses:>11d}{row.cpu_ms:>9.1f}{row.accuracy:>10.3f}"
            f"{row.accuracy_of_two:>11.3f}{row.size_error:>12.3f}{row.numpy_ratio:>11.0f}"
        )
    return 0
