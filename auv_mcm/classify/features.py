"""Express the measurements of confirmation as features of moderate size for log-odds.

Each step has the features of the steps before it. Evidence in nats is compressed, so that one very bright echo does not
outvote all else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fit import Highlight, ShapeFits
from auv_mcm.confirm import snake_rules
from auv_mcm.confirm.region import HIGHLIGHT, Region
from auv_mcm.confirm.snake import Contours
from auv_mcm.detect.belief import odds_of
from auv_mcm.detect.gate import LOG_RANGE
from auv_mcm.kernels.snake_descent import row_intervals
from auv_mcm.records import Detection

Features: TypeAlias = dict[str, float]

_NATS: Final = 5.0  # nats: below it evidence counts about in full, above it by its logarithm
_NO_SOLID: Final = 20.0  # nats: cost where no solid explains anything
_NO_ALTITUDE: Final = 0.2  # relative error of an altitude that no solid bears out
_MIN_PLAUSIBILITY: Final = 1e-3  # bounds the logarithm of a plausibility of 0 to -6.9 nats
_TEMPER: Final = 4.0  # nats a solid loses per nat of plausibility of its size; chosen, not measured
_MAX_ODDS: Final = 6.0  # nats: as far as the detector's log-odds count, the bound of detect.belief
_MAX_SCORE: Final = 15.0  # as far as a score of cascade or contrasts counts: one extreme value must not decide alone
_MIN_ROWS: Final = 4  # of an edge whose bend can be measured
_MIN_AREA_M2: Final = 0.01  # m²: keeps the logarithm of an empty highlight finite
_MAX_M: Final = 3.0  # m: no shape of an object differs by more; bounds outliers of the outline


def detector_features(detection: Detection) -> Features:
    """Describe a detection alone.

    Levels that were not measured count as 0 and have a feature that marks them.

    `range`: ln(ground range / altitude). The worth of a level or of odds
    changes with it: near objects have faint highlights and short shadows.
    Detections of the trained cascade have its score and, beside it, that of contrasts.
    """
    ratio = detection.ground_range_m / detection.altitude_m if detection.altitude_m > 0.0 else math.nan
    odds = min(max(odds_of(detection.p_mine), -_MAX_ODDS), _MAX_ODDS)
    highlight_db = known(detection.highlight_db, 0.0)
    log_range = min(max(math.log(ratio), LOG_RANGE[0]), LOG_RANGE[1]) if 0.0 < ratio < math.inf else 0.0
    trained: Features = {}
    if not math.isnan(detection.cascade_score):
        score = min(max(detection.cascade_score, -_MAX_SCORE), _MAX_SCORE)
        contrast = min(max(known(detection.score, 0.0), -_MAX_SCORE), _MAX_SCORE)
        trained = {"cascade_score": score, "cascade_score_by_range": score * log_range, "contrast": contrast}
    return {
        "detector_odds": odds,
        "highlight_db": highlight_db,
        "shadow_db": known(detection.shadow_db, 0.0),
        **_as_features(detection.reasons, ("no_highlight", "no_shadow", "too_large", "crowded")),
        "range": log_range,
        "range_squared": log_range**2,
        "detector_odds_by_range": odds * log_range,
        "highlight_db_by_range": highlight_db * log_range,
        **trained,
    }


def contour_features(contours: Contours) -> Features:
    """Describe converged contours."""
    shadow = contours.shadow_mean / contours.background_mean if contours.background_mean > 0.0 else math.nan
    broken = sum(code in snake_rules.REJECTING for code in contours.reasons)
    return {
        "contour_gain": compressed(known(contours.gain, -10.0 * _NATS)),
        "contour_repetition": math.log1p(min(max(known(contours.repetition, 5.0), 0.0), 50.0)),
        "contour_height_m": known(contours.height_m, 0.0),
        "contour_shadow": known(shadow, 1.0),
        "contour_rules_broken": float(min(broken, 3)),
        "contour_without_highlight": float(len(contours.highlight) == 0),
        "contour_without_shadow": float(len(contours.shadow) == 0),
    }


def outline_features(contours: Contours, region: Region) -> Features:
    """Describe the course of contours: extents along track, bends and roughness of edges, level and area of highlight.

    Mines have plain edges; those of rocks bend and jump from row to row.
    """
    highlight, shadow = (_Edges.of(nodes, region) for nodes in (contours.highlight, contours.shadow))
    level = contours.highlight_mean / contours.background_mean if contours.background_mean > 0.0 else math.nan
    return {
        "highlight_level": math.log(level) if 0.0 < level < math.inf else 0.0,
        "highlight_area": math.log(contours.highlight_area_m2 + _MIN_AREA_M2),
        "highlight_length_m": highlight.length_m,
        "shadow_length_m": shadow.length_m,
        "highlight_front_bend_m": _bend_m(highlight.near_m),
        "shadow_end_bend_m": _bend_m(shadow.far_m),
        "shadow_front_roughness_m": _roughness_m(shadow.near_m),
    }


class _Edges(NamedTuple):
    """Hold near and far edge of a contour in each of its rows (n_rows,), and its extent along the track."""

    near_m: NDArray[np.float64]
    far_m: NDArray[np.float64]
    length_m: float

    @classmethod
    def of(cls, nodes: NDArray[np.float64], region: Region) -> _Edges:
        if not len(nodes):
            return cls(np.empty(0), np.empty(0), 0.0)
        rows, near, far = row_intervals(nodes, region.intensity.shape)
        near_m, far_m = (side.astype(np.float64) * region.column_spacing_m for side in (near, far))
        return cls(near_m, far_m, float(np.ptp(rows) + 1) * region.row_spacing_m if len(rows) else 0.0)


def _bend_m(edge_m: NDArray[np.float64]) -> float:
    """Measure how far an edge (n_rows,) bends from a straight one, from end to end."""
    n_rows = len(edge_m)
    if n_rows < _MIN_ROWS:
        return 0.0
    along = np.arange(n_rows) - 0.5 * (n_rows - 1)
    square = along**2 - (along**2).mean()
    return min(abs(float(square @ edge_m) / float(square @ square)) * n_rows**2, _MAX_M)


def _roughness_m(edge_m: NDArray[np.float64]) -> float:
    """Compute the standard deviation of an edge (n_rows,) from a straight one."""
    n_rows = len(edge_m)
    if n_rows < _MIN_ROWS:
        return 0.0
    along = np.arange(n_rows) - 0.5 * (n_rows - 1)
    slope = float(along @ edge_m) / float(along @ along)
    return min(float((edge_m - slope * along).std()), _MAX_M)


def shape_features(fits: ShapeFits, labels: NDArray[np.uint8]) -> Features:
    """Describe the solids fitted and the labels (n_rows, n_columns) of the Markov field."""
    best = fits.fits[0] if fits.fits else None
    explained = [(known(fit.best.cost, _NO_SOLID), known(fit.plausibility, 0.0)) for fit in fits.fits]
    cost, plausible = explained[0] if explained else (_NO_SOLID, 0.0)
    weighed = min(
        (nats - _TEMPER * math.log(max(share, _MIN_PLAUSIBILITY)) for nats, share in explained), default=2.0 * _NO_SOLID
    )
    contour = cost if fits.contour_cost is None else known(fits.contour_cost, cost)
    return {
        "shape_evidence": -compressed(cost),
        "shape_evidence_of_usual_size": -compressed(weighed),
        "shape_plausibility": plausible,
        "shape_over_contours": compressed(contour - cost),
        "shape_altitude_off": _NO_ALTITUDE
        if best is None
        else known(abs(best.best.altitude_ratio - 1.0), _NO_ALTITUDE),
        **_as_features(() if best is None else best.flags, ("at_bound", "cut_off")),
        "labelled_highlight": float((labels == HIGHLIGHT).mean()) if labels.size else 0.0,
        "highlight_deeper_m": 0.0 if best is None else _deeper_m(best.highlight),
        "burial_m": 0.0 if best is None else float(getattr(best.best.shape, "burial_m", 0.0)),
    }


def with_shape(before: Features, shape: Features) -> Features:
    """Add evidence of shape, also by range, to the features."""
    return before | shape | {"shape_evidence_by_range": shape["shape_evidence"] * before["range"]}


def _deeper_m(highlight: Highlight) -> float:
    """Measure how much farther across the track a highlight reaches than its solid's."""
    return min(max(known(highlight.observed_across_m - highlight.model_across_m, 0.0), -_MAX_M), _MAX_M)


def compressed(nats: float) -> float:
    """Compress evidence: sign(x) ln(1 + |x| / 5)."""
    return math.copysign(math.log1p(abs(nats) / _NATS), nats)


def known(value: float, otherwise: float) -> float:
    """Give `value` if it is a finite number, else `otherwise`."""
    return value if math.isfinite(value) else otherwise


def _as_features(codes: Iterable[str], names: tuple[str, ...]) -> Features:
    return {name: float(name in codes) for name in names}
