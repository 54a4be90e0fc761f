"""Run the detection stage with the classical classifier's odds in place of the prescreen's."""

from __future__ import annotations

import math

import msgspec

from auv_mcm.detect.belief import probability
from auv_mcm.detect.cascade.codes import codes_of
from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.records import VALID, Tile
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.classical.chips import ChipPicture, picture
from sim_replay.fitting.cascade.classical.classical_candidates import pixels_of
from sim_replay.fitting.cascade.classical.classical_model import ClassicalModel, score_picture


def tile_picture(tile: Tile) -> ChipPicture:
    """Return the tile's sums in the codes of a labelled tile."""
    valid = (tile.mask & VALID) != 0
    return picture(
        codes_of(tile.intensity, valid), valid, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m
    )


def detect_classical(tile: Tile, config: Config, model: ClassicalModel) -> TileDetections:
    """Return the prescreen's detections, best first, with the model's log-odds as score and its probability as p_mine.

    Those that too little is known of, whose odds are -inf, count as without a position and are left out.
    """
    found = detect_tile(tile, config)
    odds = score_picture(model, tile_picture(tile), *pixels_of(found.detections, tile)).tolist()
    judged = [
        msgspec.structs.replace(detection, score=value, p_mine=probability(value))
        for detection, value in zip(found.detections, odds, strict=True)
        if math.isfinite(value)
    ]
    judged.sort(key=lambda d: (-d.score, d.row, d.column))
    n_unknown = len(found.detections) - len(judged)
    return found._replace(detections=tuple(judged), n_without_position=found.n_without_position + n_unknown)
