"""Track the sea floor below the vehicle by what it reports of depth and altitude, and distrust what cannot be.

A depth to command is made of the shallowest floor that was believed of late; the bound on depth is judged over the
deepest that was reported.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Final, NamedTuple

from auv_mcm.records import NAN

ONE_MOMENT_S: Final = 0.5  # s between a depth and an altitude that make a floor: a vehicle dives 0.3 m in that time
MAX_SLOPE: Final = 0.5  # of the sea floor along the way, 27 degrees: chosen, steeper than sediment lies
LEAP_M: Final = 1.0  # m beyond the slope: chosen, echo noise and what a vehicle dives between two sensors' readings
BELIEVED_S: Final = 3.0  # s that a floor counts: chosen, six reports of a vehicle that reports twice a second
SETTLE_S: Final = 2.0  # s that reports must follow one another before a floor is believed: longer than a glitch
MIN_REPORTS: Final = 3  # in that time, so that two wrong ones are not a floor
STILL_M: Final = (
    1.25  # m of change in depth with the same altitude, for a frozen one: 1 m of the coarsest digits, noise
)
STANDS_S: Final = BELIEVED_S  # s that an altitude may stand still: a report counts for as long
DEPTH_STANDS_S: Final = 2.0 * BELIEVED_S  # s that a depth that stands still makes no deeper floor: chosen
LOST_S: Final = 15.0  # s of doubt after which it is frozen: chosen, a vehicle that is led up rises by 1.25 m sooner
DOUBT_STEP_M: Final = 0.5  # m: chosen, so that commands do not change all the time


class SeaFloor(NamedTuple):
    """Hold the depth of the sea floor below the vehicle, in m. NaN if not known.

    shallowest_m: of those believed of late; deepest_m: of those reported of late, believed or not.
    """

    shallowest_m: float
    deepest_m: float


class FloorBelow:
    """Track the sea floor below the vehicle.

    Depth and altitude make a floor if they are of one moment. It is believed once reports have followed one another for
    2 s, and then while it deepens no faster than a slope of 0.5 does under way: a deeper one is rejected, and counted.
    A shallower one counts at once, since it leads up.

    An altitude that stands still to the last digit is either frozen or one of coarse digits over a level floor. It
    makes no floor deeper than at first, and after 3 s leads no lower than the vehicle was then. Under command the floor
    is then taken to rise as the slope allows, in steps of 0.5 m, which leads the vehicle up: digits of 1 m or finer
    change with it, and all is as before. One that does not change over 1.25 m of depth, or 15 s of that, is frozen and
    makes no floor, nor does the same number later, until others made one that is believed.

    An altitude that was reported once may be the last: a deeper floor counts once a further change has confirmed it. A
    depth that stands still to the last digit makes no deeper floor for 6 s.

    speed_mps: maximum under way. valid_s: how long what was reported counts for the deepest floor. counters:
    vehicle.floors_rejected (deeper than can be), vehicle.altitudes_doubted (that stood still under command),
    vehicle.altitudes_frozen.
    """

    def __init__(self, *, speed_mps: float, valid_s: float) -> None:
        self.counters: Counter[str] = Counter()
        self._max_deepening_mps = MAX_SLOPE * speed_mps
        self._valid_s = valid_s
        self._depth = self._altitude = (NAN, -math.inf)  # value, when
        self._still = (NAN, NAN, math.inf)  # altitude, the depth when it was first reported, and when
        self._still_depth = (NAN, NAN, math.inf)  # depth, the altitude when it was first reported, and when
        self._n_same = 0  # reports of this altitude in a row
        self._seen_before_m = NAN  # floor by the last report
        self._confirmed_m = math.inf  # floor that an altitude that stands still may show at the deepest
        self._dead_m = NAN  # altitude that was frozen
        self._commanded_s = math.inf  # since when
        self._doubted = self._frozen = False
        self._reported: deque[tuple[float, float]] = deque()  # when, depth of the floor
        self._believed: deque[tuple[float, float]] = deque()
        self._settling: list[tuple[float, float]] = []
        self._track: tuple[float, float] | None = None  # when, and the floor that others are held against
        self._first_s = math.inf  # when depth and altitude were first reported

    def hear(self, depth_m: float, altitude_m: float, now_s: float, *, is_commanded: bool = False) -> None:
        """Take what the vehicle reported, NaN for what it did not, and whether the payload commands it."""
        self._commanded_s = min(self._commanded_s, now_s) if is_commanded else math.inf
        is_other_depth = math.isfinite(depth_m) and depth_m != self._depth[0]
        if math.isfinite(depth_m):
            self._depth = depth_m, now_s
        if math.isfinite(altitude_m):
            self._hear_altitude(altitude_m, now_s)
        if is_other_depth:
            self._still_depth = depth_m, self._altitude[0], now_s
        self._drop_old(now_s)
        if not abs(self._depth[1] - self._altitude[1]) <= ONE_MOMENT_S or now_s not in (
            self._depth[1],
            self._altitude[1],
        ):
            return
        floor_m = self._depth[0] + self._altitude[0]
        self._first_s = min(self._first_s, now_s)
        self._reported.append((now_s, floor_m))
        if self._is_leap(floor_m, now_s):
            self.counters["vehicle.floors_rejected"] += 1
            self._settling.clear()
        elif self._is_frozen():
            self.counters["vehicle.altitudes_frozen"] += 1
        elif self._believed:
            self._believe(self._seen_m(now_s), now_s)
        else:
            self._settle(self._seen_m(now_s), now_s)

    def _hear_altitude(self, altitude_m: float, now_s: float) -> None:
        last_s = self._altitude[1]
        self._altitude = altitude_m, now_s
        if altitude_m == self._still[0]:
            self._n_same += 1
            if self.doubt_m and not self._doubted:
                self._doubted = True
                self.counters["vehicle.altitudes_doubted"] += 1
            return
        self._still, self._n_same, self._doubted = (altitude_m, self._depth[0], now_s), 1, False
        self._frozen = altitude_m == self._dead_m
        # Two floors in a row that agree: the altitude before lived.
        off_m = abs(self._depth[0] + altitude_m - self._seen_before_m)
        if off_m <= LEAP_M + self._max_deepening_mps * (now_s - last_s):
            self._confirmed_m = self._seen_before_m
        else:
            self._confirmed_m = math.inf if self._track is None else self._track[1]

    def settles(self, now_s: float) -> bool:
        """Find whether the first floor may still come to be believed, so that nobody has to look after it yet."""
        return self._track is None and now_s - self._first_s <= SETTLE_S + BELIEVED_S

    def at(self, now_s: float) -> SeaFloor:
        """Return the floor as it is known now, shallower by the doubt; NaN while the altitude is frozen."""
        if self._frozen:
            return SeaFloor(NAN, NAN)
        self._drop_old(now_s)
        return SeaFloor(
            min((floor_m for _, floor_m in self._believed), default=NAN) - self.doubt_m,
            max((floor_m for _, floor_m in self._reported), default=NAN),
        )

    @property
    def doubt_m(self) -> float:
        """Return how much the floor may have risen under command while the altitude stood still, m."""
        return math.ceil(self._doubted_s * self._max_deepening_mps / DOUBT_STEP_M) * DOUBT_STEP_M

    @property
    def _doubted_s(self) -> float:
        return max(self._altitude[1] - max(self._still[2] + STANDS_S, self._commanded_s), 0.0)

    def altitude_to_keep_m(self, wanted_m: float) -> float:
        """Return the altitude to keep over the floor in `at`: no lower than now where the altitude stands still."""
        stands = self._altitude[1] - self._still[2] > STANDS_S
        return max(wanted_m, self._still[0]) if stands else wanted_m

    def safe_depth_m(self, altitude_m: float, now_s: float, holds_s: float) -> float:
        """Return a depth that stays above a floor that is not seen any more; 0 where none was ever believed.

        Parameters
        ----------
        altitude_m
            Over the floor believed last, were it flat.
        holds_s
            How long the vehicle may keep the depth: the floor may rise on the way.
        """
        if self._track is None:
            return 0.0
        since_s, floor_m = self._track
        floor_m = min([floor_m, *(believed_m for _, believed_m in self._believed)])
        return max(floor_m - self.doubt_m - altitude_m - self._max_deepening_mps * (now_s - since_s + holds_s), 0.0)

    def _is_frozen(self) -> bool:
        """Find whether the altitude stands still since the depth was another, or too long; it does until it changes."""
        is_repeated = self._altitude[1] >= self._depth[1]  # not merely older than the depth
        self._frozen |= is_repeated and (abs(self._depth[0] - self._still[1]) > STILL_M or self._doubted_s > LOST_S)
        if self._frozen and self._altitude[0] != self._dead_m:
            self._dead_m = self._altitude[0]
            self._settling.clear()
            self._believed.clear()
        return self._frozen

    def _seen_m(self, now_s: float) -> float:
        """Return the floor, no deeper than what stands still may show: see the class."""
        (depth_m, _), (altitude_m, _) = self._depth, self._altitude
        _, first_altitude_m, since_s = self._still_depth
        if math.isfinite(first_altitude_m) and now_s - since_s <= DEPTH_STANDS_S:
            altitude_m = min(altitude_m, first_altitude_m)
        still_m = self._still[1]
        floor_m = altitude_m + (min(depth_m, still_m) if math.isfinite(still_m) else depth_m)
        self._seen_before_m = floor_m
        return min(floor_m, self._confirmed_m) if self._n_same > 1 else floor_m

    def _is_leap(self, floor_m: float, now_s: float) -> bool:
        if self._track is None:
            return False
        then_s, then_m = self._track
        return floor_m > then_m + self._max_deepening_mps * (now_s - then_s) + LEAP_M

    def _believe(self, floor_m: float, now_s: float) -> None:
        """Believe a floor that is not too deep; one much shallower leads up, and nothing deeper is held against it."""
        self._believed.append((now_s, floor_m))
        assert self._track is not None  # since a floor was believed
        then_s, then_m = self._track
        change_m = self._max_deepening_mps * (now_s - then_s)
        if floor_m >= then_m - change_m - LEAP_M:
            self._track = now_s, min(then_m + change_m, floor_m)

    def _settle(self, floor_m: float, now_s: float) -> None:
        """Believe a floor once reports have followed one another long enough."""
        if self._settling:
            last_s, last_m = self._settling[-1]
            off_m = abs(floor_m - last_m) - self._max_deepening_mps * (now_s - last_s)
            if off_m > LEAP_M or now_s - last_s > BELIEVED_S:
                self._settling.clear()
        self._settling.append((now_s, floor_m))
        if len(self._settling) >= MIN_REPORTS and now_s - self._settling[0][0] >= SETTLE_S:
            self._believed.extend(self._settling)
            self._track = now_s, min(floor_m for _, floor_m in self._settling)
            self._dead_m = NAN
            self._settling.clear()
            self._drop_old(now_s)

    def _drop_old(self, now_s: float) -> None:
        for floors, valid_s in ((self._believed, BELIEVED_S), (self._reported, self._valid_s)):
            while floors and now_s - floors[0][0] > valid_s:
                floors.popleft()
