"""Render mean echoes of a recovered sea floor with and without objects on it, along the recorder's slant range.

The simulator's rays do the work, over the recovered relief in place of a simulated one: what an object hides, what
hides it, layover, walls and the shadow on whatever floor lies behind come of one rule. The floor's echo follows the
model that the floor was recovered by (`sim_replay.augment.floor`): beam pattern times reflectivity times the cosine of
incidence. Both the beam pattern and the echo depend on angles as they are with the object there.

The window's plane: north ahead along the track, east to starboard, the ping that looks straight at the object at
(REFERENCE_NORTH_M, 0).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Side
from sim_replay.augment.floor import BeamPattern
from sim_replay.augment.track import SIGN
from sim_replay.simulator.backscatter import TABLE_SIZE, target_table
from sim_replay.simulator.bodies import Bodies, Body, pack
from sim_replay.simulator.objects import PlacedObject, bodies_of, material_of
from sim_replay.simulator.rays import beam_rays
from sim_replay.simulator.render import Lines, render_pings
from sim_replay.simulator.scene import Sonar
from sim_replay.simulator.world import NODES, PATCH, Patches

CELL_M: Final = 0.03  # m: of the elevation that embedded objects are drawn with
REFERENCE_NORTH_M: Final = 0.5 * PATCH * CELL_M  # few patches then do for a window
BEAM_LINES: Final = 5  # rays per beam
_NO_BODIES: Final = pack([])
_FLOOR, _TARGET = 0, 1

Floats: TypeAlias = NDArray[np.float64]


class Relief(NamedTuple):
    """Hold the recovered floor of a window.

    One side, on pings by ground-range columns, column j around (first_column + j + 0.5) * spacing.

    elevation_m, reflectivity: (n_pings, n_columns) float64, above the flat bottom, and relative; a reflectivity of 0
    hides but does not echo. along_m: (n_pings,) float64 from the reference ping, increasing. Beyond the window the
    floor is flat and of reflectivity 1.
    """

    elevation_m: Floats
    reflectivity: Floats
    along_m: Floats
    first_column: int
    column_spacing_m: float

    def at(self, north_m: Floats, ground_m: Floats) -> tuple[Floats, Floats]:
        """Return elevation and reflectivity at all of (n_north,) by (n_ground,) places, bilinear."""
        row = np.interp(north_m - REFERENCE_NORTH_M, self.along_m, np.arange(len(self.along_m)))
        column = ground_m / self.column_spacing_m - 0.5 - self.first_column
        inside = (column >= 0.0) & (column <= self.elevation_m.shape[1] - 1)
        low_row = np.minimum(row.astype(np.intp), max(len(self.along_m) - 2, 0))
        low_column = np.clip(column.astype(np.intp), 0, max(self.elevation_m.shape[1] - 2, 0))
        part_row, part_column = (row - low_row)[:, None], np.clip(column - low_column, 0.0, 1.0)
        high_row, high_column = (
            np.minimum(low_row + 1, len(self.along_m) - 1),
            np.minimum(low_column + 1, self.elevation_m.shape[1] - 1),
        )

        def taken(values: Floats, outside: float) -> Floats:
            between = values[low_row] * (1.0 - part_row) + values[high_row] * part_row
            return np.where(
                inside, between[:, low_column] * (1.0 - part_column) + between[:, high_column] * part_column, outside
            )

        return taken(self.elevation_m, 0.0), taken(self.reflectivity, 1.0)


class PingWindow(NamedTuple):
    """Hold the pings of a window and their sonar.

    along_m: (n_pings,) float64 from the reference ping. turn_rad: (n_pings,) float64, heading against the reference
    ping's. height_m: (n_pings,) float64 of the sonar above the flat bottom. first_edge_m: slant range where sample 0
    begins. beam_width_deg: 0 where resolution does not depend on range.
    """

    side: Side
    along_m: Floats
    turn_rad: Floats
    height_m: Floats
    first_edge_m: float
    spacing_m: float
    n_samples: int
    beam_width_deg: float
    beam: BeamPattern


class Echoes(NamedTuple):
    """Hold mean echoes of a window, (n_pings, n_samples) float64, all in one unit.

    Of the floor alone, of the floor with the objects there, of the objects, and of the objects if nothing but
    themselves hid them.
    """

    bare: Floats
    floor: Floats
    target: Floats
    in_full_view: Floats


def floor_bodies(scene_object: PlacedObject, relief: Relief, side: Side) -> list[Body]:
    """Build the bodies of an object of the window's plane, standing on the relief."""

    def floor_m(east_m: float, north_m: float) -> float:
        return float(relief.at(np.array([north_m]), np.array([SIGN[side] * east_m]))[0][0, 0])

    return bodies_of(scene_object, floor_m, _TARGET)


def echoes(
    view: PingWindow, relief: Relief, scene_object: PlacedObject, stands_on: Relief, farthest_m: float
) -> Echoes:
    """Render mean echoes without and with an object.

    Parameters
    ----------
    relief
        The floor as it hides and echoes.
    stands_on
        The floor as the object stands on it, without what only hides.
    scene_object
        In the window's plane, its strength_db above an echo of 1 at grazing angles whose cosine of incidence is 1.
    farthest_m
        Ground range up to which the object can change anything.
    """
    lines, n_nodes = _lines(view, farthest_m)
    bodies = pack(floor_bodies(scene_object, stands_on, view.side))
    material = material_of(scene_object)
    sine = (np.arange(TABLE_SIZE, dtype=np.float64) + 0.5) / TABLE_SIZE
    of_floor, of_target = np.zeros((2, TABLE_SIZE), dtype=np.float32), np.zeros((2, TABLE_SIZE), dtype=np.float32)
    of_floor[_FLOOR] = sine
    of_target[_TARGET] = target_table(material.strength_db, material.specular_db, material.specular_exponent)
    beam = _beam_table(view.beam)
    patches = _patches(relief, lines, n_nodes, view.side)
    level = _patches(stands_on._replace(elevation_m=np.zeros_like(stands_on.elevation_m)), lines, n_nodes, view.side)
    alone = pack(
        floor_bodies(scene_object, stands_on._replace(elevation_m=np.zeros_like(stands_on.elevation_m)), view.side)
    )

    def heard(floor: Patches, standing: Bodies, tables: NDArray[np.float32]) -> Floats:
        first_bin = round(view.first_edge_m / view.spacing_m)
        rendered = render_pings(
            lines,
            floor,
            standing,
            tables,
            beam,
            cell_m=CELL_M,
            n_nodes=n_nodes,
            n_pings=len(view.along_m),
            n_bins=first_bin + view.n_samples,
            bin_m=view.spacing_m,
        )
        return rendered.energy[:, first_bin:]

    return Echoes(
        bare=heard(patches, _NO_BODIES, of_floor),
        floor=heard(patches, bodies, of_floor),
        target=heard(patches, bodies, of_target),
        in_full_view=heard(level, alone, of_target),
    )


def _beam_table(beam: BeamPattern) -> NDArray[np.float32]:
    """Tabulate the pattern over the sine of the echo's angle below the horizontal, from -1 to 1.

    The model's image is the mean over ground range: rays, which count the floor that a stretch of slant range covers,
    take its cosine off.
    """
    sine = -1.0 + (np.arange(TABLE_SIZE, dtype=np.float64) + 0.5) * (2.0 / TABLE_SIZE)
    gain = np.interp(np.arcsin(sine), beam.depression_rad, beam.gain)
    return (gain / np.max(beam.gain) * np.sqrt(1.0 - sine**2)).astype(np.float32)


def _lines(view: PingWindow, farthest_m: float) -> tuple[Lines, int]:
    angle, share = np.zeros(1), np.ones(1)
    if view.beam_width_deg > 0.0:
        angle, share = beam_rays(Sonar(beam_width_deg=view.beam_width_deg, beam_lines=BEAM_LINES))
    shape = (len(view.along_m), len(angle))
    direction = view.turn_rad[:, None] + SIGN[view.side] * (0.5 * math.pi - angle[None, :])

    def flat(values: Floats) -> Floats:
        return np.broadcast_to(values, shape).ravel()

    lines = Lines(
        north_cells=flat((view.along_m[:, None] + REFERENCE_NORTH_M) / CELL_M),
        east_cells=flat(np.zeros((1, 1))),
        step_north=flat(np.cos(direction)),
        step_east=flat(np.sin(direction)),
        elevation_m=flat(view.height_m[:, None]),
        slant_factor=flat(np.ones((1, 1))),
        axis_cos=flat(np.ones((1, 1))),
        axis_sin=flat(np.zeros((1, 1))),
        weight=flat(share[None, :]),
        ping=flat(np.arange(len(view.along_m), dtype=np.float64)[:, None]).astype(np.int64),
    )
    return lines, math.ceil(farthest_m / CELL_M) + 2


def _patches(relief: Relief, lines: Lines, n_nodes: int, side: Side) -> Patches:
    """Return the relief on the nodes that the rays cross; outside the window one flat patch serves for all."""
    ends_north = np.concatenate([lines.north_cells, lines.north_cells + n_nodes * lines.step_north])
    ends_east = np.concatenate([lines.east_cells, lines.east_cells + n_nodes * lines.step_east])
    first_row, first_column = math.floor((ends_north.min() - 2) / PATCH), math.floor((ends_east.min() - 2) / PATCH)
    n_rows = math.floor((ends_north.max() + 2) / PATCH) - first_row + 1
    n_columns = math.floor((ends_east.max() + 2) / PATCH) - first_column + 1
    slots = np.zeros((n_rows, n_columns), dtype=np.int32)
    elevation, texture = [np.zeros((NODES, NODES), dtype=np.float32)], [np.ones((NODES, NODES), dtype=np.float32)]
    nodes = np.arange(NODES)
    near_m = (relief.first_column + 0.5) * relief.column_spacing_m
    far_m = near_m + (relief.elevation_m.shape[1] - 1) * relief.column_spacing_m
    for row, column in np.ndindex(n_rows, n_columns):
        north_m = ((first_row + row) * PATCH + nodes) * CELL_M
        ground_m = SIGN[side] * ((first_column + column) * PATCH + nodes) * CELL_M
        if ground_m.max() < near_m or ground_m.min() > far_m:
            continue
        slots[row, column] = len(elevation)
        height, reflectivity = relief.at(north_m, ground_m)
        elevation.append(height.astype(np.float32))
        texture.append(reflectivity.astype(np.float32))
    return Patches(
        np.stack(elevation),
        np.stack(texture),
        np.zeros((len(elevation), NODES, NODES), dtype=np.uint8),
        slots,
        first_row,
        first_column,
    )
