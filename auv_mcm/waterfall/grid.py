"""Resample pings onto the mission-fixed along-track grid.

Grid row k covers along-track distance [k, k + 1) * row_spacing_m from mission start, so tile boundaries never move a
sample. A ping stands for the stretch half-way to its neighbours; beside a longer gap than permitted, and at the ends of
a segment, for as much as on its other side. A row is the mean of the pings it overlaps, weighted by overlap, and a
stretch without pings stays without data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.pose_track import interpolate_track, slice_pose
from auv_mcm.kernels.waterfall_rows import average_rows
from auv_mcm.records import PoseTrack, Side

_MIN_ROW_COVER = 0.5  # share of a row that pings have to cover for it to hold echoes


LEVEL_COLUMNS: Final = 8  # pixels per value of a level across the track: 0.48 m of the default spacing
"""Levels change over metres, so that few values across the track are enough."""


class SideImage(NamedTuple):
    """Hold the image of one side.

    intensity: (n, n_columns) float32, 0 where not VALID; mask: (n, n_columns) uint8.

    offset: (n, ceil(n_columns / LEVEL_COLUMNS)) float32, nats: the angle response taken off the intensity less that of
    the whole mission so far. None where it was never measured.
    """

    intensity: NDArray[np.float32]
    mask: NDArray[np.uint8]
    offset: NDArray[np.float32] | None = None


class Swath(NamedTuple):
    """Hold n pings, or n grid rows, of all sides over ground range, with their poses.

    along_m: (n,) float64 distance from mission start, strictly increasing. first_return_m, first_return_sigma_m: (n,)
    float64. ping_number: (n,) int64.
    """

    along_m: NDArray[np.float64]
    pose: PoseTrack
    first_return_m: NDArray[np.float64]
    first_return_sigma_m: NDArray[np.float64]
    ping_number: NDArray[np.int64]
    sides: Mapping[Side, SideImage]

    @property
    def n_rows(self) -> int:
        """Count the rows."""
        return int(self.along_m.shape[0])


def concatenate_poses(poses: list[PoseTrack]) -> PoseTrack:
    """Join poses of consecutive pings or rows."""
    return PoseTrack(
        **{name: np.concatenate([getattr(pose, name) for pose in poses]) for name in PoseTrack.__struct_fields__}
    )


def slice_swath(swath: Swath, rows: slice) -> Swath:
    """Take the rows `rows` of a swath."""
    return Swath(
        swath.along_m[rows],
        slice_pose(swath.pose, rows),
        swath.first_return_m[rows],
        swath.first_return_sigma_m[rows],
        swath.ping_number[rows],
        {
            side: SideImage(
                image.intensity[rows], image.mask[rows], None if image.offset is None else image.offset[rows]
            )
            for side, image in swath.sides.items()
        },
    )


def with_own_image(swath: Swath) -> Swath:
    """Copy the image of a part of a swath, so that the part does not keep the whole in memory."""
    sides: dict[Side, SideImage] = {
        side: SideImage(
            image.intensity.copy(), image.mask.copy(), None if image.offset is None else image.offset.copy()
        )
        for side, image in swath.sides.items()
    }
    return swath._replace(sides=sides)


def concatenate_swaths(swaths: list[Swath]) -> Swath:
    """Join swaths one after another.

    Narrower ones are widened by pixels without data, and so are sides that some of them lack.
    """
    if len(swaths) == 1:
        return swaths[0]
    sides: dict[Side, SideImage] = {}
    for side in dict.fromkeys(side for swath in swaths for side in swath.sides):
        n_columns = max(swath.sides[side].mask.shape[1] for swath in swaths if side in swath.sides)
        pieces = [_widened(swath.sides.get(side), swath.n_rows, n_columns) for swath in swaths]
        offsets = [p.offset for p in pieces if p.offset is not None]
        sides[side] = SideImage(
            np.concatenate([p.intensity for p in pieces]),
            np.concatenate([p.mask for p in pieces]),
            np.concatenate(offsets) if len(offsets) == len(pieces) else None,
        )
    return Swath(
        np.concatenate([swath.along_m for swath in swaths]),
        concatenate_poses([swath.pose for swath in swaths]),
        np.concatenate([swath.first_return_m for swath in swaths]),
        np.concatenate([swath.first_return_sigma_m for swath in swaths]),
        np.concatenate([swath.ping_number for swath in swaths]),
        sides,
    )


def _widened(image: SideImage | None, n_rows: int, n_columns: int) -> SideImage:
    if image is None:
        shape = n_rows, n_columns
        return SideImage(np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.uint8), unknown_offset(shape))
    missing = n_columns - image.mask.shape[1]
    if missing == 0:
        return image
    offset = image.offset
    if offset is not None:
        offset = np.concatenate([offset, unknown_offset((n_rows, n_columns))[:, offset.shape[1] :]], axis=1)
    return SideImage(
        np.pad(image.intensity, ((0, 0), (0, missing))), np.pad(image.mask, ((0, 0), (0, missing))), offset
    )


def unknown_offset(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Make the offset of an image of a shape for which none is known: NaN."""
    return np.full((shape[0], math.ceil(shape[1] / LEVEL_COLUMNS)), np.nan, dtype=np.float32)


class AlongTrackGrid:
    """Stream pings of one segment into grid rows. Rows come out once no later ping can change them."""

    def __init__(self, row_spacing_m: float, max_gap_m: float) -> None:
        self._row_spacing_m = row_spacing_m
        self._half_gap_m = 0.5 * max_gap_m
        self._held: Swath | None = None
        self._next_row: int | None = None
        self._previous_along_m = -math.inf  # of the ping before the held ones

    def add(self, pings: Swath) -> tuple[int, Swath] | None:
        """Take pings; give the first row index and finished rows, or None if none is finished yet."""
        held = pings if self._held is None else concatenate_swaths([self._held, pings])
        self._held = held
        return self._emit(last=False)

    def close(self) -> tuple[int, Swath] | None:
        """Give the remaining rows of the segment; the grid is ready for another segment afterwards."""
        rows = self._emit(last=True) if self._held is not None else None
        self._held, self._next_row, self._previous_along_m = None, None, -math.inf
        return rows

    def _emit(self, *, last: bool) -> tuple[int, Swath] | None:
        assert self._held is not None
        held, spacing = self._held, self._row_spacing_m
        along = held.along_m
        start, stop = self._stretches(along)
        # The newest ping's stretch, and its neighbour's end, are known only with the next ping.
        known = along.shape[0] - (1 if last else 2)
        if known < 0:
            return None
        first_row = math.floor(start[0] / spacing) if self._next_row is None else self._next_row
        stop_row = math.ceil(stop[-1] / spacing) if last else math.floor(along[known] / spacing)
        if stop_row <= first_row:
            return None
        rows = _average_rows(held, start, stop, first_row, stop_row, spacing)
        if not last:
            keep = int(np.searchsorted(stop, stop_row * spacing, side="right"))
            keep = min(keep, known)
            # The ping before the kept ones bounds their stretch and carries interpolation of poses.
            keep = max(keep - 1, 0)
            if keep > 0:
                self._previous_along_m = float(along[keep - 1])
                self._held = slice_swath(held, slice(keep, None))
            self._next_row = stop_row
        return first_row, rows

    def _stretches(self, along_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute start and end of the track every held ping stands for, (n,) each."""
        step = np.diff(along_m, prepend=self._previous_along_m, append=np.inf)
        half = np.where(step <= 2.0 * self._half_gap_m, 0.5 * step, np.inf)
        before, after = half[:-1], half[1:]
        # Beside a gap a ping reaches no farther than on its other side: one ping's speckle, drawn out, looks like an
        # object.
        before, after = np.where(np.isinf(before), after, before), np.where(np.isinf(after), before, after)
        return along_m - np.minimum(before, self._half_gap_m), along_m + np.minimum(after, self._half_gap_m)


def _average_rows(
    pings: Swath,
    start_m: NDArray[np.float64],
    stop_m: NDArray[np.float64],
    first_row: int,
    stop_row: int,
    spacing_m: float,
) -> Swath:
    n_rows = stop_row - first_row
    edges = (first_row + np.arange(n_rows + 1)) * spacing_m
    # Pings overlapping row k are the contiguous run [lowest[k], highest[k]).
    lowest = np.searchsorted(stop_m, edges[:-1], side="right")
    highest = np.searchsorted(start_m, edges[1:], side="left")
    span = int((highest - lowest).max(initial=0))
    overlap = np.zeros((n_rows, max(span, 1)), dtype=np.float64)
    source = np.zeros((n_rows, max(span, 1)), dtype=np.intp)
    for step in range(span):
        ping = np.minimum(lowest + step, pings.n_rows - 1)
        length = np.minimum(stop_m[ping], edges[1:]) - np.maximum(start_m[ping], edges[:-1])
        overlap[:, step] = np.where(lowest + step < highest, np.maximum(length, 0.0), 0.0)
        source[:, step] = ping
    centre = 0.5 * (edges[:-1] + edges[1:])
    below, fraction = _place_between(pings.along_m, centre)
    nearest = below + (fraction >= 0.5)
    covered = overlap.sum(axis=1) > 0.0
    return Swath(
        centre,
        interpolate_track(pings.pose, below + fraction),
        np.interp(centre, pings.along_m, pings.first_return_m),
        np.interp(centre, pings.along_m, pings.first_return_sigma_m),
        np.where(covered, pings.ping_number[nearest], -1),
        {
            side: SideImage(
                *average_rows(image.intensity, image.mask, source, overlap, _MIN_ROW_COVER * spacing_m),
                None if image.offset is None else image.offset[nearest],
            )
            for side, image in pings.sides.items()
        },
    )


def _place_between(
    along_m: NDArray[np.float64], wanted_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Find the ping before each wanted distance, and the fraction of the way to the next.

    Distances beyond the ends give the ends. Fractions are multiples of 2^-30, so that index plus fraction is exact and
    does not depend on how many pings went before.
    """
    if along_m.shape[0] == 1:
        return np.zeros(wanted_m.shape, dtype=np.intp), np.zeros(wanted_m.shape)
    below = np.clip(np.searchsorted(along_m, wanted_m, side="right") - 1, 0, along_m.shape[0] - 2)
    fraction = np.clip((wanted_m - along_m[below]) / (along_m[below + 1] - along_m[below]), 0.0, 1.0)
    return below, np.rint(fraction * 2.0**30) * 2.0**-30
