"""Where objects show in a tile: georeferenced positions lead back to the pixels they came from."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import NOMINAL_SOUND_SPEED_MPS, EchoGeometry, locate
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.records import NAN, Side, Tile
from auv_mcm.settings.config import SonarConfig
from sim_replay.fitting.cascade.place import PlacedTarget, cropped, near_side_m, objects_in
from tests.make.records import pose_of, tile_with

ROW_M, COLUMN_M = 0.12, 0.06
N_ROWS, N_COLUMNS = 120, 500


def tile_of(
    side: Side, *, heading_rad: float = 0.0, pitch_rad: float = 0.0, turn_rad: float = 0.0, first_return_m: float = 6.0
) -> Tile:
    """Steady way in one direction, turned by turn_rad over the whole tile."""
    heading = heading_rad + np.linspace(0.0, turn_rad, N_ROWS)
    east, north = np.cumsum(np.sin(heading)) * ROW_M, np.cumsum(np.cos(heading)) * ROW_M
    frame = LocalFrame(latitude_deg=43.0, longitude_deg=5.9)
    latitude, longitude, _ = frame.to_geodetic(np.stack((east, north, np.zeros(N_ROWS)), axis=1))
    pose = pose_of(
        N_ROWS,
        time_s=0.06 * np.arange(N_ROWS),
        latitude_deg=latitude,
        longitude_deg=longitude,
        depth_m=14.0,
        heading_rad=heading,
        pitch_rad=pitch_rad,
        speed_mps=2.0,
        altitude_m=first_return_m * math.cos(pitch_rad),
    )
    return tile_with(
        np.ones((N_ROWS, N_COLUMNS)),
        side=side,
        core_start=10,
        core_stop=110,
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        pose=pose,
        first_return_m=first_return_m,
    )


def target(latitude_deg: float, longitude_deg: float, **facts: Any) -> PlacedTarget:
    """Return a point on the floor by default."""
    usual: dict[str, Any] = {
        "floor_depth_m": NAN,
        "kind": "point",
        "is_target": True,
        "seabed": "sand",
        "azimuth_rad": 0.0,
        "length_m": 0.0,
        "width_m": 0.0,
        "height_m": 0.0,
        "burial_m": 0.0,
    }
    return PlacedTarget(latitude_deg, longitude_deg, **(usual | facts))


def located(tile: Tile, row: float, column: float, sonar: SonarConfig) -> tuple[float, float]:
    """Latitude and longitude of a pixel, as detections are placed."""
    position = np.array([row - 0.5])
    first_return_m = np.interp(position, np.arange(N_ROWS), tile.first_return_m)
    echoes = EchoGeometry(
        side=tile.side,
        pose=interpolate_track(tile.pose, position),
        slant_range_m=np.hypot(np.array([column * COLUMN_M]), first_return_m),
        first_return_m=first_return_m,
        sound_speed_mps=np.array([NOMINAL_SOUND_SPEED_MPS]),
    )
    latitude, longitude, _ = locate(echoes, sonar)
    return float(latitude[0]), float(longitude[0])


@given(
    side=st.sampled_from(["port", "starboard"]),
    heading_rad=st.floats(-3.1, 3.1),
    pitch_rad=st.floats(-0.08, 0.08),
    turn_rad=st.floats(-0.1, 0.1),
    offset_deg=st.floats(-3.0, 3.0),
    arm_m=st.tuples(st.floats(-1.0, 1.0), st.floats(-0.3, 0.3)),
    row=st.floats(8.0, N_ROWS - 8.0),
    column=st.floats(60.0, N_COLUMNS - 1.0),
)
def test_an_object_shows_in_the_pixel_that_its_position_came_from(
    side: Side,
    heading_rad: float,
    pitch_rad: float,
    turn_rad: float,
    offset_deg: float,
    arm_m: tuple[float, float],
    row: float,
    column: float,
) -> None:
    sonar = SonarConfig(heading_offset_deg=offset_deg, lever_arm_m=(*arm_m, 0.0))
    tile = tile_of(side, heading_rad=heading_rad, pitch_rad=pitch_rad, turn_rad=turn_rad)
    (found,) = objects_in(tile, [target(*located(tile, row, column, sonar))], sonar)
    assert found.row == pytest.approx(row, abs=0.05)
    assert found.column == pytest.approx(column, abs=0.05)
    assert found.ground_range_m == pytest.approx(column * COLUMN_M, abs=0.01)


def test_an_object_of_the_other_side_or_beyond_the_swath_does_not_show() -> None:
    tile, sonar = tile_of("starboard"), SonarConfig()
    abeam = located(tile, 60.0, 200.0, sonar)
    assert len(objects_in(tile, [target(*abeam)], sonar)) == 1
    assert objects_in(tile_of("port"), [target(*abeam)], sonar) == ()
    assert objects_in(tile, [target(*located(tile, 60.0, N_COLUMNS + 20.0, sonar))], sonar) == ()
    assert objects_in(tile, [], sonar) == ()


def test_a_floor_lower_than_the_tile_s_shows_farther_out() -> None:
    tile, sonar = tile_of("starboard"), SonarConfig()
    place = located(tile, 60.0, 200.0, sonar)
    flat, lower = objects_in(tile, [target(*place), target(*place, floor_depth_m=21.0)], sonar)
    assert flat.column == pytest.approx(200.0, abs=0.05)
    assert lower.column * COLUMN_M == pytest.approx(math.sqrt(12.0**2 + 7.0**2 - 6.0**2), abs=0.01)


@pytest.mark.parametrize(
    ("kind", "azimuth_deg", "expected_m"),
    [
        ("cylinder", 0.0, 1.0),
        ("cylinder", 90.0, 0.25),
        ("box", 45.0, 0.25 * math.sqrt(2.0)),
        ("sphere", 37.0, 0.25),
        ("rock", 90.0, 0.25),
        ("debris", 0.0, 0.0),
    ],
)
def test_the_near_side_is_where_the_line_of_sight_enters_the_outline(
    kind: str, azimuth_deg: float, expected_m: float
) -> None:
    what = target(0.0, 0.0, kind=kind, azimuth_rad=math.radians(azimuth_deg), length_m=2.0, width_m=0.5)
    assert near_side_m(what, 0.0) == pytest.approx(expected_m)


def test_the_highlight_lies_before_the_middle_and_nearer_the_higher_the_object() -> None:
    tile, sonar = tile_of("starboard"), SonarConfig()
    place = located(tile, 60.0, 300.0, sonar)
    sizes = {"length_m": 1.0, "width_m": 1.0}
    point, low, high, buried = objects_in(
        tile,
        [
            target(*place),
            target(*place, kind="box", height_m=0.2, **sizes),
            target(*place, kind="box", height_m=0.6, **sizes),
            target(*place, kind="box", height_m=0.6, burial_m=0.4, **sizes),
        ],
        sonar,
    )
    assert high.column < low.column < point.column
    assert buried.column == low.column
    assert point.column - high.column < 0.6 / COLUMN_M


def test_aspects_count_from_the_long_axis() -> None:
    tile, sonar = tile_of("starboard", heading_rad=0.0), SonarConfig()  # looks east
    place = located(tile, 60.0, 300.0, sonar)
    end_on, broadside = objects_in(
        tile, [target(*place, azimuth_rad=0.5 * math.pi), target(*place, azimuth_rad=0.0)], sonar
    )
    assert math.cos(math.radians(end_on.aspect_deg)) == pytest.approx(1.0, abs=1e-3)
    assert broadside.aspect_deg == pytest.approx(90.0, abs=0.5)


def test_a_track_without_positions_shows_nothing() -> None:
    tile, sonar = tile_of("starboard"), SonarConfig()
    place = located(tile, 60.0, 300.0, sonar)
    nowhere = np.full(N_ROWS, np.nan)
    lost = msgspec.structs.replace(
        tile, pose=msgspec.structs.replace(tile.pose, latitude_deg=nowhere, longitude_deg=nowhere)
    )
    assert objects_in(lost, [target(*place)], sonar) == ()


def test_cropping_counts_rows_anew_and_drops_what_is_cut_away() -> None:
    tile, sonar = tile_of("starboard"), SonarConfig()
    found = objects_in(tile, [target(*located(tile, row, 200.0, sonar)) for row in (20.0, 60.0, 100.0)], sonar)
    assert [one.row for one in cropped(found, 40, 80)] == pytest.approx([20.0], abs=0.05)
