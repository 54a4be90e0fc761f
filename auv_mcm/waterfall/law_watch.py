"""Decide what samples mean from the first pings, and keep checking while pings come.

The decision depends on the pings alone, in their order, not on their delivery. Without a configured law, several
hundred pings decide, or as many as come within half a minute where pings are rare. What they leave open is read as
linear amplitude, the commonest, and checked again. The law turns if later pings strongly contradict it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.intake import equal_counts, nearly_as_many
from auv_mcm.kernels.ping_windows import BLOCK_PINGS
from auv_mcm.records import EchoTrace, Notice, Ping, Transfer, TransferKind
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.floor_speckle import floor_speckle
from auv_mcm.waterfall.regions import Regions, measure_regions
from auv_mcm.waterfall.sample_law import SampleLaw, same_picture, sample_law

DECIDE_PINGS: Final = 256  # pings before the first verdict on the law, if they take long enough
_MAX_PINGS: Final = 512  # where the first leave the law open
_MIN_PINGS: Final = 64  # pings that a verdict needs, however long they took
_DECIDE_S: Final = 30.0  # slow pings decide after this much time, so that contacts do not wait for minutes
_TURN_NATS: Final = math.log(1000.0)  # odds against the law in use from which it turns or is doubted
_TURN_FACTOR_NATS: Final = 0.35  # decibels that differ by less are not worth starting statistics again. Chosen
# Nats that configured decibels per count may differ from what speckle shows: smoothing and texture bring the estimate
# off by a third.
_DOUBT_NATS: Final = 0.7
_GAP_S: Final = 2.0
_GAP_STEPS: Final = 3.0  # of the time between pings: those of a long-range sonar come seconds apart
_SLOWEST_S: Final = 30.0  # s between pings of one recorder, maximum; chosen: sound goes 20 km and back
_RECENT_BLOCKS: Final = 32  # 512 pings
_WATCHED: Final = 4  # of so many blocks after the decision one is measured, at a quarter of the processor time
_SPREAD_BLOCKS: Final = 32
# since the start or a hole in time, after which the power is not raised any more: sea floor under pings that lie close
# together raises what is read from 2 to 2.9, and a picture that is compressed costs little
_NEW_BLOCKS: Final = _RECENT_BLOCKS


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
        self._open: dict[tuple[bool, bool], list[Ping]] = {}  # of the block being filled, by the sides that are there
        self._newest: Ping | None = None
        self._n_given = 0  # pings since the start
        self._n_pings = 0  # of them those that do not repeat the one before
        self._n_blocks = 0
        self._took_s = 0.0  # since the start, of each step between pings no more than _GAP_S
        self._last_s = math.nan
        self._far_s = math.nan  # a time that the next one shows to be wrong, or to follow a hole
        self._step_s = math.inf  # between the last two pings, unknown at first
        self._transfer: Transfer | None = None
        self._known: TransferKind | None = None  # by configuration or protocol
        self._is_checked = False
        self._next_check = 0  # block count of the next check
        self._in_doubt = False

    def add(self, ping: Ping) -> LawVerdict | None:
        """Take a ping; a verdict where one is due.

        The first verdict always names a transfer; no ping can be read before.
        """
        self._note_time(ping)
        if self._newest is None or not _repeats(ping, self._newest):
            self._n_pings += 1
            self._collect(_alive(ping))
        self._newest = ping
        if self._transfer is None:
            return self._decide(ping.transfer) if self._is_time_to_decide(ping) else None
        return self._check(ping.place) if self._n_blocks >= self._next_check else None

    def finish(self) -> LawVerdict | None:
        """Decide from the pings that came, or check once, where more were awaited for it."""
        if self._transfer is None:
            return self._decide(None) if self._n_pings else None
        return None if self._is_checked else self._check("")

    def _note_time(self, ping: Ping) -> None:
        """Restart after a hole in time: another recorder may follow, as in several logs replayed as one mission.

        A time far from those before and behind it is a wrong one, whether one message bears it or both sides' do.
        """
        self._n_given += 1
        if not math.isfinite(ping.time_s) or ping.time_s == self._far_s:
            return
        step_s, from_far_s = abs(ping.time_s - self._last_s), abs(ping.time_s - self._far_s)
        if not self._is_hole(step_s):
            self._far_s = math.nan
        elif not from_far_s < math.inf or self._is_hole(from_far_s):
            self._far_s = ping.time_s
            self._step_s = from_far_s if from_far_s < _SLOWEST_S else self._step_s  # of rarer pings than before
            return
        else:
            step_s, self._far_s = from_far_s, math.nan
            if self._transfer is not None:
                self._blocks.clear()
                self._open = {}
                self._n_blocks = 0
                self._next_check = _MIN_PINGS // BLOCK_PINGS
        self._last_s = ping.time_s
        self._took_s += min(step_s, _GAP_S) if step_s < math.inf else 0.0
        self._step_s = step_s if 0.0 < step_s < math.inf else self._step_s

    def _is_hole(self, step_s: float) -> bool:
        return step_s > max(_GAP_S, _GAP_STEPS * self._step_s)

    def _collect(self, ping: Ping) -> None:
        has_sides = ping.port is not None, ping.starboard is not None
        if has_sides == (False, False):
            return
        block = self._open.get(has_sides)
        if block is None or not _is_alike(ping, block[0]):
            block = self._open[has_sides] = []
        block.append(ping)
        if len(block) == BLOCK_PINGS:
            if self._is_measured_next():
                self._blocks.append(_Measured(self._n_blocks, measure_block(block)))
            self._n_blocks += 1
            del self._open[has_sides]
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
        if self._n_given >= _MAX_PINGS:
            return True
        if self._n_pings % BLOCK_PINGS or self._n_pings < _MIN_PINGS:
            return False
        if self._n_pings < DECIDE_PINGS and self._took_s < _DECIDE_S:
            return False
        return kind is not None or self._law(None).is_sure

    def _law(self, kind: TransferKind | None) -> SampleLaw:
        law = sample_law(floor_speckle([block.regions for block in self._blocks]), kind)
        if law.transfer.kind == "log" and self._sonar.db_per_count is not None:
            return law._replace(transfer=Transfer("log", self._sonar.db_per_count))
        return law

    def _decide(self, stated: TransferKind | None) -> LawVerdict:
        self._known = stated if self._sonar.transfer == "auto" else self._sonar.transfer
        law = self._law(self._known)
        self._transfer = law.transfer
        self._is_checked = law.n_regions > 0
        self._next_check = self._n_blocks + DECIDE_PINGS // BLOCK_PINGS
        if self._known is not None:
            return LawVerdict(self._transfer, self._doubts("") if self._is_checked else ())
        if not self._is_checked:
            return LawVerdict(self._transfer, (_unchecked(self._transfer.kind),))
        return LawVerdict(self._transfer, (_chosen(law, self._n_pings),))

    def _check(self, place: str) -> LawVerdict | None:
        assert self._transfer is not None
        self._is_checked = True
        self._next_check = self._n_blocks + DECIDE_PINGS // BLOCK_PINGS
        if self._known is not None:
            notices = self._doubts(place)
            return LawVerdict(None, notices) if notices else None
        law = self._law(None)
        held = self._transfer
        if (
            law.n_regions == 0
            or abs(law.linear_nats) < _TURN_NATS
            or same_picture(held, law.transfer, _TURN_FACTOR_NATS)
            or (self._n_blocks > _NEW_BLOCKS and _stretches(law.transfer, held))
        ):
            return None
        if held.kind == law.transfer.kind:
            # Checked after twice as many pings each time: an estimate that wavers must not restart statistics often.
            self._next_check = 2 * self._n_blocks
        self._transfer = law.transfer
        # Older blocks may come from another recorder.
        self._forget(DECIDE_PINGS // BLOCK_PINGS)
        return LawVerdict(self._transfer, (_turned(held, law, place),))

    def _doubts(self, place: str) -> tuple[Notice, ...]:
        """Report strong evidence against a configured or stated law, once until the evidence agrees again."""
        assert self._known is not None
        law = sample_law(floor_speckle([block.regions for block in self._blocks]), None)
        notice = None
        if law.n_regions and abs(law.linear_nats) >= _TURN_NATS:
            if (self._known == "log") != (law.seen == "log"):
                source = "the sonar's protocol states" if self._sonar.transfer == "auto" else "sonar.transfer is"
                notice = _disagrees(f"{source} '{self._known}'", law, place)
            elif self._known == "log" and self._sonar.db_per_count is not None:
                configured = Transfer("log", self._sonar.db_per_count)
                if not same_picture(configured, law.transfer, _DOUBT_NATS):
                    notice = _other_decibels(configured, law, place)
        raised, self._in_doubt = self._in_doubt, notice is not None
        return () if raised or notice is None else (notice,)


def measure_block(pings: Sequence[Ping]) -> Regions:
    """Measure 16 pings of one sample type and nearly as many samples each."""
    sides = ([ping.port for ping in pings], [ping.starboard for ping in pings])
    heard = [equal_counts([trace for trace in side if trace is not None]) for side in sides if side[0] is not None]
    return measure_regions([np.stack([trace.samples for trace in side]) for side in heard])


def law_of_pings(pings: Sequence[Ping], sonar: SonarConfig) -> SampleLaw:
    """Read the law from up to 512 pings spread over those given, in blocks of 16 that follow each other.

    What `sonar` configures is kept.
    """
    pings = [ping for ping in map(_alive, pings) if ping.port is not None or ping.starboard is not None]
    starts = np.linspace(0, max(len(pings) - BLOCK_PINGS, 0), _SPREAD_BLOCKS).astype(int)
    runs = [pings[start : start + BLOCK_PINGS] for start in sorted(set(starts.tolist()))]
    whole = [run for run in runs if len(run) == BLOCK_PINGS and all(_is_alike(ping, run[0]) for ping in run)]
    kind = None if sonar.transfer == "auto" else sonar.transfer
    law = sample_law(floor_speckle([measure_block(run) for run in whole]), kind)
    if law.transfer.kind == "log" and sonar.db_per_count is not None:
        return law._replace(transfer=Transfer("log", sonar.db_per_count))
    return law


def _stretches(transfer: Transfer, held: Transfer) -> bool:
    """Check whether linear samples are raised to a higher power than so far."""
    return transfer.kind == held.kind == "amplitude" and transfer.intensity_power > held.intensity_power


def _alive(ping: Ping) -> Ping:
    """Take the sides away whose samples are all one number: nothing was received there."""
    port = None if ping.port is None or _is_constant(ping.port.samples) else ping.port
    starboard = None if ping.starboard is None or _is_constant(ping.starboard.samples) else ping.starboard
    if port is ping.port and starboard is ping.starboard:
        return ping
    return structs.replace(ping, port=port, starboard=starboard)


def _is_constant(samples: NDArray[Any]) -> bool:
    return samples.size == 0 or bool(samples[0] == samples[-1] and (samples == samples[0]).all())


def _repeats(ping: Ping, before: Ping) -> bool:
    """Check whether a ping holds the samples of the one before, as where it is sent twice: their speckle is one."""
    return _is_same(ping.port, before.port) and _is_same(ping.starboard, before.starboard)


def _is_same(one: EchoTrace | None, other: EchoTrace | None) -> bool:
    if one is None or other is None:
        return one is other
    n, n_other = len(one.samples), len(other.samples)
    # The sample in the middle shows nearly all that differ, in a tenth of the time.
    return n == n_other and (
        n == 0 or bool(one.samples[n // 2] == other.samples[n // 2] and (one.samples == other.samples).all())
    )


def _is_alike(ping: Ping, first: Ping) -> bool:
    """Check whether a ping has the sides of another, their sample types, and nearly as many samples."""
    return _may_join(ping.port, first.port) and _may_join(ping.starboard, first.starboard)


def _may_join(one: EchoTrace | None, other: EchoTrace | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.samples.dtype == other.samples.dtype and nearly_as_many(one, other)


def _odds_text(law: SampleLaw) -> str:
    ratio = math.exp(min(abs(law.linear_nats), 20.0))
    return "over 1000 to 1" if ratio > 1000.0 else f"{ratio:.0f} to 1" if ratio >= 9.5 else f"{ratio:.1f} to 1"


def _detail(transfer: Transfer) -> str:
    if transfer.kind == "log":
        return f"'log' of {transfer.db_per_count:.2f} dB per count"
    power = transfer.intensity_power
    return f"'{transfer.kind}'" + ("" if power in (1.0, 2.0) else f" whose power {power:.2f} is intensity")


def _chosen(law: SampleLaw, n_pings: int) -> Notice:
    """State the choice; for the record only where it is sure."""
    if law.is_sure:
        text = (
            f"samples are taken as {_detail(law.transfer)}: they are "
            f"{'linear' if law.seen == 'amplitude' else 'logarithms'} by odds of {_odds_text(law)} from {n_pings} "
            "pings. Set sonar.transfer if the recorder's manual states otherwise."
        )
        return Notice(code="transfer.chosen", text=text, for_the_record=True)
    text = (
        f"{n_pings} pings do not show whether samples are linear or logarithms (odds {_odds_text(law)} for "
        f"'{law.seen}'). They are taken as linear amplitude, and later pings are checked. If the recorder stores "
        "logarithms, set sonar.transfer to log and replay."
    )
    return Notice(code="transfer.chosen", text=text)


def _unchecked(kind: TransferKind) -> Notice:
    text = f"too few usable samples to check the sample transfer; '{kind}' is used. Set sonar.transfer."
    return Notice(code="transfer.unchecked", text=text)


def _disagrees(source: str, law: SampleLaw, place: str) -> Notice:
    text = (
        f"{source} but the samples look like {_detail(law.transfer)} (odds {_odds_text(law)}). If that is wrong, "
        "contrast and false alarms suffer. Check the recorder's manual."
    )
    return Notice(code="transfer.disagrees", text=text, place=place)


def _other_decibels(configured: Transfer, law: SampleLaw, place: str) -> Notice:
    text = (
        f"sonar.db_per_count is {configured.db_per_count:g} but the samples look like "
        f"{law.transfer.db_per_count:.2f}. Check the recorder's manual."
    )
    return Notice(code="transfer.db_per_count", text=text, place=place)


def _turned(held: Transfer, law: SampleLaw, place: str) -> Notice:
    text = (
        f"samples look like {_detail(law.transfer)} instead of {_detail(held)} (odds {_odds_text(law)}) and are taken "
        "so from here on; statistics of the sea floor start again. Contacts before may be wrong or missing: set "
        "sonar.transfer and replay the record, and replay logs of different recorders apart."
    )
    return Notice(code="transfer.turned", text=text, place=place)
