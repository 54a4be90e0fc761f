"""Images that cannot be used: exit code 3, and words for what is wrong and what to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from auv_mcm.cli import main
from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample
from auv_mcm.settings.config import Config
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.open_log import open_log
from tests.sim_replay.logs.image_writer import write_images
from tests.sim_replay.logs.sonar_logs import mission
from tests.sim_replay.logs.test_image_log import beside, plane

CORNERS = {
    "near_first": [43.0, 5.5],
    "near_last": [43.000036, 5.5],
    "far_first": [43.0, 5.500075],
    "far_last": [43.000036, 5.500075],
}


def tiff(folder: Path, numbers: Any = None, name: str = "a.tif", **options: Any) -> Path:
    path = folder / name
    options.setdefault("photometric", "minisblack")
    tifffile.imwrite(path, plane() if numbers is None else numbers, **options)
    return path


def truncated(folder: Path) -> Path:
    path = beside(tiff(folder))
    path.write_bytes(path.read_bytes()[:-500])
    return path


def truncated_png(folder: Path) -> Path:
    path = folder / "a.png"
    cv2.imwrite(str(path), plane())
    path.write_bytes(path.read_bytes()[:-100])
    return beside(path)


def no_header(folder: Path) -> Path:
    path = tiff(folder)
    path.write_bytes(path.read_bytes()[:12])
    return beside(path)


def track_with(row: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = beside(tiff(folder))
        track = folder / "track.csv"
        track.write_text(track.read_text().replace("\n7,", f"\n{row}\n7,"))
        return path

    return write


def geotiff(matrix: Any, system: int = 4326) -> Callable[[Path], Path]:
    keys = (1, 1, 0, 1, 2048 if system == 4326 else 3072, 0, 1, system)
    tags = [(34264, "d", 16, matrix, False), (34735, "H", len(keys), keys, False)]
    return lambda folder: beside(tiff(folder, extratags=tags), track=None)


def two_planes(folder: Path) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file["one"] = file["two"] = plane()
    return beside(folder / "a.h5")


def upside_down(folder: Path) -> Path:
    """A picture with its water column, near edge named wrongly."""
    path = write_images(folder, mission())[1]
    sidecar = sidecar_path(path)
    sidecar.write_text(sidecar.read_text().replace("near_edge: left", "near_edge: right"))
    return path


PLACED: dict[str, Any] = {
    "range": "ground",
    "pixel_across_m": 0.0955,
    "near_range_m": 10.0,
    "track": None,
    "corners": CORNERS,
}
SKEWED = CORNERS | {"far_last": [43.000056, 5.500075]}
NAN_PLACE = (float("nan"), *(0.0,) * 15)

BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "truncated TIFF": (truncated, "is cut off.*Copy or export it again"),
    "truncated PNG": (truncated_png, "cut off.*Copy or export it again"),
    "header alone": (no_header, "export it again|cut off"),
    "one pixel": (lambda d: beside(tiff(d, plane(n_lines=1, n_pixels=1))), "1 x 1 pixels.*Export the whole image"),
    "16-bit signed": (lambda d: beside(tiff(d, plane(np.int16))), "signed integers.*Export unsigned"),
    "colour TIFF": (
        lambda d: beside(tiff(d, np.zeros((40, 64, 3), np.uint8), photometric="rgb")),
        "colour picture.*Export the numbers",
    ),
    "colour PNG": (
        lambda d: beside(d / "a.png") if cv2.imwrite(str(d / "a.png"), np.zeros((40, 64, 3), np.uint8)) else d,
        "colour picture.*Export a grey picture",
    ),
    "8-bit log": (lambda d: beside(tiff(d, plane(np.uint8)), samples="log"), "db_per_count.*is needed"),
    "decibels of an amplitude": (lambda d: beside(tiff(d), db_per_count=0.3), "use `samples: log`, or remove"),
    "NaN georeference": (geotiff(NAN_PLACE), "not a number.*give `corners` or `track`"),
    "unknown coordinates": (geotiff((1.0,) * 16, 27700), "EPSG 27700.*Export it in one of these"),
    "no place": (lambda d: beside(tiff(d), track=None), "does not hold its place: give `corners`"),
    "no sidecar": (tiff, "without its sidecar a.yaml.*pixel_along_m"),
    "missing pixel size": (
        lambda d: beside(tiff(d), pixel_across_m=None),
        "`pixel_across_m` is missing.*never guessed",
    ),
    "missing law": (lambda d: beside(tiff(d), samples=None), "`samples` is missing"),
    "no altitude": (lambda d: beside(tiff(d), altitude_m=None), "either `altitude_m`"),
    "pixel size out of range": (lambda d: beside(tiff(d), pixel_along_m=25.0), "pixel_along_m"),
    "unknown key": (lambda d: beside(tiff(d), pixel_size=0.1), "unknown field `pixel_size`"),
    "no date": (lambda d: beside(tiff(d), start_time="yesterday"), "write a date and time"),
    "sidecar of another image": (lambda d: beside(tiff(d), pixel_along_m=0.2), "sidecar may belong to another image"),
    "track of another image": (lambda d: beside(tiff(d), n_lines=20), "track may belong to another image"),
    "track with NaN": (track_with("6.5,nan,5.5"), "row 9: latitude_deg is not finite"),
    "track in disorder": (track_with("2,43.0,5.5"), "`line` must increase"),
    "near edge upside down": (upside_down, "picture is turned.*should be the opposite edge"),
    "corners upside down": (
        lambda d: beside(tiff(d), **(PLACED | {"side": "port"})),
        "far edge lies to starboard.*upside down: correct it",
    ),
    "corners of a larger image": (
        lambda d: beside(tiff(d), **(PLACED | {"pixel_across_m": 0.05})),
        "`pixel_across_m` the image is 3.2 m",
    ),
    "lines askew": (
        lambda d: beside(tiff(d), **(PLACED | {"corners": SKEWED | {"far_first": [43.00002, 5.500075]}})),
        r"not at right angles to the track \(70 degrees\)",
    ),
    "a corner elsewhere": (
        lambda d: beside(tiff(d), **(PLACED | {"corners": SKEWED})),
        "corners make no parallelogram",
    ),
    "complex as amplitude": (
        lambda d: beside(tiff(d, plane(np.complex64))),
        "holds complex numbers.*Write what they are",
    ),
    "turned": (lambda d: beside(tiff(d, extratags=[(274, "H", 1, 6, True)])), "stored turned.*Export it upright"),
    "two planes": (two_planes, "name the image in it by `dataset`.*one, two"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_image_is_refused_with_what_to_do(name: str, tmp_path: Path) -> None:
    write, words = BAD[name]
    with pytest.raises(BadInputError, match=f"(?s){words}"):
        open_log(write(tmp_path), Config())


STEP_DEG = 0.000075 / 64, 0.000036 / 40  # of a pixel of the corners


@pytest.mark.parametrize(
    ("edge", "tie"), [("left", ""), ("left", "area"), ("right", "point"), ("top", "area"), ("bottom", "point")]
)
def test_corners_or_the_tie_of_a_map_that_fit_place_every_line(edge: str, tie: str, tmp_path: Path) -> None:
    """A map has north at the top; its tie is the corner of a pixel, or the middle where pixels are points."""
    half = 0.5 * (tie == "point")
    place_deg = 5.5 + (10 + half) * STEP_DEG[0], 43.000036 - (7 + half) * STEP_DEG[1]
    keys = (1, 1, 0, 2, 1025, 0, 1, 1 + (tie == "point"), 2048, 0, 1, 4326)
    tags = [
        (33550, "d", 3, (*STEP_DEG, 0.0), False),
        (33922, "d", 6, (10.0, 7.0, 0.0, *place_deg, 0.0), False),
        (34735, "H", len(keys), keys, False),
    ]
    to_north = edge in ("left", "right")
    changes: dict[str, Any] = {"near_edge": edge, "side": "starboard" if edge in ("left", "top") else "port"}
    changes |= {"corners": None, "lines": "backward" if to_north else "forward"} if tie else {}
    changes |= {} if to_north else {"pixel_along_m": 0.0955, "pixel_across_m": 0.1}
    log = open_log(beside(tiff(tmp_path, extratags=tags if tie else []), **(PLACED | changes)), Config())
    fixes = [event for event in log if isinstance(event, NavSample)]
    assert {round(math.degrees(fix.heading_rad), 3) % 360.0 for fix in fixes} == {0.0 if to_north else 90.0}
    lines = (np.arange(40 if to_north else 64) + 0.5) * STEP_DEG[to_north]
    ten_m_deg = 10.0 / 6.112 * 0.000075, 10.0 / 4.0 * 0.000036
    north_deg, east_deg = {
        "left": (lines, -ten_m_deg[0]),
        "right": (lines, 0.000075 + ten_m_deg[0]),
        "top": (0.000036 + ten_m_deg[1], lines),
        "bottom": (-ten_m_deg[1], lines),
    }[edge]
    assert np.abs(np.array([fix.latitude_deg - 43.0 for fix in fixes]) - north_deg).max() < 1e-7
    assert np.abs(np.array([fix.longitude_deg - 5.5 for fix in fixes]) - east_deg).max() < 1e-7


def test_replay_exits_with_3_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(truncated(tmp_path)), "--out", str(tmp_path / "out")]) == 3
    assert capsys.readouterr().err.count("\n") == 1
