"""Echo energy of sonar rays over a height field, O(n) per ray.

A ray is one vertical slice from the sonar outwards: a profile of nodes, one sea-floor cell apart. A facet between two nodes is seen as far
as it is less depressed than all nearer nodes: a running minimum of depression, exact for height fields. A seen facet sends back

    sigma(sin of the local grazing angle) * texture * beam(angle off the axis)^2 * length along the ray * sqrt(1 + s^2 + q^2)

per metre of width, s and q being the slopes along and across the ray, and the energy is spread evenly over the slant ranges that its seen
part spans. Layover, foreshortening and shadow need no special case. Spreading, absorption and width depend on slant range alone and come
later. Walls of bodies are turned as the body is, so that a box shows its true brightness from every side.

The C kernel and the numpy twin give the same bytes.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator import backend
from sim_replay.simulator.bodies import MOVES_FLOOR, Bodies, body_tops, body_wall
from sim_replay.simulator.world import NODES, PATCH, Patches

TABLE_SIZE: Final = 4096
LINE_WIDTH: Final = 12
_NUMPY_LINES: Final = 16  # at a time, so that the intermediate arrays stay in the cache


class Lines(NamedTuple):
    """Rays; every array is (n_lines,) float64 but `ping` int64.

    north_cells, east_cells: place of node 0 in cells from the south-west corner of the patches. step_*: cells per node.
    elevation_m: of the sonar above the datum. slant_factor: slant depth per depth, from pitch. axis_cos, axis_sin: of the depression
    of the vertical beam's axis. weight: share of the beam. ping: row of the energy that the ray adds to.
    """

    north_cells: NDArray[np.float64]
    east_cells: NDArray[np.float64]
    step_north: NDArray[np.float64]
    step_east: NDArray[np.float64]
    elevation_m: NDArray[np.float64]
    slant_factor: NDArray[np.float64]
    axis_cos: NDArray[np.float64]
    axis_sin: NDArray[np.float64]
    weight: NDArray[np.float64]
    ping: NDArray[np.int64]


class Rendered(NamedTuple):
    """energy: (n_pings, n_bins) float64. beyond: (n_pings,) float64, what lies farther than the last bin.

    Per ray and node, if asked for: lit (n_lines, n_nodes) float32, the share seen of the facet that ends at the node; owner (n_lines,
    n_nodes) int16, index of the body that the node lies on, -1 for the floor.
    """

    energy: NDArray[np.float64]
    beyond: NDArray[np.float64]
    lit: NDArray[np.float32] | None
    owner: NDArray[np.int16] | None


def render(
    lines: Lines,
    patches: Patches,
    bodies: Bodies,
    tables: NDArray[np.float32],
    beam: NDArray[np.float32],
    *,
    cell_m: float,
    n_nodes: int,
    n_pings: int,
    n_bins: int,
    bin_m: float,
    keep_nodes: bool = False,
) -> Rendered:
    """Energy per slant-range bin of every ping.

    tables: (n_materials, 4096) float32 of sigma over the sine of grazing, those of the sea floor first. beam: (4096,) float32, the
    two-way power pattern over the sine of the angle off the axis from -1 to 1. Every cell that the rays cross must be in `patches`.
    """
    packed = np.zeros((len(lines.ping), LINE_WIDTH))
    for column, values in enumerate(lines):
        packed[:, column] = values
    energy = np.zeros((n_pings, n_bins + 1))
    lit = np.empty((len(packed), n_nodes), dtype=np.float32) if keep_nodes else None
    owner = np.empty((len(packed), n_nodes), dtype=np.int16) if keep_nodes else None
    origin = patches.first_patch_row * PATCH * cell_m, patches.first_patch_column * PATCH * cell_m
    library = backend.library()
    if library is None:
        for start in range(0, len(packed), _NUMPY_LINES):
            part = slice(start, start + _NUMPY_LINES)
            nodes = _render_numpy(packed[part], patches, bodies, tables, beam, cell_m, n_nodes, n_bins, bin_m, origin, energy)
            if lit is not None and owner is not None:
                lit[part], owner[part] = nodes
    else:
        tables, beam = np.ascontiguousarray(tables), np.ascontiguousarray(beam)
        scratch, row = np.empty((14, n_nodes), dtype=np.float32), np.empty(2 * (n_bins + 1))
        library.auv_mcm_render_lines(
            len(packed),
            n_nodes,
            n_bins,
            cell_m,
            1.0 / bin_m,
            *origin,
            patches.slots.shape[1],
            patches.slots.ctypes.data,
            patches.elevation.ctypes.data,
            patches.texture.ctypes.data,
            patches.seabed.ctypes.data,
            packed.ctypes.data,
            len(bodies.table),
            bodies.table.ctypes.data,
            bodies.planes.ctypes.data,
            tables.ctypes.data,
            beam.ctypes.data,
            scratch.ctypes.data,
            row.ctypes.data,
            energy.ctypes.data,
            None if lit is None else lit.ctypes.data,
            None if owner is None else owner.ctypes.data,
        )
    return Rendered(energy[:, :-1], energy[:, -1], lit, owner)


def _render_numpy(
    lines: NDArray[np.float64],
    patches: Patches,
    bodies: Bodies,
    tables: NDArray[np.float32],
    beam: NDArray[np.float32],
    cell_m: float,
    n_nodes: int,
    n_bins: int,
    bin_m: float,
    origin: tuple[float, float],
    energy: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    single = np.float32
    north0, east0, step_north, step_east = (lines[:, column, None] for column in range(4))
    altitude, slant, axis_cos, axis_sin, weight = (lines[:, column, None].astype(single) for column in range(4, 9))
    step_cells = np.sqrt(step_north * step_north + step_east * step_east)
    dy, per_dy = (step_cells * cell_m).astype(single), (1.0 / (step_cells * cell_m)).astype(single)
    ahead_north, ahead_east = (-step_east / (step_cells * cell_m)).astype(single), (step_north / (step_cells * cell_m)).astype(single)

    index = np.arange(n_nodes, dtype=np.float64)
    z, q, nearest = _gather(patches, north0 + index * step_north, east0 + index * step_east, ahead_north, ahead_east)
    texture = patches.texture.ravel().take(nearest)
    material = patches.seabed.ravel().take(nearest).astype(np.int32)
    owner = np.full(z.shape, -1, dtype=np.int16)
    if len(bodies.table):
        for row in range(len(lines)):
            if _raise_bodies(lines[row], cell_m, origin, bodies, z[row], q[row], texture[row], material[row], owner[row]):
                _turn_walls(lines[row], cell_m, origin, bodies, z[row], q[row], texture[row], material[row], owner[row])

    y = index.astype(single) * dy
    depth = altitude - z
    with np.errstate(divide="ignore"):
        t = np.divide(depth, y)
    t[:, 0] = np.inf
    depth *= slant
    r = np.sqrt(y * y + depth * depth)
    lit = np.zeros_like(t)
    least = np.minimum.accumulate(t, axis=1)[:, :-1]
    here, before = t[:, 1:], t[:, :-1]
    seen = here < least
    np.copyto(lit[:, 1:], seen)
    rows, columns = np.nonzero(seen & (before > least))
    lit[rows, columns + 1] = (least[rows, columns] - here[rows, columns]) / (before[rows, columns] - here[rows, columns])

    middle_y = (index[1:].astype(single) - single(0.5)) * dy
    middle_depth = single(0.5) * (depth[:, 1:] + depth[:, :-1])
    middle_r = single(0.5) * (r[:, 1:] + r[:, :-1])
    s = (z[:, 1:] - z[:, :-1]) * per_dy
    across = q[:, 1:]
    stretch = np.sqrt(single(1.0) + s * s + across * across)
    s *= middle_y
    s += middle_depth
    sine = s / (middle_r * stretch)
    off_axis = (middle_depth * axis_cos - middle_y * axis_sin) / middle_r
    entry = np.clip((sine * single(TABLE_SIZE)).astype(np.int32), 0, TABLE_SIZE - 1)
    beam_entry = np.clip(((off_axis + single(1.0)) * single(0.5 * TABLE_SIZE)).astype(np.int32), 0, TABLE_SIZE - 1)
    entry += material[:, 1:] * TABLE_SIZE
    sent = stretch
    sent *= dy
    sent *= lit[:, 1:]
    sent *= weight
    sent *= sine > 0.0
    strength = tables.ravel().take(entry)
    strength *= beam.take(beam_entry)
    strength *= texture[:, 1:]
    sent *= strength

    far_end = r[:, 1:] * single(1.0 / bin_m)
    near_end = (r[:, 1:] - lit[:, 1:] * (r[:, 1:] - r[:, :-1])) * single(1.0 / bin_m)
    _deposit(lines[:, 9].astype(np.int64), sent, np.minimum(near_end, far_end), np.maximum(near_end, far_end), n_bins, energy)
    return lit, owner


def _gather(
    patches: Patches,
    north: NDArray[np.float64],
    east: NDArray[np.float64],
    ahead_north: NDArray[np.float32],
    ahead_east: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Height, slope along the track, and index of the nearest node in the pool, at places in cells."""
    row, column = north.astype(np.int32), east.astype(np.int32)
    part_north, part_east = (north - row).astype(np.float32), (east - column).astype(np.float32)
    slot = patches.slots[row // PATCH, column // PATCH]
    base = slot.astype(np.int64) * (NODES * NODES) + ((row & (PATCH - 1)) * NODES + (column & (PATCH - 1)))
    elevation = patches.elevation.ravel()
    here, east_of = elevation.take(base), elevation.take(base + 1)
    north_of, beyond = elevation.take(base + NODES), elevation.take(base + (NODES + 1))
    south, far = east_of - here, beyond - north_of
    here += part_east * south
    north_of += part_east * far
    rise = north_of - here
    z = here + part_north * rise
    q = rise * ahead_north + (south + part_north * (far - south)) * ahead_east
    base += np.where(part_north >= 0.5, NODES, 0)
    base += part_east >= 0.5
    return z, q, base


def _away(line: NDArray[np.float64], cell_m: float) -> tuple[float, float, float]:
    """Length of a step, m, and the ray's direction (north, east)."""
    step_m = cell_m * float(np.sqrt(line[2] * line[2] + line[3] * line[3]))
    return step_m, float(line[2]) * cell_m / step_m, float(line[3]) * cell_m / step_m


def _raise_bodies(
    line: NDArray[np.float64],
    cell_m: float,
    origin: tuple[float, float],
    bodies: Bodies,
    z: NDArray[np.float32],
    q: NDArray[np.float32],
    texture: NDArray[np.float32],
    material: NDArray[np.int32],
    owner: NDArray[np.int16],
) -> bool:
    """Put the bodies on one profile, in place; False if the ray meets none."""
    step_m, away_north, away_east = _away(line, cell_m)
    table = bodies.table
    norths, easts = origin[0] + line[0] * cell_m - table[:, 2], origin[1] + line[1] * cell_m - table[:, 1]
    along = -(norths * away_north + easts * away_east)
    miss = norths * -away_east + easts * away_north
    inside = table[:, 3] * table[:, 3] - miss * miss
    met = False
    for k in np.flatnonzero(inside > 0.0):
        b, half = table[k], float(np.sqrt(inside[k]))
        first = max(0, int(np.ceil((along[k] - half) / step_m)))
        last = min(len(z) - 1, int(np.floor((along[k] + half) / step_m)))
        if last < first:
            continue
        met = True
        sine, cosine = b[4], b[5]
        j = np.arange(first, last + 1, dtype=np.float64)
        u = (easts[k] * sine + norths[k] * cosine) + j * ((away_east * sine + away_north * cosine) * step_m)
        v = (easts[k] * cosine - norths[k] * sine) + j * ((away_east * cosine - away_north * sine) * step_m)
        top, slope_u, slope_v, covered = body_tops(b, bodies.planes, u, v)
        slope = slope_u * (away_north * sine + -away_east * cosine) + slope_v * (away_north * cosine - -away_east * sine)
        nodes = slice(first, last + 1)
        if b[0] >= MOVES_FLOOR:
            z[nodes][covered] += top[covered].astype(np.float32)
            q[nodes][covered] += slope[covered].astype(np.float32)
            continue
        height = (b[6] + top).astype(np.float32)
        rules = covered & (height > z[nodes])
        z[nodes][rules] = height[rules]
        q[nodes][rules] = slope[rules].astype(np.float32)
        texture[nodes][rules] = 1.0
        material[nodes][rules] = int(b[7])
        owner[nodes][rules] = k
    return met


def _turn_walls(
    line: NDArray[np.float64],
    cell_m: float,
    origin: tuple[float, float],
    bodies: Bodies,
    z: NDArray[np.float32],
    q: NDArray[np.float32],
    texture: NDArray[np.float32],
    material: NDArray[np.int32],
    owner: NDArray[np.int16],
) -> None:
    """Facets between nodes of different owners belong to the higher one and are turned as its wall is."""
    step_m, away_north, away_east = _away(line, cell_m)
    ahead_north, ahead_east = -away_east, away_north
    for j in reversed(np.flatnonzero(owner[1:] != owner[:-1]) + 1):
        inner, outer = (j - 1, j) if z[j - 1] > z[j] else (j, j - 1)
        texture[j] = texture[inner]
        material[j] = material[inner]
        if owner[inner] < 0:
            continue
        b = bodies.table[owner[inner]]
        sine, cosine = b[4], b[5]
        east = (origin[1] + line[1] * cell_m - b[1]) + float(outer) * step_m * away_east
        north = (origin[0] + line[0] * cell_m - b[2]) + float(outer) * step_m * away_north
        normal_u, normal_v = body_wall(b, bodies.planes, east * sine + north * cosine, east * cosine - north * sine)
        towards = normal_u * (away_east * sine + away_north * cosine) + normal_v * (away_east * cosine - away_north * sine)
        aside = normal_u * (ahead_east * sine + ahead_north * cosine) + normal_v * (ahead_east * cosine - ahead_north * sine)
        limit = 20.0 * abs(towards)
        bounded = min(max(aside, -limit), limit)
        q[j] = np.float32(float(z[j] - z[j - 1]) / step_m * (bounded / towards)) if towards != 0.0 else 0.0


def _deposit(
    ping: NDArray[np.int64],
    sent: NDArray[np.float32],
    start: NDArray[np.float32],
    stop: NDArray[np.float32],
    n_bins: int,
    energy: NDArray[np.float64],
) -> None:
    """Spread each facet's energy evenly over [start, stop), in bins; bin n_bins takes what lies beyond."""
    first, final = (np.minimum(ends, np.float32(n_bins)).astype(np.int32) for ends in (start, stop))
    span = final - first
    split = span > 0
    density = sent / np.where(split, stop - start, np.float32(1.0))
    high = np.where(split, (stop - final.astype(np.float32)) * density, np.float32(0.0))
    low = sent - high
    long = np.nonzero(span > 1)
    low[long] -= (span[long] - 1).astype(np.float32) * density[long]
    offset = np.arange(len(sent), dtype=np.int32)[:, None] * (n_bins + 1)
    n_total = len(sent) * (n_bins + 1)
    starts = np.bincount((first + offset).ravel(), low.ravel(), n_total).reshape(len(sent), n_bins + 1)
    ends = np.bincount((final + offset).ravel(), high.ravel(), n_total).reshape(len(sent), n_bins + 1)
    for row, facet in zip(*long, strict=True):
        starts[row, first[row, facet] + 1 : final[row, facet]] += density[row, facet]
    starts += ends
    for one, values in zip(ping, starts, strict=True):
        energy[one] += values
