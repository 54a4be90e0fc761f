"""Compute highlight and shadow of simple solids on the sea floor, in closed form for every ping.

A side-scan sonar is a push-broom camera: each ping sees only the vertical slice of the world across its track, so the
shadow is a perspective across the track and a parallel projection along it. A point at ground range y and height z
casts its shadow to H y / (H - z). Treating all rays as parallel instead, as if the sonar were far away, moves the
shadow's end by decimetres at 5 m altitude.

Solids lie or stand on a plane floor, pushed into it by burial_m; what is below the floor is neither seen nor throws a
shadow. Every field of a solid may be an array: fields, pings and altitudes broadcast, so hypotheses (n, 1) times pings
(m,) give (n, m) in one call.

Frame of an object: along-track, across-track to the side looked at, up. azimuth_rad turns its long axis from
along-track to across-track. On the port side that is counter-clockwise seen from above, which matters for solids
without a plane of symmetry only.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias, assert_never

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.solids.polyhedron import Faces, polyhedron_slice, require_convex
from auv_mcm.solids.slices import Array, Slice, cone_slice, cylinder_slice, sphere_slice

Real: TypeAlias = float | NDArray[np.float64]


class Sphere(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a sphere. The centre is at radius_m - burial_m over the floor."""

    radius_m: Real
    burial_m: Real = 0.0

    def __post_init__(self) -> None:
        _require_positive(self, "radius_m")
        _require_not_negative(self, "burial_m")


class Cylinder(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a lying cylinder with flat ends.

    The axis is at radius_m - burial_m over the floor. A length of 0 is an upright disc.
    """

    radius_m: Real
    length_m: Real
    azimuth_rad: Real = 0.0
    burial_m: Real = 0.0

    def __post_init__(self) -> None:
        _require_positive(self, "radius_m")
        _require_not_negative(self, "length_m", "burial_m")


class TruncatedCone(msgspec.Struct, frozen=True, kw_only=True):
    """Describe an upright cone, no wider at the top than at its base.

    With equal radii it is an upright cylinder, with top_radius_m 0 a cone.
    """

    base_radius_m: Real
    top_radius_m: Real
    height_m: Real
    burial_m: Real = 0.0

    def __post_init__(self) -> None:
        _require_positive(self, "base_radius_m", "height_m")
        _require_not_negative(self, "top_radius_m", "burial_m")
        if np.any(np.asarray(self.top_radius_m) > np.asarray(self.base_radius_m)):
            raise ValueError(f"top_radius_m {self.top_radius_m} must not exceed base_radius_m {self.base_radius_m}")


class _Upright(msgspec.Struct, frozen=True, kw_only=True):
    length_m: Real
    width_m: Real
    height_m: Real
    azimuth_rad: Real = 0.0
    burial_m: Real = 0.0

    def __post_init__(self) -> None:
        _require_positive(self, "length_m", "width_m", "height_m")
        _require_not_negative(self, "burial_m")


class Box(_Upright, frozen=True, kw_only=True):
    """Describe an upright box; length_m is along the azimuth."""


class Wedge(_Upright, frozen=True, kw_only=True):
    """Describe a ramp: its top rises from the floor to height_m along the azimuth and ends in a vertical face."""


class ConvexPolyhedron(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a convex polyhedron.

    vertices_m: (..., n_vertices, 3) float64 in the object's frame at azimuth 0 and without burial. faces: the indices
    of each face's vertices in circular order.
    """

    vertices_m: NDArray[np.float64]
    faces: Faces
    azimuth_rad: Real = 0.0
    burial_m: Real = 0.0

    def __post_init__(self) -> None:
        _require_not_negative(self, "burial_m")
        require_convex(np.asarray(self.vertices_m, dtype=np.float64), self.faces)


Shape: TypeAlias = Sphere | Cylinder | TruncatedCone | Box | Wedge | ConvexPolyhedron


class SolidView(NamedTuple):
    """Hold what pings see of a solid: float64 arrays of the broadcast shape, NaN where a slice misses it.

    front_slant_range_m: of its nearest point, where the highlight begins; on the image it lies before the object's
    foot. tangent_slant_range_m: of the last point lit, which the ray along the shadow's far end touches. A ray that
    grazes along an edge or face touches everywhere on it; then it is some point of that. The echo of the floor before
    the object's foot may come later. shadow_end_m: ground range at which the shadow ends; infinite if the solid is as
    high as the sonar or higher.
    """

    front_slant_range_m: Array
    tangent_slant_range_m: Array
    shadow_end_m: Array


def view_shape(
    shape: Shape,
    along_track_offset_m: ArrayLike,
    ground_range_m: ArrayLike,
    altitude_m: ArrayLike,
    *,
    slope_rad: ArrayLike = 0.0,
    squint_rad: ArrayLike = 0.0,
) -> SolidView:
    """Compute the view of a solid by pings.

    Ground ranges of the result are then along the squinted slice.

    Parameters
    ----------
    along_track_offset_m
        Of the ping from the object's place, positive after it has passed.
    ground_range_m
        Of that place from the track.
    altitude_m
        Of the sonar over the floor vertically below it. All broadcast; NaN in any of them gives NaN.
    slope_rad
        Of the floor within the slice, positive if it rises away from the track; the solid stands perpendicular to it.
    squint_rad
        By which the slices are turned forward from broadside, as in parts of a synthetic aperture.

    Raises
    ------
    ValueError
        If an altitude is not positive, a slope is vertical, or a slice of the solid reaches back to the point of the
        floor nearest to the sonar: beyond it, sonar and shadow would be on different sides.
    """
    offset, ground_range, altitude, slope, squint = (
        np.asarray(value, dtype=np.float64)
        for value in (along_track_offset_m, ground_range_m, altitude_m, slope_rad, squint_rad)
    )
    _check_water(altitude, slope)
    across, along = np.sin(squint), np.cos(squint)
    offset, ground_range = offset * along + ground_range * across, ground_range * along - offset * across

    # On a slope the slice is a flat floor's, turned about the sonar: the foot of the perpendicular takes the place of
    # the nadir.
    foot = altitude * np.sin(slope)
    altitude = altitude * np.cos(slope)
    seen = _slice(shape, squint, offset, ground_range / np.cos(slope) - foot, altitude)
    if np.any(seen.near_m <= 0.0):
        raise ValueError(
            f"an object reaches to {np.nanmin(seen.near_m):.3f} m from the point of the floor nearest to the sonar; "
            "its whole slice must lie beyond that point on the side viewed: place it farther away"
        )
    below = seen.tangent_height_m < altitude
    reach = np.divide(
        altitude * seen.tangent_m, altitude - seen.tangent_height_m, out=np.full(below.shape, np.inf), where=below
    )
    return SolidView(
        front_slant_range_m=seen.front_slant_range_m,
        tangent_slant_range_m=np.hypot(seen.tangent_m, altitude - seen.tangent_height_m),
        shadow_end_m=np.where(np.isnan(seen.tangent_m), np.nan, (reach + foot) * np.cos(slope)),
    )


def _check_water(altitude: Array, slope: Array) -> None:
    """Raise ValueError unless the sonar is above a floor that it can look along."""
    if np.any(altitude <= 0.0):
        raise ValueError(
            f"altitude_m must be positive, got {np.nanmin(altitude):g}: leave out pings without a known altitude"
        )
    if np.any(np.abs(slope) >= 0.5 * np.pi):
        raise ValueError(
            f"slope_rad must be between -pi/2 and pi/2, got {slope.ravel()[np.nanargmax(np.abs(slope))]:g}"
        )


def flat_ground_range_m(slant_range_m: ArrayLike, altitude_m: ArrayLike) -> Array:
    """Compute ground range float64 over a flat floor; 0 for r < H.

    sqrt((r - H)(r + H)) keeps its digits near nadir.
    """
    slant_range, altitude = np.asarray(slant_range_m, dtype=np.float64), np.asarray(altitude_m, dtype=np.float64)
    return np.asarray(np.sqrt(np.maximum((slant_range - altitude) * (slant_range + altitude), 0.0)), dtype=np.float64)


# Corners in units of length, width and height; the face lists go round each face.
_BOX_CORNERS: Final = np.array(
    [(x, y, z) for z in (0.0, 1.0) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
)
_BOX_FACES: Final[Faces] = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_WEDGE_CORNERS: Final = np.concatenate((_BOX_CORNERS[:4], _BOX_CORNERS[5:7]))
_WEDGE_FACES: Final[Faces] = ((0, 1, 2, 3), (1, 2, 5, 4), (0, 3, 5, 4), (0, 1, 4), (3, 2, 5))


def _slice(shape: Shape, turn: Array, offset: Array, ground_range: Array, altitude: Array) -> Slice:
    burial = np.asarray(shape.burial_m, dtype=np.float64)
    match shape:
        case Sphere():
            radius = np.asarray(shape.radius_m, dtype=np.float64)
            return sphere_slice(radius, radius - burial, offset, ground_range, altitude)
        case Cylinder():
            radius, length = np.asarray(shape.radius_m, dtype=np.float64), np.asarray(shape.length_m, dtype=np.float64)
            return cylinder_slice(
                radius, length, shape.azimuth_rad + turn, radius - burial, offset, ground_range, altitude
            )
        case TruncatedCone():
            base, top, height = (
                np.asarray(value, dtype=np.float64)
                for value in (shape.base_radius_m, shape.top_radius_m, shape.height_m)
            )
            return cone_slice(
                base - (base - top) * (burial / height), top, height - burial, offset, ground_range, altitude
            )
        case Box() | Wedge():
            size = np.stack(np.broadcast_arrays(shape.length_m, shape.width_m, shape.height_m), axis=-1)[
                ..., np.newaxis, :
            ]
            corners, faces = (_BOX_CORNERS, _BOX_FACES) if isinstance(shape, Box) else (_WEDGE_CORNERS, _WEDGE_FACES)
            placed = _placed(size * corners, shape.azimuth_rad + turn, burial)
            return polyhedron_slice(placed, faces, offset, ground_range, altitude)
        case ConvexPolyhedron():
            vertices = np.asarray(shape.vertices_m, dtype=np.float64)
            return polyhedron_slice(
                _placed(vertices, shape.azimuth_rad + turn, burial), shape.faces, offset, ground_range, altitude
            )
        case _:
            assert_never(shape)


def _placed(vertices: Array, azimuth: Array, burial: Array) -> Array:
    """Turn vertices (..., n_vertices, 3) by the azimuth and lower them by the burial.

    Both broadcast against the leading axes.
    """
    cosine, sine = np.cos(azimuth)[..., np.newaxis], np.sin(azimuth)[..., np.newaxis]
    along, across, up = vertices[..., 0], vertices[..., 1], vertices[..., 2]
    turned = (along * cosine - across * sine, along * sine + across * cosine, up - burial[..., np.newaxis])
    return np.stack(np.broadcast_arrays(*turned), axis=-1)


def _require_positive(shape: msgspec.Struct, *fields: str) -> None:
    for field in fields:
        value = getattr(shape, field)
        if not (value > 0.0 if isinstance(value, float) else np.all(np.asarray(value) > 0.0)):
            raise ValueError(f"{field} of a {type(shape).__name__} must be positive, got {getattr(shape, field)}")


def _require_not_negative(shape: msgspec.Struct, *fields: str) -> None:
    for field in fields:
        value = getattr(shape, field)
        if not (value >= 0.0 if isinstance(value, float) else np.all(np.asarray(value) >= 0.0)):
            raise ValueError(f"{field} of a {type(shape).__name__} must not be negative, got {getattr(shape, field)}")
