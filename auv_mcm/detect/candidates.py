"""Find where in a tile objects may be: by contrasts and, if a trained cascade fits the sonar, by both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import contrast_odds
from auv_mcm.detect.cascade.codes import CodePlane
from auv_mcm.detect.cascade.model import SCORE_UNIT, CascadeModel
from auv_mcm.detect.cascade.peaks import spaced_apart
from auv_mcm.detect.cascade.run import core_plane, run_plane, trace_plane
from auv_mcm.detect.contrasts import Contrasts, contrasts
from auv_mcm.detect.gate import Gate, may_reach, place_features
from auv_mcm.detect.prescreen import NO_ECHO, Floor, Peak
from auv_mcm.records import CONTRAST_SHARE, NAN, Tile
from auv_mcm.settings.config import DetectConfig
from auv_mcm.skips import NO_SKIPS, Skips

STEP_M: Final = 0.4
"""Peaks closer than this, along and across the track, are one candidate."""

_KEPT_PER_CANDIDATE, _MIN_KEPT = 4, 64  # windows kept apart: some stand in the margin
# Rows and columns that a peak of contrast may be off the window that the cascade scores highest
_AROUND_PX: Final = (1, 2)
_CLEAR_PEAK_P: Final = 5.8e-8
"""Tail probability of a contrast of 5.3 deviates: from there on a place may be reported at a p_mine of 0.01 without the
cascade's help. Of the small objects marked on a recorded line one, of 8.1 deviates, is reported thanks to it;
fainter peaks changed no Pd in ten scenes.
"""
_NO_LIMIT: Final = 1 << 40  # more than a tile has pixels
_FAINTEST: Final = -5.0  # deviates, where contrast is unknown, as beside what is masked


class Candidate(NamedTuple):
    """Hold a place to measure.

    peak: where, with the score of contrasts there. floor: the sea floor around. odds: log-odds of a target before
    anything of it has been measured. cascade_score: NaN without a cascade.
    """

    peak: Peak
    floor: Floor
    odds: float
    cascade_score: float


class FaintPlaces(NamedTuple):
    """Hold places that are not measured but crowd those that are, (n,) float64 each.

    Row and column of the tile, and strength as of a detection.
    """

    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    strength: NDArray[np.float64]


NO_FAINT_PLACES: Final = FaintPlaces(np.empty(0), np.empty(0), np.empty(0))


class TileCandidates(NamedTuple):
    """Hold the candidates of a tile's core, best first.

    n_over_budget: candidates beyond the limit per tile. faint: places that cannot become contacts.

    n_windows, n_evaluations, n_cut: of the cascade, as in CascadeResult; 0 without. n_rejected: windows that it
    rejected before its last group. n_bounded: as
    in Contrasts. clear_contrasts: only clear peaks of contrast were searched for.
    """

    candidates: list[Candidate]
    n_over_budget: int
    faint: FaintPlaces
    n_windows: int = 0
    n_evaluations: int = 0
    n_cut: int = 0
    n_rejected: int = 0
    n_bounded: int = 0
    clear_contrasts: bool = False


def by_contrast(
    tile: Tile, config: DetectConfig, gate: Gate | None, min_p_mine: float, without_skips: Skips = NO_SKIPS
) -> TileCandidates:
    """Find peaks of the contrast of highlight and shadow against the sea floor around.

    Parameters
    ----------
    gate, min_p_mine
        As for by_both.
    """
    contrast = contrasts(tile, config.p_false_alarm, bounded="contrast-bounds" not in without_skips)
    peaks = contrast.peaks(STEP_M)
    scores = np.array([peak.score for peak in peaks])
    features = place_features(*_ranges(tile, peaks), contrast=scores)
    reaching = may_reach(None if gate is None or "gate" in without_skips else gate.contrast, min_p_mine, features)
    passing = np.flatnonzero(reaching)
    taken = [peaks[k] for k in passing[: _max_candidates(config, without_skips)].tolist()]
    candidates = [
        Candidate(peak, contrast.floor(peak.row, peak.column), contrast_odds(peak.score), NAN) for peak in taken
    ]
    faint = _faint([peaks[k] for k in np.flatnonzero(~reaching).tolist()], scores[~reaching])
    return TileCandidates(candidates, len(passing) - len(taken), faint, n_bounded=contrast.n_bounded)


def by_both(
    tile: Tile,
    model: CascadeModel,
    config: DetectConfig,
    max_evaluations: int | None,
    gate: Gate | None,
    min_p_mine: float,
    without_skips: Skips = NO_SKIPS,
) -> TileCandidates:
    """Find the best windows that pass the trained cascade, and the peaks of contrast that it rejects.

    A cascade recognises only what it was trained on. What stands out clearly and is unlike that is still measured, with
    odds to match.

    Without a gate nothing is dropped.

    Parameters
    ----------
    max_evaluations
        The cascade's budget, None for none. The peaks are scored whatever it is, so that a tile whose windows are all
        beyond it is served by contrasts; their cost comes out of it first.
    gate, min_p_mine
        What cannot become a contact of that p_mine is dropped, and of the contrast only clear peaks are searched for.
    """
    clear_alone = gate is not None and min_p_mine > 0.0 and "faint-contrasts" not in without_skips
    p_false_alarm = min(config.p_false_alarm, _CLEAR_PEAK_P) if clear_alone else config.p_false_alarm
    contrast = contrasts(tile, p_false_alarm, bounded="contrast-bounds" not in without_skips)
    peaks = contrast.peaks(STEP_M)
    plane = core_plane(tile)
    max_scored = _max_candidates(config, without_skips)
    peak_scores, n_spent = _scores_of(plane, model, peaks, max_scored)
    passed = run_plane(plane, model, None if max_evaluations is None else max(max_evaluations - n_spent, 0))
    del plane  # 16 MB of a wide tile
    half_rows, half_columns = STEP_M / tile.row_spacing_m, STEP_M / tile.column_spacing_m
    # Where nothing around echoes, no comparison holds, and a cascade passes all windows or none.
    heard = contrast.background[passed.rows, passed.columns] > NO_ECHO
    windows = _Places(passed.rows, passed.columns, passed.scores / SCORE_UNIT).some(heard)
    n_kept = _KEPT_PER_CANDIDATE * max_scored + _MIN_KEPT
    windows = windows.some(spaced_apart(windows.rows, windows.columns, windows.scores, half_rows, half_columns, n_kept))
    places = [
        *_clearest(contrast, windows.rows.tolist(), windows.columns.tolist(), int(half_rows), int(half_columns)),
        *peaks,
    ]
    cascade_scores = np.concatenate((windows.scores, peak_scores / SCORE_UNIT))
    rows, columns = (np.array([place[k] for place in places], dtype=np.int64) for k in (1, 2))
    contrast_scores = np.array([max(place.score, _FAINTEST) for place in places])
    strength = cascade_scores + CONTRAST_SHARE * contrast_scores
    kept = spaced_apart(rows, columns, strength, half_rows, half_columns, len(places))
    kept = kept[(rows[kept] >= tile.core_start) & (rows[kept] < tile.core_stop)]
    features = place_features(
        *_ranges(tile, [places[k] for k in kept.tolist()]), cascade=cascade_scores[kept], contrast=contrast_scores[kept]
    )
    reaching = may_reach(None if gate is None or "gate" in without_skips else gate.both, min_p_mine, features)
    passing, faint = kept[reaching], kept[~reaching]
    taken = passing[:max_scored]
    odds = model.calibration.log_odds_of(np.rint(cascade_scores[taken] * SCORE_UNIT).astype(np.int64)).tolist()
    candidates = [
        Candidate(places[k], contrast.floor(places[k].row, places[k].column), odd, float(cascade_scores[k]))
        for k, odd in zip(taken.tolist(), odds, strict=True)
    ]
    return TileCandidates(
        candidates,
        n_over_budget=len(passing) - len(taken),
        faint=_faint([places[k] for k in faint.tolist()], strength[faint]),
        n_windows=passed.n_windows,
        n_evaluations=passed.n_evaluations + n_spent,
        n_cut=passed.n_cut,
        n_rejected=passed.n_rejected,
        n_bounded=contrast.n_bounded,
        clear_contrasts=clear_alone,
    )


def _max_candidates(config: DetectConfig, without_skips: Skips) -> int:
    """Return the maximum number of candidates of a tile."""
    return _NO_LIMIT if "candidate-limit" in without_skips else config.max_candidates_per_tile


def _scores_of(
    plane: CodePlane, model: CascadeModel, peaks: Sequence[Peak], max_scored: int
) -> tuple[NDArray[np.int32], int]:
    """Score each peak's best window within AROUND_PX by the cascade, whatever it rejects.

    Returns the scores, (n_peaks,) int32, and the number of evaluations. Peaks beyond the first `max_scored` get the
    score of the calibration's lowest odds.
    """
    offsets = [
        (row, column)
        for row in range(-_AROUND_PX[0], _AROUND_PX[0] + 1)
        for column in range(-_AROUND_PX[1], _AROUND_PX[1] + 1)
    ]
    each = len(offsets) * model.n_stumps
    n_scored = min(len(peaks), max_scored)
    scores = np.full(len(peaks), model.calibration.score[0], dtype=np.int32)
    if n_scored:
        around = np.array(offsets)
        places = np.array([(peak.row, peak.column) for peak in peaks[:n_scored]])[:, np.newaxis] + around
        rows = np.clip(places[..., 0], 0, plane.n_rows - 1).ravel()
        columns = np.clip(places[..., 1], 0, plane.n_columns - 1).ravel()
        scores[:n_scored] = trace_plane(plane, model, rows, columns)[:, -1].reshape(n_scored, -1).max(axis=1)
    return scores, n_scored * each


class _Places(NamedTuple):
    """Hold places of a tile, (n,) each: row and column of the pixel, cascade score in half a log-odds."""

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    scores: NDArray[np.float64]

    def some(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> _Places:
        return _Places(self.rows[chosen], self.columns[chosen], self.scores[chosen])


def _ranges(tile: Tile, peaks: Sequence[Peak]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute ground range and first return of each peak, m, (n,) each."""
    rows, columns = (np.array([peak[k] for peak in peaks], dtype=np.int64) for k in (1, 2))
    return np.asarray((columns + 0.5) * tile.column_spacing_m, dtype=np.float64), tile.first_return_m[rows]


def _faint(peaks: Sequence[Peak], strength: NDArray[np.float64]) -> FaintPlaces:
    rows, columns = (np.array([peak[k] for peak in peaks], dtype=np.float64) for k in (1, 2))
    return FaintPlaces(rows, columns, strength)


def _clearest(
    contrast: Contrasts, rows: list[int], columns: list[int], half_rows: int, half_columns: int
) -> list[Peak]:
    """Find the pixel around each (row, column) where contrast is clearest.

    A window that the cascade scores high need not stand on the highlight's middle.
    """
    clearest = contrast.clearest(rows, columns, half_rows, half_columns)
    return [
        peak if peak.score > _FAINTEST else Peak(_FAINTEST, row, column)
        for peak, row, column in zip(clearest, rows, columns, strict=True)
    ]
