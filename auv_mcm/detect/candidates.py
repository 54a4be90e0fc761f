"""Where in a tile objects may be: by contrasts of highlight and shadow and, if there is a model for the sonar, by the trained cascade."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import contrast_odds
from auv_mcm.detect.cascade.codes import Plane
from auv_mcm.detect.cascade.model import SCORE_UNIT, CascadeModel
from auv_mcm.detect.cascade.peaks import apart
from auv_mcm.detect.cascade.run import core_plane, run_plane, trace_plane
from auv_mcm.detect.contrasts import Contrasts, contrasts
from auv_mcm.detect.prescreen import NO_ECHO, Floor, Peak
from auv_mcm.records import CONTRAST_SHARE, NAN, Tile
from auv_mcm.settings.config import DetectConfig

STEP_M: Final = 0.4
"""Peaks closer than this, along and across the track, are one candidate."""

_KEPT_PER_CANDIDATE, _KEPT_AT_LEAST = 4, 64  # windows apart that are told from each other at most: some stand in the margin
_FAINTEST: Final = -5.0  # where contrast says nothing, as beside what is masked
_AROUND_PX: Final = (1, 2)  # rows and columns that a peak of contrast may be off the window that the cascade likes best


class Candidate(NamedTuple):
    """A place to measure. peak: where, with the score of contrasts there. floor: the sea floor around. odds: log-odds of an object sought,
    before anything of it has been measured. cascade_score: NaN without a cascade."""

    peak: Peak
    floor: Floor
    odds: float
    cascade_score: float


class Found(NamedTuple):
    """Candidates of a tile's core, best first. n_over_budget: more there were. n_windows, n_evaluations, n_cut: of the cascade, as
    in CascadeResult; 0 without."""

    candidates: list[Candidate]
    n_over_budget: int
    n_windows: int = 0
    n_evaluations: int = 0
    n_cut: int = 0


def by_contrast(tile: Tile, config: DetectConfig) -> Found:
    """Peaks of the contrast of highlight and shadow against the sea floor around."""
    contrast = contrasts(tile, config.p_false_alarm)
    peaks = contrast.peaks(STEP_M)
    taken = peaks[: config.max_candidates_per_tile]
    candidates = [Candidate(peak, contrast.floor(peak.row, peak.column), contrast_odds(peak.score), NAN) for peak in taken]
    return Found(candidates, len(peaks) - len(taken))


def by_both(tile: Tile, model: CascadeModel, config: DetectConfig, max_evaluations: int | None) -> Found:
    """The best of the windows that pass the cascade, and peaks of contrast that it would have dropped, with its score of them.

    A cascade knows what it was trained on. What stands out clearly and is nothing like it is no less worth a look, with odds that say so.
    max_evaluations: the cascade's budget, None for none; the peaks' scores come out of it first.
    """
    contrast = contrasts(tile, config.p_false_alarm)
    peaks = contrast.peaks(STEP_M)
    plane = core_plane(tile)
    peak_scores, n_spent = _scores_of(plane, model, peaks, config.max_candidates_per_tile, max_evaluations)
    passed = run_plane(plane, model, None if max_evaluations is None else max_evaluations - n_spent)
    most = config.max_candidates_per_tile
    half_rows, half_columns = STEP_M / tile.row_spacing_m, STEP_M / tile.column_spacing_m
    # Where nothing around echoes no comparison holds, and a cascade passes all windows or none.
    heard = np.flatnonzero(contrast.background[passed.rows, passed.columns] > NO_ECHO)
    n_kept = _KEPT_PER_CANDIDATE * most + _KEPT_AT_LEAST
    best = heard[apart(passed.rows[heard], passed.columns[heard], passed.scores[heard], half_rows, half_columns, n_kept)]
    windows = _clearest(contrast, passed.rows[best].tolist(), passed.columns[best].tolist(), int(half_rows), int(half_columns))
    cascade_scores = np.concatenate((passed.scores[best], peak_scores)) / SCORE_UNIT
    places = [*windows, *peaks]
    rows, columns = (np.array([place[k] for place in places], dtype=np.int64) for k in (1, 2))
    strength = cascade_scores + CONTRAST_SHARE * np.array([max(place.score, _FAINTEST) for place in places])
    kept = apart(rows, columns, strength, half_rows, half_columns, len(places))
    kept = kept[(rows[kept] >= tile.core_start) & (rows[kept] < tile.core_stop)]
    taken = kept[:most]
    odds = model.calibration.log_odds_of(np.rint(cascade_scores[taken] * SCORE_UNIT).astype(np.int64)).tolist()
    candidates = [
        Candidate(places[k], contrast.floor(places[k].row, places[k].column), odd, float(cascade_scores[k]))
        for k, odd in zip(taken, odds, strict=True)
    ]
    return Found(candidates, len(kept) - len(taken), passed.n_windows, passed.n_evaluations + n_spent, passed.n_cut)


def _scores_of(
    plane: Plane, model: CascadeModel, peaks: Sequence[Peak], most: int, max_evaluations: int | None
) -> tuple[NDArray[np.int32], int]:
    """The cascade's score of each peak's best window within AROUND_PX, whatever it rejects, (n_peaks,) int32, and what that took in
    evaluations. Peaks beyond the budget, or the first `most`, get the score of the calibration's lowest odds."""
    offsets = [(row, column) for row in range(-_AROUND_PX[0], _AROUND_PX[0] + 1) for column in range(-_AROUND_PX[1], _AROUND_PX[1] + 1)]
    each = len(offsets) * model.n_stumps
    n_scored = min(len(peaks), most)
    if max_evaluations is not None:
        n_scored = min(n_scored, max_evaluations // each)
    scores = np.full(len(peaks), model.calibration.score[0], dtype=np.int32)
    if n_scored:
        around = np.array(offsets)
        places = np.array([(peak.row, peak.column) for peak in peaks[:n_scored]])[:, np.newaxis] + around
        rows = np.clip(places[..., 0], 0, plane.n_rows - 1).ravel()
        columns = np.clip(places[..., 1], 0, plane.n_columns - 1).ravel()
        scores[:n_scored] = trace_plane(plane, model, rows, columns)[:, -1].reshape(n_scored, -1).max(axis=1)
    return scores, n_scored * each


def _clearest(contrast: Contrasts, rows: list[int], columns: list[int], half_rows: int, half_columns: int) -> list[Peak]:
    """The pixel around each (row, column) where contrast is clearest: a window that a cascade likes need not stand on the highlight's
    middle."""
    clearest = contrast.clearest(rows, columns, half_rows, half_columns)
    return [
        peak if peak.score > _FAINTEST else Peak(_FAINTEST, row, column) for peak, row, column in zip(clearest, rows, columns, strict=True)
    ]
