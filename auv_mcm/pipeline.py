"""The one chain from pings and navigation to contacts: synchronous, deterministic, the same live and replayed.

    events -> intake -> waterfall -> detection -> sea floor and coverage
           -> suppression -> confirmation -> ledger -> events

What comes out depends on the events that went in and on the configuration alone: not on how the stream was cut up, on
threads, or on the time of day. Stages neither read clocks nor touch files; a timer may be injected to learn what they
cost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import repeat
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.budget import Allowance, pay_looks, tile_allowance
from auv_mcm.chain_models import read_models
from auv_mcm.classify.verifier import Opinion
from auv_mcm.clearance.coverage import CoverageGrid, cover_tile, placed_rows, uncovered
from auv_mcm.clearance.sampling import Sampling
from auv_mcm.confirm_tile import confirm_tile
from auv_mcm.confirmation import confirm_detection, detector_p_mine, opinions_on
from auv_mcm.contacts.ledger import Contacts, Ledger
from auv_mcm.contacts.operating_point import CallWatch, OperatingPoint
from auv_mcm.contacts.repeats import without_repeats
from auv_mcm.defects import Defect, caught, defect_notice
from auv_mcm.detect.detect_tile import OVERLAP_M, TileDetections, detect_tile, worth_looking
from auv_mcm.detect.place_counts import PlaceCounts
from auv_mcm.detect.suppress import Suppressor
from auv_mcm.early import EarlyLook
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation_watch import NavigationWatch
from auv_mcm.intake import Intake, PingBlock, SegmentEnd
from auv_mcm.records import (
    SIDES,
    Contact,
    CoveragePatch,
    Detection,
    NavSample,
    Notice,
    Ping,
    PipelineEvent,
    SeabedCells,
    SourceEvent,
    Tile,
)
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import configured_seabed_model
from auv_mcm.settings.config import Config
from auv_mcm.skips import NO_SKIPS, Skips
from auv_mcm.stage_costs import StageTimers
from auv_mcm.tile_notices import (
    candidates_over_budget,
    cheapest_pass_over,
    confirmation_failed,
    early_look_failed,
    looks_over_budget,
    tile_limited,
)
from auv_mcm.waterfall.law_watch import LawVerdict, LawWatch
from auv_mcm.waterfall.radiometry import REFERENCE_PINGS
from auv_mcm.waterfall.sample_checks import SampleCheck
from auv_mcm.waterfall.waterfall import Waterfall

_STATE: Final = (
    "_counts",
    "_intake",
    "_navigation_watch",
    "_sampling",
    "_samples",
    "_law",
    "_undecided",
    "_waterfall",
    "_suppressors",
    "_room",
    "_n_new_samples",
    "_likely",
    "_ledger",
    "_calls",
    "_places",
    "_early",
    "_grid",
    "_finished",
)
"""Attributes that the events change."""


class Pipeline:
    """Feed it events in the order they were recorded; it returns what became final.

    `contacts` holds the contacts so far, `counters` everything skipped or degraded. Contacts come again, under the same
    id, when another view joins them or their call turns. without_skips: skips of `auv_mcm.skips` that are switched off.
    `detect`, `look` and `seabed` take the place of detection in a tile, of confirmation of a detection, and of the
    kinds of sea floor in a tile, to compare with others or to learn from what is seen.
    kept: where contacts are kept, in memory if None; they are the same wherever that is.
    early: look at the newest rows before their tile is complete and announce early contacts; all else is the same
    without.
    reference_pings, overlap_m: of tiles, as of `Waterfall`. Where nothing is detected, an overlap of LOCAL_MEAN_REACH_M
    gives the same pixels sooner.

    The models that `config` names are read here, once. Raises BadInputError or UsageError if one cannot be.
    """

    def __init__(
        self,
        config: Config,
        *,
        without_skips: Skips = NO_SKIPS,
        threads: int = 1,
        timer: Callable[[], float] | None = None,
        detect: Callable[[Tile], TileDetections] | None = None,
        look: Callable[[Detection], Detection] | None = None,
        seabed: Callable[[Tile], SeabedCells | None] | None = None,
        kept: Contacts | None = None,
        early: bool = False,
        reference_pings: float = REFERENCE_PINGS,
        overlap_m: float = OVERLAP_M,
    ) -> None:
        self._config = config
        self._reference_pings, self._overlap_m = reference_pings, overlap_m
        self._without_skips = without_skips
        self.costs_s: dict[str, float] = {}
        self._timed = StageTimers(timer, self.costs_s)
        self._counts: Counter[str] = Counter()
        self._intake = Intake(config, self._counts)
        self._navigation_watch = NavigationWatch()
        self._sampling = Sampling()
        self._samples = {side: SampleCheck(side, config.sonar.full_scale, self._counts) for side in SIDES}
        self._law = LawWatch(config.sonar)
        self._undecided: list[Ping] = []  # pings whose samples cannot be read yet
        self._waterfall: Waterfall | None = None
        self._suppressors = {
            side: Suppressor(config.detect, config.waterfall.row_spacing_m, self._counts) for side in SIDES
        }
        models, self._detector = read_models(config, without_skips)
        model, gate, self._odds, background, sizes = models
        own = partial(detect_tile, config=config, model=model, gate=gate, without_skips=without_skips)
        self._detect_in: Callable[[Tile, int | None], TileDetections] = (
            (lambda tile, max_evaluations: own(tile, max_evaluations=max_evaluations))
            if detect is None
            else lambda tile, _: detect(tile)
        )
        self._room = 1.0
        self._n_new_samples = 0  # stored, since the last tiles
        beam_width_rad = config.sonar.beam_width_rad
        confirm = partial(
            confirm_detection,
            beam_width_rad=beam_width_rad,
            odds=self._odds,
            config=config.confirm,
            without_skips=without_skips,
            sizes=sizes,
        )
        self._look_closely: Callable[[Detection, Opinion | None], Detection] = (
            (lambda detection, opinion: confirm(detection, opinion=opinion))
            if look is None
            else lambda detection, _: look(detection)
        )
        self._asks_network = look is None and self._odds.verifier is not None
        prior = self._odds.prior if config.confirm.enabled else 0.0
        self._likely: list[Detection] = []  # mines that their passage may show once more
        self._ledger = Ledger(config.contacts, prior, kept)
        self._calls = CallWatch(config.contacts, background)
        self.constants: dict[str, object] = {"config": config, **models._asdict()}
        """What the state holds and never changes, by name; see `auv_mcm.frozen_state`."""
        # A model of the sea floor is read only where it is used, so that a new one can be fitted whatever the shipped
        # one measures.
        self._seabed_of = seabed or partial(seabed_cells, model=configured_seabed_model(config))
        self._places = PlaceCounts()
        self._early = EarlyLook(config, model, gate, self._odds, prior, sizes) if early else None
        self._grid: CoverageGrid | None = None
        self._threads = ThreadPoolExecutor(threads) if threads > 1 else None
        self._finished = False

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Read all contacts reported so far, by id, called by what was found so far."""
        return tuple(map(self._calls.point.marked, self._ledger.contacts))

    @property
    def operating_point(self) -> OperatingPoint:
        """Return what is called a mine, by what was found so far."""
        return self._calls.point

    @property
    def counters(self) -> Counter[str]:
        """Count what was rejected, skipped or degraded so far, by dotted name; zeros are left out."""
        early = Counter[str]() if self._early is None else self._early.counters
        return +(self._counts + self._intake.navigation_counters + early)

    @property
    def places(self) -> dict[str, Any]:
        """Count the places that the detector saw, reported or not, as `PlaceCounts.table` lays them out."""
        return self._places.table()

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]:
        """List likely mines for which a further view from a known direction would help."""
        return self._ledger.asking(min_p_mine)

    def leave_room(self, room: float) -> None:
        """Bound the work on tiles to come, for a service that is behind.

        room: share, 0 to 1, of the time that passes over a tile. At 1, the initial value, the configuration alone
        bounds the work. Below 1 there are no early looks.
        """
        self._room = room

    def state(self) -> dict[str, Any]:
        """Give everything that the events so far have left behind, but for `constants` and the contacts kept.

        To be frozen at once: feeding goes on changing it.
        """
        return {name: getattr(self, name) for name in _STATE}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore `state`, which needs the same configuration and contact store."""
        for name in _STATE:
            setattr(self, name, state[name])

    def reserve(self, n_contacts: int) -> None:
        """Number contacts to come from n_contacts + 1 on at the lowest: those before were announced and are lost."""
        self._ledger.reserve(n_contacts)

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        """Take one event; return what became final because of it."""
        if isinstance(event, Notice):
            return [event]
        if isinstance(event, NavSample):
            with self._timed["intake"]:
                found: list[PipelineEvent] = [*self._intake.add_navigation(event), *self._navigation_watch.add(event)]
                return found + self._run(released) if (released := self._intake.let_go()) else found
        self._counts["ping.received"] += 1
        prepared = self._prepare(event)
        port, starboard = self._samples["port"], self._samples["starboard"]
        events: list[PipelineEvent] = [*port.take_notices(event.place), *starboard.take_notices(event.place)]
        if prepared is None:
            return events
        for check, trace in ((port, prepared.port), (starboard, prepared.starboard)):
            if trace is not None:
                self._n_new_samples += trace.samples.size
                events += check.check(trace, event.place)
        with self._timed["law"]:
            verdict = self._law.add(prepared)
        if self._waterfall is None:
            self._undecided.append(prepared)
            return events if verdict is None else events + self._begin(verdict)
        if verdict is not None:
            events += verdict.notices
            if verdict.transfer is not None:
                self._counts["transfer.turned"] += 1
                self._intake.end_segment(verdict.transfer)
        return events + self._take(prepared)

    def finish(self) -> list[PipelineEvent]:
        """Release what is still in the chain at the end of the stream. Calling it again returns nothing."""
        if self._finished:
            return []
        self._finished = True
        verdict = self._law.finish()
        events: list[PipelineEvent] = []
        if verdict is not None:
            events += self._begin(verdict) if self._waterfall is None else verdict.notices
        if self._waterfall is not None:
            with self._timed["intake"]:
                released = self._intake.flush()
            events += self._run(released)
        if self._threads is not None:
            self._threads.shutdown()
        with self._timed["calls"]:
            events += self._calls.announce((), self._ledger.numbered, is_last=True)
        return [*events, *self._calls.take_notices()]

    def _prepare(self, ping: Ping) -> Ping | None:
        """Strip the ping of what cannot be an echo trace; None if nothing is left."""
        port, starboard = self._samples["port"].usable(ping.port), self._samples["starboard"].usable(ping.starboard)
        if port is None and starboard is None:
            self._counts["ping.without_samples"] += 1
            return None
        if port is ping.port and starboard is ping.starboard:
            return ping
        return msgspec.structs.replace(ping, port=port, starboard=starboard)

    def _begin(self, verdict: LawVerdict) -> list[PipelineEvent]:
        """Run the pings that waited for the first verdict, which names their transfer."""
        assert verdict.transfer is not None
        self._waterfall = Waterfall(
            self._config, verdict.transfer, self._overlap_m, self._counts, self._reference_pings
        )
        events: list[PipelineEvent] = [*verdict.notices, self._detector]
        waiting, self._undecided = self._undecided, []
        for ping in waiting:
            events += self._take(ping)
        return events

    def _take(self, ping: Ping) -> list[PipelineEvent]:
        with self._timed["intake"]:
            released = self._intake.add_ping(ping)
        return self._run(released)

    def _run(self, released: list[PingBlock | SegmentEnd]) -> list[PipelineEvent]:
        assert self._waterfall is not None
        events: list[PipelineEvent] = [*self._intake.take_notices()]
        for item in released:
            if isinstance(item, SegmentEnd):
                with self._timed["waterfall"]:
                    tiles = self._waterfall.close_segment()
                events += self._look(tiles)
                events += self._conclude([self._suppressors[side].flush() for side in SIDES])
                next_m = self._waterfall.next_segment_m()
                self._intake.start_segment(next_m)
                self._ledger.start_segment(next_m / self._config.waterfall.row_spacing_m)
                self._sampling.start_segment()
                if item.transfer is not None:
                    self._waterfall.read_as(item.transfer)
            else:
                events += [notice for ping in item.pings for notice in self._sampling.add(ping)]
                with self._timed["waterfall"]:
                    tiles = self._waterfall.add(self._intake.place_along_track(item))
                events += self._look(tiles)
                events += self._look_early(self._waterfall)
        return [*events, *self._waterfall.take_notices()]

    def _look_early(self, waterfall: Waterfall) -> list[PipelineEvent]:
        """Look at rows whose tile is not complete. What fails here is announced when the tile is complete."""
        if self._early is None or self._room < 1.0:  # a service that is behind drops this first
            return []
        with self._timed["early"]:
            found = caught(partial(self._early.look, waterfall.newest))
        if not isinstance(found, Defect):
            return [*found]
        self._counts["pipeline.early_look_failed"] += 1
        return [] if self._counts["pipeline.early_look_failed"] > 1 else [early_look_failed(found)]

    def _look(self, tiles: list[Tile]) -> list[PipelineEvent]:
        if not tiles:
            return []
        allowances = self._allowances(tiles)
        with self._timed["detect"]:
            found = list((map if self._threads is None else self._threads.map)(self._detect, tiles, allowances))
        events: list[PipelineEvent] = self._too_dear(tiles, allowances)
        settled: list[list[Detection]] = []
        for tile, result in zip(tiles, found, strict=True):
            events.append(tile)
            patch: CoveragePatch | Defect
            if isinstance(result, Defect):
                events += self._failed(result, "detection", tile)
                patch, result = uncovered(tile), TileDetections((), 0, 0)
            else:
                patch = caught(partial(self._cover, tile, 1.0 if result is None else result.covered_share))
            if isinstance(patch, Defect):
                events += self._failed(patch, "coverage", tile)
                patch = uncovered(tile)
            events.append(patch)
            self._calls.cover(patch)
            if result is None:
                self._counts["detect.tile_skipped_nothing_to_see"] += 1
                result = TileDetections((), 0, 0)
            self._places.add(tile, result)
            self._counts["detect.candidate"] += len(result.detections)
            if result.n_over_budget and not self._counts["detect.over_budget"]:
                events.append(candidates_over_budget(tile, result))
            self._counts["detect.gated"] += len(result.faint.rows)
            self._counts["detect.windows"] += result.n_windows
            self._counts["detect.evaluations"] += result.n_evaluations
            self._counts["detect.windows_cut"] += result.n_cut
            if result.covered_share < 1.0 and not self._counts["budget.tile_limited"] and self._room >= 1.0:
                events.append(tile_limited(tile, result))
            self._counts["budget.tile_limited"] += result.covered_share < 1.0
            self._counts["detect.windows_rejected"] += result.n_rejected
            self._counts["detect.pixels_bounded"] += result.n_bounded
            self._counts["detect.tiles_clear_contrasts"] += result.clear_contrasts
            self._counts["detect.over_budget"] += result.n_over_budget
            self._counts["detect.without_position"] += result.n_without_position
            with self._timed["suppress"]:
                settled.append(
                    self._suppressors[tile.side].add(result.detections, tile.first_row + tile.core_stop, result.faint)
                )
        return events + self._conclude(settled)

    def _cover(self, tile: Tile, evaluated: float) -> CoveragePatch:
        grid = self._cells_around(tile)
        with self._timed["seabed"]:
            seabed = None if grid is None else self._seabed_of(tile)
        with self._timed["coverage"]:
            assert self._waterfall is not None
            blind_rows = self._sampling.coarse_rows(tile) | self._waterfall.unheard_rows(tile)
            return cover_tile(tile, self._config.sonar, evaluated, grid, seabed, blind_rows)

    def _failed(self, defect: Defect, what: str, tile: Tile) -> list[PipelineEvent]:
        """Count a piece that could not be processed; the first one of each kind of work is reported."""
        counter = f"pipeline.{what}_failed"
        self._counts[counter] += 1
        if self._counts[counter] > 1:
            return []
        pings = tile.ping_number[tile.core_start : tile.core_stop]
        pings = pings[pings >= 0]
        place = f"{tile.side} tile {tile.index}" + (f", pings {pings[0]} to {pings[-1]}" if pings.size else "")
        return [defect_notice(defect, what, "That tile is not covered; the mission goes on.", place)]

    def _cells_around(self, tile: Tile) -> CoverageGrid | None:
        """Give the mission's cells, whose plane touches the Earth where its first tile with a position begins."""
        if self._grid is None and (placed := np.flatnonzero(placed_rows(tile))).size:
            latitude_deg, longitude_deg = (
                float(part[placed[0]]) for part in (tile.pose.latitude_deg, tile.pose.longitude_deg)
            )
            self._grid = CoverageGrid(
                LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg), self._config.plan.cell_m
            )
        return self._grid

    def _detect(self, tile: Tile, allowance: Allowance) -> TileDetections | Defect | None:
        """Find the detections of a tile; None if there is nothing to see."""
        looks_anyway = "empty-tiles" in self._without_skips
        return caught(lambda: self._detect_within(tile, allowance) if looks_anyway or worth_looking(tile) else None)

    def _detect_within(self, tile: Tile, allowance: Allowance) -> TileDetections:
        """Find what a tile's budget pays for, with surroundings for the examinations that it pays."""
        found = self._detect_in(tile, allowance.comparisons())
        config = self._config.confirm
        if not config.enabled or "look-budget" in self._without_skips:
            return found
        min_p_mine = 0.0 if "detector-odds" in self._without_skips else config.min_p_mine
        return pay_looks(found, allowance, partial(detector_p_mine, odds=self._odds), min_p_mine)

    def _allowances(self, tiles: list[Tile]) -> list[Allowance]:
        """Give each of the tiles that come together its budget."""
        n_rows = [tile.core_stop - tile.core_start for tile in tiles]
        per_row, self._n_new_samples = self._n_new_samples / max(sum(n_rows), 1), 0
        n_sides, has_verifier = len({tile.side for tile in tiles}), self._odds.verifier is not None
        return [
            tile_allowance(tile, per_row * n, n_sides, self._config.budget, self._room, has_verifier)
            for tile, n in zip(tiles, n_rows, strict=True)
        ]

    def _too_dear(self, tiles: list[Tile], allowances: list[Allowance]) -> list[PipelineEvent]:
        """Count tiles whose cheapest pass is beyond their budget; the first one by the configuration alone is
        reported."""
        dear = [(tile, one) for tile, one in zip(tiles, allowances, strict=True) if one.cheapest_us > one.total_us]
        is_first = not self._counts["budget.cheapest_pass_over"] and self._room >= 1.0
        self._counts["budget.cheapest_pass_over"] += len(dear)
        return [cheapest_pass_over(*dear[0])] if dear and is_first else []

    def _conclude(self, settled: list[list[Detection]]) -> list[PipelineEvent]:
        """Confirm what has become final, tile by tile, and report the contacts that come of it."""
        events: list[PipelineEvent] = []
        final: list[Detection] = []
        config, mapped = self._config.confirm, map if self._threads is None else self._threads.map
        with self._timed["confirm"]:
            for detections in settled:
                done = confirm_tile(
                    detections, config, self._odds, self._opinions, self._look_closely, mapped, self._without_skips
                )
                events += self._looks_failed(done.defects)
                n_over_budget = done.counters["confirm.over_budget"]
                if n_over_budget and not self._counts["confirm.over_budget"]:
                    events.append(looks_over_budget(detections[0], n_over_budget))
                self._counts.update(done.counters)
                final += done.detections
        with self._timed["ledger"]:
            once, self._likely = without_repeats(final, self._likely)
            self._counts["contacts.repeated"] += len(final) - len(once)
            changed = self._ledger.add(once)
        with self._timed["calls"]:
            events += self._calls.announce(changed, self._ledger.numbered)
        if self._early is not None:
            settled_to_row = {side: suppressor.settled_to_row for side, suppressor in self._suppressors.items()}
            events += self._early.resolve(settled_to_row, final, changed)
        return [*events, *self._calls.take_notices()]

    def _looks_failed(self, defects: list[tuple[Detection, Defect]]) -> list[PipelineEvent]:
        first = not self._counts["pipeline.close_look_failed"]
        self._counts["pipeline.close_look_failed"] += len(defects)
        return [confirmation_failed(*defects[0])] if defects and first else []

    def _opinions(self, chosen: list[Detection]) -> Iterator[Opinion | None]:
        """Yield the network's opinions on those chosen, asked together, or none if it failed; then None without end."""
        if self._asks_network and chosen:
            most = None if "look-limit" in self._without_skips else self._config.confirm.max_examined_per_tile
            found = caught(partial(opinions_on, chosen, self._config.sonar.beam_width_rad, self._odds, most))
            if not isinstance(found, Defect):
                yield from found
        yield from repeat(None)
