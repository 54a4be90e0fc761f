"""Put the profiles of an svlog's two heads into the order of transmissions, the sides of each next to each other.

Each head counts its pings and its milliseconds for itself, and some logs hold several profiles of one head before those
of the other. In 16 logs of two heads (github.com/Kyyrron/BlueBoat-SSS, SONARVIEW_SVLOG_ANALYSIS.md) the numbers differ
by 0, -1 or 60, the same through a log; where it is 60 the sides nearest in time are 6 and 20 ms apart at most.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import fmean, median
from typing import Any, Final, NamedTuple

from drivers.sonar.ping_messages import PingMessage

COUNTER_MS: Final = 2**32  # ms after which a 32-bit counter starts over
RESTART_MS: Final = 1000  # a counter that goes back by more has restarted; heads send within that of each other
_STRETCH: Final = 128  # profiles by which the heads are compared: three batches of 20 of each (chosen)
_MAX_HELD: Final = 64  # profiles that wait for the other head's (chosen)
_MIN_PAIRS: Final = 8  # by which heads are compared (chosen)
_MOST: Final = 0.75  # of the pairs, which keep the time between the heads, or in which one is stored first (chosen)
_TURNED: Final = 4.0  # weight of the fraction of pairs stored the other way round: half a batch off costs more (chosen)
_NEIGHBOUR: Final = 2.0  # profiles from one side to the other on average, where batches are too short to show (chosen)
_EQUAL: Final = 0.4  # of half an interval, by which equal numbers may be farther apart in time than others (chosen)
_AGREE: Final = 1.5  # of half an interval, within which clocks agree (chosen)
_SWAPPED: Final = 2  # pings by which a head's own order may be wrong (chosen)
_MAX_BAD: Final = 32  # transmissions in a row that are one-sided or apart, before heads are compared again (chosen)


class Offsets(NamedTuple):
    """Hold by how much the second head counts more pings and milliseconds than the first."""

    heads: tuple[Hashable, Hashable]
    begin_ms: tuple[int, int]  # the heads' counters where the stretch begins
    pings: int
    ms: int
    half_interval_ms: float


@dataclass(slots=True)
class Profile:
    """Hold a profile as stored. offsets: None where the heads could not be compared."""

    head: Hashable
    number: int
    counter_ms: int
    message: PingMessage
    offset: int
    navigation: list[Any] = field(default_factory=list)  # stored before it
    offsets: Offsets | None = None

    @property
    def transmission(self) -> int:
        """Return the first head's number of the ping."""
        is_second = self.offsets is not None and self.head == self.offsets.heads[1]
        return self.number - self.offsets.pings if is_second and self.offsets is not None else self.number


def signed_ms(difference_ms: int) -> int:
    """Return the difference of two 32-bit counters."""
    return (difference_ms + COUNTER_MS // 2) % COUNTER_MS - COUNTER_MS // 2


class HeadOrder:
    """Order profiles. Holds back a stretch of 128 where heads are compared, 64 after that.

    Heads are compared again where one restarts or their pings no longer agree. Where they cannot be, profiles keep
    the order in which they are stored.
    """

    def __init__(self) -> None:
        self._heads: list[Hashable] = []  # in the order of the log
        self._stretch: list[Profile] = []
        self._clear()

    def _clear(self) -> None:
        self._offsets: Offsets | None = None
        self._last: dict[Hashable, Profile] = {}
        self._newest: dict[Hashable, int] = {}
        self._held: dict[int, list[Profile]] = {}  # by transmission
        self._n_bad = 0

    def add(self, profile: Profile) -> list[Profile]:
        """Take a profile; return those that are ready."""
        head, ready = profile.head, []
        if head not in self._heads:
            self._heads.append(head)
        is_other = self._offsets is not None and head not in self._offsets.heads
        if is_other or self._n_bad >= _MAX_BAD or _restarts(self._last.get(head), profile):
            ready = self.finish()
        self._last[head] = profile
        if self._offsets is not None:
            return self._placed(profile, self._offsets)
        self._stretch.append(profile)
        return ready + (self._compared() if len(self._stretch) >= _STRETCH else [])

    def finish(self) -> list[Profile]:
        """Return what is held; heads are compared again after it."""
        ready = self._compared()
        ready += [profile for transmission in sorted(self._held) for profile in self._held[transmission]]
        self._clear()
        return ready

    def _compared(self) -> list[Profile]:
        stretch, self._stretch = self._stretch, []
        if stretch:
            self._offsets = _compare(self._heads, stretch)
        if self._offsets is None:
            return stretch
        return [ready for profile in stretch for ready in self._placed(profile, self._offsets)]

    def _placed(self, profile: Profile, offsets: Offsets) -> list[Profile]:
        profile.offsets = offsets
        transmission, newest = profile.transmission, max(self._held, default=profile.number)
        if transmission < newest and newest in self._held:  # stored after that one
            self._held[newest][-1].navigation += profile.navigation
            profile.navigation = []
        self._held.setdefault(transmission, []).append(profile)
        self._newest[profile.head] = max(self._newest.get(profile.head, transmission), transmission)
        ready: list[Profile] = []
        while self._held:
            sides = self._held[min(self._held)]
            at_ms = {side.head: side.counter_ms for side in sides}
            if len(at_ms) == 1 and not self._is_lone(sides[0].transmission):
                break
            ready += self._held.pop(sides[0].transmission)
            apart_ms = [at_ms[head] for head in offsets.heads if head in at_ms]
            is_good = (
                len(at_ms) == 2 and abs(signed_ms(apart_ms[1] - apart_ms[0] - offsets.ms)) <= offsets.half_interval_ms
            )
            self._n_bad = 0 if is_good else self._n_bad + 1
        return ready

    def _is_lone(self, transmission: int) -> bool:
        """Check whether the other head's profile of a transmission does not come any more."""
        is_past = len(self._newest) == 2 and transmission + _SWAPPED < min(self._newest.values())
        return is_past or sum(map(len, self._held.values())) > _MAX_HELD


def _restarts(last: Profile | None, profile: Profile) -> bool:
    if last is None:
        return False
    pings, ms = profile.number - last.number, signed_ms(profile.counter_ms - last.counter_ms)
    return ms < -RESTART_MS or pings < -_MAX_HELD or pings <= 0 < ms or ms < 0 < pings


class _Candidate(NamedTuple):
    """Hold what pairs of profiles look like with an offset of ping numbers."""

    lag: float  # mean number of profiles from the one to the other
    pings: int
    ms: int
    first_leads: float  # fraction


def _compare(heads: list[Hashable], stretch: list[Profile]) -> Offsets | None:
    """Find the offsets of a stretch's two heads; None where there are not two, or nothing is constant."""
    places: dict[Hashable, dict[int, tuple[int, int]]] = {}
    for place, profile in enumerate(stretch):
        places.setdefault(profile.head, {})[profile.number] = place, profile.counter_ms
    if len(places) != 2:
        return None
    first, second = sorted(places, key=heads.index)
    one, other = places[first], places[second]
    if min(len(one), len(other)) < _MIN_PAIRS:
        return None
    numbers = sorted(one)
    steps = pairwise(numbers)
    half_ms = 0.5 * median(signed_ms(one[after][1] - one[before][1]) / (after - before) for before, after in steps)
    differences = {m - n for n, (a, _) in one.items() for m, (b, _) in other.items() if abs(b - a) <= _MAX_HELD}
    candidates = [c for pings in sorted(differences) if (c := _candidate(one, other, pings, half_ms)) is not None]
    if (best := _best(candidates, half_ms)) is None:
        return None
    begin_ms = (next(iter(one.values()))[1], next(iter(other.values()))[1])
    return Offsets((first, second), begin_ms, best.pings, best.ms, half_ms)


def _candidate(
    one: dict[int, tuple[int, int]], other: dict[int, tuple[int, int]], pings: int, half_ms: float
) -> _Candidate | None:
    pairs = [(*at, *other[number + pings]) for number, at in one.items() if number + pings in other]
    if len(pairs) < max(_MIN_PAIRS, min(len(one), len(other)) // 3):
        return None
    apart_ms = [signed_ms(there_ms - here_ms) for _, here_ms, _, there_ms in pairs]
    ms = round(median(apart_ms))
    if sum(abs(apart - ms) <= half_ms for apart in apart_ms) < _MOST * len(pairs):
        return None
    lags = [there - here for here, _, there, _ in pairs]
    return _Candidate(fmean(map(abs, lags)), pings, ms, sum(lag > 0 for lag in lags) / len(lags))


def _best(candidates: list[_Candidate], half_ms: float) -> _Candidate | None:
    """Choose among the offsets that the order in the log allows.

    These are the closest with which one head is stored before the other, and those of neighbours. Of them the clocks
    decide where they agree, then equal numbers, then which head began.
    """
    leading = [c for c in candidates if c.first_leads >= _MOST]
    trailing = [c for c in candidates if c.first_leads <= 1.0 - _MOST]
    leads = min(leading, key=lambda c: c.lag * (1.0 + _TURNED * (1.0 - c.first_leads)), default=None)
    trails = min(trailing, key=lambda c: c.lag * (1.0 + _TURNED * c.first_leads), default=None)
    reach = max((c.lag for c in (leads, trails) if c is not None), default=_NEIGHBOUR)
    equal = next((c for c in candidates if c.pings == 0 and c.lag <= reach), None)
    near = [c for c in candidates if c.lag <= _NEIGHBOUR and 1.0 - _MOST < c.first_leads < _MOST]
    options = [c for c in (leads, trails, equal, *near) if c is not None]
    if not options:
        return None
    closest = min(options, key=lambda c: (abs(c.ms) - _EQUAL * half_ms * (c.pings == 0), c.pings))
    if abs(closest.ms) <= _AGREE * half_ms:
        return closest
    return equal or leads or closest
