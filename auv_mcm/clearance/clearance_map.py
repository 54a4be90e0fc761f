"""Map how well each piece of sea floor was searched: views add up to the probability of having found a mine there.

Looks at a cell with probabilities P_k leave a mine unseen with the product of 1 - P_k, so their miss exponents -ln(1 -
P_k) add up. That holds for looks that are independent. One from nearly the same direction sees the same side of the
same mine and counts only in part, as does, a little, any further one: what is buried is buried from everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, SEABED_TYPES, CoveragePatch, Side, SurveyedCells

Array = NDArray[np.float64]

HIGHEST_P: Final = 0.98  # of one view: no mine is ever seen for certain
N_LOOKS: Final = 64  # directions distinguished
_SAME_LOOK_RAD: Final = math.radians(15.0)
# s between patches of one pass, either way: tiles of both sides overlap in time; chosen, not measured
_SAME_PASS_S: Final = 60.0
_ROUNDING_RAD: Final = 1e-6  # rad: look angles at the border count alike whatever the rounding
_AT_ONCE: Final = 1 << 18  # looks added up at once, bounds memory
_KEY: Final = 1 << 32  # packs a cell's east and north index, 32 bits each, into one integer
# of a laid-out map: 8.2 km square at cells of 4 m, about 230 MB while it is drawn and written
_MAX_BOX_CELLS: Final = 1 << 22
# side of the squares among which the one searched most is taken as the middle of a map too large to lay out
_DENSE_CELLS: Final = 1024


class LookModel(Protocol):
    """State what a view is worth.

    same_look_correlation, other_look_correlation: the part of a further view that adds nothing new, from within 15
    degrees of an earlier one and from elsewhere, 0 to 1. Maps go by them, plans by MIN_ALIKE for the former.
    """

    @property
    def same_look_correlation(self) -> float:
        """Return the part of a further view from within 15 degrees that adds nothing new."""

    @property
    def other_look_correlation(self) -> float:
        """Return the part of a further view from elsewhere that adds nothing new."""

    def p_look(self, view: CellView) -> Array:
        """Compute the probability that one view of the whole of a cell finds a mine there, (n,)."""
        ...


class Clearance(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold how the search stands, (n_north, n_east) cells of the mission's plane.

    Element [0, 0] is cell (first_east, first_north).

    exponent float64: miss exponent, 0 where nothing was seen. share float32: what passes saw of the cell, added up to
    1: two that see the same half count as all of it, 0.5 % of two lanes that share half a swath and 8 % of one flown
    twice, at cells of 4 m. looks uint8: passes that saw something of the cell. towards uint64: the directions they
    looked in, as `look_bit` has them. seabed uint8, ripple_rad, wavelength_m, unevenness_db float32: as the surest look
    has it, weighted by how much of the cell it saw. altitude_m float32: mean over looks. Where nothing was seen these
    are `unknown` and NaN. n_elsewhere: cells seen too far from the others to be laid out in one box with them.
    """

    origin_latitude_deg: float
    origin_longitude_deg: float
    cell_m: float
    first_east: int
    first_north: int
    exponent: Array
    share: NDArray[np.float32]
    looks: NDArray[np.uint8]
    towards: NDArray[np.uint64]
    seabed: NDArray[np.uint8]
    ripple_rad: NDArray[np.float32]
    wavelength_m: NDArray[np.float32]
    unevenness_db: NDArray[np.float32]
    altitude_m: NDArray[np.float32]
    n_elsewhere: int = 0

    @property
    def p_detected(self) -> Array:
        """Compute the probability that a mine in the cell would have been found."""
        return np.asarray(-np.expm1(-self.exponent))

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Find the cells that were seen, bool of the map's shape."""
        return self.looks > 0


def look_bit(look_rad: ArrayLike) -> NDArray[np.uint64]:
    """Give the bit, of N_LOOKS, of the direction nearest to that of a view; any shape."""
    number = np.rint(np.asarray(look_rad, dtype=np.float64) * (N_LOOKS / (2.0 * math.pi))).astype(np.int64) % N_LOOKS
    return np.asarray(np.uint64(1) << number.astype(np.uint64))


class _Look(NamedTuple):
    """Hold the cells that one pass saw, and the worth of a view of the whole of each, (n,).

    It is kept for a whole mission, without repetition.
    """

    p: Array
    cells: SurveyedCells


class _Seen(NamedTuple):
    """Hold the cells seen by all passes, (n,) each, as Clearance has them."""

    cell: NDArray[np.int64]
    exponent: Array
    share: Array
    n_looks: NDArray[np.intp]
    towards: NDArray[np.uint64]


class _Pass(NamedTuple):
    side: Side
    look_rad: float
    start_s: float
    stop_s: float
    number: int


class ClearanceMap:
    """Collect views of cells from patches; equal patches give equal maps, whatever the order of tiles of a pass.

    Patches of one side that follow one another within a minute and look the same way are one pass, and what a pass sees
    of a cell in two patches is one look.
    """

    def __init__(self, model: LookModel, area_deg: Sequence[tuple[float, float]] = ()) -> None:
        """area_deg: corners of the area to be cleared, which is laid out first where not all cells can be."""
        self._model = model
        self._area_deg = tuple(area_deg)
        self._looks: list[_Look] = []
        self._numbers: list[int] = []  # of the pass, per look
        self._passes: dict[Side, _Pass] = {}
        self._n_passes = 0

    def add(self, patch: CoveragePatch) -> None:
        """Take a patch; one without cells adds nothing.

        Raises ValueError for cells that are not in the plane of the patches before.
        """
        cells = patch.cells
        if cells is None or not len(cells.fraction):
            return
        if self._looks and _plane(cells) != _plane(self._looks[0].cells):
            raise ValueError(
                "patches of two missions: their cells lie in different planes. Give each mission a map of its own"
            )
        view = CellView(*(getattr(cells, name) for name in CellView._fields))
        p = np.clip(self._model.p_look(view), 0.0, HIGHEST_P)
        self._looks.append(_Look(p, cells))
        self._numbers.append(self._pass_of(patch))

    def snapshot(self) -> Clearance | None:
        """Give how the search stands; None before the first patch with cells."""
        if not self._looks:
            return None
        seen = [look.cells for look in self._looks]
        key = np.concatenate([cells.east_index.astype(np.int64) * _KEY + cells.north_index for cells in seen])
        number = np.repeat(self._numbers, [len(cells.fraction) for cells in seen])
        fraction = np.concatenate([cells.fraction for cells in seen]).astype(np.float64)
        look_rad = np.concatenate([cells.look_rad for cells in seen]).astype(np.float64)
        p = np.concatenate([look.p for look in self._looks])
        order = np.lexsort((number, key))  # stable: of one cell and pass in order of time
        key, number = key[order], number[order]
        share = np.minimum(np.bincount(np.unique(key, return_inverse=True)[1], fraction[order]), 1.0)
        starts = np.flatnonzero(np.append(True, (np.diff(key) != 0) | (np.diff(number) != 0)))
        # No more than its best part, seen whole, would give: so that a worse part never takes anything away.
        p_seen = np.minimum(np.add.reduceat((fraction * p)[order], starts), np.maximum.reduceat(p[order], starts))
        by_time = np.lexsort((order[starts], key[starts]))  # looks at a cell in the order in which it was first seen
        key, p_seen, look = key[starts][by_time], p_seen[by_time], look_rad[order[starts]][by_time]
        cell, first = np.unique(key, return_index=True)
        n_looks = np.diff(np.append(first, len(key)))
        exponent = self._added_up(-np.log1p(-p_seen), look, first, n_looks)
        return self._laid_out(_Seen(cell, exponent, share, n_looks, np.bitwise_or.reduceat(look_bit(look), first)))

    def _pass_of(self, patch: CoveragePatch) -> int:
        assert patch.cells is not None
        look = patch.cells.look_rad.astype(np.float64)
        towards = math.atan2(float(np.sin(look).sum()), float(np.cos(look).sum()))
        current = self._passes.get(patch.side)
        follows = (
            current is not None
            # Sub-apertures of a pass come one after another, each from its beginning.
            and current.start_s - _SAME_PASS_S <= patch.start_s <= current.stop_s + _SAME_PASS_S
            and abs(math.remainder(towards - current.look_rad, 2.0 * math.pi)) <= _SAME_LOOK_RAD
        )
        if current is None or not follows:
            current = _Pass(patch.side, towards, patch.start_s, patch.stop_s, self._n_passes)
            self._n_passes += 1
        self._passes[patch.side] = current._replace(stop_s=max(current.stop_s, patch.stop_s))
        return current.number

    def _added_up(self, exponent: Array, look_rad: Array, first: NDArray[np.intp], n_looks: NDArray[np.intp]) -> Array:
        """Add up, per cell, the exponents of its views, each reduced by what earlier views have in common with it."""
        total = np.zeros(len(first))
        order = np.argsort(n_looks, kind="stable")
        start = 0
        while start < len(order):  # cells of about as many looks: one that all legs pass must not widen all others
            ahead = n_looks[order[start : start + _AT_ONCE]]
            fits = ahead * np.arange(1, len(ahead) + 1) <= _AT_ONCE
            cells = order[start : start + max(int(np.count_nonzero(fits)), 1)]
            total[cells] = self._added_up_alike(exponent, look_rad, first[cells], n_looks[cells])
            start += len(cells)
        return total

    def _added_up_alike(
        self, exponent: Array, look_rad: Array, first: NDArray[np.intp], n_looks: NDArray[np.intp]
    ) -> Array:
        max_looks = int(n_looks.max())
        column = np.arange(max_looks)
        there = column < n_looks[:, np.newaxis]
        row = np.where(there, first[:, np.newaxis] + column, 0)
        direction = np.where(there, np.mod(look_rad[row], 2.0 * np.pi), np.nan)
        total = np.zeros(len(first))
        same, other = 1.0 - self._model.same_look_correlation, 1.0 - self._model.other_look_correlation
        for k in range(max_looks):
            apart = np.abs(direction[:, :k] - direction[:, k : k + 1])
            again = (np.minimum(apart, 2.0 * np.pi - apart) <= _SAME_LOOK_RAD + _ROUNDING_RAD).any(axis=1)
            weight = np.where(again, same, other if k else 1.0)
            total += np.where(there[:, k], weight * exponent[row[:, k]], 0.0)
        return total

    def _that_fit(self, east: NDArray[np.int64], north: NDArray[np.int64]) -> NDArray[np.intp]:
        """Choose the cells to lay out, rising indices.

        All, or, if their box is too large, those nearest to the area to be cleared, without one to the densest part.
        A position that was wrong by kilometres, the way to the area, or a second site, must not cost the memory of all
        that lies between.
        """
        if (int(np.ptp(east)) + 1) * (int(np.ptp(north)) + 1) <= _MAX_BOX_CELLS:
            return np.arange(len(east))
        low, high = self._area_box() if self._area_deg else _densest(east, north)
        place = np.stack([east, north], axis=1)
        order = np.argsort(np.maximum(low - place, place - high).max(axis=1).clip(0), kind="stable")
        n_east = np.maximum.accumulate(east[order]) - np.minimum.accumulate(east[order]) + 1
        n_north = np.maximum.accumulate(north[order]) - np.minimum.accumulate(north[order]) + 1
        return np.sort(order[n_east * n_north <= _MAX_BOX_CELLS])

    def _area_box(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the first and the last cell, east and north, of the box about the area to be cleared."""
        latitude_deg, longitude_deg, cell_m = _plane(self._looks[0].cells)
        plane = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        latitudes_deg, longitudes_deg = np.array(self._area_deg).T
        corner_m = plane.to_enu(latitudes_deg, longitudes_deg, 0.0)[:, :2]
        corner = np.floor(corner_m / cell_m).astype(np.int64)
        return corner.min(axis=0), corner.max(axis=0)

    def _laid_out(self, seen: _Seen) -> Clearance:
        east = (seen.cell + _KEY // 2) // _KEY
        north = seen.cell - east * _KEY
        kept = self._that_fit(east, north)
        n_elsewhere = len(seen.cell) - len(kept)
        east, north = east[kept], north[kept]
        first_east, first_north = int(east.min()), int(north.min())
        shape = int(np.ptp(north)) + 1, int(np.ptp(east)) + 1
        at = (north - first_north, east - first_east)
        dense, share = np.zeros(shape), np.zeros(shape, dtype=np.float32)
        dense[at], share[at] = seen.exponent[kept], seen.share[kept]
        looks = np.zeros(shape, dtype=np.uint8)
        looks[at] = np.minimum(seen.n_looks[kept], 255)
        looked_towards = np.zeros(shape, dtype=np.uint64)
        looked_towards[at] = seen.towards[kept]
        # The surest view decides what kind of sea floor it is; of equals the first.
        confidence = np.full(shape, -1.0, dtype=np.float32)
        seabed = np.full(shape, SEABED_TYPES.index("unknown"), dtype=np.uint8)
        ripple, wavelength, unevenness = (np.full(shape, np.nan, dtype=np.float32) for _ in range(3))
        altitude, weight = np.zeros(shape), np.zeros(shape)
        for look in self._looks:
            row, column = look.cells.north_index - first_north, look.cells.east_index - first_east
            inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
            place = row[inside], column[inside]
            sure = (look.cells.confidence * look.cells.fraction)[inside]
            better = sure > confidence[place]
            surer = place[0][better], place[1][better]
            confidence[surer] = sure[better]
            for layer, values in (
                (seabed, look.cells.seabed),
                (ripple, look.cells.ripple_rad),
                (wavelength, look.cells.wavelength_m),
                (unevenness, look.cells.unevenness_db),
            ):
                layer[surer] = values[inside][better]
            fraction = look.cells.fraction[inside].astype(np.float64)
            altitude[place] += fraction * look.cells.altitude_m[inside]
            weight[place] += fraction
        plane = self._looks[0].cells
        return Clearance(
            origin_latitude_deg=plane.origin_latitude_deg,
            origin_longitude_deg=plane.origin_longitude_deg,
            cell_m=plane.cell_m,
            first_east=first_east,
            first_north=first_north,
            exponent=dense,
            share=share,
            looks=looks,
            towards=looked_towards,
            seabed=seabed,
            ripple_rad=ripple,
            wavelength_m=wavelength,
            unevenness_db=unevenness,
            altitude_m=np.divide(altitude, weight, out=np.full(shape, np.nan), where=weight > 0.0).astype(np.float32),
            n_elsewhere=n_elsewhere,
        )


def _densest(east: NDArray[np.int64], north: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the middle cell, as first and last, of the square with most cells."""
    _, square, n_cells = np.unique(
        east // _DENSE_CELLS * _KEY + north // _DENSE_CELLS, return_inverse=True, return_counts=True
    )
    densest = square == np.argmax(n_cells)
    middle = np.array([np.median(east[densest]), np.median(north[densest])]).astype(np.int64)
    return middle, middle


def _plane(cells: SurveyedCells) -> tuple[float, float, float]:
    return cells.origin_latitude_deg, cells.origin_longitude_deg, cells.cell_m


def unsearched(origin_latitude_deg: float, origin_longitude_deg: float, cell_m: float) -> Clearance:
    """Give the clearance before any survey: no cells yet."""
    return Clearance(
        origin_latitude_deg=origin_latitude_deg,
        origin_longitude_deg=origin_longitude_deg,
        cell_m=cell_m,
        first_east=0,
        first_north=0,
        exponent=np.zeros((0, 0)),
        share=np.zeros((0, 0), dtype=np.float32),
        looks=np.zeros((0, 0), dtype=np.uint8),
        towards=np.zeros((0, 0), dtype=np.uint64),
        seabed=np.zeros((0, 0), dtype=np.uint8),
        ripple_rad=np.zeros((0, 0), dtype=np.float32),
        wavelength_m=np.zeros((0, 0), dtype=np.float32),
        unevenness_db=np.zeros((0, 0), dtype=np.float32),
        altitude_m=np.zeros((0, 0), dtype=np.float32),
    )


def clearance_over(clearance: Clearance, first_east: int, first_north: int, shape: tuple[int, int]) -> Clearance:
    """Cut out or widen a clearance to a box of (n_north, n_east) cells.

    It may hold some or none of them; what lies outside is left out.
    """
    row, column = clearance.first_north - first_north, clearance.first_east - first_east
    n_north, n_east = clearance.looks.shape
    rows = slice(max(row, 0), max(min(row + n_north, shape[0]), 0))
    columns = slice(max(column, 0), max(min(column + n_east, shape[1]), 0))

    def laid(layer: NDArray[np.generic], outside: float) -> NDArray[np.generic]:
        box = np.full(shape, outside, dtype=layer.dtype)
        box[rows, columns] = layer[
            rows.start - row : max(rows.stop - row, 0), columns.start - column : max(columns.stop - column, 0)
        ]
        return box

    outside = dict.fromkeys(("exponent", "share", "looks", "towards"), 0.0)
    outside |= {"seabed": float(SEABED_TYPES.index("unknown"))}
    outside |= dict.fromkeys(("ripple_rad", "wavelength_m", "unevenness_db", "altitude_m"), NAN)
    layers = {name: laid(getattr(clearance, name), value) for name, value in outside.items()}
    return msgspec.structs.replace(clearance, first_east=first_east, first_north=first_north, **layers)
