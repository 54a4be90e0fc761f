"""Views of solids by sampling them: slow, with no formula but each solid's height over a place of the floor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from auv_mcm.solids.shapes import Box, ConvexPolyhedron, Cylinder, Shape, SolidView, Sphere, TruncatedCone, Wedge

Array = NDArray[np.float64]


def reach_m(shape: Shape) -> float:
    """Horizontal distance within which all of the solid lies, with some room."""
    match shape:
        case Sphere():
            size = float(shape.radius_m)
        case Cylinder():
            size = float(np.hypot(shape.radius_m, 0.5 * shape.length_m))
        case TruncatedCone():
            size = float(shape.base_radius_m)
        case Box() | Wedge():
            size = float(0.5 * np.hypot(shape.length_m, shape.width_m))
        case ConvexPolyhedron():
            size = float(np.hypot(shape.vertices_m[:, 0], shape.vertices_m[:, 1]).max())
    return 1.01 * size


def height_m(shape: Shape) -> float:
    """Of the highest point over the floor."""
    match shape:
        case Sphere() | Cylinder():
            top = 2.0 * shape.radius_m
        case TruncatedCone() | Box() | Wedge():
            top = shape.height_m
        case ConvexPolyhedron():
            top = shape.vertices_m[:, 2].max()
    return float(top - shape.burial_m)


def extent_m(shape: Shape, along: Array, across: Array) -> tuple[Array, Array]:
    """Lowest and highest points of the solid over places of the floor, what is below the floor left out; inf and -inf
    beside it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        bottom, top = _whole_extent(shape, along, across)
        bottom, top = bottom - float(shape.burial_m), top - float(shape.burial_m)
        there = top >= np.maximum(bottom, 0.0)
    return np.where(there, np.maximum(bottom, 0.0), np.inf), np.where(there, top, -np.inf)


def _whole_extent(shape: Shape, along: Array, across: Array) -> tuple[Array, Array]:
    if isinstance(shape, Sphere | TruncatedCone):
        from_axis = np.hypot(along, across)
    else:
        sine, cosine = np.sin(shape.azimuth_rad), np.cos(shape.azimuth_rad)
        axial, lateral = along * cosine + across * sine, across * cosine - along * sine
    match shape:
        case Sphere():
            half = np.sqrt(shape.radius_m**2 - from_axis**2)
            return shape.radius_m - half, shape.radius_m + half
        case Cylinder():
            half = np.where(np.abs(axial) <= 0.5 * shape.length_m, np.sqrt(shape.radius_m**2 - lateral**2), np.nan)
            return shape.radius_m - half, shape.radius_m + half
        case TruncatedCone():
            side = shape.height_m * (shape.base_radius_m - from_axis) / (shape.base_radius_m - shape.top_radius_m)
            top = np.where(from_axis <= shape.top_radius_m, shape.height_m, side)
            return np.zeros(top.shape), np.where(from_axis <= shape.base_radius_m, top, np.nan)
        case Box() | Wedge():
            inside = (np.abs(axial) <= 0.5 * shape.length_m) & (np.abs(lateral) <= 0.5 * shape.width_m)
            rise = 1.0 if isinstance(shape, Box) else 0.5 + axial / shape.length_m
            return np.zeros(axial.shape), np.where(inside, shape.height_m * rise, np.nan)
        case ConvexPolyhedron():
            bottom, top = np.full(axial.shape, -np.inf), np.full(axial.shape, np.inf)
            for normal_along, normal_across, normal_up, shift in ConvexHull(shape.vertices_m).equations:
                rest = normal_along * axial + normal_across * lateral + shift
                if normal_up > 1e-12:
                    top = np.minimum(top, -rest / normal_up)
                elif normal_up < -1e-12:
                    bottom = np.maximum(bottom, -rest / normal_up)
                else:
                    top = np.where(rest <= 0.0, top, np.nan)
            return bottom, top


def sampled_view(
    shape: Shape,
    offset: Array,
    ground_range: float,
    altitude: float,
    *,
    slope_rad: float = 0.0,
    squint_rad: float = 0.0,
) -> SolidView:
    """View from the points of each slice with the greatest elevation and the least distance, sampled ever more densely
    around them.

    offset: (n_pings,). A slope and a squint are not meant to be given together. NaN where no sample meets the solid.
    """
    centre = (ground_range * np.cos(squint_rad) - offset * np.sin(squint_rad)) / np.cos(slope_rad)

    def points(along_slice: Array) -> tuple[Array, Array, Array]:
        """Ground range, and heights of the solid's lowest and highest points, at distances along the floor in the
        slice."""
        along = offset[:, np.newaxis] + along_slice * np.sin(squint_rad)
        across = along_slice * np.cos(squint_rad) - ground_range / np.cos(slope_rad)
        return (along_slice, *extent_m(shape, along, across))

    def tilted(along_slice: Array, height: Array) -> tuple[Array, Array]:
        """Horizontal and vertical coordinates of what is that high over a sloping floor."""
        return (
            along_slice * np.cos(slope_rad) - height * np.sin(slope_rad),
            along_slice * np.sin(slope_rad) + height * np.cos(slope_rad),
        )

    def elevation(along_slice: Array) -> Array:
        _, _, top = points(along_slice)
        y, z = tilted(along_slice, np.where(np.isfinite(top), top, 0.0))
        return np.where(np.isfinite(top), np.arctan2(z - altitude, y), -np.inf)

    def nearness(along_slice: Array) -> Array:
        _, bottom, top = points(along_slice)
        there = np.isfinite(top)
        bottom, top = np.where(there, bottom, 0.0), np.where(there, top, 0.0)
        perpendicular = altitude * np.cos(slope_rad)  # the nearest point of a line that stands upright on the slope
        y, z = tilted(along_slice, np.clip(perpendicular, bottom, top))
        return np.where(there, -np.hypot(y, z - altitude), -np.inf)

    highest = _zoom(elevation, centre, reach_m(shape) / np.cos(slope_rad))
    _, _, top = points(highest[:, np.newaxis])
    hit = np.isfinite(top[:, 0])
    y, z = tilted(highest, np.where(hit, top[:, 0], 0.0))
    fall = altitude - z + y * np.tan(slope_rad)
    shadow_end = np.where(fall > 0.0, altitude * y / np.where(fall > 0.0, fall, 1.0), np.inf)
    front = -nearness(_zoom(nearness, centre, reach_m(shape) / np.cos(slope_rad))[:, np.newaxis])[:, 0]
    return SolidView(
        np.where(hit, front, np.nan),
        np.where(hit, np.hypot(y, z - altitude), np.nan),
        np.where(hit, shadow_end, np.nan),
    )


def sampled_parallel_end_m(shape: Shape, offset: Array, cotangent: float) -> Array:
    """How far behind the object's place the shadow of parallel rays ends; NaN where no sample meets the solid."""

    def end(across: Array) -> Array:
        return across + cotangent * extent_m(shape, np.broadcast_to(offset[:, np.newaxis], across.shape), across)[1]

    ends = end(_zoom(end, np.zeros(offset.shape), reach_m(shape))[:, np.newaxis])[:, 0]
    return np.where(np.isfinite(ends), ends, np.nan)


def _zoom(objective: Callable[[Array], Array], centre: Array, half_width: float) -> Array:
    """Where the objective, with one maximum, is greatest: samples at 1/2000 of the half width, then four times 1/100 of
    that."""
    best, width = centre, half_width
    for n_samples in (4001, 201, 201, 201, 201, 201):
        places = best[:, np.newaxis] + width * np.linspace(-1.0, 1.0, n_samples)
        best = places[np.arange(best.size), objective(places).argmax(axis=1)]
        width *= 2.0 / (n_samples - 1)
    return best
