"""Know which rows of a tile were sampled too coarsely across track for a mine to be seen."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Notice, Ping, Side, Tile

MAX_SPACING_M: Final = 0.48
"""Range between samples beyond which nothing is credited. With pixels of 48 cm the best possible observer is sure to
find at most 4 % of mines of the usual sizes (docs/results.md), whatever the detector; a
truncated cone is two such samples wide."""
_MAX_CHANGES: Final = 64  # of one side, before old ones are forgotten: tiles overlap, and a damaged log may have many
_SIDES: Final[tuple[Side, ...]] = ("port", "starboard")


class Sampling:
    """Keep from when on each side's samples were too far apart, or no longer."""

    def __init__(self) -> None:
        self._changes: dict[Side, list[tuple[float, bool]]] = {side: [(-np.inf, False)] for side in _SIDES}
        self._is_reported = False

    def add(self, ping: Ping) -> list[Notice]:
        """Take a ping; return a notice where its samples are the first to be too far apart.

        Pings come in order of time within a segment.
        """
        coarsest_m = 0.0
        for side, trace in zip(_SIDES, (ping.port, ping.starboard), strict=True):
            if trace is None:
                continue
            changes, is_coarse = self._changes[side], bool(trace.spacing_m > MAX_SPACING_M)
            coarsest_m = max(coarsest_m, trace.spacing_m)
            if is_coarse != changes[-1][1]:
                changes.append((ping.time_s, is_coarse))
        if coarsest_m <= MAX_SPACING_M or self._is_reported:
            return []
        self._is_reported = True
        text = (
            f"samples are {coarsest_m:.2f} m of range apart: beyond {MAX_SPACING_M:g} m no mine stands out from the "
            "sea floor, and nothing counts as covered. Log more samples a ping or set a shorter range."
        )
        return [Notice(code="coverage.samples_too_coarse", text=text, place=ping.place)]

    def start_segment(self) -> None:
        """Forget former changes: the tiles before are done, and the clock may have been set back."""
        for changes in self._changes.values():
            changes[:] = [(-np.inf, changes[-1][1])]

    def coarse_rows(self, tile: Tile) -> NDArray[np.bool_]:
        """Select the rows of a tile whose samples are too far apart, (n_rows,); tiles come in order of time."""
        changes = self._changes[tile.side]
        times_s, is_coarse = (np.array(values) for values in zip(*changes, strict=True))
        at = np.maximum(np.searchsorted(times_s, tile.pose.time_s, side="right") - 1, 0)
        if len(changes) > _MAX_CHANGES:
            del changes[: int(at.min(initial=len(changes) - 1))]
        return np.asarray(is_coarse[at], dtype=np.bool_)
