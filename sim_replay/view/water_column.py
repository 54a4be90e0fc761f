"""Draw pings over slant range, row by row beside the waterfall, so that water column and first bottom return show."""

from __future__ import annotations

from collections import deque
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import VALID, EchoTrace, Ping, Side, Tile
from sim_replay.view.waterfall_store import WaterfallStore

_KEPT_PINGS: Final = 8192
"""Pings that wait for their rows: a tile comes up to 25 m late, which are 1500 pings at 0.5 m/s and 30 a second."""
_SCALE_PINGS: Final = 16  # pings between two looks at what samples are dark and bright
_SHARES: Final = (2.0, 99.0)  # per cent of samples below which they are black, and above which white; chosen
_BLACK_DB, _WHITE_DB = -13.0, 14.0
"""About the mean of the sea floor: what the page shows as black and white at first."""
_INTENSITY: Final = np.concatenate([[0.0], 10.0 ** (np.linspace(_BLACK_DB, _WHITE_DB, 255) / 10.0)]).astype(
    np.float32
)  # linear, of each shade; shade 0 is no echo
_NEW_SHARE: Final = 0.2  # of the newest look at dark and bright: a change of gain is followed within some 100 pings
_NEAR_S: Final = 1.0  # s between a row and its ping, maximum


class _Drawn(NamedTuple):
    """Hold a ping as it is shown: shades of either side over slant range, None without that side."""

    time_s: float
    sides: dict[Side, NDArray[np.uint8] | None]


class WaterColumn:
    """Take pings and then the tiles that they went into; fill stores with the same rows, over slant range.

    Samples are shown as they were stored, whatever they are: from dark to bright, on a scale that follows them slowly.
    """

    def __init__(self, column_m: float, max_range_m: float) -> None:
        """column_m: slant range of a pixel. max_range_m: slant range beyond which nothing is drawn."""
        self._column_m, self._max_range_m = column_m, max_range_m
        self._pings: deque[_Drawn] = deque(maxlen=_KEPT_PINGS)
        self._n_pings = 0
        self._dark_bright: dict[Side, NDArray[np.float64]] = {}

    def add_ping(self, ping: Ping) -> None:
        """Draw a ping."""
        drawn: dict[Side, NDArray[np.uint8] | None] = {
            "port": self._draw("port", ping.port),
            "starboard": self._draw("starboard", ping.starboard),
        }
        self._n_pings += 1
        self._pings.append(_Drawn(ping.time_s, drawn))

    def add_tile(self, tile: Tile, store: WaterfallStore) -> None:
        """Write the rows that belong to a tile alone into a store. Raises OSError, as on a full disk."""
        held = [ping for ping in self._pings if ping.sides[tile.side] is not None]
        if not held:
            return
        held.sort(key=lambda ping: ping.time_s)
        times_s = np.array([ping.time_s for ping in held])
        wanted_s = tile.pose.time_s[tile.core_start : tile.core_stop]
        after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(len(times_s) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(times_s) - 1)
        nearest = np.where(wanted_s - times_s[before] <= times_s[after] - wanted_s, before, after)
        lines = [held[index].sides[tile.side] for index in nearest]
        n_columns = max(len(line) for line in lines if line is not None)
        shades = np.zeros((tile.intensity.shape[0], n_columns), dtype=np.uint8)
        for row, (line, index) in enumerate(zip(lines, nearest, strict=True), tile.core_start):
            if line is not None and abs(times_s[index] - wanted_s[row - tile.core_start]) <= _NEAR_S:
                shades[row, : len(line)] = line
        mask = np.where(shades > 0, VALID, 0).astype(np.uint8)
        store.add(msgspec.structs.replace(tile, intensity=_INTENSITY[shades], mask=mask))

    def _draw(self, side: Side, trace: EchoTrace | None) -> NDArray[np.uint8] | None:
        if trace is None or not trace.samples.size or not trace.spacing_m > 0.0:
            return None
        samples = trace.samples
        if self._n_pings % _SCALE_PINGS == 0 or side not in self._dark_bright:
            now = np.percentile(_finite(samples), _SHARES)
            before = self._dark_bright.get(side, now)
            self._dark_bright[side] = before + _NEW_SHARE * (now - before)
        dark, bright = self._dark_bright[side]
        reach_m = min(trace.first_range_m + trace.spacing_m * samples.shape[0], self._max_range_m)
        slant_m = (np.arange(max(1, int(reach_m / self._column_m))) + 0.5) * self._column_m
        index = np.rint((slant_m - trace.first_range_m) / trace.spacing_m).astype(np.int64)
        inside = (index >= 0) & (index < samples.shape[0])
        share = np.clip((_finite(samples[np.where(inside, index, 0)]) - dark) / max(bright - dark, 1e-12), 0.0, 1.0)
        return np.where(inside, 1.0 + np.rint(254.0 * share), 0.0).astype(np.uint8)


def _finite(samples: NDArray[Any]) -> NDArray[np.float64]:
    return np.nan_to_num(np.asarray(samples, dtype=np.float64), posinf=0.0, neginf=0.0)
