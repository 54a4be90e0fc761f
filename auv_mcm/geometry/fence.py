"""Check whether circles, straight runs and paths stay inside a polygon, many at once.

Points are (..., 2) arrays of east and north in metres. A fence is (k, 2) corners in order, closed by itself, possibly
concave; a margin is kept from its edges on the inside. The inside goes by the even-odd rule, so that crossing edges
have a meaning, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]
Flags = NDArray[np.bool_]


def circles_inside(centres: Points, radius_m: ArrayLike, fence: Points, margin_m: float) -> Flags:
    """Check whether circles keep to the inside, (...,); a radius of 0 checks the points themselves."""
    starts, ends = fence, np.roll(fence, -1, axis=0)
    distance = _to_segments(centres[..., np.newaxis, :], starts, ends).min(axis=-1)
    return np.asarray(_within(centres, fence) & (distance >= np.asarray(radius_m) + margin_m))


def runs_inside(starts: Points, ends: Points, fence: Points, margin_m: float) -> Flags:
    """Check whether straight runs from (n, 2) starts to (n, 2) ends keep to the inside, (n,)."""
    edge_starts, edge_ends = fence, np.roll(fence, -1, axis=0)
    a, b = starts[:, np.newaxis], ends[:, np.newaxis]
    near = np.minimum(_to_segments(a, edge_starts, edge_ends), _to_segments(b, edge_starts, edge_ends))
    near = np.minimum(near, _to_segments(edge_starts, a, b))
    same_side = _turn(a, b, edge_starts) * _turn(a, b, edge_ends) > 0.0
    apart = same_side | (_turn(edge_starts, edge_ends, a) * _turn(edge_starts, edge_ends, b) > 0.0)
    return np.asarray(_within(starts, fence) & apart.all(axis=1) & (near.min(axis=1) >= margin_m))


def _within(points: Points, fence: Points) -> Flags:
    """Apply the even-odd rule: a ray to the east crosses the edges an odd number of times."""
    starts, ends = fence, np.roll(fence, -1, axis=0)
    east, north = points[..., :1], points[..., 1:]
    spans = (starts[:, 1] > north) != (ends[:, 1] > north)
    rise = np.where(ends[:, 1] == starts[:, 1], 1.0, ends[:, 1] - starts[:, 1])
    crossing = starts[:, 0] + (north - starts[:, 1]) / rise * (ends[:, 0] - starts[:, 0])
    return np.asarray(np.count_nonzero(spans & (crossing > east), axis=-1) % 2 == 1)


def _turn(start: Points, end: Points, point: Points) -> Points:
    """Compute the side of a point: positive to the left of the line from start to end."""
    along, to = end - start, point - start
    return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])


def _to_segments(points: Points, starts: Points, ends: Points) -> Points:
    """Measure distances of points to segments, all broadcast against each other."""
    along = ends - starts
    length2 = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    to = points - starts
    share = np.clip(np.sum(to * along, axis=-1) / length2, 0.0, 1.0)
    away = to - share[..., np.newaxis] * along
    return np.asarray(np.hypot(away[..., 0], away[..., 1]))
