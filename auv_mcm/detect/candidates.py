"""Where in a tile objects may be: by contrasts of highlight and shadow and, if there is a model for the sonar, by the trained cascade."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import contrast_odds
from auv_mcm.detect.cascade.model import SCORE_UNIT, CascadeModel
from auv_mcm.detect.cascade.peaks import apart
from auv_mcm.detect.cascade.run import core_plane, run_plane
from auv_mcm.detect.contrasts import Contrasts, contrasts, unscored
from auv_mcm.detect.gate import Forecast, Gate, may_reach, place_features
from auv_mcm.detect.prescreen import NO_ECHO, Floor, Peak
from auv_mcm.records import CONTRAST_SHARE, NAN, Tile
from auv_mcm.settings.config import DetectConfig

STEP_M: Final = 0.4
"""Peaks closer than this, along and across the track, are one candidate."""

_KEPT_PER_CANDIDATE, _KEPT_AT_LEAST = 4, 64  # windows apart that are told from each other at most: some stand in the margin
_FAINTEST: Final = -5.0  # where contrast says nothing, as beside what is masked


class Candidate(NamedTuple):
    """A place to measure. peak: where, with the score of contrasts there. floor: the sea floor around. odds: log-odds of an object sought,
    before anything of it has been measured. cascade_score: NaN without a cascade."""

    peak: Peak
    floor: Floor
    odds: float
    cascade_score: float


class FaintPlaces(NamedTuple):
    """Places that are not measured but crowd those that are, (n,) float64 each: row and column of the tile, and strength as of a
    detection."""

    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    strength: NDArray[np.float64]


NO_FAINT_PLACES: Final = FaintPlaces(np.empty(0), np.empty(0), np.empty(0))


class Found(NamedTuple):
    """Candidates of a tile's core, best first. n_over_budget: more there were. n_gated: places that cannot become contacts; faint: those of
    them whose contrast is known. n_windows, n_evaluations, n_cut: of the cascade, as in CascadeResult; 0 without."""

    candidates: list[Candidate]
    n_over_budget: int
    n_gated: int
    faint: FaintPlaces
    n_windows: int = 0
    n_evaluations: int = 0
    n_cut: int = 0


def by_contrast(tile: Tile, config: DetectConfig, gate: Gate | None, min_p_mine: float) -> Found:
    """Find peaks of the contrast of highlight and shadow against the sea floor around. gate, min_p_mine: as for by_cascade."""
    contrast = contrasts(tile, config.p_false_alarm)
    peaks = contrast.peaks(STEP_M)
    scores = np.array([peak.score for peak in peaks])
    features = place_features(*_ranges(tile, peaks), contrast=scores)
    reaching = may_reach(None if gate is None else gate.contrast, min_p_mine, features)
    passing = np.flatnonzero(reaching)
    taken = [peaks[k] for k in passing[: config.max_candidates_per_tile].tolist()]
    candidates = [Candidate(peak, contrast.floor(peak.row, peak.column), contrast_odds(peak.score), NAN) for peak in taken]
    faint = _faint([peaks[k] for k in np.flatnonzero(~reaching).tolist()], scores[~reaching])
    return Found(candidates, len(passing) - len(taken), len(peaks) - len(passing), faint)


def by_cascade(
    tile: Tile, model: CascadeModel, config: DetectConfig, max_evaluations: int | None, gate: Gate | None, min_p_mine: float
) -> Found:
    """Find the best of the windows that pass the trained cascade, each with its contrast against the sea floor around.

    max_evaluations: the cascade's budget, None for none. gate, min_p_mine: what cannot become a contact of that p_mine is dropped, by its
    score first, then with its contrast, which is measured around what is left alone. Without a gate nothing is dropped.
    """
    by_score, by_both = (None, None) if gate is None else (gate.cascade, gate.both)
    passed = run_plane(core_plane(tile), model, max_evaluations)
    spent = (passed.n_windows, passed.n_evaluations, passed.n_cut)
    half_rows, half_columns = STEP_M / tile.row_spacing_m, STEP_M / tile.column_spacing_m
    places = _Places(passed.rows, passed.columns, passed.scores / SCORE_UNIT)
    if not _reaching(by_score, min_p_mine, tile, places).any():
        return Found([], 0, _n_apart(tile, places, half_rows, half_columns), NO_FAINT_PLACES, *spent)
    contrast = unscored(tile)
    # Where nothing around echoes no comparison holds, and a cascade passes all windows or none.
    places = places.some(contrast.background[places.rows, places.columns] > NO_ECHO)
    most = config.max_candidates_per_tile
    n_kept = _KEPT_PER_CANDIDATE * most + _KEPT_AT_LEAST
    places = places.some(apart(places.rows, places.columns, places.scores, half_rows, half_columns, n_kept))
    likely = places.some(_reaching(by_score, min_p_mine, tile, places))
    peaks = _clearest(contrast, likely.rows.tolist(), likely.columns.tolist(), int(half_rows), int(half_columns))
    rows, columns = (np.array([peak[k] for peak in peaks], dtype=np.int64) for k in (1, 2))
    contrast_scores = np.array([peak.score for peak in peaks])
    strength = likely.scores + CONTRAST_SHARE * contrast_scores
    kept = apart(rows, columns, strength, half_rows, half_columns, len(peaks))
    kept = kept[(rows[kept] >= tile.core_start) & (rows[kept] < tile.core_stop)]
    features = place_features(*_ranges(tile, [peaks[k] for k in kept]), cascade=likely.scores[kept], contrast=contrast_scores[kept])
    reaching = may_reach(by_both, min_p_mine, features)
    passing, faint = kept[reaching], kept[~reaching]
    taken = passing[:most]
    odds = model.calibration.log_odds_of(np.rint(likely.scores[taken] * SCORE_UNIT).astype(np.int64)).tolist()
    candidates = [
        Candidate(peaks[k], contrast.floor(peaks[k].row, peaks[k].column), odd, float(likely.scores[k]))
        for k, odd in zip(taken.tolist(), odds, strict=True)
    ]
    in_core = np.count_nonzero((places.rows >= tile.core_start) & (places.rows < tile.core_stop))
    n_gated = max(int(in_core) - len(passing), 0)
    return Found(candidates, len(passing) - len(taken), n_gated, _faint([peaks[k] for k in faint.tolist()], strength[faint]), *spent)


class _Places(NamedTuple):
    """Places of a tile, (n,) each: row and column of the pixel, and the cascade's score in units of half a log-odds."""

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    scores: NDArray[np.float64]

    def some(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> _Places:
        return _Places(self.rows[chosen], self.columns[chosen], self.scores[chosen])


def _reaching(forecast: Forecast | None, min_p_mine: float, tile: Tile, places: _Places) -> NDArray[np.bool_]:
    ground_range_m = np.asarray((places.columns + 0.5) * tile.column_spacing_m, dtype=np.float64)
    features = place_features(ground_range_m, tile.first_return_m[places.rows], cascade=places.scores)
    return may_reach(forecast, min_p_mine, features)


def _ranges(tile: Tile, peaks: Sequence[Peak]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ground range and first return of each peak, (n,) each."""
    rows, columns = (np.array([peak[k] for peak in peaks], dtype=np.int64) for k in (1, 2))
    return np.asarray((columns + 0.5) * tile.column_spacing_m, dtype=np.float64), tile.first_return_m[rows]


def _faint(peaks: Sequence[Peak], strength: NDArray[np.float64]) -> FaintPlaces:
    rows, columns = (np.array([peak[k] for peak in peaks], dtype=np.float64) for k in (1, 2))
    return FaintPlaces(rows, columns, strength)


def _n_apart(tile: Tile, places: _Places, half_rows: float, half_columns: float) -> int:
    """Count the places of the core that are apart from better ones."""
    kept = apart(places.rows, places.columns, places.scores, half_rows, half_columns, places.rows.size)
    rows = places.rows[kept]
    return int(np.count_nonzero((rows >= tile.core_start) & (rows < tile.core_stop)))


def _clearest(contrast: Contrasts, rows: list[int], columns: list[int], half_rows: int, half_columns: int) -> list[Peak]:
    """The pixel around each (row, column) where contrast is clearest: a window that a cascade likes need not stand on the highlight's
    middle."""
    clearest = contrast.clearest(rows, columns, half_rows, half_columns)
    return [
        peak if peak.score > _FAINTEST else Peak(_FAINTEST, row, column) for peak, row, column in zip(clearest, rows, columns, strict=True)
    ]
