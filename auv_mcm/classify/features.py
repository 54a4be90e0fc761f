"""What the steps of a close look measure, as numbers of moderate size that log-odds can be weighed from.

Each step knows what those before it do. Evidence in nats is compressed, so that one very bright echo does not outvote all else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fit import ShapeFits
from auv_mcm.confirm import snake_rules
from auv_mcm.confirm.region import HIGHLIGHT
from auv_mcm.confirm.snake import Contours
from auv_mcm.detect.belief import odds_of
from auv_mcm.records import Detection

Features: TypeAlias = dict[str, float]

_NATS: Final = 5.0  # below it evidence counts about as it is, above it by its logarithm
_NO_SOLID: Final = 20.0  # cost where no solid explains anything
_NO_ALTITUDE: Final = 0.2  # relative, of an altitude that no solid bears out
_LEAST_PLAUSIBILITY: Final = 1e-3
_TEMPER: Final = 4.0
_MOST_ODDS: Final = 6.0


def detector_features(detection: Detection) -> Features:
    """Of a detection by itself. Levels that were not measured count as 0 and are told by a feature of their own."""
    return {
        "detector_odds": min(max(odds_of(detection.p_mine), -_MOST_ODDS), _MOST_ODDS),
        "highlight_db": _known(detection.highlight_db, 0.0),
        "shadow_db": _known(detection.shadow_db, 0.0),
        **_told(detection.reasons, ("no_highlight", "no_shadow", "too_large", "crowded")),
    }


def contour_features(contours: Contours) -> Features:
    """Of converged contours."""
    shadow = contours.shadow_mean / contours.background_mean if contours.background_mean > 0.0 else math.nan
    broken = sum(code in snake_rules.REJECTING for code in contours.reasons)
    return {
        "contour_gain": compressed(_known(contours.gain, -10.0 * _NATS)),
        "contour_repetition": math.log1p(min(max(_known(contours.repetition, 5.0), 0.0), 50.0)),
        "contour_height_m": _known(contours.height_m, 0.0),
        "contour_shadow": _known(shadow, 1.0),
        "contour_rules_broken": float(min(broken, 3)),
        "contour_without_highlight": float(len(contours.highlight) == 0),
        "contour_without_shadow": float(len(contours.shadow) == 0),
    }


def shape_features(fits: ShapeFits, labels: NDArray[np.uint8]) -> Features:
    """Of the solids fitted and of the labels (n_rows, n_columns) of the Markov field."""
    best = fits.fits[0] if fits.fits else None
    explained = [(_known(fit.best.cost, _NO_SOLID), _known(fit.plausibility, 0.0)) for fit in fits.fits]
    cost, plausible = explained[0] if explained else (_NO_SOLID, 0.0)
    weighed = min((nats - _TEMPER * math.log(max(share, _LEAST_PLAUSIBILITY)) for nats, share in explained), default=2.0 * _NO_SOLID)
    contour = cost if fits.contour_cost is None else _known(fits.contour_cost, cost)
    return {
        "shape_evidence": -compressed(cost),
        "shape_evidence_of_usual_size": -compressed(weighed),
        "shape_plausibility": plausible,
        "shape_over_contours": compressed(contour - cost),
        "shape_altitude_off": _NO_ALTITUDE if best is None else _known(abs(best.best.altitude_ratio - 1.0), _NO_ALTITUDE),
        **_told(() if best is None else best.flags, ("at_bound", "cut_off")),
        "labelled_highlight": float((labels == HIGHLIGHT).mean()) if labels.size else 0.0,
    }


def compressed(nats: float) -> float:
    """sign(x) ln(1 + |x| / 5)."""
    return math.copysign(math.log1p(abs(nats) / _NATS), nats)


def _known(value: float, otherwise: float) -> float:
    return value if math.isfinite(value) else otherwise


def _told(codes: Iterable[str], names: tuple[str, ...]) -> Features:
    return {name: float(name in codes) for name in names}
