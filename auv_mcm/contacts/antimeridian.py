"""Cut lines and polygons at the antimeridian: nothing drawn may cross longitude 180 (RFC 7946 section 3.1.9).

Input longitudes may be wrapped or continuous; two neighbouring vertices are taken the short way round. Rings are simple
(not crossing themselves), which every coverage outline and error ellipse is.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Line: TypeAlias = NDArray[np.float64]  # (n, 2) longitude, latitude in degrees

_NUDGE_DEG = 1e-11  # a ring's vertex on the cut itself moves by a micrometre, so that every crossing is a proper one
_MIN_WIDTH_DEG = 1e-10  # thinner pieces come from the nudge


def split_line(line: Line) -> list[Line]:
    """Split a (n, 2) line with longitudes in [-180, 180] into pieces, in order, none crossing the antimeridian."""
    points = _continuous(line)
    pieces: list[Line] = []
    piece = [points[0]]
    world = _world(points[0, 0])
    for before, after in pairwise(points):
        while _world(after[0]) != world:
            step = 1 if after[0] > before[0] else -1
            cut = 360.0 * world + 180.0 * step
            crossing = _crossing(before, after, cut)
            pieces.append(_shifted([*piece, crossing], world))
            piece = [crossing]
            world += step
        piece.append(after)
    pieces.append(_shifted(piece, world))
    return [piece for piece in pieces if len(piece) > 1 and not (piece == piece[0]).all()]


def split_ring(ring: Line) -> list[Line]:
    """Split a (n, 2) ring into rings that together cover its inside.

    The rings are closed and counter-clockwise, with longitudes in [-180, 180].

    A ring that runs once around a pole is closed over that pole.
    """
    given = np.asarray(ring, dtype=np.float64)
    low, high = given[:, 0].min(), given[:, 0].max()
    if low > -180.0 and high < 180.0 and high - low < 180.0 and np.array_equal(given[0], given[-1]):
        return _whole([given[:-1]])
    points = _continuous(given)
    turns = round((points[-1, 0] - points[0, 0]) / 360.0)
    if turns:
        pole = 90.0 if points[:, 1].mean() > 0.0 else -90.0
        points = np.vstack([points, [points[-1, 0], pole], [points[0, 0], pole]])
    elif np.array_equal(points[0], points[-1]):
        points = points[:-1]
    points[(points[:, 0] - 180.0) % 360.0 == 0.0, 0] += _NUDGE_DEG
    pieces: list[Line] = []
    rest = [points]
    while rest:
        polygon = rest.pop()
        world = _world(float(polygon[:, 0].min()))
        cut = 360.0 * world + 180.0
        if polygon[:, 0].max() <= cut:
            pieces.append(_shifted(list(polygon), world))
        else:
            pieces.extend(_shifted(list(part), world) for part in _half(polygon, cut, west=True))
            rest.extend(_half(polygon, cut, west=False))
    return _whole(pieces)


def _continuous(line: Line) -> Line:
    points = np.array(line, dtype=np.float64)
    points[:, 0] = np.unwrap(points[:, 0], period=360.0)
    return points


def _world(longitude_deg: float) -> int:
    return int(np.floor((longitude_deg + 180.0) / 360.0))


def _shifted(points: list[NDArray[np.float64]], world: int) -> Line:
    shifted = np.array(points, dtype=np.float64)
    shifted[:, 0] = np.clip(shifted[:, 0] - 360.0 * world, -180.0, 180.0)
    return shifted


def _crossing(before: NDArray[np.float64], after: NDArray[np.float64], cut: float) -> NDArray[np.float64]:
    fraction = (cut - before[0]) / (after[0] - before[0])
    return np.array([cut, before[1] + fraction * (after[1] - before[1])])


def _half(polygon: Line, cut: float, *, west: bool) -> list[Line]:
    """Cut out the parts of an open simple polygon on one side of a meridian.

    The outline falls into chains on this side, each from one crossing of the meridian to another. With crossings sorted
    by latitude, the stretches 0-1, 2-3, ... of the meridian lie inside the polygon: these are the edges that join the
    chains.
    """
    keep = polygon[:, 0] < cut if west else polygon[:, 0] >= cut
    if not keep.any():
        return []
    if keep.all():
        return [polygon]
    start = int(np.flatnonzero(keep & ~np.roll(keep, 1))[0])
    order = np.roll(np.arange(len(polygon)), -start)
    chains: list[list[NDArray[np.float64]]] = []
    for index in order:
        before, after = (index - 1) % len(polygon), (index + 1) % len(polygon)
        if not keep[index]:
            continue
        if not keep[before]:
            chains.append([_crossing(polygon[before], polygon[index], cut)])
        chains[-1].append(polygon[index])
        if not keep[after]:
            chains[-1].append(_crossing(polygon[index], polygon[after], cut))
    ends = sorted((float(chain[end][1]), number, end) for number, chain in enumerate(chains) for end in (0, -1))
    partner: dict[tuple[int, int], tuple[int, int]] = {}
    for one, other in zip(ends[::2], ends[1::2], strict=True):
        partner[one[1:]], partner[other[1:]] = other[1:], one[1:]
    parts: list[Line] = []
    unused = set(range(len(chains)))
    while unused:
        first = current = min(unused)
        outline: list[NDArray[np.float64]] = []
        while current in unused:
            unused.remove(current)
            outline.extend(chains[current])
            current = partner[current, -1][0]
        if current == first:
            parts.append(np.array(outline))
    return parts


def _whole(pieces: list[Line]) -> list[Line]:
    """Close the pieces that have an area, counter-clockwise."""
    closed = []
    for piece in pieces:
        offset = piece - piece[0]
        (east, north), (next_east, next_north) = offset.T, np.concatenate((offset[1:], offset[:1])).T
        doubled_area = float(np.sum(east * next_north - next_east * north))
        if doubled_area != 0.0 and np.ptp(piece[:, 0]) > _MIN_WIDTH_DEG:
            ring = piece[::-1] if doubled_area < 0.0 else piece
            closed.append(ring if np.array_equal(ring[0], ring[-1]) else np.concatenate((ring, ring[:1])))
    return closed
