"""Decide what samples mean from the first pings, and keep checking while pings come.

The decision depends on the pings alone, in their order, not on their delivery. Without a configured law, several
hundred pings decide, or as many as come within half a minute where pings are rare. The law turns if later pings
strongly contradict it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import BLOCK_PINGS
from auv_mcm.records import NAN, EchoTrace, Notice, Ping, Transfer, TransferKind
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.decibels import USUAL_DB_PER_COUNT
from auv_mcm.waterfall.law import LAWS, Law, LawOdds, weigh_laws
from auv_mcm.waterfall.regions import Regions, measure_regions
from auv_mcm.waterfall.speckle import summarise

DECIDE_PINGS: Final = 256  # pings before the first verdict on the law, if they take long enough
_MAX_PINGS: Final = 512  # where the first do not decide
_MIN_PINGS: Final = 64  # pings that a verdict needs, however long they took
_LOOK_AGAIN_PINGS: Final = 128  # pings between checks after the first: each check costs 12 ms of processor time
_DECIDE_S: Final = 30.0  # slow pings decide after this much time, so that contacts do not wait for minutes
_MAX_S: Final = 60.0  # s after which it is taken with _MIN_PINGS: slow sonars
_DECISIVE: Final = 0.99  # probability of the likeliest law, from which the verdict stands
_NARROW_NATS: Final = 0.35  # between the ends of the interval of decibels per count; wider, more pings are awaited
# Probability below which a law is contradicted: a notice, or a turn, must not come of an odd stretch of sea floor
_STRONG: Final = 1e-3
_TURN_NATS: Final = 0.2  # decibels per count that differ by less are not worth starting anew for
_DOUBT_RATIO: Final = (
    1.6  # beyond the interval of decibels per count: fields of boulders bring the estimate down by a third
)
_GAP_S: Final = 2.0
_GAP_STEPS: Final = 3.0  # of the time between pings: those of a long-range sonar come seconds apart
_RECENT_BLOCKS: Final = 32  # 512 pings
_WATCHED: Final = 2  # of so many blocks after the decision one is measured, at half the processor time
_SPREAD_BLOCKS: Final = 32


class LawVerdict(NamedTuple):
    """Hold the transfer from here on, None if it stays, and notices for a person."""

    transfer: Transfer | None
    notices: tuple[Notice, ...]


class _Measured(NamedTuple):
    """Hold a block's regions and its number since the start, or since a hole in time."""

    number: int
    regions: Regions


class LawWatch:
    """Watch every ping of a mission once, in order, and decide what its samples are and when they change."""

    def __init__(self, sonar: SonarConfig) -> None:
        self._sonar = sonar
        self._blocks: deque[_Measured] = deque()  # of the newest _RECENT_BLOCKS those that were measured
        self._open: list[Ping] = []  # of the block being filled
        self._open_form: tuple[object, ...] = ()  # of its pings
        self._n_pings = 0  # since the start, or since a hole in time
        self._n_blocks = 0
        self._first_s = math.nan
        self._last_s = math.nan
        self._step_s = math.inf  # between the last two pings, unknown at first
        self._transfer: Transfer | None = None
        self._kind_known = False  # by configuration or protocol
        self._is_checked = False
        self._next_check = 0  # block count of the next check
        self._next_decibels = 0
        self._in_doubt = False

    def add(self, ping: Ping) -> LawVerdict | None:
        """Take a ping; a verdict where one is due.

        The first verdict always names a transfer; no ping can be read before.
        """
        self._note_time(ping)
        self._collect(ping)
        if self._transfer is None:
            return self._decide(ping.transfer) if self._is_time_to_decide(ping) else None
        return self._check(ping.place) if self._n_blocks >= self._next_check else None

    def finish(self) -> LawVerdict | None:
        """Decide from the pings that came, or check once, where more were awaited for it."""
        if self._transfer is None:
            return self._decide(None) if self._n_pings else None
        return None if self._is_checked else self._check("")

    def _note_time(self, ping: Ping) -> None:
        """Restart after a hole in time: another recorder may follow, as in several logs replayed as one mission."""
        step_s = abs(ping.time_s - self._last_s)
        if self._transfer is not None and step_s > max(_GAP_S, _GAP_STEPS * self._step_s):
            self._blocks.clear()
            self._open = []
            self._n_blocks = 0
            self._next_check = self._next_decibels = _MIN_PINGS // BLOCK_PINGS
        if not math.isfinite(self._first_s):
            self._first_s = ping.time_s
        self._last_s = ping.time_s
        self._step_s = step_s if math.isfinite(step_s) else self._step_s
        self._n_pings += 1

    def _collect(self, ping: Ping) -> None:
        form = _form(ping)
        if form != self._open_form:
            self._open, self._open_form = [], form
        self._open.append(ping)
        if len(self._open) == BLOCK_PINGS:
            if self._is_measured_next():
                self._blocks.append(_Measured(self._n_blocks, measure_block(self._open)))
            self._n_blocks += 1
            self._open = []
            self._forget(_RECENT_BLOCKS)

    def _is_measured_next(self) -> bool:
        """Whether the block that is complete counts: all until the law is known, and at first after a hole in time."""
        is_new = self._transfer is None or self._n_blocks < DECIDE_PINGS // BLOCK_PINGS
        return is_new or self._n_blocks % _WATCHED == 0

    def _forget(self, n_blocks: int) -> None:
        """Keep only what was measured of the newest n_blocks."""
        while self._blocks and self._blocks[0].number < self._n_blocks - n_blocks:
            self._blocks.popleft()

    def _is_time_to_decide(self, ping: Ping) -> bool:
        sonar = self._sonar
        kind = ping.transfer if sonar.transfer == "auto" else sonar.transfer
        if kind is not None and (kind != "log" or sonar.db_per_count is not None):
            return True
        lasted_s = abs(ping.time_s - self._first_s)
        if self._n_pings >= _MAX_PINGS or (self._n_pings >= _MIN_PINGS and lasted_s >= _MAX_S):
            return True
        if self._n_pings % BLOCK_PINGS or self._n_pings < _MIN_PINGS:
            return False
        if self._n_pings < DECIDE_PINGS and lasted_s < _DECIDE_S:
            return False
        if self._n_pings > DECIDE_PINGS and self._n_pings % _LOOK_AGAIN_PINGS:
            return False
        odds = self._odds()
        return max(odds.probability) >= _DECISIVE and (odds.likeliest != "log" or self._are_decibels_known(odds))

    def _are_decibels_known(self, odds: LawOdds) -> bool:
        low, high = odds.db_interval
        return self._sonar.db_per_count is not None or math.log(high / low) <= _NARROW_NATS

    def _odds(self) -> LawOdds:
        return weigh_laws(summarise([block.regions for block in self._blocks]))

    def _decide(self, stated: TransferKind | None) -> LawVerdict:
        known = stated if self._sonar.transfer == "auto" else self._sonar.transfer
        odds = self._odds()
        kind = odds.likeliest if known is None else known
        self._kind_known = known is not None
        self._transfer = Transfer(kind, self._db_per_count(odds) if kind == "log" else NAN)
        self._is_checked = odds.n_regions > 0
        self._next_check = self._n_blocks + DECIDE_PINGS // BLOCK_PINGS
        self._next_decibels = 2 * max(self._n_blocks, 1)
        if self._kind_known:
            return LawVerdict(self._transfer, self._doubts(odds, "") if self._is_checked else ())
        if not self._is_checked:
            return LawVerdict(self._transfer, (_unchecked(kind),))
        return LawVerdict(self._transfer, (_chosen(self._transfer, odds, self._n_pings),))

    def _check(self, place: str) -> LawVerdict | None:
        assert self._transfer is not None
        odds = self._odds()
        self._is_checked = True
        self._next_check = self._n_blocks + DECIDE_PINGS // BLOCK_PINGS
        if odds.n_regions == 0:
            return None
        if self._kind_known:
            notices = self._doubts(odds, place)
            return LawVerdict(None, notices) if notices else None
        held, likeliest = self._transfer, odds.likeliest
        if likeliest != held.kind:
            if odds.of(held.kind) >= _STRONG:
                return None
        elif not self._decibels_turned(odds):
            return None
        if likeliest == "log" and held.kind != "log" and not self._are_decibels_known(odds):
            # Reading on by the wrong law is worse than usual decibels until more pings have come.
            self._transfer = Transfer(likeliest, USUAL_DB_PER_COUNT)
            self._next_decibels = self._next_check
        else:
            self._transfer = Transfer(likeliest, self._db_per_count(odds) if likeliest == "log" else NAN)
        # Older blocks may come from another recorder.
        self._forget(DECIDE_PINGS // BLOCK_PINGS)
        return LawVerdict(self._transfer, (_turned(held, self._transfer, odds, place),))

    def _decibels_turned(self, odds: LawOdds) -> bool:
        held = self._transfer
        if (
            held is None
            or held.kind != "log"
            or self._sonar.db_per_count is not None
            or self._n_blocks < self._next_decibels
        ):
            return False
        # Checked after twice as many pings each time: an estimate that wavers must not restart statistics again and
        # again.
        self._next_decibels = 2 * self._n_blocks
        low, high = odds.db_interval
        outside = not low <= held.db_per_count <= high
        return outside and abs(math.log(odds.db_per_count / held.db_per_count)) > _TURN_NATS

    def _db_per_count(self, odds: LawOdds) -> float:
        if self._sonar.db_per_count is not None:
            return self._sonar.db_per_count
        return odds.db_per_count if math.isfinite(odds.db_per_count) else USUAL_DB_PER_COUNT

    def _doubts(self, odds: LawOdds, place: str) -> tuple[Notice, ...]:
        """Report strong evidence against a configured or stated law, once until the evidence agrees again."""
        assert self._transfer is not None
        kind = self._transfer.kind
        source = "the sonar's protocol states" if self._sonar.transfer == "auto" else "sonar.transfer is"
        notices = []
        if odds.of(kind) < _STRONG:
            notices.append(
                Notice(
                    code="transfer.disagrees",
                    text=f"{source} '{kind}' but the samples look like '{odds.likeliest}' (odds "
                    f"{_odds_text(odds, odds.likeliest, kind)}). "
                    "If that is wrong, contrast and false alarms suffer. Check the recorder's manual.",
                    place=place,
                )
            )
        configured, (low, high) = self._sonar.db_per_count, odds.db_interval
        doubted = configured is not None and (configured < low / _DOUBT_RATIO or configured > high * _DOUBT_RATIO)
        if not notices and kind == "log" and doubted:
            notices.append(
                Notice(
                    code="transfer.db_per_count",
                    text=f"sonar.db_per_count is {configured:g} but the samples look like {odds.db_per_count:.3f} "
                    f"({low:.2f} to {high:.2f}). Check the recorder's manual.",
                    place=place,
                )
            )
        raised, self._in_doubt = self._in_doubt, bool(notices)
        return () if raised else tuple(notices)


def measure_block(pings: Sequence[Ping]) -> Regions:
    """Measure 16 pings of equal layout and sample type."""
    sides = ([ping.port for ping in pings], [ping.starboard for ping in pings])
    return measure_regions([np.stack([_samples(trace) for trace in side]) for side in sides if side[0] is not None])


def weigh_pings(pings: Sequence[Ping]) -> LawOdds:
    """Weigh the laws from up to 512 pings spread over those given, in blocks of 16 that follow each other."""
    starts = np.linspace(0, max(len(pings) - BLOCK_PINGS, 0), _SPREAD_BLOCKS).astype(int)
    runs = [pings[start : start + BLOCK_PINGS] for start in sorted(set(starts.tolist()))]
    whole = [run for run in runs if len(run) == BLOCK_PINGS and len({_form(ping) for ping in run}) == 1]
    return weigh_laws(summarise([measure_block(run) for run in whole]))


def settled_transfer(sonar: SonarConfig, odds: LawOdds) -> Transfer:
    """Give the configured transfer or, where that is left open, the likeliest."""
    kind = odds.likeliest if sonar.transfer == "auto" else sonar.transfer
    if kind != "log":
        return Transfer(kind)
    if sonar.db_per_count is not None:
        return Transfer(kind, sonar.db_per_count)
    return Transfer(kind, odds.db_per_count if math.isfinite(odds.db_per_count) else USUAL_DB_PER_COUNT)


def _samples(trace: EchoTrace | None) -> NDArray[Any]:
    assert trace is not None  # all pings of a block have the same sides
    return trace.samples


def _form(ping: Ping) -> tuple[object, ...]:
    port, starboard = ping.port, ping.starboard
    return (
        None if port is None else (port.samples.shape[0], port.samples.dtype.str),
        None if starboard is None else (starboard.samples.shape[0], starboard.samples.dtype.str),
    )


def _odds_text(odds: LawOdds, law: Law, other: Law) -> str:
    ratio = odds.of(law) / max(odds.of(other), 1e-12)
    return "over 1000 to 1" if ratio > 1000.0 else f"{ratio:.0f} to 1" if ratio >= 9.5 else f"{ratio:.1f} to 1"


def _detail(transfer: Transfer, odds: LawOdds) -> str:
    low, high = odds.looks_interval
    looks = (
        f"about {low:.0f} looks averaged" if round(low) == round(high) else f"{low:.0f} to {high:.0f} looks averaged"
    )
    if transfer.kind != "log":
        return looks
    low, high = odds.db_interval
    return f"{transfer.db_per_count:.3f} dB per count ({low:.2f} to {high:.2f}), {looks}"


def _chosen(transfer: Transfer, odds: LawOdds, n_pings: int) -> Notice:
    """State the choice and its odds; for the record only where it is decisive and no decibels had to be estimated."""
    is_settled = transfer.kind != "log" and odds.of(transfer.kind) >= _DECISIVE
    next_likeliest = max((law for law in LAWS if law != transfer.kind), key=odds.of)
    keys = "sonar.transfer and sonar.db_per_count" if transfer.kind == "log" else "sonar.transfer"
    return Notice(
        code="transfer.chosen",
        text=f"samples are taken as '{transfer.kind}': odds {_odds_text(odds, transfer.kind, next_likeliest)} against "
        f"'{next_likeliest}' "
        f"from {n_pings} pings; {_detail(transfer, odds)}. Set {keys} if the recorder's manual states otherwise.",
        for_the_record=is_settled,
    )


def _unchecked(kind: TransferKind) -> Notice:
    text = f"too few usable samples to check the sample transfer; '{kind}' is used. Set sonar.transfer."
    return Notice(code="transfer.unchecked", text=text)


def _turned(held: Transfer, transfer: Transfer, odds: LawOdds, place: str) -> Notice:
    if held.kind == transfer.kind:
        what = f"'log' samples look like {_detail(transfer, odds)} instead of {held.db_per_count:.3f} dB"
    else:
        what = (
            f"samples look like '{transfer.kind}' instead of '{held.kind}' (odds "
            f"{_odds_text(odds, transfer.kind, held.kind)}; "
            f"{_detail(transfer, odds)})"
        )
    return Notice(
        code="transfer.turned",
        text=f"{what} and are taken so from here on; statistics of the sea floor start anew. Contacts before may be "
        "wrong or missing: set "
        "sonar.transfer and replay the record, and replay logs of different recorders apart.",
        place=place,
    )
