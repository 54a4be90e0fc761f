"""Make tiles, poses and coverage of which a test states what matters to it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, VALID, CoveragePatch, NavSample, PoseTrack, SurveyedCells, Tile, Waypoint
from drivers.vehicle.dialect import ContactReport

ROW_M, COLUMN_M = 0.12, 0.06  # of tiles


def nav_of(time_s: float, **changes: float) -> NavSample:
    """A full sample, level and on a heading of 0, at 43° N 5° E, but for what is given."""
    known: dict[str, Any] = {"latitude_deg": 43.0, "longitude_deg": 5.0, "heading_rad": 0.0, "pitch_rad": 0.0}
    known |= {"roll_rad": 0.0, "depth_m": 10.0, "altitude_m": 5.0, "speed_mps": 1.5}
    return NavSample(time_s=time_s, **(known | changes))


def pose_of(n_rows: int, **columns: Any) -> PoseTrack:
    """A pose per row: 0 but for what is given, a number or (n_rows,) values; nothing is stale."""
    known: dict[str, Any] = dict.fromkeys(PoseTrack.__struct_fields__, 0.0) | columns
    stale = known.pop("stale") or False
    return PoseTrack(
        **{name: np.broadcast_to(np.asarray(value, np.float64), n_rows).copy() for name, value in known.items()},
        stale=np.full(n_rows, stale, dtype=np.bool_),
    )


def straight_pose(
    n_rows: int,
    row_m: float,
    home_deg: tuple[float, float],
    *,
    first_row: int = 0,
    heading_rad: float = 0.0,
    speed_mps: float,
    start_s: float = 0.0,
    **columns: Any,
) -> PoseTrack:
    """A pose at each row's centre of a straight way; the upper edge of row 0 at home; others as of `pose_of`."""
    along_m = np.asarray((first_row + np.arange(n_rows) + 0.5) * row_m, dtype=np.float64)
    way = np.stack((along_m * math.sin(heading_rad), along_m * math.cos(heading_rad), np.zeros(n_rows)), axis=-1)
    latitude, longitude, _ = LocalFrame(latitude_deg=home_deg[0], longitude_deg=home_deg[1]).to_geodetic(way)
    place = {"latitude_deg": latitude, "longitude_deg": longitude, "heading_rad": heading_rad}
    return pose_of(n_rows, time_s=start_s + along_m / speed_mps, speed_mps=speed_mps, **place, **columns)


def tile_with(intensity: NDArray[Any], mask: NDArray[np.uint8] | None = None, **changes: Any) -> Tile:
    """A tile of these pixels, all valid without a mask and all core, seen from 5 m; changes as of Tile."""
    n_rows = len(intensity)
    first_return_m = changes.pop("first_return_m", 5.0)
    plain = Tile(
        side="starboard",
        index=0,
        first_row=0,
        core_start=0,
        core_stop=n_rows,
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        intensity=intensity.astype(np.float32),
        mask=np.full(intensity.shape, VALID, dtype=np.uint8) if mask is None else mask,
        pose=pose_of(n_rows),
        first_return_m=np.full(n_rows, first_return_m),
        first_return_sigma_m=np.full(n_rows, 0.1),
        ping_number=np.arange(n_rows, dtype=np.int64),
    )
    return msgspec.structs.replace(plain, **changes)


def patch_of(**changes: Any) -> CoveragePatch:
    """What was covered by a tile of one second: nothing but what is given."""
    plain = CoveragePatch(side="port", tile_index=0, start_s=0.0, stop_s=1.0, rings_deg=(), covered_m2=0.0, lost_m2={})
    return msgspec.structs.replace(plain, **changes)


def waypoint_of(kind: str, latitude_deg: float, longitude_deg: float, leg: int = 1, **changes: Any) -> Waypoint:
    """A waypoint of a leg northward past a contact."""
    plain = Waypoint(
        leg=leg,
        kind=kind,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=0.0,
        contact_id="C00001",
        why="",
    )
    return msgspec.structs.replace(plain, **changes)


def report_of(**changes: Any) -> ContactReport:
    """The report of a likely sphere."""
    plain = ContactReport(
        session=77,
        number=3,
        revision=1,
        time_s=1.7e9,
        latitude_deg=41.185,
        longitude_deg=-8.706,
        sigma_m=1.5,
        p_mine=0.75,
        classification="sphere",
        belief={"sphere": 0.75, "unknown": 0.25},
        n_views=1,
    )
    return msgspec.structs.replace(plain, **changes)


def cells_of(places: Mapping[tuple[int, int], float], **columns: Any) -> SurveyedCells:
    """Cells of 4 m, each seen in this share; columns as of SurveyedCells, a number or a value per cell."""
    n = len(places)
    known: dict[str, Any] = {
        "ground_range_m": 0.0, "altitude_m": 0.0, "look_rad": 0.0, "seabed": 0, "confidence": 1.0, "ripple_rad": NAN,
        "wavelength_m": NAN, "unevenness_db": NAN, "cell_m": 4.0,
        "origin_latitude_deg": 43.0, "origin_longitude_deg": 5.0,
    } | columns  # fmt: skip
    scalars = {name: known.pop(name) for name in ("origin_latitude_deg", "origin_longitude_deg", "cell_m")}
    index = np.array(list(places), dtype=np.int32).reshape(-1, 2)
    values: dict[str, Any] = {
        name: np.broadcast_to(np.asarray(value, np.uint8 if name == "seabed" else np.float32), n).copy()
        for name, value in known.items()
    }
    fraction = np.array(list(places.values()), dtype=np.float32)
    return SurveyedCells(**scalars, east_index=index[:, 0], north_index=index[:, 1], fraction=fraction, **values)


def clearance_of(p_detected: ArrayLike, **changes: Any) -> Clearance:
    """Cells of 4 m from 43° N 5° E on, seen once and wholly; changes as of Clearance."""
    p = np.asarray(p_detected, dtype=np.float64)
    nothing = np.full(p.shape, NAN, dtype=np.float32)
    plain = Clearance(
        origin_latitude_deg=43.0,
        origin_longitude_deg=5.0,
        cell_m=4.0,
        first_east=0,
        first_north=0,
        exponent=-np.log1p(-p),
        share=np.ones(p.shape, dtype=np.float32),
        looks=np.ones(p.shape, dtype=np.uint8),
        towards=np.ones(p.shape, dtype=np.uint64),
        seabed=np.zeros(p.shape, dtype=np.uint8),
        ripple_rad=nothing,
        wavelength_m=nothing,
        unevenness_db=nothing,
        altitude_m=nothing,
    )
    return msgspec.structs.replace(plain, **changes)
