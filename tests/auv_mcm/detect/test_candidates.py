"""Candidates of the trained cascade: what they carry, the budget, the gate, and that contrasts are measured as in the
whole tile."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.candidates import STEP_M, Candidate, TileCandidates, by_both, by_contrast
from auv_mcm.detect.cascade.peaks import spaced_apart
from auv_mcm.detect.cascade.run import core_plane, trace_plane
from auv_mcm.detect.contrasts import contrasts
from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.detect.gate import Forecast, Gate
from auv_mcm.records import CONTRAST_SHARE, Tile
from auv_mcm.settings.config import Config, DetectConfig
from tests.auv_mcm.detect.drawn_cascade import MODEL
from tests.auv_mcm.detect.scene_tiles import COLUMN_M, ROW_M, make_tile, speckle

PLACES = [(40, 120), (90, 200), (140, 150)]
CONFIG = Config()


def scene() -> Tile:
    plane = speckle(3, (180, 320), spread_pixels=1.0)
    for row, column in PLACES:
        plane[row - 2 : row + 3, column - 3 : column + 4] *= 20.0
        plane[row - 2 : row + 3, column + 4 : column + 34] *= 0.02
    return make_tile(plane)


def found(tile: Tile, max_evaluations: int | None = None, most: int = 256, gate: Gate | None = None) -> TileCandidates:
    return by_both(tile, MODEL, DetectConfig(max_candidates_per_tile=most), max_evaluations, gate, 0.5)


def at(some: list[Candidate], row: int, column: int) -> Candidate:
    return next(c for c in some if abs(c.peak.row - row) * ROW_M < 0.5 and abs(c.peak.column - column) * COLUMN_M < 0.5)


def gate_at(contrast: float) -> Gate:
    """Drop what has a lower contrast, at a p_mine of 0.5."""
    forecast = Forecast(offset=-contrast, weights={"contrast": 1.0}, margin_nats=0.0)
    return Gate(fitted_on="nothing", both=forecast, contrast=forecast)


def test_objects_are_found_where_they_are_with_score_odds_and_the_floor_around_them() -> None:
    tile = scene()
    floor = contrasts(tile, 1e-4).floor
    best = found(tile).candidates
    for row, column in PLACES:
        candidate = at(best, row, column)
        assert candidate.cascade_score == 3.0
        assert candidate.odds == 6.0
        assert candidate.peak.score > 5.0
        assert candidate.floor == pytest.approx(floor(candidate.peak.row, candidate.peak.column), rel=1e-4)


def test_no_two_candidates_are_of_one_object() -> None:
    places = [(c.peak.row, c.peak.column) for c in found(scene()).candidates]
    assert all(
        abs(a[0] - b[0]) * ROW_M > STEP_M or abs(a[1] - b[1]) * COLUMN_M > STEP_M
        for i, a in enumerate(places)
        for b in places[:i]
    )


def test_beyond_the_number_of_candidates_the_best_stay_and_the_rest_is_counted() -> None:
    everything, limited = found(scene()), found(scene(), most=2)
    assert limited.candidates == everything.candidates[:2]
    assert limited.n_over_budget == len(everything.candidates) - 2


def test_a_budget_is_kept_and_what_it_cut_is_counted() -> None:
    whole = found(scene())
    assert whole.n_cut == 0
    part = found(scene(), whole.n_evaluations // 2)
    assert part.n_evaluations <= whole.n_evaluations // 2
    assert part.n_cut > 0
    result = detect_tile(scene(), CONFIG, MODEL, max_evaluations=0)
    assert result.n_cut == result.n_windows
    assert detect_tile(scene(), CONFIG, MODEL, max_evaluations=0, without_skips={"cascade-budget"}).n_cut == 0


def test_without_any_budget_clear_peaks_of_contrast_keep_the_cascades_score() -> None:
    whole, none = found(scene()).candidates, found(scene(), 0).candidates
    for row, column in PLACES:
        assert at(none, row, column).cascade_score == at(whole, row, column).cascade_score == 3.0


def test_detections_carry_the_cascades_score_and_rank_by_it() -> None:
    result = detect_tile(scene(), CONFIG, MODEL)
    assert len(result.detections) >= len(PLACES)
    assert all(
        detection.strength == detection.cascade_score + CONTRAST_SHARE * detection.score
        for detection in result.detections
    )
    assert [d.strength for d in result.detections] == sorted((d.strength for d in result.detections), reverse=True)
    alone = detect_tile(scene(), CONFIG)
    assert all(
        math.isnan(detection.cascade_score) and detection.strength == detection.score for detection in alone.detections
    )


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 300),
    most=st.integers(1, 50),
    half=st.tuples(st.floats(0.0, 9.0), st.floats(0.0, 9.0)),
)
def test_windows_apart_are_those_of_one_comparison_after_the_other(
    seed: int, n: int, most: int, half: tuple[float, float]
) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    rows, columns, scores = (rng.integers(0, k, n).astype(np.int32) for k in (40, 60, 9))
    slow: list[int] = []
    for k in sorted(range(n), key=lambda k: (-scores[k], k)):
        if len(slow) < most and all(
            abs(rows[k] - rows[o]) > half[0] or abs(columns[k] - columns[o]) > half[1] for o in slow
        ):
            slow.append(k)
    assert spaced_apart(rows, columns, scores, *half, most).tolist() == slow


@settings(max_examples=60)
@given(
    places=st.lists(
        st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(-5, 5)),
        min_size=1,
        max_size=60,
        unique_by=lambda p: p[:2],
    ),
    cut=st.integers(0, 60),
)
def test_more_windows_never_lose_a_candidate_without_a_better_one_in_reach(
    places: list[tuple[int, int, int]], cut: int
) -> None:
    places.sort(key=lambda place: -place[2])
    rows, columns, scores = np.array(places).T
    kept = spaced_apart(rows, columns, scores, 3.0, 5.0, len(places))
    few = spaced_apart(rows[:cut], columns[:cut], scores[:cut], 3.0, 5.0, len(places))
    for one in few:
        near = kept[(np.abs(rows[kept] - rows[one]) <= 3.0) & (np.abs(columns[kept] - columns[one]) <= 5.0)]
        assert (scores[near] >= scores[one]).any()
    assert (np.diff(scores[kept]) <= 0).all()


def test_windows_are_traced_to_the_same_scores_in_any_order_and_however_often(
    n_runs: Callable[[int, int], int],
) -> None:
    plane = core_plane(scene())
    rng = np.random.Generator(np.random.PCG64(5))
    rows, columns = rng.integers(20, 160, 400), rng.integers(0, 320, 400)
    rows[200:], columns[200:] = rows[:200], columns[:200]
    found = trace_plane(plane, MODEL, rows, columns)
    for one in range(0, 400, 400 // n_runs(100, 20)):
        assert np.array_equal(
            found[one : one + 1], trace_plane(plane, MODEL, rows[one : one + 1], columns[one : one + 1])
        )


def test_the_gate_leaves_candidates_as_they_are_and_counts_the_others() -> None:
    everything = found(scene())
    contrasts_of = sorted((c.peak.score for c in everything.candidates), reverse=True)
    between = 0.5 * (contrasts_of[1] + contrasts_of[2])
    gated = found(scene(), gate=gate_at(between))
    assert gated.candidates == [c for c in everything.candidates if c.peak.score > between]
    assert len(gated.faint.rows) > 0
    strength = {
        round(c.cascade_score + CONTRAST_SHARE * c.peak.score, 6)
        for c in everything.candidates
        if c.peak.score < between
    }
    assert {round(float(value), 6) for value in gated.faint.strength} <= strength


def test_what_stands_out_but_is_nothing_the_cascade_knows_is_a_candidate_with_its_score() -> None:
    plane = np.ones((180, 320), dtype=np.float32) * speckle(3, (180, 320), spread_pixels=1.0)
    plane[90:93, 200:202] *= 60.0  # bright, with nothing dark behind
    plane[90:93, 203:225] *= 0.02
    tile = make_tile(plane)
    known, clear = (at(some.candidates, 91, 201) for some in (found(tile), found(tile, gate=gate_at(5.3))))
    assert known.peak.score > 5.3
    assert clear == known


def test_contrasts_alone_pass_the_same_gate() -> None:
    config = DetectConfig()
    everything = by_contrast(scene(), config, None, 0.5)
    gated = by_contrast(scene(), config, gate_at(5.0), 0.5)
    assert gated.candidates == [c for c in everything.candidates if c.peak.score >= 5.0]
    assert 0 < len(gated.faint.rows) == len(everything.candidates) - len(gated.candidates)


def test_nothing_passes_on_a_masked_tile() -> None:
    tile = make_tile(np.ones((64, 64), dtype=np.float32), mask=np.zeros((64, 64), dtype=np.uint8))
    assert found(tile).candidates == []
