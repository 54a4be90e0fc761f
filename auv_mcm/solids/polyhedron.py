"""Compute the vertical slices of convex polyhedra that single pings see: polygons with corners on the edges.

Coordinates as in `slices`. Leading axes of vertices are hypotheses and broadcast against the pings.
"""

from __future__ import annotations

import functools
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.solids.slices import Array, Slice

Faces: TypeAlias = tuple[tuple[int, ...], ...]


class _Incidence(NamedTuple):
    """Hold which edges and faces meet.

    edges: (n_edges, 2) vertices they join; share_face: (n_edges, n_edges) bool, whether two have a face in common.
    """

    edges: NDArray[np.intp]
    share_face: NDArray[np.bool_]


def polyhedron_slice(vertices: Array, faces: Faces, offset: Array, ground_range: Array, altitude: Array) -> Slice:
    """Compute the slice of a convex polyhedron above the floor.

    A side of the polygon lies in a face and joins the crossings of two of its edges. All pairs of edges of a face are
    taken: those that are not sides lie within the polygon and change neither the farthest nor the nearest point.

    Parameters
    ----------
    vertices
        (..., n_vertices, 3) along-track and across-track from the object's place, and height.
    faces
        Indices of their vertices in circular order.
    offset, ground_range, altitude
        Arrays that broadcast against the leading axes of the vertices.
    """
    incidence = _incidence(faces)
    shape = np.broadcast_shapes(vertices.shape[:-2], offset.shape, ground_range.shape, altitude.shape)
    corners = np.moveaxis(vertices, (-2, -1), (0, 1))
    corners = corners.reshape(corners.shape[:2] + (1,) * (len(shape) - corners.ndim + 2) + corners.shape[2:])
    start, end = corners[incidence.edges[:, 0]], corners[incidence.edges[:, 1]]
    run = end[:, 0] - start[:, 0]
    crosses = (
        (np.minimum(start[:, 0], end[:, 0]) <= offset) & (offset <= np.maximum(start[:, 0], end[:, 0])) & (run != 0.0)
    )
    part = np.divide(offset - start[:, 0], run, out=np.zeros(crosses.shape), where=crosses)
    y = np.broadcast_to(ground_range, shape) + start[:, 1] + part * (end[:, 1] - start[:, 1])
    z = start[:, 2] + part * (end[:, 2] - start[:, 2])

    crosses, y, z = np.broadcast_arrays(crosses, y, z)
    # A plane crosses few of the edges: those come first, the others are left out.
    n_crossed = max(int(crosses.sum(axis=0).max(initial=0)), 2)
    order = np.argsort(~crosses, axis=0, kind="stable")[:n_crossed]
    crosses, y, z = (np.take_along_axis(each, order, axis=0) for each in (crosses, y, z))
    first, second = np.triu_indices(n_crossed, 1)
    sides = crosses[first] & crosses[second] & incidence.share_face[order[first], order[second]]
    y0, z0, y1, z1 = y[first], z[first], y[second], z[second]
    # the floor cuts sides, and the new corners are farther out than what remains of the old ones
    if np.any(corners[:, 2] < 0.0):
        sides = sides & (np.maximum(z0, z1) >= 0.0)
        (y0, z0), (y1, z1) = _raised_to_floor(y0, z0, y1, z1), _raised_to_floor(y1, z1, y0, z0)
        y, z, crosses = np.concatenate((y0, y1)), np.concatenate((z0, z1)), np.concatenate((sides, sides))
    nearest = np.sqrt(np.where(sides, _square_distance(y0, z0, y1, z1, altitude), np.inf).min(axis=0))
    near = np.where(crosses, y, np.inf).min(axis=0)
    elevation = np.divide(z - altitude, y, out=np.full(y.shape, -np.inf), where=crosses & (y > 0.0))
    highest = elevation.max(axis=0)
    tangent = np.where(elevation == highest, y, -np.inf).max(axis=0)
    hit = crosses.any(axis=0)
    tangent_height = altitude + np.where(np.isfinite(highest), highest, 0.0) * np.where(hit, tangent, 0.0)
    return Slice(*(np.where(hit, result, np.nan) for result in (near, nearest, tangent, tangent_height)))


def require_convex(vertices: Array, faces: Faces) -> None:
    """Check that the faces are plane, close the surface, and have all vertices on one side. Raises ValueError."""
    n_vertices = vertices.shape[-2]
    if vertices.shape[-1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices_m must be finite and of shape (..., n_vertices, 3), got shape {vertices.shape}")
    if any(len(face) < 3 or not all(0 <= index < n_vertices for index in face) for face in faces):
        raise ValueError(f"every face needs three or more indices below {n_vertices}, got {faces}")
    sides = [frozenset(side) for face in faces for side in _sides(face)]
    open_sides = {tuple(sorted(side)) for side in sides if sides.count(side) != 2}
    if open_sides or not faces:
        raise ValueError(
            f"faces must close the surface: edges {sorted(open_sides)} do not belong to exactly two of them"
        )
    size = np.ptp(vertices, axis=-2).max(axis=-1, keepdims=True)
    for face in faces:
        corner = vertices[..., face[0], :]
        normal = np.cross(vertices[..., face[1], :] - corner, vertices[..., face[2], :] - corner)
        distance = np.einsum("...vc,...c->...v", vertices - corner[..., np.newaxis, :], normal)
        scale = 1e-9 * size * np.linalg.norm(normal, axis=-1, keepdims=True)
        on_one_side = (distance <= scale).all(axis=-1) | (distance >= -scale).all(axis=-1)
        plane = (np.abs(distance[..., list(face)]) <= scale).all(axis=-1)
        if not (on_one_side & plane & (scale[..., 0] > 0.0)).all():
            raise ValueError(
                f"face {face} must be plane with all vertices on one side of it, as faces of a convex solid are"
            )


@functools.cache
def _incidence(faces: Faces) -> _Incidence:
    edges = {
        frozenset(side): index
        for index, side in enumerate({frozenset(side): side for face in faces for side in _sides(face)})
    }
    share_face = np.zeros((len(edges), len(edges)), dtype=np.bool_)
    for face in faces:
        around = [edges[frozenset(side)] for side in _sides(face)]
        share_face[np.ix_(around, around)] = True
    return _Incidence(np.array([sorted(edge) for edge in edges], dtype=np.intp), share_face)


def _sides(face: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(zip(face, face[1:] + face[:1], strict=True))


def _raised_to_floor(y: Array, z: Array, other_y: Array, other_z: Array) -> tuple[Array, Array]:
    """Raise a point below the floor to where its line to another point above the floor leaves the floor."""
    below = (z < 0.0) & (other_z >= 0.0)
    part = np.divide(z, z - other_z, out=np.zeros(z.shape), where=below)
    return y + part * (other_y - y), np.where(below, 0.0, z)


def _square_distance(y0: Array, z0: Array, y1: Array, z1: Array, altitude: Array) -> Array:
    """Compute the squared distance of the sonar from the line between two points."""
    run, rise = y1 - y0, z1 - z0
    square = run * run + rise * rise
    part = np.divide((altitude - z0) * rise - y0 * run, square, out=np.zeros(square.shape), where=square > 0.0)
    part = np.clip(part, 0.0, 1.0)
    across, up = y0 + part * run, altitude - z0 - part * rise
    return np.asarray(across * across + up * up, dtype=np.float64)
