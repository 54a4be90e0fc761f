"""Write GeoJSON (RFC 7946): a feature a line, keys in a fixed order, numbers rounded to what they can mean.

An unknown number is `null`. 1e-9 degrees is 0.1 mm.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import wrap_longitude_deg

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | None"

DEGREE_DIGITS: Final = 9  # decimals of a degree: 0.1 mm, below the 1 mm that platforms agree to
METRE_DIGITS: Final = 3  # decimals of a metre: 1 mm
PROBABILITY_DIGITS: Final = 4  # decimals: far below any error of a probability


def collection(features: Iterable[Mapping[str, Json]]) -> bytes:
    """Write one feature per line, so that people can read and compare the file line by line."""
    return b"".join(collection_parts(features))


def collection_parts(features: Iterable[Mapping[str, Json]]) -> Iterator[bytes]:
    """Write a collection a feature at a time."""
    before = '{"type":"FeatureCollection","features":['
    end = "]}\n"
    for feature in features:
        line = json.dumps(feature, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
        yield f"{before}\n{line}".encode("utf-8", "replace")
        before, end = ",", "\n]}\n"
    yield (before.removeprefix(",") + end).encode()


def feature(geometry: Json, properties: dict[str, Json]) -> dict[str, Json]:
    """Make a GeoJSON feature."""
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def one_or_multi(kind: str, parts: list[Json]) -> Json:
    """Make a geometry of one part, or a Multi- of several; None without any."""
    if not parts:
        return None
    return (
        {"type": kind, "coordinates": parts[0]} if len(parts) == 1 else {"type": f"Multi{kind}", "coordinates": parts}
    )


def geojson_point(longitude_deg: float, latitude_deg: float) -> Json:
    """Make a GeoJSON point, rounded; None if a coordinate is not finite."""
    longitude, latitude = rounded_longitude(longitude_deg), rounded(latitude_deg, DEGREE_DIGITS)
    return None if longitude is None or latitude is None else {"type": "Point", "coordinates": [longitude, latitude]}


def positions_of(points: NDArray[np.float64]) -> list[Json]:
    """Make GeoJSON positions of (n, 2) points, longitude and latitude in degrees."""
    return [
        [round(longitude, DEGREE_DIGITS) + 0.0, round(latitude, DEGREE_DIGITS) + 0.0]
        for longitude, latitude in points.tolist()
    ]


def rounded_longitude(longitude_deg: float) -> float | None:
    """Round a longitude and wrap it into -180 to 180 degrees; None if it is not finite."""
    longitude = rounded(longitude_deg, DEGREE_DIGITS)
    return None if longitude is None else round(float(wrap_longitude_deg(longitude)), DEGREE_DIGITS) + 0.0


def rounded(value: float, digits: int) -> float | None:
    """Round a number, never to -0; None for anything not finite."""
    return round(float(value), digits) + 0.0 if math.isfinite(value) else None


def rounded_direction(direction_deg: float, digits: int) -> float:
    """Round a compass direction to 0 degrees or more, below 360; NaN if it is not finite."""
    return round(float(direction_deg) % 360.0, digits) % 360.0
