"""Random cascades and grounds for them, and what a cascade makes of them by definition: one window, one stump, one box
at a time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import WINDOW, FeatureBox
from auv_mcm.detect.cascade.codes import CodePlane, make_plane
from auv_mcm.detect.cascade.model import Calibration, CascadeModel, Stump, check_model

ROW_M, COLUMN_M = 0.3, 0.35
OTHER = FeatureBox(-0.5, 0.5, -0.6, 0.0, 0.4, 0.5)
"""For contrasts against another box than the whole window's."""


class Ground(NamedTuple):
    """What a plane is made from."""

    codes: NDArray[np.uint16]
    valid: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    first_return_m: NDArray[np.float64]
    row_m: float = ROW_M
    column_m: float = COLUMN_M

    def plane(self) -> CodePlane:
        return make_plane(self.codes, self.valid, self.usable, self.first_return_m, self.row_m, self.column_m)


def draw_box(random: np.random.Generator) -> FeatureBox:
    top, bottom = np.sort(random.uniform(-1.0, 1.0, 2))
    near, far = np.sort(random.uniform(-1.0, 1.0, 2))
    shadow = random.uniform(0.0, 1.2) if random.random() < 0.5 else 0.0
    return FeatureBox(float(top), float(bottom + 1e-3 * (bottom <= top)), float(near), 0.0, float(far), float(shadow))


def draw_stump(random: np.random.Generator) -> Stump:
    below, above = (int(leaf) for leaf in random.integers(-900, 900, 2))
    a, b = draw_box(random), draw_box(random)
    if random.random() < 0.5:
        return Stump(kind="ratio", a=a, b=b, threshold=float(np.exp(random.normal(0.0, 0.3))), below=below, above=above)
    w = WINDOW if random.random() < 0.7 else OTHER
    return Stump(kind="contrast", a=a, b=b, w=w, threshold=float(random.normal(0.0, 0.3)), below=below, above=above)


def draw_model(
    seed: int, *, kind: str = "soft", sizes: tuple[int, ...] = (2, 3, 9, 7, 12), reject: int | None = None
) -> CascadeModel:
    """A model whose thresholds drop about half of the windows each time; with `reject` as all thresholds."""
    random = np.random.Generator(np.random.PCG64(seed))
    groups = tuple(tuple(draw_stump(random) for _ in range(size)) for size in sizes)
    expected, thresholds = 0.0, []
    for group in groups:
        expected = (0.0 if kind == "stages" else expected) + sum(0.5 * (stump.below + stump.above) for stump in group)
        thresholds.append(round(expected + random.normal(0.0, 300.0)) if reject is None else reject)
    assert kind in ("soft", "stages")
    model = CascadeModel(
        kind="stages" if kind == "stages" else "soft",
        trained_on="nothing: drawn at random",
        training_sha256="",
        row_spacing_m=(0.05, 0.5),
        column_spacing_m=(0.02, 0.5),
        calibration=Calibration(score=(-1024, 1024), log_odds=(-2.0, 2.0)),
        reject=tuple(thresholds),
        groups=groups,
    )
    check_model(model, "drawn model")
    return model


def draw_ground(seed: int, n_rows: int = 14, n_columns: int = 40) -> Ground:
    """Speckle with a bright and a dark patch, some of it not valid, some of it not usable, under an altitude that
    changes."""
    random = np.random.Generator(np.random.PCG64(seed))
    codes = np.minimum(np.rint(1024 * random.exponential(size=(n_rows, n_columns))), 16384)
    row, column = random.integers(n_rows), random.integers(n_columns)
    codes[row : row + 3, column : column + 3] *= 5
    codes[row : row + 3, column + 3 : column + 8] *= 0.1
    valid = random.random((n_rows, n_columns)) < random.choice([1.0, 0.95, 0.75])
    codes = np.where(valid, np.minimum(codes, 16384), 1024)
    usable = valid & (random.random((n_rows, n_columns)) < random.choice([1.0, 0.5]))
    first_return_m = random.uniform(0.4, 12.0) + random.uniform(-0.3, 0.3, n_rows)
    return Ground(codes.astype(np.uint16), valid, usable, first_return_m)


def brute_force(ground: Ground, model: CascadeModel) -> dict[tuple[int, int], int]:
    """Score of every window that passes, by row and column."""
    found = {}
    for row, column in zip(*(indices.tolist() for indices in np.nonzero(ground.usable)), strict=True):
        shadow_m = _band_shadow_m(ground, row, column, model.reference_height_m)
        if 5 * _sum(ground.valid, _pixels(WINDOW, ground, shadow_m), row, column, 0) < 3 * _area(
            _pixels(WINDOW, ground, shadow_m)
        ):
            continue
        score = 0
        for group, reject in zip(model.groups, model.reject, strict=True):
            score = 0 if model.kind == "stages" else score
            score += sum(_outcome(stump, ground, shadow_m, row, column) for stump in group)
            if score < reject:
                break
        else:
            found[row, column] = score
    return found


def n_windows(ground: Ground, reference_height_m: float) -> int:
    """How many windows have enough valid pixels."""
    n = 0
    for row, column in zip(*(indices.tolist() for indices in np.nonzero(ground.usable)), strict=True):
        window = _pixels(WINDOW, ground, _band_shadow_m(ground, row, column, reference_height_m))
        n += 5 * _sum(ground.valid, window, row, column, 0) >= 3 * _area(window)
    return n


def _band_shadow_m(ground: Ground, row: int, column: int, height_m: float) -> float:
    clearance_m = max(ground.first_return_m[row] - height_m, 0.3)
    shadow_m = height_m * (column + 0.5) * ground.column_m / clearance_m
    band = sum(shadow_m >= 0.4 * 15.0 ** (k / 24) for k in range(1, 24))
    return float(0.4 * 15.0 ** ((band + 0.5) / 24))


def _pixels(box: FeatureBox, ground: Ground, shadow_m: float) -> tuple[int, int, int, int]:
    top, bottom = _whole(box.top_m / ground.row_m), _whole(box.bottom_m / ground.row_m)
    left = _whole((box.near_m + box.near_shadow * shadow_m) / ground.column_m)
    right = _whole((box.far_m + box.far_shadow * shadow_m) / ground.column_m)
    return top, max(bottom, top + 1), left, max(right, left + 1)


def _whole(from_centre: float) -> int:
    from_edge = from_centre + 0.5
    whole = math.floor(abs(from_edge) + 0.5 + 1e-6)
    return whole if from_edge >= 0.0 else -whole


def _area(pixels: tuple[int, int, int, int]) -> int:
    top, bottom, left, right = pixels
    return (bottom - top) * (right - left)


def _sum(
    plane: NDArray[np.uint16] | NDArray[np.bool_], pixels: tuple[int, int, int, int], row: int, column: int, beyond: int
) -> int:
    top, bottom, left, right = pixels
    n_rows, n_columns = plane.shape
    rows = slice(max(row + top, 0), max(min(row + bottom, n_rows), 0))
    columns = slice(max(column + left, 0), max(min(column + right, n_columns), 0))
    inside = plane[rows, columns]
    return int(inside.sum(dtype=np.int64)) + beyond * (_area(pixels) - inside.size)


def _outcome(stump: Stump, ground: Ground, shadow_m: float, row: int, column: int) -> int:
    def weighed(box: FeatureBox, factor: float) -> np.float32:
        pixels = _pixels(box, ground, shadow_m)
        total = _sum(ground.codes, pixels, row, column, 1024)
        return np.float32(np.float32(total) * np.float32(factor * (1.0 / _area(pixels))))

    if stump.w is None:
        holds = weighed(stump.a, 1.0) < weighed(stump.b, stump.threshold)
    else:
        holds = np.float32(weighed(stump.a, 1.0) - weighed(stump.b, 1.0)) < weighed(stump.w, stump.threshold)
    return stump.below if holds else stump.above
