"""Run the waterfall stage: blocks of pings with poses in, metric tiles out."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.intake import PingBlock, equal_counts
from auv_mcm.kernels.waterfall_rows import Turning, ping_masks, scale_rows
from auv_mcm.records import SIDES, Notice, Ping, Side, Tile, Transfer
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.bottom import BottomTrack, BottomTracker
from auv_mcm.waterfall.floor_watch import FloorWatch
from auv_mcm.waterfall.grid import LEVEL_COLUMNS, AlongTrackGrid, SideImage, Swath
from auv_mcm.waterfall.ground import Traces, mean_between
from auv_mcm.waterfall.interference import InterferenceFilter
from auv_mcm.waterfall.pixel_geometry import LEVEL_BIN_M, PixelGeometry, pixel_geometry, runs
from auv_mcm.waterfall.quality import TraceChecker
from auv_mcm.waterfall.radiometry import REFERENCE_PINGS, AngleCurve, GainStepFilter, ping_levels
from auv_mcm.waterfall.tiles import TileCutter

_MIN_SPEED_MPS: Final = 0.2  # m/s: keeps the turn per metre finite when the vehicle stands
_WATER_FRACTION: Final = 0.9  # of the first return, up to which samples are water for certain
_TURN_SIGN: Final[dict[Side, float]] = {"port": 1.0, "starboard": -1.0}


class _HeldBlock(NamedTuple):
    block: PingBlock
    traces: dict[Side, Traces]


class Waterfall:
    """Stream blocks of pings into tiles; count everything rejected in `counters`.

    reference_pings: over which the response is averaged that levels are measured against; 0 for levels as recorded.
    """

    def __init__(
        self,
        config: Config,
        transfer: Transfer,
        overlap_m: float,
        counters: Counter[str],
        reference_pings: float = REFERENCE_PINGS,
    ) -> None:
        self._config = config
        self._counters = counters
        self._reference_pings = reference_pings
        self.read_as(transfer)
        self._grid = AlongTrackGrid(config.waterfall.row_spacing_m, config.waterfall.max_ping_gap_m)
        self._cutter = TileCutter(config.waterfall, overlap_m)
        self._held: _HeldBlock | None = None
        self._floors = {side: FloorWatch(side, counters) for side in SIDES}
        self._interference = {side: InterferenceFilter(side, counters) for side in SIDES}
        self._notices: list[Notice] = []

    def take_notices(self) -> list[Notice]:
        """Take the notices raised since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def unheard_rows(self, tile: Tile) -> NDArray[np.bool_]:
        """Select the rows of a tile whose pings show no sea floor, (n_rows,)."""
        return self._floors[tile.side].unheard_rows(tile)

    def read_as(self, transfer: Transfer) -> None:
        """Read samples as `transfer` states from the next segment on, and drop what was learnt before."""
        self._checkers = {
            side: TraceChecker(side, transfer, self._config.sonar.full_scale, self._counters) for side in SIDES
        }
        self._curves = {side: AngleCurve() for side in SIDES}
        self._references = {side: AngleCurve(self._reference_pings) for side in SIDES}
        self._gains = {side: GainStepFilter() for side in SIDES}
        self._tracker = BottomTracker(self._config.sonar.blank_m)

    def add(self, block: PingBlock) -> list[Tile]:
        """Take the next block of a segment; return the tiles that are complete."""
        traces = {side: made for side in SIDES if (made := self._traces(side, block.pings)) is not None}
        max_range_m = min(
            max((t.first_range_m + t.n_samples * t.spacing_m for t in traces.values()), default=1.0),
            self._config.sonar.max_range_m,
        )
        corrected_m = self._corrected_m(block.pings, max_range_m)
        track = self._tracker.add(
            [traces.get(side) for side in SIDES], block.poses.altitude_m, max_range_m, corrected_m
        )
        self._cutter.squint_rad = block.pings[0].squint_rad  # a segment has one
        tiles = self._finish_block(track) if track is not None else []
        self._held = _HeldBlock(block, traces)
        return tiles

    def close_segment(self) -> list[Tile]:
        """Give the remaining tiles of a segment."""
        track = self._tracker.flush()
        tiles = self._finish_block(track) if track is not None else []
        rest = self._grid.close()
        if rest is not None:
            tiles += self._cutter.add(*rest)
        self._held = None
        return tiles + self._cutter.close()

    def newest(self, from_row: int, min_rows: int, n_behind: int, n_ahead: int) -> list[Tile]:
        """Give the newest rows as tiles before theirs are complete; see `TileCutter.newest`."""
        return self._cutter.newest(from_row, min_rows, n_behind, n_ahead)

    def next_segment_m(self) -> float:
        """Give the along-track distance at which the next segment may start."""
        return self._cutter.next_segment_row() * self._config.waterfall.row_spacing_m

    def _corrected_m(self, pings: list[Ping], max_range_m: float) -> NDArray[np.float64]:
        """Take the first returns that a person corrected, (n_pings,) float64, NaN elsewhere and beyond the range."""
        stated_m = np.array([ping.first_return_m for ping in pings])
        corrected_m = np.where((stated_m > 0.0) & (stated_m < max_range_m), stated_m, math.nan)
        n_corrected = int(np.count_nonzero(np.isfinite(corrected_m)))
        if n_corrected:
            self._counters["bottom.corrected"] += n_corrected
        if n_beyond := int(np.count_nonzero(np.isfinite(stated_m))) - n_corrected:
            self._counters["bottom.correction_beyond_range"] += n_beyond
        return corrected_m

    def _traces(self, side: Side, pings: list[Ping]) -> Traces | None:
        first = pings[0].port if side == "port" else pings[0].starboard
        if first is None:
            return None
        traces = [ping.port if side == "port" else ping.starboard for ping in pings]
        return self._checkers[side].cumulate(equal_counts([trace for trace in traces if trace is not None]))

    def _finish_block(self, track: BottomTrack) -> list[Tile]:
        assert self._held is not None
        block, traces = self._held
        self._counters["bottom.not_seen"] += int(np.count_nonzero(~track.seen))
        columns = {side: self._n_columns(traces[side]) for side in traces}
        geometry = {n: pixel_geometry(track, n, self._config.waterfall) for n in set(columns.values())}
        images = {side: self._side_image(side, traces[side], block, geometry[columns[side]]) for side in traces}
        swath = Swath(
            block.along_m,
            block.poses,
            track.first_return_m,
            track.sigma_m,
            np.array([ping.number for ping in block.pings], dtype=np.int64),
            images,
        )
        rows = self._grid.add(swath)
        return [] if rows is None else self._cutter.add(*rows)

    def _n_columns(self, traces: Traces) -> int:
        max_range_m = min(traces.first_range_m + traces.n_samples * traces.spacing_m, self._config.sonar.max_range_m)
        return max(1, math.ceil(max_range_m / self._config.waterfall.column_spacing_m))

    def _side_image(self, side: Side, traces: Traces, block: PingBlock, geometry: PixelGeometry) -> SideImage:
        first_return_m = geometry.return_m.values[geometry.return_m.row]
        ground = mean_between(traces, geometry.edges_m, geometry.return_m.row)
        echoes, notices = self._interference[side].cleaned(ground.intensity, ground.valid, block.along_m)
        self._notices += notices
        if echoes is not ground.intensity:  # what was taken out is not clipped any more
            ground = ground._replace(intensity=echoes, saturated=ground.saturated & (echoes == ground.intensity))
        turning = self._turning(side, block, first_return_m)
        max_ratio = self._config.waterfall.max_spacing_ratio
        level_row = geometry.level_m.row
        mask = ping_masks(
            ground.valid, ground.saturated, turning, geometry.ground_m, geometry.coarse, level_row, max_ratio
        )
        positive = ground.valid & (ground.intensity > 0.0)
        log_intensity = _logarithms(ground.intensity)
        learnable = positive & ~ground.saturated
        seabed_level = ping_levels(log_intensity, learnable)
        water_level = self._water_level(traces, first_return_m)
        rise = _near_level(traces, geometry) - water_level
        self._notices += self._floors[side].add(rise, block.poses.time_s)
        gain, n_steps = self._gains[side].corrections(seabed_level, water_level)
        self._counters[f"radiometry.{side}_gain_step"] += n_steps
        if gain.any():
            log_intensity -= gain[:, None]
        curve = self._curves[side].learn(log_intensity, learnable, geometry.tangent, level_row)
        # The correction, computed once for pings in a row that share their height and gain.
        gains = runs(gain)
        both = runs(level_row * len(gains.values) + gains.row)
        level, corrected = np.divmod(both.values, len(gains.values))
        intensity = scale_rows(ground.intensity, np.exp(-gains.values[corrected, None] - curve[level]), both.row)
        # A few columns are enough for an angle response, which changes slowly.
        n_columns = mask.shape[1]
        some = np.minimum(np.arange(LEVEL_COLUMNS // 2, n_columns + LEVEL_COLUMNS // 2, LEVEL_COLUMNS), n_columns - 1)
        offset = curve[:, some]
        if self._reference_pings:
            log_few, learnable_few = np.take(log_intensity, some, axis=1), np.take(learnable, some, axis=1)
            tangent = np.take(geometry.tangent, some, axis=1)
            offset = offset - self._references[side].learn(log_few, learnable_few, tangent, level_row)
        return SideImage(intensity, mask, offset.astype(np.float32)[level_row])

    def _turning(self, side: Side, block: PingBlock, first_return_m: NDArray[np.float64]) -> Turning:
        """Compute the rotation that spreads or squeezes the pings on the bottom.

        Spacing over its straight-line value: 1 -+ y * yaw rate / v on the inside / outside, plus altitude * pitch rate
        / v.
        """
        speed = np.maximum(block.poses.speed_mps, _MIN_SPEED_MPS)
        yaw = _TURN_SIGN[side] * block.yaw_rate_rad_s / speed
        pitch = first_return_m * block.pitch_rate_rad_s / speed
        fast = np.abs(block.yaw_rate_rad_s) > math.radians(self._config.waterfall.max_turn_rate_deg_s)
        return Turning(pitch, yaw, fast)

    def _water_level(self, traces: Traces, first_return_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the median ln I of the water column between ring-down and bottom per ping, (n_pings,) float64.

        NaN where it is too short.
        """
        n_bins = int(np.max(first_return_m) * _WATER_FRACTION / LEVEL_BIN_M)
        edges = self._config.sonar.blank_m + np.arange(max(n_bins, 1) + 1, dtype=np.float64) * LEVEL_BIN_M
        means = mean_between(traces, edges[None, :])
        usable = means.valid & (means.intensity > 0.0) & (edges[None, 1:] < _WATER_FRACTION * first_return_m[:, None])
        return ping_levels(_logarithms(means.intensity), usable)


def _near_level(traces: Traces, geometry: PixelGeometry) -> NDArray[np.float64]:
    """Take the median ln I of the first metres of sea floor per ping, (n_pings,); NaN where too little is there."""
    means = mean_between(traces, geometry.near_m, geometry.return_m.row)  # with what lies between the bins
    usable = means.valid & (means.intensity > 0.0)
    usable[:, 1::2] = False
    return ping_levels(_logarithms(means.intensity), usable)


def _logarithms(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take natural logarithms of values, of what is not positive that of the smallest number."""
    positive = np.maximum(values, np.finfo(np.float64).tiny)
    return np.asarray(np.log(positive, out=positive))
