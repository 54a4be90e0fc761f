"""Compute the sea floor of a scene on request: height, texture and kind at any place.

Cell (i, j) counts north and east; node (i, j) is at north = i * cell_m, east = j * cell_m. Square patches of PATCH
cells hold the nodes on all their sides, so those on a side belong to both neighbours and interpolation never leaves a
patch. A patch is a function of scene, seed and place alone, to the last bit: the pool may forget it and make it again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_replay.simulator import scene
from sim_replay.simulator.bedforms import RippleTrain
from sim_replay.simulator.fields import FloatArray, Noise, power_law, refine, step_for
from sim_replay.simulator.grounds import Ground
from sim_replay.simulator.partition import Partition
from sim_replay.simulator.seabeds import cover_of
from sim_replay.simulator.stones import Stones, raise_stones

PATCH: Final = 256  # cells along a patch's side: bounds memory and what is drawn in vain
NODES: Final = PATCH + 1

Labels: TypeAlias = NDArray[np.uint8]

# Height and kind are worked out on nodes at most this far apart and drawn finer from there; kinds blend over about
# three of them.
_COARSE_M: Final = 0.5
_FORM_PERIODS: Final = (625, 648)
_STONE_BRIGHTNESS: Final = 3.0


class Patches(NamedTuple):
    """Address patches in the pool; they are valid until the next request.

    elevation: (n_slots, NODES, NODES) float32, m above the datum plane. texture: same shape, float32, factor on
    backscattered intensity, mean 1. seabed: same shape, uint8, index into `World.covers`. slots: (n_patch_rows,
    n_patch_columns) int32, a patch's place in those or -1. Patch (r, c) of `slots` starts at cell ((first_patch_row +
    r) * PATCH, (first_patch_column + c) * PATCH).
    """

    elevation: FloatArray
    texture: FloatArray
    seabed: Labels
    slots: NDArray[np.int32]
    first_patch_row: int
    first_patch_column: int


class SimulatedFloor:
    """Compute the sea floor of a scene."""

    def __init__(self, world: scene.World, seed: int, *, max_patches: int = 384) -> None:
        self.covers: Final = tuple(cover_of(seabed) for seabed in world.seabeds)
        self.cell_m: Final = world.cell_m
        cell_m = world.cell_m
        self._step = step_for(_COARSE_M, cell_m)
        slope, towards = math.tan(math.radians(world.slope_deg)), math.radians(world.slope_towards_deg)
        self._rise_north, self._rise_east = slope * math.cos(towards) * cell_m, slope * math.sin(towards) * cell_m
        self._forms_rms = np.float32(world.relief_rms_m)
        self._forms: Noise | None = None
        if world.relief_rms_m > 0.0:
            self._forms = Noise(
                seed,
                "forms",
                step=self._step,
                cell_m=cell_m,
                spectrum=power_law(world.relief_outer_m),
                periods=_FORM_PERIODS,
                splined=self._step > 1,
            )
        self._sand_waves: RippleTrain | None = None
        if world.sand_waves is not None:
            self._sand_waves = RippleTrain(world.sand_waves, seed, "sand waves", cell_m=cell_m)
        self._partition: Partition | None = None
        if len(world.seabeds) > 1:
            shares = tuple(seabed.share for seabed in world.seabeds)
            self._partition = Partition(shares, world.patch_m, seed=seed, step=self._step, cell_m=cell_m)
        self._stones = Stones(self.covers, seed)
        self._margin = math.ceil(self._stones.reach_m / (self._step * cell_m)) if self._stones else 0
        self._grounds = tuple(
            Ground(cover, seed, f"{index} {cover.type}", cell_m=cell_m, step=self._step)
            for index, cover in enumerate(self.covers)
        )
        self._slot_of: dict[tuple[int, int], int] = {}
        self._patch_here: tuple[int, int] | None = None
        self._heights_here = np.empty((NODES, NODES))
        self._allocate(max_patches)

    def _allocate(self, n_slots: int) -> None:
        self._elevation = np.empty((n_slots, NODES, NODES), dtype=np.float32)
        self._texture = np.empty((n_slots, NODES, NODES), dtype=np.float32)
        self._seabed = np.empty((n_slots, NODES, NODES), dtype=np.uint8)

    def patches(self, needed: NDArray[np.bool_], first_patch_row: int, first_patch_column: int) -> Patches:
        """Compute each patch that is True in `needed`, (n_patch_rows, n_patch_columns).

        The first is (first_patch_row, first_patch_column).
        """
        wanted = [(first_patch_row + row, first_patch_column + column) for row, column in np.argwhere(needed).tolist()]
        if len(wanted) > len(self._elevation):
            elevation, texture, seabed = self._elevation, self._texture, self._seabed
            self._allocate(len(wanted))
            self._elevation[: len(elevation)] = elevation
            self._texture[: len(texture)] = texture
            self._seabed[: len(seabed)] = seabed
        # The dictionary's order is that of last use: what is wanted moves to its end before anything is dropped from
        # its start.
        missing = []
        for place in wanted:
            slot = self._slot_of.pop(place, None)
            if slot is None:
                missing.append(place)
            else:
                self._slot_of[place] = slot
        for place in missing:
            slot = len(self._slot_of)
            if slot == len(self._elevation):
                slot = self._slot_of.pop(next(iter(self._slot_of)))
            self._make(*place, slot)
            self._slot_of[place] = slot
        slots = np.full(needed.shape, -1, dtype=np.int32)
        slots[needed] = [self._slot_of[place] for place in wanted]
        return Patches(self._elevation, self._texture, self._seabed, slots, first_patch_row, first_patch_column)

    def elevation_m(self, east_m: ArrayLike, north_m: ArrayLike) -> NDArray[np.float64]:
        """Return the height above the datum plane (m) at places of any one shape, bilinear between nodes; float64."""
        out = np.empty(np.broadcast_shapes(np.shape(east_m), np.shape(north_m)))
        for chosen, slot, row, column in self._by_patch(east_m, north_m):
            i, j = np.minimum(row.astype(np.intp), PATCH - 1), np.minimum(column.astype(np.intp), PATCH - 1)
            down, right = row - i, column - j
            height = self._elevation[slot]
            near = height[i, j] * (1.0 - right) + height[i, j + 1] * right
            far = height[i + 1, j] * (1.0 - right) + height[i + 1, j + 1] * right
            out[chosen] = near * (1.0 - down) + far * down
        return out

    def floor_m(self, east_m: float, north_m: float) -> float:
        """Return elevation_m of one place (m), for a vehicle that queries at every step.

        The patch below the vehicle is kept beside the pool.
        """
        row, column = north_m / self.cell_m, east_m / self.cell_m
        place = math.floor(row / PATCH), math.floor(column / PATCH)
        if place != self._patch_here:
            patch = self.patches(np.ones((1, 1), dtype=np.bool_), *place)
            self._patch_here, self._heights_here = place, patch.elevation[int(patch.slots[0, 0])].astype(np.float64)
        row, column = row - place[0] * PATCH, column - place[1] * PATCH
        i, j = min(int(row), PATCH - 1), min(int(column), PATCH - 1)
        heights, up, right = self._heights_here, row - i, column - j
        south = heights[i, j] * (1.0 - right) + heights[i, j + 1] * right
        north = heights[i + 1, j] * (1.0 - right) + heights[i + 1, j + 1] * right
        return float(south * (1.0 - up) + north * up)

    def seabed_at(self, east_m: ArrayLike, north_m: ArrayLike) -> Labels:
        """Return the index into `covers` of the node nearest to places of any one shape; uint8."""
        out = np.empty(np.broadcast_shapes(np.shape(east_m), np.shape(north_m)), dtype=np.uint8)
        for chosen, slot, row, column in self._by_patch(east_m, north_m):
            out[chosen] = self._seabed[slot, np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)]
        return out

    def _by_patch(
        self, east_m: ArrayLike, north_m: ArrayLike
    ) -> Iterator[tuple[NDArray[np.bool_], int, NDArray[np.float64], NDArray[np.float64]]]:
        """Sort places by patch: which places, the patch's slot, and their rows and columns in it."""
        east, north = np.broadcast_arrays(np.asarray(east_m, dtype=np.float64), np.asarray(north_m, dtype=np.float64))
        row, column = north / self.cell_m, east / self.cell_m
        patch_row, patch_column = np.floor(row / PATCH).astype(np.int64), np.floor(column / PATCH).astype(np.int64)
        for place in sorted(set(zip(patch_row.ravel().tolist(), patch_column.ravel().tolist(), strict=True))):
            patch = self.patches(np.ones((1, 1), dtype=np.bool_), *place)
            chosen = (patch_row == place[0]) & (patch_column == place[1])
            yield chosen, int(patch.slots[0, 0]), row[chosen] - place[0] * PATCH, column[chosen] - place[1] * PATCH

    def _coarse_fields(self, patch_row: int, patch_column: int) -> FloatArray | None:
        """Return the kinds' fields on the coarse nodes of a patch.

        The window has one node more before, two behind, and as many around as stones reach.
        """
        if self._partition is None:
            return None
        nodes, margin = PATCH // self._step, self._margin
        size = nodes + 4 + 2 * margin
        return self._partition.fields(patch_row * nodes - 1 - margin, patch_column * nodes - 1 - margin, size, size)

    def _make(self, patch_row: int, patch_column: int, slot: int) -> None:
        nodes, margin = PATCH // self._step, self._margin
        window = (patch_row * nodes - 1, patch_column * nodes - 1, nodes + 4, nodes + 4)
        cells = (patch_row * PATCH, patch_column * PATCH, NODES, NODES)
        coarse = np.zeros(window[2:], dtype=np.float32)
        if self._forms is not None:
            np.multiply(self._forms.window(*window), self._forms_rms, out=coarse)
        fields = self._coarse_fields(patch_row, patch_column)
        texture, seabed = self._texture[slot], self._seabed[slot]
        if self._partition is None or fields is None:
            weights, kinds = None, [0]
        else:
            weights = self._partition.weights(fields[:, margin : margin + window[2], margin : margin + window[3]])
            kinds = np.flatnonzero(weights.any(axis=(1, 2))).tolist()
        for kind in kinds:
            canopy = self._grounds[kind].canopy(*window)
            if canopy is not None:
                coarse += canopy if weights is None else canopy * weights[kind]
        height = refine(coarse, self._step, NODES, NODES)
        if self._sand_waves is not None:
            height += self._sand_waves.on_cells(*cells)
        if self._partition is None or weights is None or len(kinds) == 1:
            (kind,) = kinds
            height += self._grounds[kind].relief(*cells)
            own = self._grounds[kind].texture(*cells)
            texture[...] = 1.0 if own is None else own
            seabed[...] = kind
        else:
            self._blend(self._partition, patch_row, patch_column, weights, kinds, height, texture, seabed)
        if self._stones:
            self._scatter_stones(patch_row, patch_column, fields, height, texture)
        row, column = patch_row * PATCH + np.arange(NODES), patch_column * PATCH + np.arange(NODES)
        height += (row * self._rise_north).astype(np.float32)[:, None]
        np.add(height, (column * self._rise_east).astype(np.float32), out=self._elevation[slot])

    def _blend(
        self,
        partition: Partition,
        patch_row: int,
        patch_column: int,
        weights: FloatArray,
        kinds: list[int],
        height: FloatArray,
        texture: FloatArray,
        seabed: Labels,
    ) -> None:
        """Add the relief of several kinds to `height`, each by its weight, and fill `seabed` with the kinds of
        highest weight and `texture` with theirs. `weights`: (kinds, rows, columns) on the patch's coarse nodes, one
        more before and two behind.
        """
        texture[...] = 1.0
        seabed[...] = 0
        highest = np.zeros((NODES, NODES), dtype=np.float32)
        boxes = [_box(weights[kind], self._step) for kind in kinds]
        for kind, (rows, columns) in zip(kinds, boxes, strict=True):
            box = (rows.start, columns.start, rows.stop - rows.start, columns.stop - columns.start)
            cells = (patch_row * PATCH + box[0], patch_column * PATCH + box[1], *box[2:])
            # A hair more than 1, then cut: weights must be exactly 1 where there is no other kind, or patches would
            # differ on their sides.
            scaled = weights[kind] * np.float32(1.0001)
            first_row, first_column = box[0] // self._step, box[1] // self._step
            weight = refine(scaled[first_row:, first_column:], self._step, *box[2:])
            np.minimum(weight, np.float32(1.0), out=weight)
            relief = self._grounds[kind].relief(*cells)
            relief *= weight
            height[rows, columns] += relief
            fringe = partition.fringe(kind, *cells)
            if fringe is not None:
                weight *= fringe
            # In bytes that wrap, this sets the kind where its weight is higher; several times faster than an index of
            # truth values.
            label = seabed[rows, columns]
            label += (np.uint8(kind) - label) * (weight > highest[rows, columns])
            np.maximum(highest[rows, columns], weight, out=highest[rows, columns])
        for kind, (rows, columns) in zip(kinds, boxes, strict=True):
            own = self._grounds[kind].texture(
                patch_row * PATCH + rows.start,
                patch_column * PATCH + columns.start,
                rows.stop - rows.start,
                columns.stop - columns.start,
            )
            if own is not None:
                np.copyto(texture[rows, columns], own, where=seabed[rows, columns] == kind)

    def _scatter_stones(
        self, patch_row: int, patch_column: int, fields: FloatArray | None, height: FloatArray, texture: FloatArray
    ) -> None:
        reach, size_m = self._stones.reach_m, PATCH * self.cell_m
        east = patch_column * size_m - reach, (patch_column + 1) * size_m + reach
        north = patch_row * size_m - reach, (patch_row + 1) * size_m + reach
        nodes, before, spacing_m = PATCH // self._step, 1 + self._margin, self._step * self.cell_m

        def label_at(east_m: NDArray[np.float64], north_m: NDArray[np.float64]) -> Labels:
            if fields is None:
                return np.zeros(east_m.shape, dtype=np.uint8)
            row = np.rint(north_m / spacing_m).astype(np.intp) - (patch_row * nodes - before)
            column = np.rint(east_m / spacing_m).astype(np.intp) - (patch_column * nodes - before)
            highest: Labels = np.argmax(fields[:, row, column], axis=0).astype(np.uint8)
            return highest

        stones = self._stones.within(*east, *north, label_at)
        if len(stones):
            layer = np.zeros((NODES, NODES), dtype=np.float32)
            raise_stones(layer, stones, patch_row * PATCH, patch_column * PATCH, self.cell_m)
            height += layer
            np.multiply(texture, np.float32(_STONE_BRIGHTNESS), out=texture, where=layer > 0.0)


def _box(weight: FloatArray, step: int) -> tuple[slice, slice]:
    """Return rows and columns of a patch's nodes that coarse nodes of some weight reach."""
    rows, columns = np.nonzero(weight)
    return _span(rows, step), _span(columns, step)


def _span(nodes: NDArray[np.intp], step: int) -> slice:
    first, last = int(nodes.min()), int(nodes.max())
    # Coarse node k lies at cell (k - 1) * step, and a cubic B-spline's coefficients reach two nodes.
    return slice(max(0, (first - 3) * step), min(NODES, (last + 1) * step + 1))
