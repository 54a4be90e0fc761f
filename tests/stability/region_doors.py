"""One region with an object, and every door of confirmation and classification that takes a region."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fit import Effort, ShapeFits, fit_shapes
from auv_mcm.classify.likelihood import labels_cost
from auv_mcm.confirm.mrf import Segmentation, segment
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Contours, Start, converge
from auv_mcm.kernels import snake_twin
from auv_mcm.solids.shapes import TruncatedCone
from tests.auv_mcm.classify.closed_forms import closed_form_region
from tests.make.drawn_contours import box

Plane = NDArray[np.float64]

RANGE_M = 18.0
SMALL = Effort(80, 3, 4, 4, 1, 4, 4)
HYPOTHESIS = np.array([[2.4, RANGE_M, 1.0, 0.49, 0.25, 0.47, 0.0, 0.0]])  # the truncated cone of `cone_region`
START = Start(box(16, 22, 24, 32), box(16, 32, 24, 56))  # about its highlight and shadow


@functools.cache
def cone_region(seed: int = 1) -> Region:
    """40 rows of 12 cm, 90 columns of 6 cm, single-look speckle. Nobody may write into it."""
    random = np.random.Generator(np.random.PCG64(seed))
    cone = TruncatedCone(base_radius_m=0.49, top_radius_m=0.25, height_m=0.47)
    whole = closed_form_region(cone, RANGE_M, random=random, beam_width_rad=0.007, along_track_m=2.4)
    region = msgspec.structs.replace(
        whole,
        intensity=whole.intensity[:40, 20:110].copy(),
        valid=whole.valid[:40, 20:110].copy(),
        first_ground_range_m=whole.first_ground_range_m + 20 * whole.column_spacing_m,
        column=whole.column - 20.0,
    )
    for plane in (region.intensity, region.valid):
        plane.setflags(write=False)
    return region


def labels_of(region: Region) -> NDArray[np.uint8]:
    """Some labels for `labels_cost`: the boxes of START."""
    labels = np.full(region.intensity.shape, BACKGROUND, dtype=np.uint8)
    labels[16:24, 22:32], labels[16:24, 32:56] = HIGHLIGHT, SHADOW
    return labels


def plain(value: Any) -> Any:
    """Results as lists and numbers that can be compared with =="""
    if isinstance(value, msgspec.Struct):
        return {name: plain(part) for name, part in msgspec.structs.asdict(value).items()}
    if isinstance(value, np.ndarray):
        return repr(value.tolist())
    return repr(value)


DOORS: dict[str, Callable[[Region], Any]] = {
    "segment": segment,
    "converge": lambda region: converge(region, START, correlation_px=1.5),
    "fit_shapes": lambda region: fit_shapes(region, None, 1.5, effort=SMALL),
    "labels_cost": lambda region: labels_cost(region, labels_of(region), 1.5),
}


def through(door: str, region: Region) -> Any:
    """What a door says, of finite numbers in their order, every floating-point flag but underflow being an error."""
    with np.errstate(all="raise", under="ignore"):
        answer = DOORS[door](region)
    if isinstance(answer, Segmentation):
        assert answer.labels.shape == region.intensity.shape
        assert answer.labels.max(initial=0) <= 2
        numbers = [answer.energy, answer.lower_bound, answer.smoothness, *answer.correlation, answer.law.looks]
        assert np.isfinite([*numbers, answer.background_mean, answer.shadow_mean, answer.highlight_mean]).all()
        assert answer.lower_bound <= answer.energy + 1e-9 * abs(answer.energy)
    elif isinstance(answer, Contours):
        assert_sound(answer, region)
    elif isinstance(answer, ShapeFits):
        for fit in answer.fits:
            best = fit.best
            assert np.isfinite([best.cost, best.row, best.ground_range_m, fit.plausibility]).all()
        for fit in answer.fits[:1]:
            assert np.isfinite([*fit.contrast, *fit.sigma.values()]).all()
    return answer


def assert_sound(contours: Contours, region: Region) -> None:
    """Polygons without crossings inside the region, or none, and a criterion unless they are rejected."""
    for nodes in (contours.highlight, contours.shadow):
        assert np.isfinite(nodes).all()
        assert len(nodes) == 0 or snake_twin.is_sound(nodes)
        assert ((nodes >= 0.0) & (nodes <= region.intensity.shape)).all()
    assert contours.rejected or math.isfinite(contours.criterion)
