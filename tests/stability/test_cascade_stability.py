"""Extreme tiles and extreme models through the trained cascade: exact sums, no wrap, the same windows wherever and
however a tile lies.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from auv_mcm.detect.candidates import STEP_M
from auv_mcm.detect.cascade.bands import (
    WINDOW,
    WINDOW_FAR_M,
    WINDOW_SHADOWS,
    FeatureBox,
    areas,
    margins_px,
    pixel_boxes,
)
from auv_mcm.detect.cascade.codes import MAX_BOX_PX, box_sums, make_plane
from auv_mcm.detect.cascade.model import MAX_LEAF, MAX_STUMPS, SCORE_UNIT, Calibration, CascadeModel, Stump, check_model
from auv_mcm.detect.cascade.run import CascadeResult, core_plane, run_plane
from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID, Tile
from auv_mcm.settings.config import Config, DetectConfig
from tests.auv_mcm.detect.drawn_cascade import BEFORE, HIGHLIGHT, SHADOW
from tests.make.models import model_with
from tests.stability.tile_pictures import COLUMN_M, PICTURES, ROW_M, SHAPE, holes, speckle, tile_of, with_object

ANY_SCORE = -MAX_STUMPS * MAX_LEAF
CONFIG = Config(detect=DetectConfig(max_candidates_per_tile=40))


def ratio(a: FeatureBox, b: FeatureBox, threshold: float, leaf: int = SCORE_UNIT) -> Stump:
    return Stump(kind="ratio", a=a, b=b, threshold=threshold, below=-leaf, above=leaf)


def contrast(a: FeatureBox, b: FeatureBox, threshold: float, leaf: int = SCORE_UNIT) -> Stump:
    return Stump(kind="contrast", a=a, b=b, w=WINDOW, threshold=threshold, below=-leaf, above=leaf)


def model_of(*groups: tuple[Stump, ...], reject: int = 0) -> CascadeModel:
    any_m = 0.001, 10.0
    calibration = Calibration(score=(-3 * SCORE_UNIT, 3 * SCORE_UNIT), log_odds=(-6.0, 6.0))
    model = model_with(groups, reject, row_spacing_m=any_m, column_spacing_m=any_m, calibration=calibration)
    check_model(model, "made here")
    return model


MODEL = model_of((ratio(HIGHLIGHT, BEFORE, 3.0),), (contrast(BEFORE, SHADOW, 0.5),), (ratio(HIGHLIGHT, SHADOW, 10.0),))
"""Bright before something dark."""
ALL_PASS = msgspec.structs.replace(MODEL, reject=(ANY_SCORE,) * 3)


def looked_at(tile: Tile, model: CascadeModel | None = MODEL) -> TileDetections:
    """Detections with every floating-point flag but underflow an error."""
    with np.errstate(all="raise", under="ignore"):
        result = detect_tile(tile, CONFIG, model)
    for d in result.detections:
        assert np.isfinite(
            [d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.longitude_deg, d.length_m, d.width_m]
        ).all()
        assert np.isfinite(d.covariance_m2).all()
        assert math.isfinite(d.cascade_score) == (model is not None)
    return result


def run(tile: Tile, model: CascadeModel = ALL_PASS) -> CascadeResult:
    with np.errstate(all="raise", under="ignore"):
        return run_plane(core_plane(tile), model, None)


def scores(result: CascadeResult, first_row: int = 0) -> dict[tuple[int, int], int]:
    return {
        (row + first_row, column): score
        for row, column, score in zip(
            result.rows.tolist(), result.columns.tolist(), result.scores.tolist(), strict=True
        )
    }


# --- extreme pictures ---


EVERY_DETECTOR = pytest.mark.parametrize("model", [None, MODEL, ALL_PASS], ids=["contrasts", "model", "all pass"])


@EVERY_DETECTOR
@pytest.mark.parametrize("name", PICTURES)
def test_no_picture_raises_a_floating_point_flag(name: str, model: CascadeModel | None) -> None:
    looked_at(tile_of(PICTURES[name]), model)


@pytest.mark.parametrize("first_silent", [0, 110])
def test_nothing_is_detected_where_nothing_echoes(first_silent: int) -> None:
    """Comparisons of nothing with nothing all come out alike, and some cascade passes just that."""
    frame = round(2.5 / COLUMN_M) if first_silent else 0  # around an object, in which the sea floor is measured
    for nothing in (0.0, 1e-42):
        result = looked_at(tile_of(np.where(np.indices(SHAPE)[1] < first_silent, speckle(), nothing)), ALL_PASS)
        assert not [d for d in result.detections if d.column >= first_silent + frame]


@EVERY_DETECTOR
@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.95, 1.0])
def test_no_mask_raises_a_floating_point_flag(share: float, model: CascadeModel | None) -> None:
    looked_at(tile_of(with_object(speckle()), holes(share)), model)


@pytest.mark.parametrize("bit", [SATURATED, TURN, LOW_RESOLUTION])
def test_flags_on_half_the_picture_raise_none(bit: int) -> None:
    mask = np.full(SHAPE, VALID, dtype=np.uint8)
    mask[:, 110:] |= np.uint8(bit)
    for model in (None, ALL_PASS):
        looked_at(tile_of(with_object(speckle()), mask), model)


@pytest.mark.parametrize("first_return_m", [0.0, 1e-9, 0.3, 1.0, 30.0, 190.0, math.nan, math.inf])
@pytest.mark.parametrize("spacing", [(0.02, 0.02), (0.12, 0.06), (2.0, 2.0), (0.05, 2.0), (2.0, 0.02)])
def test_windows_are_accounted_for_at_every_altitude_on_every_grid(
    first_return_m: float, spacing: tuple[float, float]
) -> None:
    tile = tile_of(speckle(3, (40, 60)), row_m=spacing[0], column_m=spacing[1], first_return_m=first_return_m)
    result = run(tile, msgspec.structs.replace(ALL_PASS, reject=(0, 0, 0)))
    assert 0 <= result.n_windows <= 40 * 60
    entered = (result.n_windows, *result.n_alive[:-1])
    assert result.n_evaluations == sum(n * len(group) for n, group in zip(entered, MODEL.groups, strict=True))
    assert len(result.rows) == result.n_alive[-1]


@pytest.mark.parametrize("first_return_m", [0.0, 1e-9, 0.05, 0.3, 1.0, 30.0, 190.0])
@pytest.mark.parametrize("spacing", [(0.01, 0.005), (0.12, 0.06), (2.0, 2.0), (0.01, 2.0), (2.0, 0.02)])
def test_no_altitude_and_no_grid_raises_a_flag(first_return_m: float, spacing: tuple[float, float]) -> None:
    row_m, column_m = spacing
    looked_at(tile_of(speckle(3, (60, 90)), row_m=row_m, column_m=column_m, first_return_m=first_return_m), None)


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (2, 3), (400, 1), (7, 7)])
def test_no_shape_raises_a_flag(shape: tuple[int, int]) -> None:
    looked_at(tile_of(speckle(4, shape)), None)


# --- exact sums ---


def test_the_largest_box_admitted_full_of_the_brightest_echoes_does_not_overflow() -> None:
    row_m, column_m = 0.0117, 0.0117
    largest = FeatureBox(-1.0, 1.0, -1.0, 0.0, WINDOW_FAR_M, WINDOW_SHADOWS)
    boxes = pixel_boxes([largest], row_m, column_m)
    area = int(areas(boxes).max())
    assert 0.95 * MAX_BOX_PX < area <= MAX_BOX_PX
    rows, near, far = margins_px(row_m, column_m)
    bright = np.full((2 * rows + 1, near + far + 1), 16384, dtype=np.uint16)
    everywhere = np.ones(bright.shape, dtype=np.bool_)
    plane = make_plane(bright, everywhere, everywhere, np.full(len(bright), 5.0), row_m, column_m)
    middle = np.array([rows]), np.array([near])
    assert box_sums(plane, *middle, boxes[-1]).tolist() == [area * 16384]


def test_the_largest_model_does_not_wrap() -> None:
    stumps = (contrast(BEFORE, SHADOW, 1e4, MAX_LEAF),) * MAX_STUMPS
    tile = tile_of(np.ones((12, 60)))
    for sign in (1, -1):
        model = model_of(
            tuple(msgspec.structs.replace(stump, below=sign * MAX_LEAF) for stump in stumps), reject=ANY_SCORE
        )
        result = run(tile, model)
        assert set(result.scores.tolist()) == {sign * MAX_STUMPS * MAX_LEAF}
        assert set(model.calibration.log_odds_of(result.scores).tolist()) == {sign * 6.0}


# --- what may be done to a tile without a score changing ---


def test_reversing_the_track_finds_the_same_object() -> None:
    plane = with_object(speckle(5))
    there, back = (looked_at(tile_of(p), None).detections[0] for p in (plane, plane[::-1]))
    assert SHAPE[0] - back.row == pytest.approx(there.row, abs=1.0)
    assert back.column == pytest.approx(there.column, abs=1.0)
    assert back.score == pytest.approx(there.score, abs=1e-3)


def test_a_side_is_as_good_as_the_other() -> None:
    port = tile_of(with_object(speckle()))
    assert scores(run(port)) == scores(run(msgspec.structs.replace(port, side="starboard")))


@pytest.mark.parametrize("model", [None, MODEL])
def test_every_pixel_doubled_finds_the_same_object(model: CascadeModel | None) -> None:
    plane = with_object(speckle(6))
    finer = np.repeat(np.repeat(plane, 2, axis=0), 2, axis=1)
    coarse = looked_at(tile_of(plane), model).detections[0]
    fine = looked_at(tile_of(finer, row_m=0.5 * ROW_M, column_m=0.5 * COLUMN_M), model).detections[0]
    assert (fine.cascade_score == coarse.cascade_score == 3.0) or model is None
    assert fine.p_mine == pytest.approx(coarse.p_mine, abs=0.2)
    assert fine.row * 0.5 == pytest.approx(coarse.row, abs=1.0)
    assert fine.column * 0.5 == pytest.approx(coarse.column, abs=1.5)


# --- order ---


def test_of_windows_that_are_all_alike_the_first_are_kept_however_often_asked() -> None:
    tile = tile_of(np.ones(SHAPE))
    first, again = looked_at(tile, ALL_PASS), looked_at(tile, ALL_PASS)
    places = [(d.row, d.column) for d in first.detections]
    assert places == [(d.row, d.column) for d in again.detections]
    assert len(places) == 40
    assert first.n_over_budget > 0
    alike = run(tile, ALL_PASS)
    assert len(set(alike.scores.tolist())) == 1
    assert list(scores(alike)) == sorted(scores(alike))


@pytest.mark.parametrize("model", [None, MODEL])
def test_one_pixel_missing_in_a_hundred_does_not_lose_an_object(model: CascadeModel | None) -> None:
    for seed in range(3):
        found = looked_at(tile_of(with_object(speckle(seed)), holes(0.01)), model).detections[0]
        assert abs(found.row - 62.5) * ROW_M < STEP_M
        assert abs(found.column - 103.0) * COLUMN_M < STEP_M
