"""Where in a tile objects may be: by the trained cascade if there is a model for the sonar, else by contrasts alone.

The cascade looks at every pixel first, since it costs a tenth of the contrasts, which are then taken only around what it leaves.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from auv_mcm.config import DetectConfig
from auv_mcm.detect.belief import contrast_odds
from auv_mcm.detect.cascade.model import SCORE_UNIT, CascadeModel
from auv_mcm.detect.cascade.peaks import apart
from auv_mcm.detect.cascade.run import run_cascade
from auv_mcm.detect.prescreen import Floor, Peak, find_peaks, score_places, score_tile
from auv_mcm.records import NAN, Tile

STEP_M: Final = 0.4
"""Peaks closer than this, along and across the track, are one candidate."""

_MARGIN_CANDIDATES: Final = 2  # looked for in the margin around the core for each one in it


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
    maps = score_tile(tile)
    peaks = find_peaks(tile, maps, config.p_false_alarm, STEP_M)
    taken = peaks[: config.max_candidates_per_tile]
    candidates = [Candidate(peak, maps.floor(peak.row, peak.column), contrast_odds(peak.score), NAN) for peak in taken]
    return Found(candidates, len(peaks) - len(taken))


def by_cascade(tile: Tile, model: CascadeModel, config: DetectConfig, max_evaluations: int | None) -> Found:
    """The best of the windows that pass the cascade. max_evaluations: its budget, None for none."""
    passed = run_cascade(tile, model, max_evaluations)
    most = config.max_candidates_per_tile
    half_rows, half_columns = STEP_M / tile.row_spacing_m, STEP_M / tile.column_spacing_m
    best = apart(passed.rows, passed.columns, passed.scores, half_rows, half_columns, (1 + _MARGIN_CANDIDATES) * most + 1)
    best = best[(passed.rows[best] >= tile.core_start) & (passed.rows[best] < tile.core_stop)]
    taken = best[:most]
    rows, columns = passed.rows[taken], passed.columns[taken]
    scores = passed.scores[taken]
    candidates = [
        Candidate(Peak(contrast, int(row), int(column)), floor, odds, int(score) / SCORE_UNIT)
        for (contrast, floor), row, column, odds, score in zip(
            score_places(tile, rows, columns, STEP_M),
            rows,
            columns,
            model.calibration.log_odds_of(scores).tolist(),
            scores,
            strict=True,
        )
    ]
    return Found(candidates, len(best) - len(taken), passed.n_windows, passed.n_evaluations, passed.n_cut)
