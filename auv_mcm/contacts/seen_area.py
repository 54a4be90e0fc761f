"""Add up the sea floor that was covered, counting overlap of whole cells once."""

from __future__ import annotations

import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import CoveragePatch, SurveyedCells

_BLOCK: Final = 64  # cells on the side of a block: 16 kB each, 256 m at cells of 4 m


class SeenArea:
    """Sum coverage patches over the cells of the mission's plane: of each cell no more counts than its whole area.

    What passes saw of one cell adds up to that, also where they saw the same part; see `Clearance`.

    Cells lie in blocks that come into being where something was covered. So memory grows with the area, about 0.3 MB
    per km².
    """

    def __init__(self) -> None:
        self._blocks: dict[tuple[int, int], NDArray[np.float32]] = {}
        self._m2 = 0.0

    def __getstate__(self) -> dict[str, Any]:
        """Give the blocks packed, a seventh as large: most cells were seen wholly or not at all."""
        return vars(self) | {
            "_blocks": {place: zlib.compress(block.tobytes(), 1) for place, block in self._blocks.items()}
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        for place, packed in state["_blocks"].items():
            block = np.frombuffer(bytearray(zlib.decompress(packed)), dtype=np.float32)
            self._blocks[place] = block.reshape(_BLOCK, _BLOCK)

    @property
    def km2(self) -> float:
        """Return the area covered so far, km²."""
        return self._m2 * 1e-6

    def add(self, patch: CoveragePatch) -> None:
        """Add a patch. What could not be placed on Earth lies in no cell, and counts in full."""
        if patch.cells is None:
            self._m2 += patch.covered_m2
        else:
            self._m2 += self._newly_seen_m2(patch.cells)

    def _newly_seen_m2(self, cells: SurveyedCells) -> float:
        block = np.stack([cells.east_index // _BLOCK, cells.north_index // _BLOCK], axis=1)
        new = 0.0
        for east, north in np.unique(block, axis=0).tolist():
            chosen = (block[:, 0] == east) & (block[:, 1] == north)
            seen = self._blocks.setdefault((east, north), np.zeros((_BLOCK, _BLOCK), dtype=np.float32))
            place = cells.east_index[chosen] - east * _BLOCK, cells.north_index[chosen] - north * _BLOCK
            before = seen[place].astype(np.float64)
            after = np.minimum(before + cells.fraction[chosen], 1.0).astype(np.float32)
            new += float((after - before).sum())
            seen[place] = after
        return new * cells.cell_m**2
