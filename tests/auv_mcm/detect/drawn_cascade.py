"""A cascade of three comparisons that finds what is bright with something dark behind."""

from __future__ import annotations

from auv_mcm.detect.cascade.bands import FeatureBox
from auv_mcm.detect.cascade.model import SCORE_UNIT, Calibration, Stump
from tests.make.models import model_with

HIGHLIGHT = FeatureBox(-0.18, 0.18, -0.15, 0.0, 0.15, 0.0)
BEFORE = FeatureBox(-0.5, 0.5, -0.9, 0.0, -0.4, 0.0)
SHADOW = FeatureBox(-0.18, 0.18, 0.3, 0.0, 0.3, 0.8)


def stump(a: FeatureBox, b: FeatureBox, threshold: float) -> Stump:
    return Stump(kind="ratio", a=a, b=b, threshold=threshold, below=-SCORE_UNIT, above=SCORE_UNIT)


MODEL = model_with(
    ((stump(HIGHLIGHT, BEFORE, 3.0),), (stump(BEFORE, SHADOW, 3.0),), (stump(HIGHLIGHT, SHADOW, 10.0),)),
    training_sha256="0" * 64,
    row_spacing_m=(0.05, 0.2),
    column_spacing_m=(0.03, 0.1),
    calibration=Calibration(score=(-3 * SCORE_UNIT, 3 * SCORE_UNIT), log_odds=(-6.0, 6.0)),
)
