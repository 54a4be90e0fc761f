"""Measure field, contours and solids on drawn regions, and what a user would take instead."""

from __future__ import annotations

import itertools
import math
import statistics
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.classify.fit import Effort, fit_shapes
from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.confirm.mrf import edge_weights
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Start, converge
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import Correlation
from auv_mcm.kernels.shape import Solid, intervals_numpy, single_solid
from auv_mcm.kernels.trws import energy_of, icm, trws
from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.scoring.overlap import overlap

Plane = NDArray[np.float64]

_COLUMN_M: Final = 0.06  # of drawn regions, across the track
_ROW_M: Final = 0.12  # and along it
_LEVELS: Final = np.array([1.0, 10.0**-0.9, 8.0])  # of floor, shadow at -9 dB, and highlight
_INDEPENDENT: Final = edge_weights(1.0, (1, 1), Correlation(1.0, 1.0))


def random_of(*seed: int) -> np.random.Generator:
    """Draw random numbers of their own for each seed."""
    return np.random.Generator(np.random.PCG64(list(seed)))


def _drawn_field(seed: int) -> tuple[Plane, NDArray[np.uint8]]:
    """Draw single-look speckle about a highlight and a shadow, (48, 72), and its true labels."""
    random = random_of(3, seed)
    labels = np.zeros((48, 72), dtype=np.uint8)
    top, near = int(random.integers(12, 20)), int(random.integers(12, 20))
    rows, columns = np.indices(labels.shape)
    labels[(np.abs(rows - top - 8) < 8) & (columns >= near) & (columns < near + 6)] = HIGHLIGHT
    inside = ((rows - top - 8) / 8.0) ** 2 + ((columns - near - 6) / 28.0) ** 2 < 1.0
    labels[inside & (columns >= near + 6)] = SHADOW
    return _LEVELS[labels] * random.exponential(size=labels.shape), labels


def field_rows(n: int) -> list[Row]:
    """Label drawn regions by tree-reweighted messages; instead, by iterated conditional modes."""
    drawn = [_drawn_field(seed) for seed in range(n)]
    costs = [np.asarray(np.log(_LEVELS) + plane[:, :, np.newaxis] / _LEVELS) for plane, _ in drawn]
    bounds = [trws(cost, _INDEPENDENT, 300).lower_bound for cost in costs]

    def by_icm() -> list[NDArray[np.uint8]]:
        return [icm(cost, _INDEPENDENT, cost.argmin(axis=2).astype(np.uint8), 20)[0] for cost in costs]

    def gap(found: list[NDArray[np.uint8]]) -> float:
        return statistics.median(
            100.0 * (energy_of(labels, cost, _INDEPENDENT) - bound) / abs(bound)
            for labels, cost, bound in zip(found, costs, bounds, strict=True)
        )

    def missed(found: list[NDArray[np.uint8]]) -> float:
        return 1.0 - statistics.median(
            overlap(labels == SHADOW, truth == SHADOW) for labels, (_, truth) in zip(found, drawn, strict=True)
        )

    other, rows = Other("ICM", by_icm), []
    for sweeps in (1, 3, 10, 50):
        work, setting = partial(_labels_after, costs, sweeps), f"{sweeps} sweeps, {n} regions"
        for unit, error, bound in (("% above the bound", gap, 0.2), ("1 - IoU of the shadow", missed, 0.4)):
            rows.append(Row("field", setting, work, error, unit, bound if sweeps >= 10 else None, other))
    return rows


def _labels_after(costs: list[Plane], sweeps: int) -> list[NDArray[np.uint8]]:
    return [trws(cost, _INDEPENDENT, sweeps).labels for cost in costs]


def _region_of(plane: Plane) -> Region:
    return Region(
        intensity=plane,
        valid=np.ones(plane.shape, dtype=np.bool_),
        altitude_m=6.0,
        row_spacing_m=_ROW_M,
        column_spacing_m=_COLUMN_M,
        first_ground_range_m=16.0,
        row=0.5 * plane.shape[0],
        column=20.0,
        beam_width_rad=0.0,
    )


def contour_rows(n: int) -> list[Row]:
    """Draw contours of shadows with more and more nodes; instead, two methods of scikit-image."""
    drawn = [_drawn_field(seed) for seed in range(n)]
    box = [np.array([[14.0, a], [14.0, b], [34.0, b], [34.0, a]]) for a, b in ((14.0, 22.0), (22.0, 46.0))]
    start = Start(*box)
    shape = drawn[0][1].shape

    def by_snake(nodes: int) -> list[NDArray[np.bool_]]:
        schedule = ((nodes, 1.0, 30),)
        return [
            contour_mask(converge(_region_of(plane), start, coarse=((4, 2.0, 20),), fine=schedule).shadow, shape)
            for plane, _ in drawn
        ]

    def missed(found: list[NDArray[np.bool_]]) -> float:
        return 1.0 - statistics.median(
            overlap(mask, truth == SHADOW) for mask, (_, truth) in zip(found, drawn, strict=True)
        )

    def by_chan_vese() -> list[NDArray[np.bool_]]:
        segmentation = import_module("skimage.segmentation")
        inside = np.zeros(shape, dtype=np.bool_)
        inside[14:34, 22:46] = True
        found = []
        for plane, _ in drawn:
            image = np.log(np.maximum(ndimage.uniform_filter(plane, 3), 1e-3))
            mask = segmentation.morphological_chan_vese(image, 60, init_level_set=inside, smoothing=2).astype(bool)
            dark = image[mask].mean() < image[~mask].mean() if mask.any() and not mask.all() else True
            found.append(mask if dark else ~mask)
        return found

    def by_active_contour() -> list[NDArray[np.bool_]]:
        segmentation, draw = import_module("skimage.segmentation"), import_module("skimage.draw")
        angle = np.linspace(0.0, 2.0 * np.pi, 40)
        begun = np.column_stack([24.0 + 12.0 * np.sin(angle), 34.0 + 14.0 * np.cos(angle)])
        return [
            draw.polygon2mask(
                shape, segmentation.active_contour(ndimage.gaussian_filter(np.log(np.maximum(p, 1e-3)), 2.0), begun)
            )
            for p, _ in drawn
        ]

    missing = "" if find_spec("skimage") is not None else "scikit-image is not installed"
    others = [
        Other("scikit-image Chan-Vese", by_chan_vese, missing=missing),
        Other("scikit-image active contour", by_active_contour, missing=missing),
    ]
    rows = []
    for nodes in (4, 8, 16):
        work, bound = partial(by_snake, nodes), 0.4 if nodes == 16 else None
        setting, unit = f"{nodes} nodes, {n} regions", "1 - IoU of the shadow"
        rows += [Row("contours", setting, work, missed, unit, bound, other) for other in others]
    return rows


_SIZES: Final[dict[Solid, tuple[float, ...]]] = {
    "sphere": (0.5, 0.1, 0.0, 0.0, 0.0),
    "cylinder": (0.25, 1.8, 0.9, 0.05, 0.0),
    "truncated_cone": (0.49, 0.25, 0.47, 0.0, 0.0),
    "wedge": (1.0, 0.8, 0.4, 0.6, 0.0),
}
"""Fields of usual mines of each class, m and rad."""


_AT_M: Final = (3.66, 20.0)  # place of drawn objects along and across the track


def _ends(solid: Solid, sizes: tuple[float, ...], region: Region) -> Plane:
    """Find where highlight and shadow of each row begin and the shadow ends, (n_rows, 3) columns, NaN outside."""
    image = image_row_sums(region, 1.0)
    assert image is not None
    return intervals_numpy(solid, np.array([[*_AT_M, 1.0, *sizes]]), image)[0, :, 0]


def _masks(ends: Plane, n_columns: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    column = np.arange(n_columns) + 0.5
    begun = [column >= np.nan_to_num(ends[:, k], nan=math.inf)[:, np.newaxis] for k in range(3)]
    return begun[0] & ~begun[1], begun[1] & ~begun[2]


def solid_rows(n: int) -> list[Row]:
    """Fit solids with fewer and more hypotheses to objects drawn by their closed forms; instead, match templates."""
    blank = _region_of(np.ones((61, 170)))
    drawn: list[tuple[Solid, float, Region]] = []
    for (solid, sizes), number in itertools.product(_SIZES.items(), range(n)):
        random = random_of(7, number)
        scale = random.uniform(0.85, 1.15)
        own = (*(size * scale for size in sizes[:2]), *sizes[2:])
        highlight, shadow = _masks(_ends(solid, own, blank), 170)
        level = np.where(highlight, 8.0, np.where(shadow, 0.1, 1.0))
        region = msgspec.structs.replace(
            blank, intensity=level * random.exponential(size=level.shape), row=30.5, column=66.0
        )
        drawn.append((solid, _longest_m(single_solid(solid, np.array(own))), region))
    templates: list[tuple[Solid, float, NDArray[np.float32]]] = []
    for solid, sizes in _SIZES.items():
        for scale in (0.85, 1.0, 1.15):
            scaled = (*(size * scale for size in sizes[:2]), *sizes[2:])
            highlight, shadow = _masks(_ends(solid, scaled, blank), 170)
            template = (highlight.astype(np.float32) - shadow)[12:49, 45:125]
            templates.append((solid, _longest_m(single_solid(solid, np.array(scaled))), template - template.mean()))

    def by_fit(effort: Effort) -> list[tuple[Solid, float]]:
        bests = [fit_shapes(region, None, 1.0, effort=effort).fits[0] for _, _, region in drawn]
        return [(best.solid, _longest_m(best.best.shape)) for best in bests]

    def by_template() -> list[tuple[Solid, float]]:
        found = []
        for _, _, region in drawn:
            image = np.log(np.maximum(region.intensity, 1e-2)).astype(np.float32)
            scores = [float(cv2.matchTemplate(image, t, cv2.TM_CCOEFF_NORMED).max()) for *_, t in templates]
            solid, size_m, _ = templates[int(np.argmax(scores))]
            found.append((solid, size_m))
        return found

    other, rows = Other("template match, after Myers and Fawcett", by_template), []
    for name, effort in {"160 hypotheses": Effort(160, 4, 10, 6, 2, 10, 6), "default": Effort()}.items():
        work, setting = partial(by_fit, effort), f"{name}, {len(drawn)} objects"
        for unit, error, bound in (
            ("share of classes wrong", _wrong, 0.5),
            ("m, median of the longest size", _size_m, 0.3),
        ):
            rows.append(Row("solids", setting, work, partial(error, drawn), unit, bound, other))
    return rows


def _longest_m(shape: Any) -> float:
    """Take the longest horizontal extent of a solid."""
    fields = msgspec.structs.asdict(shape)
    widths_m = [2.0 * fields.get(name, 0.0) for name in ("radius_m", "base_radius_m")]
    return float(max(*widths_m, fields.get("length_m", 0.0), fields.get("width_m", 0.0)))


def _wrong(drawn: list[tuple[Solid, float, Region]], found: list[tuple[Solid, float]]) -> float:
    return sum(solid != true for (solid, _), (true, *_) in zip(found, drawn, strict=True)) / len(drawn)


def _size_m(drawn: list[tuple[Solid, float, Region]], found: list[tuple[Solid, float]]) -> float:
    return statistics.median(abs(size - true) for (_, size), (_, true, _) in zip(found, drawn, strict=True))
