"""Measure details of a detection that only trees weigh: unbounded, in their units, each with its own name.

A linear sum of them would let one outlier decide. Questions whether a measure is above a threshold take no harm from
it.
"""

from __future__ import annotations

from typing import Final

from auv_mcm.classify.features import Features, known
from auv_mcm.records import Detection

_NOT_MEASURED: Final = -1.0  # of lengths and heights, which are positive


def detection_details(detection: Detection) -> Features:
    """Give the place of the detection and its size as the detector measured it."""
    return {
        "altitude_m": known(detection.altitude_m, _NOT_MEASURED),
        "ground_range_m": known(detection.ground_range_m, _NOT_MEASURED),
        "detected_length_m": known(detection.length_m, 0.0),
        "detected_width_m": known(detection.width_m, 0.0),
        "detected_height_m": known(detection.height_m, _NOT_MEASURED),
        "detected_shadow_m": known(detection.shadow_length_m, 0.0),
    }
