"""Look at the newest rows before their tile is complete, so that a likely mine is announced some ten seconds after it
was passed.

    newest rows -> cascade -> detection -> confirmation -> early contact -> what the finished tile makes of it

Early contacts have ids of their own and appear in no result: a finished mission gives the same results with and without
them. Rows are examined once, a few metres at a time, with less sea floor around them than their tile will have. Those
where the cascade finds nothing likely go no further.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import msgspec

from auv_mcm.budget import Allowance, tile_allowance
from auv_mcm.classify.odds import MineOdds
from auv_mcm.classify.size_evidence import SizeEvidence
from auv_mcm.confirmation import confirm_detection, is_worth_confirming, verified
from auv_mcm.contacts.ledger import contact_from_views
from auv_mcm.detect.cascade.model import SCORE_UNIT, CascadeModel
from auv_mcm.detect.cascade.run import core_plane, run_plane
from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.detect.gate import Gate
from auv_mcm.detect.suppress import Suppressor
from auv_mcm.records import SIDES, Contact, Detection, EarlyContact, Side, Tile, early_id
from auv_mcm.settings.config import Config

EARLY_P_MINE: Final = 0.05
"""Lowest p_mine of an early contact. Those below are announced by their tile, and none of them is a mine that ends at
0.2 or more on flat, mixed, ripple and rough (seed 9400, 110 views)."""
AHEAD_M: Final = 4.0
"""Newest track that is not looked at yet, m: the sea floor before and behind an object that confirmation looks at. With
2 and 3 m 108 and 107 of those views are in time, as with 4 m, 108."""
# minimum of new track, m: less is found no sooner, for rows come in blocks of 32 pings, and costs more
_STEP_M: Final = 6.0
_BEHIND_M: Final = 8.0  # of track before it, m: the 7.5 m that a score depends on
_PROMISING_SCORE: Final = 0.9
"""Of the cascade, in half log-odds. On flat, mixed, ripple and rough (seeds 9400 and 9410) it leaves nine strips in
ten; 1.5 leaves four in five, and lets two of 110 views wait for their tile."""
_MAX_COMPARISONS: Final = 8_000_000  # of the cascade in a strip: 8 ms by the shipped price list
_NO_CONTRAST_ALONE: Final = 1e-30  # tail probability, of 11 deviates: what the cascade does not find can wait
# Between an early contact and the detection of the same object, along and across: what suppression takes for one
_SAME_M: Final = 2.5


class _Pending(NamedTuple):
    contact: Contact
    view: Detection


class _FinalView(NamedTuple):
    """Hold a detection of a finished tile.

    contact_id: of the contact that it is a view of, "" if that is not reported.
    """

    view: Detection
    contact_id: str


class EarlyLook:
    """Find early contacts, and report what became of each. Reads results of the chain and changes none."""

    def __init__(
        self,
        config: Config,
        model: CascadeModel | None,
        gate: Gate | None,
        odds: MineOdds,
        prior: float,
        sizes: SizeEvidence | None = None,
    ) -> None:
        """model: the cascade; contrasts serve without one. odds, prior, sizes: as for the finished tile."""
        self.counters: Counter[str] = Counter()
        share = _STEP_M / (config.waterfall.tile_rows * config.waterfall.row_spacing_m)
        detect = msgspec.structs.replace(
            config.detect,
            p_false_alarm=config.detect.p_false_alarm if model is None else _NO_CONTRAST_ALONE,
            max_candidates_per_tile=math.ceil(config.detect.max_candidates_per_tile * 2.0 * share),
        )
        self._config = msgspec.structs.replace(config, detect=detect)
        self._max_looks = math.ceil(config.confirm.max_per_tile * 2.0 * share)
        self._model, self._gate, self._odds, self._prior, self._sizes = model, gate, odds, prior, sizes
        self._row_m = config.waterfall.row_spacing_m
        self._next_row = 0
        self._recent: dict[Side, list[Detection]] = {side: [] for side in SIDES}
        self._pending: list[_Pending] = []
        self._final: dict[Side, list[_FinalView]] = {side: [] for side in SIDES}
        self._n_found = 0

    def look(self, newest: Callable[[int, int, int, int], list[Tile]]) -> list[EarlyContact]:
        """Look at what is new. newest: gives tiles of the newest rows, as `Waterfall.newest` does."""
        strips = newest(self._next_row, *(round(length_m / self._row_m) for length_m in (_STEP_M, _BEHIND_M, AHEAD_M)))
        found: list[Detection] = []
        for strip in strips:
            self._next_row = strip.first_row + strip.core_stop
            self.counters["early.strips"] += 1
            allowance = tile_allowance(
                strip, 0.0, len(SIDES), self._config.budget, has_verifier=self._odds.verifier is not None
            )
            comparisons = allowance.comparisons()
            max_evaluations = _MAX_COMPARISONS if comparisons is None else min(comparisons, _MAX_COMPARISONS)
            if self._is_promising(strip, max_evaluations):
                self.counters["early.strips_measured"] += 1
                found += self._likely(strip, allowance, max_evaluations)
        return [self._announced(view) for view in sorted(found, key=lambda d: (d.time_s, d.side, d.column))]

    def resolve(
        self, settled: dict[Side, float], final: Iterable[Detection], contacts: Sequence[Contact]
    ) -> list[EarlyContact]:
        """Report what became of early contacts whose tile is finished.

        Parameters
        ----------
        settled
            Row of the mission grid, per side, before which all detections are final.
        final
            Those that became so, with all confirmation.
        contacts
            Those reported because of them.
        """
        if not self._pending:
            return []
        ids = {(view.side, view.row, view.column): contact.id for contact in contacts for view in contact.views}
        for view in final:
            self._final[view.side].append(_FinalView(view, ids.get((view.side, view.row, view.column), "")))
        reach = _SAME_M / self._row_m
        done = [pending for pending in self._pending if pending.view.row + reach < settled[pending.view.side]]
        self._pending = [pending for pending in self._pending if pending not in done]
        resolved = [self._resolved(pending) for pending in done]
        for side, views in self._final.items():
            first = min((p.view.row for p in self._pending if p.view.side == side), default=settled[side])
            self._final[side] = [each for each in views if each.view.row >= first - reach]
        return resolved

    def _is_promising(self, strip: Tile, max_evaluations: int) -> bool:
        """Decide by the cascade alone whether a strip may show a likely mine."""
        if self._model is None:
            return True
        passed = run_plane(core_plane(strip), self._model, max_evaluations)
        return bool(passed.scores.size) and float(passed.scores.max()) >= _PROMISING_SCORE * SCORE_UNIT

    def _likely(self, strip: Tile, allowance: Allowance, max_evaluations: int) -> list[Detection]:
        """Detect and confirm in a strip; return likely mines that have not been found before."""
        seen = detect_tile(strip, self._config, self._model, self._gate, max_evaluations=max_evaluations)
        paid = allowance.n_looks(seen.n_evaluations, len(seen.detections)) if allowance.is_limited else self._max_looks
        reach = _BEHIND_M / self._row_m
        before = [d for d in self._recent[strip.side] if d.row >= strip.first_row + strip.core_start - reach]
        self._recent[strip.side] = [*before, *seen.detections]
        suppressor = Suppressor(self._config.detect, self._row_m, Counter())
        suppressor.add((*before, *seen.detections), -math.inf, seen.faint)
        new = {(d.row, d.column) for d in seen.detections}
        views = [d for d in suppressor.flush() if (d.row, d.column) in new and not self._is_known(d)]
        if self._config.confirm.enabled:
            worthwhile = [d for d in views if is_worth_confirming(d, self._odds, self._config.confirm)]
            best_first = sorted(worthwhile, key=lambda d: (-d.p_mine, d.row, d.column))[: min(self._max_looks, paid)]
            self.counters["early.looked_at"] += len(best_first)
            views = self._confirmed(best_first)
        least = max(EARLY_P_MINE, self._config.contacts.min_p_mine)
        return [msgspec.structs.replace(d, surroundings=None) for d in views if d.p_mine >= least]

    def _confirmed(self, views: list[Detection]) -> list[Detection]:
        """Find p_mine of the views. Outline, size and kind can wait for the finished tile where a verifier decides."""
        width_rad, odds, config = self._config.sonar.beam_width_rad, self._odds, self._config.confirm
        if odds.verifier is not None:
            return verified(views, width_rad, odds)
        return [confirm_detection(one, width_rad, odds, config, sizes=self._sizes) for one in views]

    def _is_known(self, detection: Detection) -> bool:
        return any(_are_same(pending.view, detection) for pending in self._pending)

    def _announced(self, view: Detection) -> EarlyContact:
        self._n_found += 1
        self.counters["early.found"] += 1
        contact = contact_from_views(early_id(self._n_found), (view,), self._prior)
        self._pending.append(_Pending(contact, view))
        return EarlyContact(contact=contact, state="found")

    def _resolved(self, pending: _Pending) -> EarlyContact:
        near = [
            each for each in self._final[pending.view.side] if each.contact_id and _are_same(each.view, pending.view)
        ]
        if not near:
            self.counters["early.withdrawn"] += 1
            return EarlyContact(contact=pending.contact, state="withdrawn")
        self.counters["early.became"] += 1
        nearest = min(near, key=lambda each: (_distance_m(each.view, pending.view), each.contact_id))
        return EarlyContact(contact=pending.contact, state="became", became=nearest.contact_id)


def _distance_m(a: Detection, b: Detection) -> float:
    return math.hypot((a.row - b.row) * a.row_spacing_m, (a.column - b.column) * a.column_spacing_m)


def _are_same(a: Detection, b: Detection) -> bool:
    return a.side == b.side and _distance_m(a, b) <= _SAME_M
