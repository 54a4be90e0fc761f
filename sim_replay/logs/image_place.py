"""Find where the sonar was at each line of an image: from a table, from corners, or from a GeoTIFF's own tags."""

from __future__ import annotations

import csv
import io
import math
from array import array
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.safe_files import read_regular
from sim_replay.logs.image_sidecar import MAX_LENGTH_M, Corners, Sidecar
from sim_replay.logs.xtf_navigation import projection

Floats = NDArray[np.float64]

_LENGTH_TOLERANCE: Final = 0.1  # of a length along or across, between pixels and positions: half a speed off is a fault
_ANGLE_TOLERANCE_DEG: Final = 10.0  # degrees between the line of sight and abeam: SAS is processed to zero Doppler
_GEOGRAPHIC: Final = 4326  # EPSG: WGS 84
_UTM_NORTH, _UTM_SOUTH = 32600, 32700  # EPSG: WGS 84 / UTM zone 1 is one more
_N_ZONES: Final = 60  # of UTM
_UTM_EAST_M, _UTM_NORTH_M = 2e6, 1e7  # m: beyond any zone, whose eastings span 1e6 m and northings 1e7 m
_TRACK_COLUMNS: Final = ("line", "latitude_deg", "longitude_deg", "heading_deg", "altitude_m")  # the first three needed
_MAX_TRACK_BYTES: Final = 1 << 26  # of a track: chosen, a million lines with all columns


class Track(NamedTuple):
    """Hold where the sonar was at each line, in the order recorded; all (n_lines,) float64."""

    latitude_deg: Floats
    longitude_deg: Floats
    heading_rad: Floats
    altitude_m: Floats


def track_of(image: Path, sidecar: Sidecar, n_lines: int, n_pixels: int, geo_tags: dict[str, Any]) -> Track:
    """Place the lines of an image. Raises BadInputError where that is impossible or contradicts the sidecar."""
    if sidecar.track is not None:
        track = _from_table(image.parent / sidecar.track, sidecar, n_lines)
    else:
        corners = sidecar.corners
        if corners is None:
            corners = _geotiff_corners(image, sidecar, n_lines, n_pixels, geo_tags)
        track = _from_corners(image, corners, sidecar, n_lines, n_pixels)
    frame = LocalFrame(
        latitude_deg=float(track.latitude_deg[0]), longitude_deg=float(track.longitude_deg[0]), height_m=0.0
    )
    path = frame.to_enu(track.latitude_deg, track.longitude_deg, np.zeros(n_lines))[:, :2]
    sailed_m = float(np.hypot(*np.diff(path, axis=0).T).sum())
    _require_length(image, "along", sailed_m, (n_lines - 1) * sidecar.pixel_along_m)
    return track


def ground_range_m(range_m: float, altitude_m: float, sidecar: Sidecar) -> float:
    """Convert a range of the sidecar's kind to ground range."""
    if sidecar.range == "ground":
        return range_m
    return math.sqrt(max(range_m**2 - altitude_m**2, 0.0))


def _require_length(image: Path, direction: str, placed_m: float, by_pixels_m: float) -> None:
    if not (by_pixels_m > 0.0 and abs(placed_m - by_pixels_m) <= _LENGTH_TOLERANCE * by_pixels_m):
        raise BadInputError(
            f"{image}: by `pixel_{direction}_m` the image is {by_pixels_m:.1f} m {direction} the track, by its "
            f"positions {placed_m:.1f} m. The sidecar may belong to another image, or a pixel size is "
            "wrong: correct it."
        )


# --- a table ---


def _from_table(path: Path, sidecar: Sidecar, n_lines: int) -> Track:
    columns = _read_table(path)
    line, latitude, longitude = columns["line"], columns["latitude_deg"], columns["longitude_deg"]
    if (np.abs(latitude) > 90.0).any() or (np.abs(longitude) > 180.0).any():
        raise BadInputError(f"{path}: a latitude or longitude is beyond 90 or 180 degrees. Correct it.")
    if line.size < 2 or (np.diff(line) <= 0.0).any():
        raise BadInputError(f"{path}: `line` must increase from row to row, over two rows or more. Sort it.")
    if line[0] > 0.0 or line[-1] < n_lines - 1:
        raise BadInputError(
            f"{path} places lines {line[0]:g} to {line[-1]:g}, the image has lines 0 to {n_lines - 1}. The track may "
            "belong to another image: give the one that covers all lines."
        )
    recorded = np.arange(n_lines, dtype=np.float64)
    stored = recorded if sidecar.lines == "forward" else n_lines - 1 - recorded
    longitude = np.unwrap(longitude, period=360.0)
    fixes = np.flatnonzero(np.append(True, (np.diff(latitude) != 0.0) | (np.diff(longitude) != 0.0)))  # others repeat
    placed = [np.interp(stored, line[fixes], values[fixes]) for values in (latitude, longitude)]
    if "heading_deg" in columns:
        heading = np.interp(stored, line, np.unwrap(np.radians(columns["heading_deg"])))
    else:
        heading = _course_rad(*placed)
    altitude = np.full(n_lines, sidecar.sonar_altitude_m)
    if "altitude_m" in columns:
        lowest_m, highest_m = float(columns["altitude_m"].min()), float(columns["altitude_m"].max())
        if not 0.0 < lowest_m <= highest_m <= MAX_LENGTH_M:
            raise BadInputError(
                f"{path}: altitude_m reaches from {lowest_m:g} to {highest_m:g} m, and must lie above 0 and below "
                f"{MAX_LENGTH_M:g} m. Correct it."
            )
        altitude = np.interp(stored, line, columns["altitude_m"])
    return Track(placed[0], placed[1], heading, altitude)


def _read_table(path: Path) -> dict[str, Floats]:
    """Read the columns of a track that are known, all of one length, each number finite."""
    columns: dict[str, array[float]] = {}
    try:
        text = io.StringIO(read_regular(path, _MAX_TRACK_BYTES).decode("utf-8-sig"), newline="")
        reader = csv.reader(text, skipinitialspace=True)
        names = {name: place for place, name in enumerate(next(reader, []))}
        if missing := [name for name in _TRACK_COLUMNS[:3] if name not in names]:
            raise BadInputError(
                f"{path} has no column {missing[0]}: its first row must name line, latitude_deg, longitude_deg, "
                "and may name heading_deg and altitude_m."
            )
        columns = {name: array("d") for name in _TRACK_COLUMNS if name in names}
        for row in filter(None, reader):
            for name, values in columns.items():
                values.append(_number(path, name, row, names[name], reader.line_num))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"{path}, the track of a sidecar, cannot be read: {error}. Check `track`.") from error
    return {name: np.array(values) for name, values in columns.items()}


def _number(path: Path, name: str, row: list[str], place: int, line: int) -> float:
    try:
        value = float(row[place])
    except (IndexError, ValueError) as error:
        raise BadInputError(f"{path}: column {name} holds what is no number ({error}). Correct it.") from error
    if not math.isfinite(value):
        raise BadInputError(f"{path}, row {line}: {name} is not finite. Leave such rows out; lines between are filled.")
    return value


_STILL_M: Final = 1e-4  # m between two lines, below which a position stands still: pixels have 1 mm at the least


def _course_rad(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    frame = LocalFrame(latitude_deg=float(latitude_deg[0]), longitude_deg=float(longitude_deg[0]), height_m=0.0)
    east, north = frame.to_enu(latitude_deg, longitude_deg, np.zeros(latitude_deg.shape)).T[:2]
    right, ahead = np.gradient(east), np.gradient(north)
    moves = np.flatnonzero(np.hypot(right, ahead) > _STILL_M)
    if not len(moves):
        return np.zeros(len(east))
    course = np.unwrap(np.arctan2(right[moves], ahead[moves]))
    return np.asarray(np.interp(np.arange(len(east)), moves, course))  # none where a position is held


# --- corners ---


def _from_corners(image: Path, corners: Corners, sidecar: Sidecar, n_lines: int, n_pixels: int) -> Track:
    places = (corners.near_first, corners.near_last, corners.far_first, corners.far_last)
    if sidecar.lines == "backward":
        places = (places[1], places[0], places[3], places[2])
    frame = LocalFrame(latitude_deg=places[0][0], longitude_deg=places[0][1], height_m=0.0)
    latitudes, longitudes = zip(*places, strict=True)
    near_first, near_last, far_first, far_last = frame.to_enu(latitudes, longitudes, np.zeros(4))[:, :2]
    along, across = near_last - near_first, far_first - near_first
    length_m, width_m = float(np.hypot(*along)), float(np.hypot(*across))
    altitude_m = sidecar.sonar_altitude_m
    near_m = ground_range_m(sidecar.near_range_m, altitude_m, sidecar)
    far_m = ground_range_m(sidecar.near_range_m + n_pixels * sidecar.pixel_across_m, altitude_m, sidecar)
    _require_length(image, "along", length_m, n_lines * sidecar.pixel_along_m)
    _require_length(image, "across", width_m, far_m - near_m)
    if float(np.hypot(*(far_last - far_first - along))) > _LENGTH_TOLERANCE * max(length_m, width_m):
        raise BadInputError(
            f"{image}: its corners make no parallelogram. Check their order, or give a `track` by line."
        )
    to_right = along[1] * across[0] - along[0] * across[1]  # of the track, where positive
    sine = float(to_right / (length_m * width_m))
    if abs(sine) < math.cos(math.radians(_ANGLE_TOLERANCE_DEG)):
        raise BadInputError(
            f"{image}: its lines are not at right angles to the track ({math.degrees(math.asin(abs(sine))):.0f} "
            "degrees). It may have been turned to a map: give the image in track coordinates."
        )
    if (sine > 0.0) != (sidecar.side == "starboard"):
        raise BadInputError(
            f"{image}: by its corners the far edge lies to {'starboard' if sine > 0.0 else 'port'} of the track, its "
            f"sidecar says `side: {sidecar.side}`. Either `side`, `near_edge: {sidecar.near_edge}` or "
            f"`lines: {sidecar.lines}` is wrong, as in a picture that was turned upside down: correct it."
        )
    middle = (np.arange(n_lines) + 0.5) / n_lines
    start = near_first - across * (near_m / width_m)
    path = start + middle[:, np.newaxis] * along
    latitude, longitude, _ = frame.to_geodetic(np.column_stack([path, np.zeros(n_lines)]))
    heading = np.full(n_lines, math.atan2(along[0], along[1]) % math.tau)
    return Track(latitude, longitude, heading, np.full(n_lines, altitude_m))


def _geotiff_corners(image: Path, sidecar: Sidecar, n_lines: int, n_pixels: int, tags: dict[str, Any]) -> Corners:
    """Place the corners by a GeoTIFF's tags (OGC 19-008r4)."""
    try:
        affine = affine_of(tags)
        is_point = int(tags.get("GTRasterTypeGeoKey", 1)) == 2
        system = int(tags.get("ProjectedCSTypeGeoKey", tags.get("GeographicTypeGeoKey", 0)))
    except (TypeError, ValueError) as error:  # damaged tags hold any number of any type
        raise BadInputError(
            f"{image}: its georeference cannot be read ({clean(str(error))}). Export it again, or give `corners` or "
            "`track` in the sidecar."
        ) from error
    if affine is None:
        raise BadInputError(
            f"{image} does not hold its place: give `corners` (latitude and longitude of near_first, near_last, "
            "far_first, far_last) or `track` (a CSV file of positions by line) in the sidecar."
        )
    if not np.isfinite(affine).all():
        raise BadInputError(
            f"{image}: its georeference is not a number (NaN). Export it again with navigation, or give `corners` or "
            "`track` in the sidecar."
        )
    lines_are_rows = sidecar.near_edge in ("left", "right")
    half = -0.5 if is_point else 0.0  # the tie lies in the middle of a pixel
    across_m = (n_pixels, 0.0) if sidecar.near_edge in ("right", "bottom") else (0.0, n_pixels)

    def place(line: float, pixel: float) -> tuple[float, float]:
        column, row = (pixel, line) if lines_are_rows else (line, pixel)
        x, y = affine @ np.array([column + half, row + half, 1.0])
        return _geodetic(image, float(x), float(y), system)

    return Corners(
        near_first=place(0.0, across_m[0]),
        near_last=place(n_lines, across_m[0]),
        far_first=place(0.0, across_m[1]),
        far_last=place(n_lines, across_m[1]),
    )


def affine_of(tags: dict[str, Any]) -> Floats | None:
    """Compute the matrix (2, 3) from column, row and 1 to coordinates; None where the tags hold none."""
    if (matrix := tags.get("ModelTransformation")) is not None:
        whole = np.asarray(matrix, dtype=np.float64).reshape(4, 4)
        return np.asarray(whole[:2][:, [0, 1, 3]])
    scale, ties = tags.get("ModelPixelScale"), tags.get("ModelTiepoint")
    if scale is None or ties is None or len(ties) < 6:
        return None
    column, row, _, x, y = ties[:5]
    scale = np.asarray(scale, dtype=np.float64)[:2]
    return np.array([[scale[0], 0.0, x - column * scale[0]], [0.0, -scale[1], y + row * scale[1]]])


def _geodetic(image: Path, x: float, y: float, system: int) -> tuple[float, float]:
    if system == _GEOGRAPHIC and abs(x) <= 180.0 and abs(y) <= 90.0:
        return y, x
    in_utm = any(1 <= system - first <= _N_ZONES for first in (_UTM_NORTH, _UTM_SOUTH))
    if in_utm and abs(x) <= _UTM_EAST_M and abs(y) <= _UTM_NORTH_M:
        return projection(system)(x, y)
    raise BadInputError(
        f"{image}: its coordinate system (EPSG {system}) is not WGS 84 in degrees (4326) or UTM (32601 to 32760), or "
        "its coordinates lie outside. Export it in one of these, or give `corners` in the sidecar."
    )
