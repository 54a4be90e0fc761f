"""Lay straight legs that may be sailed, and compute what each adds to the clearance of every cell that it sees.

A leg looks to both sides of its credited run. A cell counts as seen where all of it lies abeam of that run, with the
part of its width that the swath reaches. The strip right below the vehicle is not seen. Before and after the credited
run lies the settling distance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import HIGHEST_P, N_LOOKS, LookModel, look_bit
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.fence import circles_inside, runs_inside
from auv_mcm.plan.dubins import Array, PlanePose
from auv_mcm.plan.limits import Limits, turns_inside

MoreTime = Callable[[], bool]

SAME_LOOK_RAD: Final = math.radians(15.0)  # as in `clearance`
RIGHT: Final = math.pi / 2.0
_N_HEADINGS: Final = 8  # of survey lines over half a turn, 22.5° apart; bounds time
_IN_TURN: Final = (0, 4, 2, 6, 1, 5, 3, 7)  # headings
_OWN_HEADING_RAD: Final = math.radians(5.0)  # ripples nearer than this to a heading need no heading of their own
_TURNED_RAD: Final = math.radians(3.0)
_LINES_PER_SWATH: Final = 8  # tried side by side; bounds time: a line is at most a sixteenth of a swath from the best
_MAX_LINES: Final = 64  # side by side
_MAX_SAMPLES: Final = 32  # per line, to find where it is inside the fence
_MIN_EXPONENT: Final = 1e-4  # of clearance in a cell, minimum: less clears nothing
_ROUNDING_RAD: Final = 1e-6  # rad: look angles at the border count alike whatever the rounding


def _bits_alike() -> NDArray[np.uint64]:
    look_rad = 2.0 * math.pi / N_LOOKS * np.arange(N_LOOKS)
    apart = (
        np.abs(np.mod(look_rad[:, np.newaxis] - look_rad + math.pi, 2.0 * math.pi) - math.pi)
        <= SAME_LOOK_RAD + _ROUNDING_RAD
    )
    return np.asarray((apart * _LOOK_BIT).sum(axis=1, dtype=np.uint64))


_LOOK_BIT: Final = look_bit(2.0 * math.pi / N_LOOKS * np.arange(N_LOOKS))
_ALIKE: Final = _bits_alike()
"""(64,) uint64: per look direction the bits of those from nearly the same side."""


class Cells(NamedTuple):
    """Hold (n,) cells that are not cleared yet.

    need: miss exponent that is wanting. weight_m2: what it is worth, as area, to find for sure the mines there that
    have been missed so far.

    looked: whether the cell was seen before, so that a further view adds less; towards: in which directions, bits as in
    `look_bit`.
    """

    east_m: Array
    north_m: Array
    need: Array
    weight_m2: Array
    looked: NDArray[np.bool_]
    towards: NDArray[np.uint64]
    seabed: NDArray[np.uint8]
    ripple_rad: NDArray[np.float32]
    unevenness_db: NDArray[np.float32]
    cell_m: float


class Tracks(NamedTuple):
    """Hold legs, n in all.

    What leg i sees are elements [first[i], last[i]) of the arrays below, in order along its way.

    run: (n, 2, 3) poses of entry and exit, settling included. cell: index into `Cells`; exponent: what a first look
    adds to it; bit: of its direction, alike: of those that are nearly the same, uint64. line: number of the straight
    line that a leg is part of, lines in order from side to side; heading: number of their heading, both -1 for legs
    past contacts, which count for nothing else.
    """

    run: Array
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    cell: NDArray[np.int32]
    exponent: Array
    bit: NDArray[np.uint64]
    alike: NDArray[np.uint64]
    line: NDArray[np.int64]
    heading: NDArray[np.int64]

    @property
    def n_legs(self) -> int:
        """Count the legs."""
        return len(self.run)

    @property
    def length_m(self) -> Array:
        """Compute the lengths of the legs, (n,) m."""
        return np.asarray(np.hypot(*(self.run[:, 1, :2] - self.run[:, 0, :2]).T))


class _Lines(NamedTuple):
    """Hold parallel lines; per seen cell its place along the line, in order of line and place."""

    heading_rad: float
    offset_m: Array
    start: NDArray[np.int64]
    along_m: Array
    cell: NDArray[np.int64]
    exponent: Array
    to_right: NDArray[np.bool_]


def half_extent_m(cell_m: float, heading_rad: float) -> float:
    """Compute half the extent of a cell along a heading."""
    return 0.5 * cell_m * (abs(math.sin(heading_rad)) + abs(math.cos(heading_rad)))


def look_number(look_rad: float) -> int:
    """Find the nearest of the look directions that are distinguished."""
    return round(look_rad / (2.0 * math.pi) * N_LOOKS) % N_LOOKS


def headings_rad(cells: Cells) -> list[float]:
    """Choose headings, the opposite of each included.

    Eight are evenly spread from the direction in which the cells reach farthest; others run along the crests of ripples
    that lie between these.
    """
    if not len(cells.need):
        return []
    turned = np.arange(0.0, math.pi / 2.0 - 1e-9, _TURNED_RAD)[:, np.newaxis]
    sine, cosine = np.sin(turned), np.cos(turned)
    along = np.ptp(cells.east_m * sine + cells.north_m * cosine, axis=1)
    across = np.ptp(cells.east_m * cosine - cells.north_m * sine, axis=1)
    best = int(np.argmin(np.round((along + cells.cell_m) * (across + cells.cell_m), 6)))
    base = float(turned[best, 0]) + (math.pi / 2.0 if across[best] > along[best] else 0.0)
    headings = [math.fmod(base + k * math.pi / _N_HEADINGS, math.pi) for k in range(_N_HEADINGS)]
    ripple = cells.ripple_rad[np.isfinite(cells.ripple_rad)].astype(np.float64)
    if len(ripple):
        crests = 0.5 * math.atan2(float(np.sin(2.0 * ripple).sum()), float(np.cos(2.0 * ripple).sum())) + math.pi / 2.0
        if all(abs(math.remainder(crests - heading, math.pi)) > _OWN_HEADING_RAD for heading in headings):
            headings.append(crests % math.pi)
    # Crests before all others, then what differs most from what there is: there may be time for a few only.
    return headings[_N_HEADINGS:] + [headings[k] for k in _IN_TURN]


def survey_tracks(
    cells: Cells, model: LookModel, limits: Limits, known: list[tuple[PlanePose, PlanePose]], more_time: MoreTime
) -> Tracks:
    """Lay legs over open cells that can be entered and left inside the fence.

    As many headings are tried as there is time for, but at least until there is a leg. known: runs to be included.
    """
    legs = _Legs(cells, limits)
    for heading in headings_rad(cells):
        legs.add(_lines(cells, heading, _offsets(cells, heading, limits), model, limits))
        if legs.any_enterable() and not more_time():
            break
    for entry, leave in known:
        legs.add_run(_lines(cells, entry.heading_rad, np.array([_across(entry)]), model, limits), entry, leave)
    return legs.tracks()


def _offsets(cells: Cells, heading: float, limits: Limits) -> Array:
    """Place lines from side to side, in metres to the right of the plane's origin."""
    near_m, far_m = limits.swath
    across = cells.east_m * math.cos(heading) - cells.north_m * math.sin(heading)
    middle, reach = 0.5 * (across.min() + across.max()), 0.5 * (np.ptp(across) + near_m + far_m)
    step = max(cells.cell_m / 2.0, (far_m - near_m) / _LINES_PER_SWATH, 2.0 * reach / _MAX_LINES)
    n_beside = int(reach / step)
    return np.asarray(middle + step * np.arange(-n_beside, n_beside + 1))


def _lines(cells: Cells, heading: float, offset_m: Array, model: LookModel, limits: Limits) -> _Lines:
    near_m, far_m = limits.swath
    sine, cosine = math.sin(heading), math.cos(heading)
    along = cells.east_m * sine + cells.north_m * cosine
    order = np.argsort(along, kind="stable")
    beside = (cells.east_m * cosine - cells.north_m * sine)[order] - offset_m[:, np.newaxis]
    ground = np.abs(beside)
    fraction = np.clip(np.minimum(ground - near_m, far_m - ground) / cells.cell_m + 0.5, 0.0, 1.0)
    line, place = np.nonzero(fraction)
    cell = order[place]
    to_right = beside[line, place] > 0.0
    look = np.where(to_right, heading + RIGHT, heading - RIGHT) % (2.0 * math.pi)
    view = CellView(
        seabed=cells.seabed[cell],
        ground_range_m=ground[line, place].astype(np.float32),
        altitude_m=np.float32(limits.altitude_m),
        look_rad=look.astype(np.float32),
        ripple_rad=cells.ripple_rad[cell],
        unevenness_db=cells.unevenness_db[cell],
    )
    p = fraction[line, place] * np.clip(np.nan_to_num(model.p_look(view), nan=0.0), 0.0, HIGHEST_P)
    exponent = -np.log1p(-p)
    kept = exponent > _MIN_EXPONENT
    line, cell = line[kept], cell[kept]
    start = np.searchsorted(line, np.arange(len(offset_m) + 1))
    return _Lines(heading, offset_m, start, along[cell], cell, exponent[kept], to_right[kept])


class _Legs:
    """Collect legs as they are found."""

    def __init__(self, cells: Cells, limits: Limits) -> None:
        self._cells, self._limits = cells, limits
        self._lines: list[_Lines] = []
        self._looks: list[float] = []
        self._n_seen = 0
        self._runs: list[tuple[PlanePose, PlanePose]] = []
        self._numbers: list[tuple[int, int, int, int]] = []  # first, last, line, heading

    def add(self, lines: _Lines) -> None:
        margin_m = self._limits.settling_m + half_extent_m(self._cells.cell_m, lines.heading_rad)
        unbounded = not len(lines.along_m) or _box_inside(lines, margin_m, self._limits)
        inside = None if unbounded else _Inside(lines, margin_m, self._limits)
        # Between pieces farther apart than this, another leg may run meanwhile.
        apart_m = 2.0 * margin_m + math.pi * self._limits.turn_radius_m
        for number in range(len(lines.offset_m)):
            low, high = int(lines.start[number]), int(lines.start[number + 1])
            if low == high:
                continue
            along = lines.along_m[low:high]
            cuts = [0, *(np.flatnonzero(np.diff(along) > apart_m) + 1).tolist(), high - low]
            pieces = list(pairwise(cuts))
            if len(pieces) > 1:
                pieces.append((0, high - low))
            if self._limits.budget_m < 4.0 * (along[-1] - along[0]):  # a part may be all there is track for
                pieces += [(0, (high - low) // 2), ((high - low) // 2, high - low)]
            for begin, end in pieces:
                if end > begin:
                    ends = float(along[begin]) - margin_m, float(along[end - 1]) + margin_m
                    for stretch in [ends] if inside is None else inside.parts(number, *ends):
                        self._add_run(lines, number, low, along, stretch, None)
        self._keep(lines)

    def add_run(self, lines: _Lines, entry: PlanePose, leave: PlanePose) -> None:
        ahead = math.sin(entry.heading_rad), math.cos(entry.heading_rad)
        begin, end = (pose.east_m * ahead[0] + pose.north_m * ahead[1] for pose in (entry, leave))
        self._add_run(lines, 0, 0, lines.along_m, (begin, end), (entry, leave))
        self._keep(lines)

    def any_enterable(self) -> bool:
        """Check whether there is a leg that `tracks` will keep."""
        return bool(self._runs) and bool(enterable(np.array(self._runs[-1:], dtype=np.float64), self._limits).any())

    def _keep(self, lines: _Lines) -> None:
        self._lines.append(lines)
        self._n_seen += len(lines.cell)

    def _add_run(
        self,
        lines: _Lines,
        number: int,
        low: int,
        along: Array,
        stretch: tuple[float, float],
        ends: tuple[PlanePose, PlanePose] | None,
    ) -> None:
        begin, end = stretch
        # A cell counts if all of it lies abeam of the credited run.
        margin_m = self._limits.settling_m + half_extent_m(self._cells.cell_m, lines.heading_rad) - 1e-6
        first, last = np.searchsorted(along, [begin + margin_m, end - margin_m])
        if last > first:
            self._runs.append(ends or (_on_line(lines, number, begin), _on_line(lines, number, end)))
            offset = self._n_seen + low
            self._numbers.append((offset + int(first), offset + int(last), number, len(self._lines)))

    def tracks(self) -> Tracks:
        first, last, line, heading = np.array(self._numbers, dtype=np.int64).reshape(-1, 4).T
        sides = [
            (look_number(lines.heading_rad - RIGHT), look_number(lines.heading_rad + RIGHT)) for lines in self._lines
        ]
        looks = [np.where(lines.to_right, right, left) for lines, (left, right) in zip(self._lines, sides, strict=True)]
        look = np.concatenate([np.empty(0, dtype=np.int64), *looks])
        tracks = Tracks(
            run=np.array(self._runs, dtype=np.float64).reshape(-1, 2, 3),
            first=first,
            last=last,
            cell=np.concatenate([np.empty(0, dtype=np.int32), *(lines.cell.astype(np.int32) for lines in self._lines)]),
            exponent=np.concatenate([np.empty(0), *(lines.exponent for lines in self._lines)]),
            bit=_LOOK_BIT[look],
            alike=_ALIKE[look],
            line=line,
            heading=heading,
        )
        return _only(tracks, enterable(tracks.run, self._limits))


def _box_inside(lines: _Lines, margin_m: float, limits: Limits) -> bool:
    """Check whether all lines with their turns are inside the fence, by a rectangle that no edge crosses or lies in."""
    fence = limits.fence
    if fence is None:
        return True
    ahead = np.array([math.sin(lines.heading_rad), math.cos(lines.heading_rad)])
    right = np.array([ahead[1], -ahead[0]])
    wide_m = 2.0 * limits.turn_radius_m
    low = np.array([float(lines.along_m.min()) - margin_m - wide_m, float(lines.offset_m[0]) - wide_m])
    high = np.array([float(lines.along_m.max()) + margin_m + wide_m, float(lines.offset_m[-1]) + wide_m])
    corners = np.array(
        [
            along * ahead + across * right
            for along, across in ((low[0], low[1]), (low[0], high[1]), high, (high[0], low[1]))
        ]
    )
    places = np.column_stack([fence @ ahead, fence @ right])
    if ((places > low) & (places < high)).all(axis=1).any():
        return False
    return bool(runs_inside(corners, np.roll(corners, -1, axis=0), fence, limits.fence_margin_m).all())


class _Inside:
    """Find where parallel lines are inside the fence and can be entered or left, at samples along them."""

    def __init__(self, lines: _Lines, margin_m: float, limits: Limits) -> None:
        assert limits.fence is not None
        low, high = float(lines.along_m.min()) - margin_m, float(lines.along_m.max()) + margin_m
        n = max(2, min(_MAX_SAMPLES, math.ceil((high - low) / 2.0)))
        self._at = np.linspace(low, high, n)
        heading = np.array([math.sin(lines.heading_rad), math.cos(lines.heading_rad)])
        right = np.array([heading[1], -heading[0]])
        points = self._at[:, np.newaxis] * heading + lines.offset_m[:, np.newaxis, np.newaxis] * right
        self._inside = circles_inside(points, 0.0, limits.fence, limits.fence_margin_m)
        poses = np.concatenate([points, np.full((*points.shape[:2], 1), lines.heading_rad)], axis=-1)
        self._turns = self._inside & turns_inside(poses, limits.turn_radius_m, limits).any(axis=-1)

    def parts(self, line: int, begin: float, end: float) -> Iterator[tuple[float, float]]:
        """Find the longest stretches of a line inside the fence, between places where a turn fits."""
        low = max(int(np.searchsorted(self._at, begin + 1e-9, side="right")) - 1, 0)
        high = min(int(np.searchsorted(self._at, end - 1e-9)), len(self._at) - 1)
        outside = np.flatnonzero(~self._inside[line, low : high + 1]) + low
        edges = [low - 1, *outside.tolist(), high + 1]
        for before, after in pairwise(edges):
            turns = np.flatnonzero(self._turns[line, before + 1 : after]) + before + 1
            if len(turns) > 1:
                yield float(self._at[turns[0]]), float(self._at[turns[-1]])


def enterable(run: Array, limits: Limits) -> NDArray[np.bool_]:
    """Check whether (n, 2, 3) runs lie inside the fence with room for a turn at both ends, (n,)."""
    if limits.fence is None or not len(run):
        return np.ones(len(run), dtype=np.bool_)
    inside = runs_inside(run[:, 0, :2], run[:, 1, :2], limits.fence, limits.fence_margin_m)
    return np.asarray(inside & turns_inside(run, limits.turn_radius_m, limits).any(axis=-1).all(axis=-1))


def _only(tracks: Tracks, kept: NDArray[np.bool_]) -> Tracks:
    return tracks._replace(
        **{name: getattr(tracks, name)[kept] for name in ("run", "first", "last", "line", "heading")}
    )


def _across(pose: PlanePose) -> float:
    return pose.east_m * math.cos(pose.heading_rad) - pose.north_m * math.sin(pose.heading_rad)


def _on_line(lines: _Lines, number: int, along_m: float) -> PlanePose:
    sine, cosine, offset = math.sin(lines.heading_rad), math.cos(lines.heading_rad), float(lines.offset_m[number])
    return PlanePose(along_m * sine + offset * cosine, along_m * cosine - offset * sine, lines.heading_rad)
