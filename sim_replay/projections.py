"""Project longitude and latitude for a map that people ask for: UTM or any projected EPSG code in metres."""

from __future__ import annotations

import math
import re
from bisect import bisect
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import wrap_longitude_deg

if TYPE_CHECKING:
    from pyproj import Transformer

Array: TypeAlias = NDArray[np.float64]

UTM: Final = "utm"
_EPSG: Final = re.compile(r"(?:EPSG:)?([0-9]{4,5})", re.IGNORECASE)
_SAME_DEG: Final = 1e-5  # between a place and where it comes back from the map: a metre (chosen)
_NORTH, _SOUTH = 32600, 32700  # EPSG codes of UTM zone 0 on WGS 84, north and south


class Projection(NamedTuple):
    """Hold a projection. project: takes longitude and latitude, degrees; gives easting and northing, m."""

    epsg: int
    project: Callable[[Array, Array], tuple[Array, Array]]


def check_crs(text: str) -> str:
    """Check the name of a projection before anything is read. Raises UsageError."""
    if text.lower() == UTM:
        return UTM
    _ = projection(text, math.nan, math.nan)
    return text


def projection(text: str, longitude_deg: float, latitude_deg: float) -> Projection:
    """Find a projection by name.

    Parameters
    ----------
    text
        "utm" for the zone of the place, or the code of a projected reference system in metres, as EPSG:25832.
    longitude_deg, latitude_deg
        Where the mission began; NaN where that is not known yet.

    Raises
    ------
    UsageError
        For a name that is none, a system that is not projected in metres to the east and the north, or a place that it
        does not map.
    """
    if text.lower() == UTM:
        epsg = (_NORTH if latitude_deg >= 0.0 else _SOUTH) + _utm_zone(longitude_deg, latitude_deg)
    else:
        found = _EPSG.fullmatch(text)
        if found is None:
            raise UsageError(f"--crs '{text}' is no reference system. Name one as EPSG:25832, or give utm")
        epsg = int(found[1])
    transformer = _transformer(text, epsg)

    def project(longitude: Array, latitude: Array) -> tuple[Array, Array]:
        east_m, north_m = transformer.transform(longitude, latitude)
        return np.asarray(east_m, dtype=np.float64), np.asarray(north_m, dtype=np.float64)

    if math.isfinite(longitude_deg):
        back_deg = transformer.transform(*transformer.transform(longitude_deg, latitude_deg), direction="INVERSE")
        away_deg = np.subtract(back_deg, (longitude_deg, latitude_deg))
        if not abs(away_deg[1]) < _SAME_DEG or not abs(wrap_longitude_deg(away_deg[0])) < _SAME_DEG:
            raise UsageError(
                f"--crs {text}: the mission, at {latitude_deg:.4f}, {longitude_deg:.4f} degrees, is outside of what it "
                "can map. Name another, or give utm"
            )
    return Projection(epsg, project)


def _utm_zone(longitude_deg: float, latitude_deg: float) -> int:
    """Find the zone of UTM, whose borders are others off southern Norway and about Svalbard."""
    longitude_deg = float(wrap_longitude_deg(longitude_deg))
    if 56.0 <= latitude_deg < 64.0 and 3.0 <= longitude_deg < 6.0:
        return 32
    if latitude_deg >= 72.0 and 0.0 <= longitude_deg < 42.0:
        return 31 + 2 * bisect((9.0, 21.0, 33.0), longitude_deg)
    return min(math.floor((longitude_deg + 180.0) / 6.0), 59) + 1


def _transformer(text: str, epsg: int) -> Transformer:
    """Find what projects onto a system in metres to the east and the north. Raises UsageError."""
    from pyproj import CRS, Transformer  # bench extra
    from pyproj.exceptions import CRSError, ProjError

    try:
        system = CRS.from_epsg(epsg)
    except CRSError as error:
        raise UsageError(f"--crs {text}: there is no EPSG code {epsg}. Look it up at epsg.org, or give utm") from error
    axes = system.axis_info
    if not system.is_projected or any(axis.unit_name != "metre" for axis in axes):
        raise UsageError(f"--crs {text}: '{system.name}' is not projected in metres. Name another, or give utm")
    if len(axes) != 2 or any(axis.direction == "west" for axis in axes):
        raise UsageError(
            f"--crs {text}: '{system.name}' does not count metres to the east and to the north alone. Name another, or "
            "give utm"
        )
    try:
        return Transformer.from_crs(4326, epsg, always_xy=True)
    except ProjError as error:
        raise UsageError(f"--crs {text}: '{system.name}' is no single projection. Name another, or give utm") from error
