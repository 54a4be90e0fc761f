"""Convert UTM coordinates of WGS 84 to latitude and longitude.

Series of L. Krueger, "Konforme Abbildung des Erdellipsoids in der Ebene" (1912), in the form of C. Karney, Journal of
Geodesy 85 (2011), to the fourth order of the third flattening: better than a millimetre within a zone.
"""

from __future__ import annotations

import math
from typing import Final

from auv_mcm.geometry.geodesy import FLATTENING, SEMI_MAJOR_M

_N: Final = FLATTENING / (2.0 - FLATTENING)  # third flattening
_SCALE: Final = 0.9996  # on the central meridian (UTM)
_FALSE_EASTING_M: Final = 500_000.0  # m (UTM)
_FALSE_NORTHING_M: Final = 10_000_000.0  # m, of the southern hemisphere (UTM)
_RADIUS_M: Final = SEMI_MAJOR_M / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0)
_BETA: Final = (
    _N / 2.0 - 2.0 * _N**2 / 3.0 + 37.0 * _N**3 / 96.0 - _N**4 / 360.0,
    _N**2 / 48.0 + _N**3 / 15.0 - 437.0 * _N**4 / 1440.0,
    17.0 * _N**3 / 480.0 - 37.0 * _N**4 / 840.0,
    4397.0 * _N**4 / 161_280.0,
)
_DELTA: Final = (
    2.0 * _N - 2.0 * _N**2 / 3.0 - 2.0 * _N**3 + 116.0 * _N**4 / 45.0,
    7.0 * _N**2 / 3.0 - 8.0 * _N**3 / 5.0 - 227.0 * _N**4 / 45.0,
    56.0 * _N**3 / 15.0 - 136.0 * _N**4 / 35.0,
    4279.0 * _N**4 / 630.0,
)


def utm_to_geodetic(easting_m: float, northing_m: float, zone: int, *, north: bool) -> tuple[float, float]:
    """Convert a position in a UTM zone (1 to 60) to latitude and longitude in degrees."""
    xi = (northing_m - (0.0 if north else _FALSE_NORTHING_M)) / (_SCALE * _RADIUS_M)
    eta = (easting_m - _FALSE_EASTING_M) / (_SCALE * _RADIUS_M)
    xi_on_sphere, eta_on_sphere = xi, eta
    for order, beta in enumerate(_BETA, 1):
        xi_on_sphere -= beta * math.sin(2 * order * xi) * math.cosh(2 * order * eta)
        eta_on_sphere -= beta * math.cos(2 * order * xi) * math.sinh(2 * order * eta)
    conformal = math.asin(math.sin(xi_on_sphere) / math.cosh(eta_on_sphere))
    latitude = conformal + sum(delta * math.sin(2 * order * conformal) for order, delta in enumerate(_DELTA, 1))
    longitude = math.atan2(math.sinh(eta_on_sphere), math.cos(xi_on_sphere))
    return math.degrees(latitude), math.degrees(longitude) + 6.0 * zone - 183.0
