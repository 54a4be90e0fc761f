"""Measure field, contours and solids at settings from cheap to dear: the curve of error against time of each.

Inputs are those on which the settings that ship were chosen: regions drawn at several grains of speckle, leaning and
rounded outlines from random starts, and solids rendered with beam and speckle, two views of each.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from typing import Final

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
from sim_replay.benches.every_stage.rows import Alternative, Amount, StageRow, timed
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


def field_curve_rows(amount: Amount) -> list[StageRow]:
    """Label regions of growing grain by the chain's segmentation; instead, by the source paper's."""
    rows = []
    for spread in _SPREADS_PIXELS:
        drawn = [draw_region(drawing) for drawing in aperture_drawings(amount.n, spread, _FIRST_DRAWING)]

        def ours(drawn: list[tuple[Region, Labels]] = drawn) -> list[Labels]:
            return [segment(region).labels for region, _ in drawn]

        def papers(drawn: list[tuple[Region, Labels]] = drawn) -> list[Labels]:
            return [segment_as_paper(region).labels for region, _ in drawn]

        (own, cost), (their, their_cost) = timed(amount.repeat, ours, papers)
        truths = [truth == SHADOW for _, truth in drawn]
        rows.append(
            StageRow(
                stage="field",
                setting=f"grain {max(1.0, math.sqrt(2.0 * math.pi) * spread):.1f} pixels, {amount.n} regions",
                cost=cost,
                error=_missed([labels == SHADOW for labels in own], truths),
                unit="1 - IoU of the shadow",
                alternative=Alternative(
                    name="the source paper's field",
                    cost=their_cost,
                    error=_missed([labels == SHADOW for labels in their], truths),
                ),
            )
        )
    return rows


def contour_curve_rows(amount: Amount) -> list[StageRow]:
    """Move contours by schedules of more and more nodes, from random starts."""
    drawn = [drawn_pair(seed) for seed in range(_FIRST_PAIR, _FIRST_PAIR + amount.n)]
    starts = [random_start(each, number) for number, each in enumerate(drawn)]

    def moved(coarse: Schedule, fine: Schedule) -> list[NDArray[np.bool_]]:
        return [
            contour_mask(converge(each.region, start, coarse=coarse, fine=fine).shadow, SHAPE)
            for each, start in zip(drawn, starts, strict=True)
        ]

    works: list[Callable[[], list[NDArray[np.bool_]]]] = [
        lambda parts=parts: moved(*parts)  # type: ignore[misc]  # a default is its type
        for parts in SCHEDULES.values()
    ]
    return [
        StageRow(
            stage="contours",
            setting=f"{name}, {amount.n} random starts",
            cost=cost,
            error=_missed(masks, [each.shadow for each in drawn]),
            unit="1 - IoU of the shadow",
        )
        for name, (masks, cost) in zip(SCHEDULES, timed(amount.repeat, *works), strict=True)
    ]


def solid_curve_rows(amount: Amount) -> list[StageRow]:
    """Fit solids to rendered objects with four efforts, judged by one view and by two 90 degrees apart."""
    drawn = [draw_object(SOLIDS[k % len(SOLIDS)], _FIRST_SOLID + k) for k in range(len(SOLIDS) * amount.n)]

    def fitted(effort: Effort) -> list[list[ShapeFits]]:
        return [[fit_shapes(region, None, CORRELATION_AREA, effort=effort) for region in each.views] for each in drawn]

    works: list[Callable[[], list[list[ShapeFits]]]] = [
        lambda effort=effort: fitted(effort)  # type: ignore[misc]  # a default is its type
        for effort in EFFORTS.values()
    ]
    rows = []
    for name, (fits, cost) in zip(EFFORTS, timed(amount.repeat, *works), strict=True):
        for unit, error in (
            ("share of classes wrong, one view", _wrong_of_one),
            ("share of classes wrong, two views", _wrong_of_two),
            ("relative, root mean square of sizes", _size_error),
        ):
            rows.append(
                StageRow(
                    stage="solids",
                    setting=f"{name} effort, {len(drawn)} rendered objects",
                    cost=cost,
                    error=error(fits, drawn),
                    unit=unit,
                )
            )
    return rows


def _missed(found: list[NDArray[np.bool_]], truths: list[NDArray[np.bool_]]) -> float:
    return 1.0 - statistics.median(overlap(mask, truth) for mask, truth in zip(found, truths, strict=True))


def _wrong_of_one(fits: list[list[ShapeFits]], drawn: list[DrawnSolid]) -> float:
    return statistics.fmean(
        best_class([view]) != each.solid for views, each in zip(fits, drawn, strict=True) for view in views
    )


def _wrong_of_two(fits: list[list[ShapeFits]], drawn: list[DrawnSolid]) -> float:
    return statistics.fmean(best_class(views) != each.solid for views, each in zip(fits, drawn, strict=True))


def _size_error(fits: list[list[ShapeFits]], drawn: list[DrawnSolid]) -> float:
    """Return the error of the right class's sizes over all views that it was fitted to; inf if to none."""
    errors: list[float] = []
    for views, each in zip(fits, drawn, strict=True):
        for fit in (fit for view in views for fit in view.fits if fit.solid == each.solid):
            found = np.array([getattr(fit.best.shape, name) for name in SIZES[each.solid]])
            errors += (found / each.sizes_m - 1.0).tolist()
    return math.sqrt(statistics.fmean(error * error for error in errors)) if errors else math.inf
