"""Detect satellite receivers under water that go on sending plausible positions, by depth and by distance run."""

from __future__ import annotations

import math
from collections import deque
from typing import Final, Literal, NamedTuple, TypeAlias

from drivers.navigation.corrections import Position, offset_m
from drivers.navigation.reckoning import Travelled

Doubt: TypeAlias = Literal["submerged", "frozen", "not_the_way_made", "recovering"]

_WINDOW_S: Final = 20.0  # s of fixes that are compared with the distance run; chosen, not measured
_MAX_FIXES: Final = 256  # bounds memory: 20 s at 10 Hz, and some
_FROZEN_M: Final = 4.0  # run while positions stay equal to the last digit; receivers round to 2 m or finer
_WAY_SLACK: Final = 0.3  # of the distance run, for its own errors: a log that runs through a current
_N_GOOD: Final = 3  # after a doubt so many fixes in a row must be good


class _Seen(NamedTuple):
    time_s: float
    antenna: Position
    position: Position
    travelled: Travelled
    is_doubted: bool = False


class GnssWatch:
    """Accept or reject one receiver's positions. Holds at most 256 of the last 20 seconds."""

    def __init__(self, surface_depth_m: float) -> None:
        self._surface_depth_m = surface_depth_m
        self._seen: deque[_Seen] = deque(maxlen=_MAX_FIXES)
        self._same_since: _Seen | None = None
        self._n_good = _N_GOOD

    def doubt(
        self, time_s: float, antenna: Position, position: Position, depth_m: float | None, travelled: Travelled
    ) -> Doubt | None:
        """Return why a position is rejected; None if it is accepted.

        Parameters
        ----------
        antenna, position
            As the receiver sends it, and of the vehicle's reference, which turns about it.
        depth_m
            None if not known.
        travelled
            Run by reckoning.
        """
        seen = _Seen(time_s, antenna, position, travelled)
        doubt = self._judge(seen, depth_m)
        self._seen.append(seen._replace(is_doubted=doubt is not None))
        if doubt is not None:
            self._n_good = 0
            return doubt
        self._n_good = min(self._n_good + 1, _N_GOOD + 1)
        return "recovering" if self._n_good < _N_GOOD else None

    def _judge(self, seen: _Seen, depth_m: float | None) -> Doubt | None:
        same, leg = self._same_since, seen.travelled.leg
        if same is None or same.antenna[:2] != seen.antenna[:2] or same.travelled.leg != leg:
            self._same_since = same = seen
        if depth_m is not None and depth_m > self._surface_depth_m:
            self._seen.clear()
            return "submerged"
        if math.dist(same.travelled[1:], seen.travelled[1:]) > _FROZEN_M:
            return "frozen"
        while self._seen and seen.time_s - self._seen[0].time_s > _WINDOW_S:
            self._seen.popleft()
        on_leg = (other for other in self._seen if other.travelled.leg == leg)
        before = min(on_leg, key=lambda other: other.is_doubted, default=None)  # the oldest good one, or the oldest
        if before is not None:
            east_m, north_m = offset_m(before.position[:2], seen.position[:2])
            way_east_m = seen.travelled.east_m - before.travelled.east_m
            way_north_m = seen.travelled.north_m - before.travelled.north_m
            slack_m = 3.0 * math.hypot(before.position.sigma_m, seen.position.sigma_m) + _WAY_SLACK * math.hypot(
                way_east_m, way_north_m
            )
            if math.hypot(east_m - way_east_m, north_m - way_north_m) > slack_m:
                return "not_the_way_made"
        return None
