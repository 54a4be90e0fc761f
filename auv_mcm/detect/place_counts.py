"""Count the places of a mission by ground range and strength, measured or not, for statistics of false alarms."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import numpy as np

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.records import Tile

RANGE_BAND_M: Final = 10.0  # m of ground range per row of the table in the summary
STRENGTH_STEP: Final = 0.5
"""Of the detector's strength: the cascade's score and a share of the contrast, or the contrast alone, in its deviates.
"""


class PlaceCounts:
    """Count strengths in bands of ground range."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[int, int]] = Counter()

    def add(self, tile: Tile, found: TileDetections) -> None:
        """Count the detections of a tile and the faint places beside them."""
        columns = np.concatenate([found.faint.columns, [detection.column for detection in found.detections]])
        strength = np.concatenate([found.faint.strength, [detection.strength for detection in found.detections]])
        bands = np.floor(columns * tile.column_spacing_m / RANGE_BAND_M).astype(int).tolist()
        steps = np.floor(strength / STRENGTH_STEP).astype(int).tolist()
        self._counts.update(zip(bands, steps, strict=True))

    def table(self) -> dict[str, Any]:
        """Lay the histogram out for JSON.

        Keys are the near edge of the band, m, then the lower edge of the strength; values are numbers of places.
        """
        counts: dict[str, dict[str, int]] = {}
        for (band, step), n_places in sorted(self._counts.items()):
            counts.setdefault(f"{band * RANGE_BAND_M:g}", {})[f"{step * STRENGTH_STEP:g}"] = n_places
        return {"range_band_m": RANGE_BAND_M, "strength_step": STRENGTH_STEP, "counts": counts}
