"""Scores of all pixels of a tile, none held back by bounds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from auv_mcm.detect import contrasts as module
from auv_mcm.detect.contrasts import contrasts
from auv_mcm.detect.prescreen import combined
from auv_mcm.records import Tile
from tests.auv_mcm.detect.scene_tiles import Plane


class AllScores(NamedTuple):
    """Deviates are 0 and scores -inf where nothing can be said."""

    score: Plane
    highlight: Plane
    shadow: Plane
    background: Plane
    small_box_variance: Plane


def all_scores(tile: Tile) -> AllScores:
    found = contrasts(tile, 1e-9)
    places = module._scored(found, np.flatnonzero(found.known))
    score, highlight, shadow = (np.full(tile.mask.shape, value, dtype=np.float32) for value in (-np.inf, 0.0, 0.0))
    highlight.ravel()[places] = bright = module._highlights_at(found, places)
    shadow.ravel()[places] = dark = module._shadows_at(found, places)
    score.ravel()[places] = combined(bright, dark)
    return AllScores(score, highlight, shadow, found.background, found.small)
