"""Render echo energy of sonar rays over a height field, O(n) per ray.

A ray is one vertical slice from the sonar outwards: a profile of nodes, one sea-floor cell apart. A facet between two
nodes is seen as far as it is less depressed than all nearer nodes: a running minimum of depression, exact for height
fields. A seen facet sends back

    sigma(sin of the local grazing angle) * texture * beam(angle off the axis)^2 * length along the ray * sqrt(1 + s^2 +
    q^2)

per metre of width, s and q being the slopes along and across the ray, and the energy is spread evenly over the slant
ranges that its seen part spans. Layover, foreshortening and shadow need no special case. Spreading, absorption and
width depend on slant range alone and come later. Walls of bodies are turned as the body is, so that a box shows its
true brightness from every side.

The C kernel and the numpy twin give the same bytes.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator import backend
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import MOVES_FLOOR, Bodies, body_tops, body_wall
from sim_replay.simulator.world import NODES, PATCH, Patches

LINE_WIDTH: Final = 12  # numbers per line; equal in C
_PATCH_SHIFT: Final = PATCH.bit_length() - 1
_NUMPY_LINES: Final = 32  # at a time: fewer cost more calls, more do not stay in the cache

Singles: TypeAlias = NDArray[np.float32]


class Lines(NamedTuple):
    """Hold rays; every array is (n_lines,) float64 but `ping` int64.

    north_cells, east_cells: place of node 0 in cells from the origin of the scene. step_*: cells per node. elevation_m:
    of the sonar above the datum. slant_factor: slant depth per depth, from pitch. axis_cos, axis_sin: of the depression
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
    """Hold energy: (n_pings, n_bins) float64. beyond: (n_pings,) float64, the energy farther than the last bin.

    Per ray and node, if asked for: lit (n_lines, n_nodes) float32, the share seen of the facet that ends at the node;
    owner (n_lines, n_nodes) int16, index of the body that the node lies on, -1 for the floor.
    """

    energy: NDArray[np.float64]
    beyond: NDArray[np.float64]
    lit: NDArray[np.float32] | None
    owner: NDArray[np.int16] | None


def render_pings(
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
    """Render energy per slant-range bin of every ping.

    Every cell that the rays cross must be in `patches`.

    Parameters
    ----------
    tables
        (n_materials, 4096) float32 of sigma over the sine of grazing, those of the sea floor first.
    beam
        (4096,) float32, the two-way power pattern over the sine of the angle off the axis from -1 to 1.
    """
    packed, (energy, lit, owner) = _packed(lines), _empty(len(lines.ping), n_nodes, n_pings, n_bins, keep_nodes)
    scratch, bins = np.empty((22, n_nodes), dtype=np.float32), np.empty((n_bins + 1, 2))
    numbers = len(packed), n_nodes, n_bins, cell_m, 1.0 / bin_m
    first = patches.first_patch_row * PATCH, patches.first_patch_column * PATCH, patches.slots.shape[1]
    floor = patches.slots, patches.elevation, patches.texture, patches.seabed, packed
    given = len(bodies.table), bodies.table, bodies.planes, tables, beam
    if not backend.call("render_lines", *numbers, *first, *floor, *given, scratch, bins, energy, lit, owner):
        return render_numpy(
            lines,
            patches,
            bodies,
            tables,
            beam,
            cell_m=cell_m,
            n_nodes=n_nodes,
            n_pings=n_pings,
            n_bins=n_bins,
            bin_m=bin_m,
            keep_nodes=keep_nodes,
        )
    return Rendered(energy[:, :-1], energy[:, -1], lit, owner)


def render_numpy(
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
    """Render in numpy alone."""
    packed, (energy, lit, owner) = _packed(lines), _empty(len(lines.ping), n_nodes, n_pings, n_bins, keep_nodes)
    for start in range(0, len(packed), _NUMPY_LINES):
        part = slice(start, start + _NUMPY_LINES)
        some, index = packed[part], np.arange(n_nodes, dtype=np.float32)
        step_m = np.sqrt(some[:, 2:3] * some[:, 2:3] + some[:, 3:4] * some[:, 3:4]) * cell_m
        on = _on_nodes(some, patches, bodies, step_m, index, cell_m)
        sight = _seen(some, on.z, step_m, index)
        facets = _facets(some, on, sight, step_m, index)
        strength = _strength(facets, on, sight.lit, tables, beam)
        _deposit(some[:, 9].astype(np.int64), strength, sight, np.float32(1.0 / bin_m), n_bins, energy)
        if lit is not None and owner is not None:
            lit[part], owner[part] = sight.lit, on.owner
    return Rendered(energy[:, :-1], energy[:, -1], lit, owner)


def _packed(lines: Lines) -> NDArray[np.float64]:
    """Pack rows as render.c reads them."""
    packed = np.zeros((len(lines.ping), LINE_WIDTH))
    for column, values in enumerate(lines):
        packed[:, column] = values
    return packed


def _empty(
    n_lines: int, n_nodes: int, n_pings: int, n_bins: int, keep_nodes: bool
) -> tuple[NDArray[np.float64], Singles | None, NDArray[np.int16] | None]:
    """Allocate the output; the energy of a ping ends with the energy beyond the last bin."""
    energy = np.zeros((n_pings, n_bins + 1))
    if not keep_nodes:
        return energy, None, None
    return energy, np.empty((n_lines, n_nodes), dtype=np.float32), np.empty((n_lines, n_nodes), dtype=np.int16)


class _OnNodes(NamedTuple):
    """Hold what lies on the nodes of rays, (n_lines, n_nodes) each.

    z: height, m. q: slope across the ray. owner: index of the body, -1 for the floor.
    """

    z: Singles
    q: Singles
    texture: Singles
    material: NDArray[np.int32]
    owner: NDArray[np.int16]


class _Seen(NamedTuple):
    """Hold how the sonar sees the nodes, (n_lines, n_nodes) each.

    depth: under it, m, along its own down. r: slant range, m. lit: share seen of the facet that ends at the node.
    """

    depth: Singles
    r: Singles
    lit: Singles


class _Facets(NamedTuple):
    """Hold the facets that end at the nodes, (n_lines, n_nodes) each.

    area: per metre of width, weighed as its ray. sine: of the local grazing angle. off_axis: sine of the angle off the
    axis of the beam.
    """

    area: Singles
    sine: Singles
    off_axis: Singles


def _column(lines: NDArray[np.float64], column: int) -> Singles:
    return lines[:, column, None].astype(np.float32)


def _on_nodes(
    lines: NDArray[np.float64],
    patches: Patches,
    bodies: Bodies,
    step_m: NDArray[np.float64],
    index: Singles,
    cell_m: float,
) -> _OnNodes:
    """Lay rays over the floor and the bodies on it."""
    z, q, nearest = _gather(patches, lines, step_m, index)
    material = patches.seabed.ravel().take(nearest).astype(np.int32)
    on = _OnNodes(z, q, patches.texture.ravel().take(nearest), material, np.full(z.shape, -1, dtype=np.int16))
    if len(bodies.table):
        for row, line in enumerate(lines):
            profile = _OnNodes(*(values[row] for values in on))
            if _raise_bodies(line, cell_m, bodies, profile):
                _turn_walls(line, cell_m, bodies, profile)
    return on


def _seen(lines: NDArray[np.float64], z: Singles, step_m: NDArray[np.float64], index: Singles) -> _Seen:
    """Find the slant range of nodes, and what nearer ones hide."""
    y = index * step_m.astype(np.float32)
    depth = _column(lines, 4) - z
    with np.errstate(divide="ignore", invalid="ignore"):
        t = depth * (np.float32(1.0) / index)
    t[:, 0] = np.inf
    depth *= _column(lines, 5)
    y *= y
    y += depth * depth
    return _Seen(depth, np.sqrt(y, out=y), _lit(t, index))


def _facets(
    lines: NDArray[np.float64], on: _OnNodes, seen: _Seen, step_m: NDArray[np.float64], index: Singles
) -> _Facets:
    """Find how facets are turned to the sonar; `on.q` is used up."""
    single = np.float32
    dy = step_m.astype(single)
    middle_y = (index - single(0.5)) * dy
    middle_depth = _with_last(np.add, seen.depth)
    middle_depth *= single(0.5)
    middle_r = _with_last(np.add, seen.r)
    middle_r *= single(0.5)
    s, q = _with_last(np.subtract, on.z), on.q
    s *= (1.0 / step_m).astype(single)
    q *= q
    stretch = s * s
    stretch += single(1.0)
    stretch += q
    np.sqrt(stretch, out=stretch)
    middle_r *= stretch
    per = np.divide(single(1.0), middle_r, out=middle_r)
    s *= middle_y
    s += middle_depth * (1.0 / lines[:, 5:6]).astype(single)
    s *= per
    middle_depth *= _column(lines, 6)
    middle_y *= _column(lines, 7)
    middle_depth -= middle_y
    per *= stretch
    middle_depth *= per
    stretch *= dy * _column(lines, 8)
    return _Facets(area=stretch, sine=s, off_axis=middle_depth)


def _strength(
    facets: _Facets, on: _OnNodes, lit: Singles, tables: NDArray[np.float32], beam: NDArray[np.float32]
) -> Singles:
    """Compute what seen facets send back; `facets` and `on.material` are used up."""
    single, (area, sine, off_axis), material = np.float32, facets, on.material
    area *= lit
    area *= on.texture
    area *= sine > 0.0
    sine *= single(TABLE_SIZE)
    entry = sine.astype(np.int32)
    np.clip(entry, 0, TABLE_SIZE - 1, out=entry)
    material *= TABLE_SIZE
    entry += material
    off_axis += single(1.0)
    off_axis *= single(0.5 * TABLE_SIZE)
    beam_entry = off_axis.astype(np.int32)
    np.clip(beam_entry, 0, TABLE_SIZE - 1, out=beam_entry)
    strength = tables.ravel().take(entry)
    strength *= beam.take(beam_entry)
    strength *= area
    return strength


def _with_last(operation: np.ufunc, values: Singles) -> Singles:
    """Pair every value with the one before it; results at first nodes mean nothing, as no facet ends there."""
    out = np.empty_like(values)
    flat, flat_out = values.ravel(), out.ravel()
    operation(flat[1:], flat[:-1], out=flat_out[1:])
    operation(flat[:1], flat[-1:], out=flat_out[:1])
    return out


def _gather(
    patches: Patches, lines: NDArray[np.float64], step_m: NDArray[np.float64], index: Singles
) -> tuple[Singles, Singles, NDArray[np.int64]]:
    """Return height, slope along the track, and index of the nearest node in the pool."""
    n_patch_columns = patches.slots.shape[1]
    row, part_north = _cells(lines[:, 0:1], lines[:, 2:3], patches.first_patch_row, index)
    column, part_east = _cells(lines[:, 1:2], lines[:, 3:4], patches.first_patch_column, index)
    patch = (row >> _PATCH_SHIFT) * np.int32(n_patch_columns)
    patch += column >> _PATCH_SHIFT
    row *= np.int32(NODES)
    row += column
    # Where in the pool a patch starts, less what its nodes count from the first patch.
    slot_row, slot_column = np.indices(patches.slots.shape)
    start = patches.slots.astype(np.int64) * (NODES * NODES) - PATCH * (slot_row * NODES + slot_column)
    base = start.ravel().take(patch)
    base += row
    elevation = patches.elevation.ravel()
    here, south = elevation.take(base), elevation[1:].take(base)
    north_of, far = elevation[NODES:].take(base), elevation[NODES + 1 :].take(base)
    south -= here
    far -= north_of
    here += part_east * south
    north_of += part_east * far
    north_of -= here
    rise = north_of
    z = here + part_north * rise
    far -= south
    far *= part_north
    far += south
    far *= (lines[:, 2:3] / step_m).astype(np.float32)
    rise *= (-lines[:, 3:4] / step_m).astype(np.float32)
    rise += far
    part_north += np.float32(0.5)
    part_east += np.float32(0.5)
    nearest = part_north.astype(np.int32)
    nearest *= np.int32(NODES)
    nearest += part_east.astype(np.int32)
    base += nearest
    return z, rise, base


def _cells(
    first: NDArray[np.float64], step: NDArray[np.float64], first_patch: int, index: Singles
) -> tuple[NDArray[np.int32], Singles]:
    """Return cells from the first patch on along one axis, and the place within them."""
    whole = np.floor(first)
    place = index * step.astype(np.float32)
    place += (first - whole).astype(np.float32)
    cell = np.floor(place)
    place -= cell
    count = cell.astype(np.int32)
    count += (whole - first_patch * PATCH).astype(np.int32)
    return count, place


def _lit(t: Singles, index: Singles) -> Singles:
    """Return the share of each facet that no nearer node hides."""
    nearest_so_far = np.minimum.accumulate(t, axis=1)
    lit = np.zeros_like(t)
    flat, before, after = lit.ravel()[1:], nearest_so_far.ravel()[:-1], nearest_so_far.ravel()[1:]
    seen = after < before
    np.copyto(flat, seen)
    seen &= before < t.ravel()[:-1]
    cut = np.flatnonzero(seen)
    j = (cut + 1) % t.shape[1]
    out, hidden = (
        (before[cut] - t.ravel()[cut + 1]) * index[j],
        (t.ravel()[cut] - before[cut]) * (index[j] - np.float32(1.0)),
    )
    flat[cut] = out / (out + hidden)
    lit[:, 0] = 0.0
    return lit


def _away(line: NDArray[np.float64], cell_m: float) -> tuple[float, float, float]:
    """Return the length of a step, m, and the ray's direction (north, east)."""
    step_m = cell_m * float(np.sqrt(line[2] * line[2] + line[3] * line[3]))
    return step_m, float(line[2]) * cell_m / step_m, float(line[3]) * cell_m / step_m


def _raise_bodies(line: NDArray[np.float64], cell_m: float, bodies: Bodies, on: _OnNodes) -> bool:
    """Put the bodies on one profile, in place; False if the ray meets none."""
    z, q, texture, material, owner = on
    step_m, away_north, away_east = _away(line, cell_m)
    table = bodies.table
    norths, easts = line[0] * cell_m - table[:, 2], line[1] * cell_m - table[:, 1]
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
        slope = slope_u * (away_north * sine + -away_east * cosine) + slope_v * (
            away_north * cosine - -away_east * sine
        )
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


def _turn_walls(line: NDArray[np.float64], cell_m: float, bodies: Bodies, on: _OnNodes) -> None:
    """Assign facets between nodes of different owners to the higher one and turn them as its wall."""
    z, q, texture, material, owner = on
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
        east = (line[1] * cell_m - b[1]) + float(outer) * step_m * away_east
        north = (line[0] * cell_m - b[2]) + float(outer) * step_m * away_north
        normal_u, normal_v = body_wall(b, bodies.planes, east * sine + north * cosine, east * cosine - north * sine)
        towards = normal_u * (away_east * sine + away_north * cosine) + normal_v * (
            away_east * cosine - away_north * sine
        )
        aside = normal_u * (ahead_east * sine + ahead_north * cosine) + normal_v * (
            ahead_east * cosine - ahead_north * sine
        )
        limit = 20.0 * abs(towards)
        bounded = min(max(aside, -limit), limit)
        q[j] = np.float32(float(z[j] - z[j - 1]) / step_m * (bounded / towards)) if towards != 0.0 else 0.0


def _deposit(
    ping: NDArray[np.int64],
    sent: Singles,
    seen: _Seen,
    bins_per_m: np.float32,
    n_bins: int,
    energy: NDArray[np.float64],
) -> None:
    """Spread each facet's energy evenly over the slant ranges that its lit part spans; bin n_bins takes what lies
    beyond."""
    single, r = np.float32, seen.r
    near_end = _with_last(np.subtract, r)
    near_end *= seen.lit
    np.subtract(r, near_end, out=near_end)
    near_end *= bins_per_m
    far_end = r * bins_per_m
    stop = np.maximum(near_end, far_end)
    start = np.minimum(near_end, far_end, out=near_end)
    np.minimum(start, single(n_bins), out=far_end)
    first = far_end.astype(np.int32)
    np.minimum(stop, single(n_bins), out=far_end)
    final = far_end.astype(np.int32)
    np.floor(far_end, out=far_end)
    np.subtract(stop, start, out=start)
    np.maximum(start, single(1e-30), out=start)  # a facet within one bin may have no length
    per_bin = np.divide(single(1.0), start, out=start)
    stop -= far_end
    stop *= per_bin
    past = stop
    past *= final > first
    past *= sent
    own = sent - past
    final -= first
    between = np.maximum(final - np.int32(1), 0)
    first += np.arange(len(sent), dtype=np.int32)[:, None] * np.int32(n_bins + 1)
    starts, started, ends, ended = first.ravel(), own.ravel(), first.ravel(), past.ravel()
    skipping = np.flatnonzero(between)
    if len(skipping):
        count, each = between.ravel()[skipping], sent.ravel()[skipping] * per_bin.ravel()[skipping]
        where, rest, ending = starts[skipping], started[skipping] - count.astype(single) * each, ended[skipping]
        started[skipping] = ended[skipping] = 0.0
        steps = np.arange(count.sum(), dtype=np.int32) - np.repeat(np.cumsum(count, dtype=np.int32) - count, count)
        starts = np.concatenate([starts, where, np.repeat(where + 1, count) + steps])
        started = np.concatenate([started, rest, np.repeat(each, count)])
        ends, ended = np.concatenate([ends, where + count]), np.concatenate([ended, ending])
    n_total = len(sent) * (n_bins + 1)
    rows = np.bincount(starts, started, n_total).reshape(len(sent), n_bins + 1)
    rows[:, 1:] += np.bincount(ends, ended, n_total).reshape(len(sent), n_bins + 1)[:, :-1]
    for one, values in zip(ping, rows, strict=True):
        energy[one] += values
