"""Convert WGS-84 positions through Earth-centred coordinates: exact at the poles and across the antimeridian.

Degrees for latitude and longitude, metres for heights above the ellipsoid (below the surface: negative). All functions
work on arrays of any shape that broadcast and compute in float64; NaN in gives NaN out.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

SEMI_MAJOR_M: Final = 6378137.0  # m; with the flattening it defines the ellipsoid of WGS 84
FLATTENING: Final = 1.0 / 298.257223563  # of the ellipsoid of WGS 84
SEMI_MINOR_M: Final = SEMI_MAJOR_M * (1.0 - FLATTENING)
ECCENTRICITY_SQUARED: Final = FLATTENING * (2.0 - FLATTENING)
_SECOND_ECCENTRICITY_SQUARED: Final = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)


def wrap_longitude_deg(longitude_deg: ArrayLike) -> NDArray[np.float64]:
    """Wrap a longitude to [-180, 180); values already inside come back unchanged to the last bit."""
    longitude = np.asarray(longitude_deg, dtype=np.float64)
    if not longitude.size or (longitude.min() >= -180.0 and longitude.max() < 180.0):
        return longitude.copy()
    is_inside = (longitude >= -180.0) & (longitude < 180.0)
    wrapped = np.mod(longitude + 180.0, 360.0) - 180.0
    wrapped = np.where(wrapped >= 180.0, -180.0, wrapped)  # mod rounds up to 360 just below a multiple of it
    return np.where(is_inside, longitude, wrapped)


def geodetic_to_ecef(latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike) -> NDArray[np.float64]:
    """Convert to Earth-centred, Earth-fixed coordinates, (..., 3), metres."""
    latitude = np.deg2rad(np.asarray(latitude_deg, dtype=np.float64))
    longitude = np.deg2rad(np.asarray(longitude_deg, dtype=np.float64))
    height = np.asarray(height_m, dtype=np.float64)
    sine = np.sin(latitude)
    prime_vertical = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    from_axis = (prime_vertical + height) * np.cos(latitude)
    z = (prime_vertical * (1.0 - ECCENTRICITY_SQUARED) + height) * sine
    x, y = from_axis * np.cos(longitude), from_axis * np.sin(longitude)
    ecef = np.empty((*x.shape, 3))
    ecef[..., 0], ecef[..., 1], ecef[..., 2] = x, y, z
    return ecef


def ecef_to_geodetic(ecef_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Convert (..., 3) coordinates to latitude, longitude in [-180, 180) and height.

    Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (1976), repeated once, which is
    exact to rounding for all depths and heights on Earth. The height form has no division, so the poles need no branch.
    """
    ecef = np.asarray(ecef_m, dtype=np.float64)
    x, y, z = ecef[..., 0], ecef[..., 1], ecef[..., 2]
    from_axis = np.hypot(x, y)
    sine, cosine = _unit(z * SEMI_MAJOR_M, from_axis * SEMI_MINOR_M)
    for _ in range(2):
        rise = z + _SECOND_ECCENTRICITY_SQUARED * SEMI_MINOR_M * sine**3
        run = from_axis - ECCENTRICITY_SQUARED * SEMI_MAJOR_M * cosine**3
        # of the reduced latitude: tan(reduced) = b/a tan(latitude)
        sine, cosine = _unit(SEMI_MINOR_M * rise, SEMI_MAJOR_M * run)
    latitude = np.arctan2(rise, run)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    height = from_axis * cosine + z * sine - SEMI_MAJOR_M * np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    return np.rad2deg(latitude), wrap_longitude_deg(np.rad2deg(np.arctan2(y, x))), height


def local_to_ecef_rotation(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> NDArray[np.float64]:
    """Compute rotation matrices (..., 3, 3) whose columns are east, north and up in Earth-centred axes."""
    latitude, longitude = np.broadcast_arrays(
        np.deg2rad(np.asarray(latitude_deg, dtype=np.float64)), np.deg2rad(np.asarray(longitude_deg, dtype=np.float64))
    )
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    rotation = np.empty((*latitude.shape, 3, 3))
    rotation[..., 0, 0], rotation[..., 1, 0], rotation[..., 2, 0] = -sin_lon, cos_lon, 0.0
    rotation[..., 0, 1], rotation[..., 1, 1], rotation[..., 2, 1] = -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat
    rotation[..., 0, 2], rotation[..., 1, 2], rotation[..., 2, 2] = cos_lat * cos_lon, cos_lat * sin_lon, sin_lat
    return rotation


class LocalFrame(msgspec.Struct, frozen=True, kw_only=True):
    """Define east, north, up axes tangent to the ellipsoid at one origin."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def to_enu(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike) -> NDArray[np.float64]:
        """Convert geodetic positions to (..., 3) east, north, up in metres."""
        origin = geodetic_to_ecef(self.latitude_deg, self.longitude_deg, self.height_m)
        offset = geodetic_to_ecef(latitude_deg, longitude_deg, height_m) - origin
        return np.asarray(offset @ self.rotation(), dtype=np.float64)

    def to_geodetic(self, enu_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Convert (..., 3) east, north, up positions to latitude, longitude, height."""
        origin = geodetic_to_ecef(self.latitude_deg, self.longitude_deg, self.height_m)
        return ecef_to_geodetic(origin + np.asarray(enu_m, dtype=np.float64) @ self.rotation().T)

    def rotation(self) -> NDArray[np.float64]:
        """Give the rotation (3, 3): `ecef = rotation @ enu` for directions."""
        return local_to_ecef_rotation(self.latitude_deg, self.longitude_deg)


def _unit(rise: NDArray[np.float64], run: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute sine and cosine of the angle whose tangent is rise / run."""
    angle = np.arctan2(rise, run)
    return np.sin(angle), np.cos(angle)
