"""Find what is called mine-like in recorded pictures, by the detector alone and after confirmation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from auv_mcm.classify.odds import MineOdds
from auv_mcm.confirmation import confirm_detection
from auv_mcm.records import Detection
from tests.real.pictures.real_pictures import Picture
from tests.real.pictures.real_tiles import Geometry, config_of, detections_of, tile_of_picture

CALLED: Final = (0.5, 0.2)
"""p_mine from which a detection counts as a call."""


class Called(NamedTuple):
    """Count calls in one picture without the object, per threshold of CALLED, by the detector alone and after
    confirmation.
    """

    picture: Picture
    geometry: Geometry
    detections: tuple[Detection, ...]
    looked_at: tuple[Detection, ...]

    def n_detector(self, threshold: float) -> int:
        return sum(d.p_mine >= threshold for d in self.detections)

    def n_confirmed(self, threshold: float) -> int:
        return sum(is_call(d, threshold) for d in self.looked_at)


def call(picture: Picture, geometry: Geometry, odds: MineOdds) -> Called:
    """Return the detections called mine-like in a picture without the object."""
    tile, config = tile_of_picture(picture, geometry), config_of(geometry)
    detections = detections_of(tile, config)
    beam_width_rad = math.radians(geometry.beam_width_deg)
    looked_at = tuple(confirm_detection(detection, beam_width_rad, odds, config.confirm) for detection in detections)
    return Called(picture, geometry, tuple(detections), looked_at)


def is_call(detection: Detection, threshold: float) -> bool:
    """Report whether a confirmed detection is called mine-like and its contours do not contradict it."""
    return detection.p_mine >= threshold and not (
        detection.confirmation is not None and detection.confirmation.rejected
    )


def n_kept(of_object: Sequence[float], of_none: Sequence[float], n_false: int) -> int:
    """Count the object's probabilities above all but `n_false` of those of anything else."""
    ordered = sorted(of_none, reverse=True)
    min_p = ordered[n_false] if n_false < len(ordered) else -math.inf
    return sum(p > min_p for p in of_object)
