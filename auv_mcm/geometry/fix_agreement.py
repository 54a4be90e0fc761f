"""Decide which position fixes of one source to accept, by which of them agree with each other.

Fixes that a vehicle can have reached one from another form a track. One track is accepted; the others are candidates.
No single fix is worth more than another because it came first: at the start the track with most fixes is chosen once
they span a while, and a candidate takes over when the accepted track falls silent or has far fewer fixes. The decision
depends on the fixes and their times alone.

Autopilots reset their position filter in the same way, after several seconds of consistent rejected fixes (PX4 EKF2
`EKF2_NOAID_TOUT`, 5 s; ArduPilot EKF3 position timeout, 10 s).
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from operator import attrgetter
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

# fixes that must agree before a candidate is accepted: two may be one glitch that was reported twice
REFIX_COUNT: Final = 3
WINDOW: Final = 30  # newest fixes that are compared
_OUTNUMBERED: Final = 2  # a candidate with so many times the accepted track's fixes in the window takes over
_COMPARABLE: Final = 0.25  # of the accepted track's fixes in the window: a candidate with fewer is noise
_MAX_CANDIDATES: Final = 8  # the one silent for longest is dropped; scattered fixes must cost no memory
# times span_s: undecided fixes older than this are rejected, so that the wait for them is bounded
_HOLD_FACTOR: Final = 4.0 / 3.0


class Timed(Protocol):
    """Have a time."""

    @property
    def time_s(self) -> float:
        """Return UTC seconds since 1970."""


F = TypeVar("F", bound=Timed)


class FixDecision(NamedTuple, Generic[F]):
    """Report the decision that one fix brought.

    accepted: fixes accepted by this decision, in order of time. n_rejected: fixes rejected for good. step_m: distance
    from the last fix accepted before to the first accepted one if the vehicle cannot have travelled it, else 0.
    doubt_m: distance to the farthest track that may be the true one instead and has a comparable number of the newest
    fixes, 0 without one: the track accepted before a step, or one that comes back again and again, in which case the
    position is disputed.
    """

    accepted: tuple[F, ...] = ()
    n_rejected: int = 0
    step_m: float = 0.0
    doubt_m: float = 0.0
    disputed: bool = False


class _Track(Generic[F]):
    def __init__(self, fix: F) -> None:
        self.last = fix
        self.since_s = fix.time_s  # first fix since the present track is accepted
        self.n_since_settled = 0
        self.n_runs = 0  # since then: how often it got fixes again after another track had some
        self.run_since_s = fix.time_s  # first fix since the accepted track had its last one
        self.n_run = 0
        self.waiting: list[F] = []

    def take(self, fix: F, resumes: bool) -> None:
        self.n_runs += resumes
        if self.n_since_settled == 0:
            self.since_s = fix.time_s
        if self.n_run == 0:
            self.run_since_s = fix.time_s
        self.last = fix
        self.n_run += 1
        self.n_since_settled += 1
        self.waiting.append(fix)


class FixAgreement(Generic[F]):
    """Decide on fixes of one source in order of arrival; see the module."""

    def __init__(self, apart_m: Callable[[F, F], float], reach_m: Callable[[F, F], float], span_s: float) -> None:
        """apart_m: distance between two fixes. reach_m: what the vehicle can have travelled between them, their errors
        included.

        span_s: how long fixes have to agree before the first or a new track is accepted.
        """
        self._apart_m = apart_m
        self._reach_m = reach_m
        self._span_s = span_s
        self._accepted: _Track[F] | None = None
        self._candidates: list[_Track[F]] = []
        self._recent: deque[_Track[F]] = deque(maxlen=WINDOW)

    @property
    def last(self) -> F | None:
        """Give the newest accepted fix."""
        return None if self._accepted is None else self._accepted.last

    @property
    def is_decided(self) -> bool:
        """Check whether a track is accepted, or there is nothing to decide."""
        return self._accepted is not None or not self._candidates

    @property
    def waiting_since_s(self) -> float:
        """Give the time of the oldest fix that may still be accepted; inf if there is none."""
        if not self._candidates:  # as a rule
            return math.inf
        return min(
            (candidate.waiting[0].time_s for candidate in self._candidates if candidate.waiting), default=math.inf
        )

    @property
    def waiting_apart_m(self) -> float:
        """Measure from the newest accepted fix to the farthest track that may still be accepted; 0 if there is none."""
        if self._accepted is None:
            return 0.0
        last = self._accepted.last
        return max(
            (self._apart_m(last, candidate.last) for candidate in self._candidates if candidate.waiting), default=0.0
        )

    def add(self, fix: F) -> FixDecision[F]:
        """Take the next fix."""
        accepted = self._accepted
        if accepted is not None and not self._candidates and self._reaches(accepted.last, fix):
            self._extend(accepted, fix)
            return FixDecision((fix,))
        candidate = self._nearest_candidate(fix)
        if accepted is not None and self._continues(accepted, candidate, fix):
            self._extend(accepted, fix)
            n_rejected = self._reject_waiting()
            if self._candidates:
                recent = set(map(id, self._recent))
                self._candidates = [candidate for candidate in self._candidates if id(candidate) in recent]
            return FixDecision((fix,), n_rejected, 0.0, *self._doubt())
        n_forgotten = 0
        if candidate is None:
            n_forgotten = self._make_room()
            candidate = _Track(fix)
            self._candidates.append(candidate)
        candidate.take(fix, resumes=not self._recent or self._recent[-1] is not candidate)
        self._recent.append(candidate)
        decision = (
            self._settle(self._best_candidate()) if accepted is None and self._spans(fix.time_s) else FixDecision[F]()
        )
        if accepted is not None and self._takes_over(candidate, accepted, fix):
            decision = self._settle(candidate)
        return decision._replace(n_rejected=decision.n_rejected + n_forgotten)

    def advance(self, time_s: float) -> FixDecision[F]:
        """Advance the time without a fix: settle the first track if it is due, reject fixes that waited too long."""
        if self._accepted is None:
            return self._settle(self._best_candidate()) if self._candidates and self._spans(time_s) else FixDecision()
        n_rejected = 0
        for candidate in self._candidates:
            while candidate.waiting and time_s - candidate.waiting[0].time_s > _HOLD_FACTOR * self._span_s:
                del candidate.waiting[0]
                n_rejected += 1
        return FixDecision(n_rejected=n_rejected)

    def decide(self) -> FixDecision[F]:
        """Accept the track that most fixes support so far, because a caller cannot wait."""
        return FixDecision() if self.is_decided else self._settle(self._best_candidate())

    def _extend(self, accepted: _Track[F], fix: F) -> None:
        accepted.last = fix
        accepted.n_since_settled += 1
        self._recent.append(accepted)

    def _reaches(self, before: F, after: F) -> bool:
        return self._apart_m(before, after) <= self._reach_m(before, after)

    def _spans(self, time_s: float) -> bool:
        return time_s - min(candidate.run_since_s for candidate in self._candidates) >= self._span_s

    def _nearest_candidate(self, fix: F) -> _Track[F] | None:
        within = [candidate for candidate in self._candidates if self._reaches(candidate.last, fix)]
        return min(within, key=lambda candidate: self._apart_m(candidate.last, fix), default=None)

    def _continues(self, accepted: _Track[F], candidate: _Track[F] | None, fix: F) -> bool:
        """Check whether a fix continues the accepted track rather than a nearer candidate: in time any place can be
        reached."""
        if not self._reaches(accepted.last, fix):
            return False
        if candidate is None or candidate.n_run == 0:
            return True
        return self._apart_m(accepted.last, fix) <= self._apart_m(candidate.last, fix)

    def _make_room(self) -> int:
        """Drop the candidate with fewest new fixes if there are too many; give how many fixes were rejected with it."""
        if len(self._candidates) < _MAX_CANDIDATES:
            return 0
        silent = min(self._candidates, key=lambda candidate: (self._recent.count(candidate), candidate.last.time_s))
        self._candidates.remove(silent)
        return len(silent.waiting)

    def _best_candidate(self) -> _Track[F]:
        """Choose the candidate with most fixes, the latest of equals."""
        return max(self._candidates, key=lambda candidate: (len(candidate.waiting), candidate.last.time_s))

    def _takes_over(self, candidate: _Track[F], accepted: _Track[F], fix: F) -> bool:
        """Check whether the candidate has had all fixes for long enough, or outnumbers the accepted track."""
        if candidate.n_run >= REFIX_COUNT and fix.time_s - candidate.run_since_s >= self._span_s:
            return True
        if len(self._recent) < WINDOW or fix.time_s - candidate.since_s < self._span_s:
            return False
        return self._recent.count(candidate) >= _OUTNUMBERED * self._recent.count(accepted)

    def _reject_waiting(self) -> int:
        n_rejected = 0
        for candidate in self._candidates:
            n_rejected += len(candidate.waiting)
            candidate.waiting.clear()
            candidate.n_run = 0
        return n_rejected

    def _settle(self, track: _Track[F]) -> FixDecision[F]:
        before = self._accepted
        self._candidates.remove(track)
        n_rejected = self._reject_waiting()
        step_m = 0.0
        accepted = tuple(sorted(track.waiting, key=attrgetter("time_s")))
        if before is not None:
            self._candidates.append(before)
            step_m = self._apart_m(before.last, accepted[0])
            before.n_run = 0
            for candidate in self._candidates:
                candidate.n_since_settled = candidate.n_runs = 0
        track.waiting = []
        self._accepted = track
        return FixDecision(accepted, n_rejected, step_m, *self._doubt())

    def _doubt(self) -> tuple[float, bool]:
        accepted = self._accepted
        if accepted is None or not self._candidates:
            return 0.0, False
        n_fixes = Counter(map(id, self._recent))
        doubt_m, disputed = 0.0, False
        for candidate in self._candidates:
            comes_back, accepted_before = candidate.n_runs > 1, candidate.n_since_settled == 0
            comparable = n_fixes[id(candidate)] >= max(REFIX_COUNT, _COMPARABLE * n_fixes[id(accepted)])
            if comparable and (comes_back or accepted_before):
                doubt_m = max(doubt_m, self._apart_m(accepted.last, candidate.last))
                disputed = disputed or comes_back
        return doubt_m, disputed
