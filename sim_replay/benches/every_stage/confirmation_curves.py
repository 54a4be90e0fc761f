"""Measure field, contours and solids at settings from cheap to dear: the curve of error against time of each.

Inputs are those on which the settings that ship were chosen: regions drawn at several grains of speckle, leaning and
rounded outlines from random starts, and solids rendered with beam and speckle, two views of each.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fit import SOLIDS, Effort, ShapeFits, fit_shapes
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import SHADOW, Region
from auv_mcm.confirm.snake import COARSE, FINE, converge
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.kernels.snake_descent import Schedule
from sim_replay.benches.every_stage.drawn_contours import SHAPE, drawn_pair, random_start
from sim_replay.benches.every_stage.drawn_regions import aperture_drawings, draw_region
from sim_replay.benches.every_stage.paper_mrf import segment_as_paper
from sim_replay.benches.every_stage.rendered_solids import CORRELATION_AREA, SIZES, DrawnSolid, best_class, draw_object
from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.scoring.overlap import overlap

Labels = NDArray[np.uint8]

_SPREADS_PIXELS: Final = (0.0, 0.8, 1.1, 1.4)  # of the point: grains of 1 to 3.5 pixels, single pixels to those of SAS
_FIRST_DRAWING: Final = 11  # seed
_FIRST_PAIR: Final = 100  # seed; those below 100 served to choose schedules
_FIRST_SOLID: Final = 5  # seed
SCHEDULES: Final[dict[str, tuple[Schedule, Schedule]]] = {
    "4 nodes": (COARSE, ((4, 1.0, 20),)),
    "8 nodes": (COARSE, ((8, 3.0, 20), (8, 1.0, 20), (0, 0.0, 1), (0, 1.0, 10))),
    "16 nodes (default)": (COARSE, FINE),
    "16 nodes, no pruning": (COARSE, FINE[:-2]),
    "24 nodes": (COARSE, (*FINE[:-2], (24, 1.0, 20), *FINE[-2:])),
}
EFFORTS: Final = {
    "quarter": Effort(160, 4, 10, 6, 2, 10, 6),
    "half": Effort(320, 6, 14, 6, 2, 16, 8),
    "default": Effort(),
    "double": Effort(1280, 14, 24, 8, 4, 28, 10),
}


def field_curve_rows(n: int) -> list[Row]:
    """Label regions of growing grain by the chain's segmentation; instead, by the source paper's."""
    rows = []
    for spread in _SPREADS_PIXELS:
        drawn = [draw_region(drawing) for drawing in aperture_drawings(n, spread, _FIRST_DRAWING)]
        rows.append(
            Row(
                "field",
                f"grain {max(1.0, math.sqrt(2.0 * math.pi) * spread):.1f} pixels, {n} regions",
                partial(_shadows_by, segment, drawn),
                partial(_missed, [truth == SHADOW for _, truth in drawn]),
                "1 - IoU of the shadow",
                alternative=Other("the source paper's field", partial(_shadows_by, segment_as_paper, drawn)),
            )
        )
    return rows


def _shadows_by(labelled: Callable[[Region], Any], drawn: list[tuple[Region, Labels]]) -> list[NDArray[np.bool_]]:
    return [labelled(region).labels == SHADOW for region, _ in drawn]


def contour_curve_rows(n: int) -> list[Row]:
    """Move contours by schedules of more and more nodes, from random starts."""
    drawn = [drawn_pair(seed) for seed in range(_FIRST_PAIR, _FIRST_PAIR + n)]
    starts = [random_start(each, number) for number, each in enumerate(drawn)]

    def moved(coarse: Schedule, fine: Schedule) -> list[NDArray[np.bool_]]:
        return [
            contour_mask(converge(each.region, start, coarse=coarse, fine=fine).shadow, SHAPE)
            for each, start in zip(drawn, starts, strict=True)
        ]

    error = partial(_missed, [each.shadow for each in drawn])
    return [
        Row("contours", f"{name}, {n} random starts", partial(moved, *parts), error, "1 - IoU of the shadow")
        for name, parts in SCHEDULES.items()
    ]


def solid_curve_rows(n: int) -> list[Row]:
    """Fit solids to rendered objects with four efforts, judged by one view and by two 90 degrees apart."""
    drawn = [draw_object(SOLIDS[k % len(SOLIDS)], _FIRST_SOLID + k) for k in range(len(SOLIDS) * n)]

    def fitted(effort: Effort) -> list[list[ShapeFits]]:
        return [[fit_shapes(region, None, CORRELATION_AREA, effort=effort) for region in each.views] for each in drawn]

    rows = []
    for name, effort in EFFORTS.items():
        work = partial(fitted, effort)
        for unit, error in (
            ("share of classes wrong, one view", _wrong_of_one),
            ("share of classes wrong, two views", _wrong_of_two),
            ("relative, root mean square of sizes", _size_error),
        ):
            rows.append(
                Row("solids", f"{name} effort, {len(drawn)} rendered objects", work, partial(error, drawn), unit)
            )
    return rows


def _missed(truths: list[NDArray[np.bool_]], found: list[NDArray[np.bool_]]) -> float:
    return 1.0 - statistics.median(overlap(mask, truth) for mask, truth in zip(found, truths, strict=True))


def _wrong_of_one(drawn: list[DrawnSolid], fits: list[list[ShapeFits]]) -> float:
    return statistics.fmean(
        best_class([view]) != each.solid for views, each in zip(fits, drawn, strict=True) for view in views
    )


def _wrong_of_two(drawn: list[DrawnSolid], fits: list[list[ShapeFits]]) -> float:
    return statistics.fmean(best_class(views) != each.solid for views, each in zip(fits, drawn, strict=True))


def _size_error(drawn: list[DrawnSolid], fits: list[list[ShapeFits]]) -> float:
    """Return the error of the right class's sizes over all views that it was fitted to; inf if to none."""
    errors: list[float] = []
    for views, each in zip(fits, drawn, strict=True):
        for fit in (fit for view in views for fit in view.fits if fit.solid == each.solid):
            found = np.array([getattr(fit.best.shape, name) for name in SIZES[each.solid]])
            errors += (found / each.sizes_m - 1.0).tolist()
    return math.sqrt(statistics.fmean(error * error for error in errors)) if errors else math.inf
