"""Write pings as sonar images: a TIFF per side and straight run, its sidecar, and its place in tags or a table.

What an image cannot hold is lost: pitch, roll and depth, and of a place in tags all but the ends of the run.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import SIDES, EchoTrace, NavSample, Ping, PoseTrack, Side
from auv_mcm.settings.config import NavigationConfig
from sim_replay.logs.image_sidecar import sidecar_path

_GAP_S: Final = 1.0  # s without a ping, beyond which another image begins
_TRANSFORMATION: Final = 34264  # tag ModelTransformation (OGC 19-008r4), as the next
_GEO_KEYS: Final = 34735  # tag GeoKeyDirectory
_WGS84_KEYS: Final = (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326)  # geographic, pixel is area, WGS 84


def write_images(
    folder: Path,
    events: Iterable[NavSample | Ping],
    *,
    place: Literal["tags", "track"] = "track",
    samples: Literal["amplitude", "intensity"] = "amplitude",
    kind: Literal["side_scan", "sas"] = "sas",
    **tiff: Any,
) -> list[Path]:
    """Write the images of a mission into a folder that is there; returns the TIFF files in order of time.

    Parameters
    ----------
    folder
        Where they are written, as run0-port.tif and so on.
    events
        Navigation and pings; those of a run are to be laid out alike.
    place
        Straight between the ends of a run (tags), or line by line in a table (track).
    samples
        What those of the pings are.
    kind
        Of the sonar.
    tiff
        Further arguments of tifffile.imwrite, such as compression.
    """
    navigation = NavBuffer(NavigationConfig(), set())
    pings: list[Ping] = []
    for event in events:
        if isinstance(event, NavSample):
            navigation.add(event)
        else:
            pings.append(event)
    written = []
    for number, run in enumerate(_runs(pings)):
        poses = navigation.interpolate(np.array([ping.time_s for ping in run]))
        for side in SIDES:
            traces = [ping.port if side == "port" else ping.starboard for ping in run]
            if (first := traces[0]) is None:
                continue
            plane = np.stack([trace.samples for trace in traces if trace is not None])
            path = folder / f"run{number}-{side}.tif"
            sidecar = _sidecar(run, poses, first, side) | {"samples": samples, "kind": kind}
            tags: list[tuple[Any, ...]] = []
            if place == "tags":
                tags = _geo_tags(poses, first, plane.shape, side, sidecar["altitude_m"])
            else:
                sidecar["track"] = path.with_suffix(".csv").name
                _write_track(path.with_suffix(".csv"), poses)
            tifffile.imwrite(path, plane, photometric="minisblack", metadata=None, extratags=tags, **tiff)
            sidecar_path(path).write_text(yaml.safe_dump(sidecar, sort_keys=False), "utf-8")
            written.append(path)
    return written


def _runs(pings: Sequence[Ping]) -> Iterator[Sequence[Ping]]:
    first = 0
    for number in range(1, len(pings) + 1):
        if (
            number == len(pings)
            or pings[number].time_s - pings[number - 1].time_s > _GAP_S
            or pings[number].squint_rad != pings[number - 1].squint_rad
        ):
            yield pings[first:number]
            first = number


def _sidecar(run: Sequence[Ping], poses: PoseTrack, trace: EchoTrace, side: Side) -> dict[str, Any]:
    seconds = run[-1].time_s - run[0].time_s
    length_m = float(np.hypot(*np.diff(_path(poses), axis=0).T).sum())
    return {
        "side": side,
        "near_edge": "left",
        "pixel_along_m": length_m / (len(run) - 1),
        "pixel_across_m": trace.spacing_m,
        "range": "slant",
        "near_range_m": max(trace.first_range_m - 0.5 * trace.spacing_m, 0.0),
        "altitude_m": float(np.median(poses.altitude_m)),
        "start_time": datetime.fromtimestamp(run[0].time_s, UTC).isoformat(),
        "speed_mps": length_m / seconds,
        "sound_speed_mps": run[0].sound_speed_mps,
        **({} if run[0].squint_rad == 0.0 else {"squint_deg": math.degrees(run[0].squint_rad)}),
    }


def _path(poses: PoseTrack) -> NDArray[np.float64]:
    frame = LocalFrame(latitude_deg=float(poses.latitude_deg[0]), longitude_deg=float(poses.longitude_deg[0]))
    return frame.to_enu(poses.latitude_deg, poses.longitude_deg, np.zeros(len(poses)))[:, :2]


def _write_track(path: Path, poses: PoseTrack) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["line", "latitude_deg", "longitude_deg", "heading_deg", "altitude_m"])
        for line in range(len(poses)):
            place = (f"{poses.latitude_deg[line]:.9f}", f"{poses.longitude_deg[line]:.9f}")
            heading_deg = math.degrees(poses.heading_rad[line]) % 360.0
            table.writerow([line, *place, f"{heading_deg:.4f}", f"{poses.altitude_m[line]:.3f}"])


def _geo_tags(
    poses: PoseTrack, trace: EchoTrace, shape: tuple[int, ...], side: Side, altitude_m: float
) -> list[tuple[Any, ...]]:
    """Place the image by the straight line that fits its run best."""
    n_lines, n_pixels = shape
    path = _path(poses)
    lines = np.arange(n_lines) + 0.5
    (step, start) = np.polyfit(lines, path, 1)  # metres per line, and where line 0 begins
    heading = math.atan2(step[0], step[1])
    abeam = np.array([math.cos(heading), -math.sin(heading)]) * (1.0 if side == "starboard" else -1.0)
    ranges = trace.first_range_m + trace.spacing_m * np.array([-0.5, n_pixels - 0.5])
    near_m, far_m = np.sqrt(np.maximum(ranges**2 - altitude_m**2, 0.0))
    corners = np.array([start + near_m * abeam, start + far_m * abeam, start + near_m * abeam + n_lines * step])
    frame = LocalFrame(latitude_deg=float(poses.latitude_deg[0]), longitude_deg=float(poses.longitude_deg[0]))
    latitude, longitude, _ = frame.to_geodetic(np.column_stack([corners, np.zeros(3)]))
    x = (longitude[0], (longitude[1] - longitude[0]) / n_pixels, (longitude[2] - longitude[0]) / n_lines)
    y = (latitude[0], (latitude[1] - latitude[0]) / n_pixels, (latitude[2] - latitude[0]) / n_lines)
    matrix = (x[1], x[2], 0.0, x[0], y[1], y[2], 0.0, y[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return [
        (_TRANSFORMATION, "d", 16, tuple(map(float, matrix)), False),
        (_GEO_KEYS, "H", len(_WGS84_KEYS), _WGS84_KEYS, False),
    ]
