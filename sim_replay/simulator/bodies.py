"""Tabulate bodies on the sea floor: height and slope over any place, and the direction their walls face.

A body is seen from above as a height field: what hangs over is filled down to the floor, which neither shadows nor
first echoes show. Its axes: u along its azimuth, v to the right of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

BODY_WIDTH: Final = 20  # numbers per body; equal in C
ELLIPSOID, CYLINDER, CONE, POLYHEDRON, TORUS, SCAR, MOAT = range(7)
MOVES_FLOOR: Final = SCAR  # this kind and those after it move the floor instead of standing on it

Floats: TypeAlias = NDArray[np.float64]
Tops: TypeAlias = tuple[Floats, Floats, Floats, NDArray[np.bool_]]
Planes: TypeAlias = tuple[tuple[float, float, float], ...]


class Body(NamedTuple):
    """Describe one body.

    `kind` and `sizes` are as the builders below make them; `planes`: a polyhedron's sides, then tops.
    """

    kind: int
    east_m: float
    north_m: float
    base_m: float
    azimuth_rad: float
    reach_m: float
    sizes: tuple[float, ...]
    material: int = 0
    planes: Planes = ()
    n_sides: int = 0


class Bodies(NamedTuple):
    """Pack bodies for the renderer.

    table: (n_bodies, 20) float64, columns as in bodies.h. planes: (n_planes, 3) float64.
    """

    table: Floats
    planes: Floats


def pack(bodies: Sequence[Body]) -> Bodies:
    """Tabulate `bodies`, those that move the floor first so that all others stand on the moved floor."""
    ordered = sorted(bodies, key=lambda body: body.kind < MOVES_FLOOR)
    table = np.zeros((len(ordered), BODY_WIDTH))
    planes: list[tuple[float, float, float]] = []
    for row, body in zip(table, ordered, strict=True):
        row[:8] = (
            body.kind,
            body.east_m,
            body.north_m,
            body.reach_m,
            math.sin(body.azimuth_rad),
            math.cos(body.azimuth_rad),
            body.base_m,
            body.material,
        )
        row[8 : 8 + len(body.sizes)] = body.sizes
        row[13:16] = len(planes), body.n_sides, len(body.planes) - body.n_sides
        planes.extend(body.planes)
    return Bodies(table, np.array(planes, dtype=np.float64).reshape(-1, 3))


def near(bodies: Bodies, low_east_m: float, high_east_m: float, low_north_m: float, high_north_m: float) -> Bodies:
    """Return the bodies that reach into a rectangle."""
    table = bodies.table
    east, north, reach = table[:, 1], table[:, 2], table[:, 3]
    inside = (
        (east + reach > low_east_m)
        & (east - reach < high_east_m)
        & (north + reach > low_north_m)
        & (north - reach < high_north_m)
    )
    return Bodies(np.ascontiguousarray(table[inside]), bodies.planes)


def body_tops(b: Floats, planes: Floats, u: Floats, v: Floats) -> Tops:
    """Return height over the base, slopes along u and v, and coverage at (n,) places.

    b: (20,) row of the table.

    The numpy twin of body_top in bodies.h.
    """
    kind = int(b[0])
    if kind == POLYHEDRON:
        first, n_sides, n_tops = (int(value) for value in b[13:16])
        last = first + n_sides
        return _polyhedron_tops(planes[first:last], planes[last : last + n_tops], u, v)
    return _TOPS[kind]([float(value) for value in b[8:13]], u, v)


def _ellipsoid_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, p3, _ = sizes
    top, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    s, t = u / p0, v / p1
    inside = 1.0 - s * s - t * t
    covered = inside > 0.0
    root = np.sqrt(inside[covered])
    top[covered] = p3 + p2 * root
    slope_u[covered] = -p2 * s[covered] / (p0 * root)
    slope_v[covered] = -p2 * t[covered] / (p1 * root)
    return top, slope_u, slope_v, covered


def _cylinder_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, p3, p4 = sizes
    top, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    inside = p0 * p0 - v * v
    root = np.sqrt(np.where(inside > 0.0, inside, 1.0))
    rise, half = p3 / p4, root / p4
    z = u * rise + half
    along = u * p4 + z * p3
    lying = (inside > 0.0) & (along <= p1) & (along >= -p1)
    top[lying], slope_u[lying] = p2 + z[lying], rise
    slope_v[lying] = -v[lying] / (root[lying] * p4)
    if p3 <= 0.0:
        return top, slope_u, slope_v, lying
    end = (p1 - u * p4) / p3
    ending = (inside > 0.0) & (along > p1) & (end >= u * rise - half)
    top[ending], slope_u[ending] = p2 + end[ending], -p4 / p3
    return top, slope_u, slope_v, lying | ending


def _cone_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, p3, _ = sizes
    top, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    across = np.sqrt(u * u + v * v)
    flat, side = across <= p1, (across > p1) & (across < p0)
    top[flat] = p2 - p3
    if side.any():
        steep = p2 / (p0 - p1)
        top[side] = (p0 - across[side]) * steep - p3
        slope_u[side] = -steep * u[side] / across[side]
        slope_v[side] = -steep * v[side] / across[side]
    return top, slope_u, slope_v, flat | side


def _polyhedron_tops(sides: Floats, tops: Floats, u: Floats, v: Floats) -> Tops:
    top, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    covered = np.ones(u.shape, dtype=np.bool_)
    for plane in sides:
        covered &= ~(plane[0] * u + plane[1] * v > plane[2])
    for k, plane in enumerate(tops):
        z = plane[0] * u + plane[1] * v + plane[2]
        lower = np.ones(u.shape, dtype=np.bool_) if k == 0 else z < top
        top[lower], slope_u[lower], slope_v[lower] = z[lower], plane[0], plane[1]
    return top, slope_u, slope_v, covered


def _torus_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, p3, _ = sizes
    top, slope_u, slope_v = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    across = np.sqrt(u * u + v * v)
    w = (across - p0) / p1
    inside = 1.0 - w * w
    covered = (inside > 0.0) & (across > 0.0)
    root = np.sqrt(inside[covered])
    steep = -p2 * w[covered] / (p1 * root)
    top[covered] = p3 + p2 * root
    slope_u[covered], slope_v[covered] = steep * u[covered] / across[covered], steep * v[covered] / across[covered]
    return top, slope_u, slope_v, covered


def _scar_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, _, _ = sizes
    s, t = u / p0, v / p1
    along, across = 1.0 - s * s, 1.0 - t * t
    end, ramp = np.where(along < 0.19, along / 0.19, 1.0), np.where(along < 0.19, -2.0 * s / (0.19 * p0), 0.0)
    shape = across * across * (1.0 - 6.0 * t * t)
    steep = -4.0 * t * across * (1.0 - 6.0 * t * t) - 12.0 * t * across * across
    return -p2 * end * shape, -p2 * ramp * shape, -p2 * end * steep / p1, (along > 0.0) & (across > 0.0)


def _moat_tops(sizes: list[float], u: Floats, v: Floats) -> Tops:
    p0, p1, p2, p3, _ = sizes
    s, t = u / p0, v / p1
    across = np.sqrt(s * s + t * t)
    w = (across - 1.0) / p3
    inside = 1.0 - w * w
    covered = (inside > 0.0) & (across > 0.0)
    steep = 4.0 * p2 * w * inside / (p3 * np.where(covered, across, 1.0))
    return -p2 * inside * inside, steep * s / p0, steep * t / p1, covered


_TOPS: Final[dict[int, Callable[[list[float], Floats, Floats], Tops]]] = {
    ELLIPSOID: _ellipsoid_tops,
    CYLINDER: _cylinder_tops,
    CONE: _cone_tops,
    TORUS: _torus_tops,
    SCAR: _scar_tops,
    MOAT: _moat_tops,
}
"""The tops of each kind by its sizes, columns 8 to 12 of its row, at places (u, v)."""


def body_wall(b: Floats, planes: Floats, u: float, v: float) -> tuple[float, float]:
    """Return the horizontal normal (u, v), of any length, of the wall next to a place outside of the body.

    It is the numpy twin of body_wall in bodies.h.
    """
    kind = int(b[0])
    if kind == ELLIPSOID:
        return u / float(b[8] * b[8]), v / float(b[9] * b[9])
    if kind == CYLINDER:
        return (u, 0.0) if abs(u) - float(b[9]) > abs(v) - float(b[8]) else (0.0, v)
    if kind == POLYHEDRON:
        first, n_sides = int(b[13]), int(b[14])
        sides = planes[first : first + n_sides]
        outside = sides[:, 0] * u + sides[:, 1] * v - sides[:, 2]
        normal = sides[int(np.argmax(outside))]
        return float(normal[0]), float(normal[1])
    return u, v
