"""Mosaics: pixels where the geometry puts them, the same however memory is bounded, and files that GDAL reads."""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.cli import main
from auv_mcm.geometry.geodesy import SEMI_MAJOR_M, LocalFrame
from auv_mcm.geometry.georeference import (
    NOMINAL_SOUND_SPEED_MPS,
    EchoGeometry,
    locate,
    position_covariance,
    tile_echoes,
)
from auv_mcm.records import LOW_RESOLUTION, TURN, VALID, PoseTrack, Tile
from auv_mcm.settings.config import Config
from sim_replay.mosaic import BLOCK, SIGMA_STEP_M, Mosaic
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import EXACT, Lawnmower, Scene, SceneObject, Sonar, Track
from tests.make.records import pose_of
from tests.sim_replay.report_samples import tile as plain_tile

LATITUDE_DEG, LONGITUDE_DEG = 54.0, 179.9999  # beside the antimeridian
ROW_M = 0.12


def tile(index: int = 0, n_rows: int = 40, n_columns: int = 90, heading_deg: float = 30.0, **changes: Any) -> Tile:
    """A tile of speckle along a straight line, whose pixels are square."""
    generator = np.random.default_rng(index)
    heading_rad = math.radians(heading_deg)
    along_m = (index * n_rows + np.arange(n_rows, dtype=np.float64)) * ROW_M
    enu = np.column_stack([along_m * math.sin(heading_rad), along_m * math.cos(heading_rad), np.zeros(n_rows)])
    latitude, longitude, _ = LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG).to_geodetic(enu)
    pose = pose_of(
        n_rows, time_s=along_m / 2.0, latitude_deg=latitude, longitude_deg=longitude, heading_rad=heading_rad
    )
    mask = np.full((n_rows, n_columns), VALID, dtype=np.uint8)
    mask[:, :5] |= LOW_RESOLUTION
    mask[3, 20:30] = 0
    values: dict[str, Any] = {
        "pose": pose,
        "mask": mask,
        "intensity": generator.exponential(size=(n_rows, n_columns)).astype(np.float32),
        "column_spacing_m": ROW_M,
    }
    return plain_tile(index, "starboard", n_rows, n_columns, **(values | changes))


def drawn(mosaic: Mosaic, number: int = 0) -> NDArray[np.float32]:
    """All sums of a level in one array, (3, height, width)."""
    level = list(mosaic.levels())[number]
    whole = np.zeros((3, -(-level.height // BLOCK) * BLOCK, -(-level.width // BLOCK) * BLOCK), dtype=np.float32)
    for column, row in level.blocks:
        sums = level.blocks.get((column, row))
        assert sums is not None
        whole[: len(sums), row * BLOCK : (row + 1) * BLOCK, column * BLOCK : (column + 1) * BLOCK] = sums
    return whole


@pytest.mark.parametrize(("n_unknown", "heights"), [(0, [41]), (1, [41]), (20, [21]), (40, [])])
def test_rows_without_a_heading_are_left_out_and_no_others(n_unknown: int, heights: list[int]) -> None:
    one, mosaic = tile(heading_deg=0.0), Mosaic(Config(), ROW_M)
    heading_rad = np.where(np.arange(40) < n_unknown, math.nan, one.pose.heading_rad)
    mosaic.add(msgspec.structs.replace(one, pose=msgspec.structs.replace(one.pose, heading_rad=heading_rad)))
    assert [len(level.picture()[0]) for level in mosaic.levels()][:1] == heights


def test_the_error_of_a_position_is_that_of_its_own_range() -> None:
    one = tile(n_columns=600, heading_deg=0.0)  # the swath reaches 72 m
    one.pose.position_sigma_m[:] = 1.5
    mosaic = Mosaic(Config(), ROW_M)
    mosaic.add(one)
    picture, _ = next(mosaic.levels()).picture()
    found_m = SIGMA_STEP_M * picture[len(picture) // 2, :, 1]
    for share in (0.1, 0.25, 0.5, 0.65, 0.8, 0.95):
        echoes = tile_echoes(one, np.array([20.0]), share * 600 * ROW_M)
        (covariance,) = position_covariance(echoes, Config().sonar, Config().navigation, one.first_return_sigma_m[:1])
        sigma_m = math.sqrt(np.linalg.eigvalsh(covariance)[-1] + float(echoes.pose.position_sigma_m[0]) ** 2)
        assert found_m[int(share * len(found_m))] == pytest.approx(sigma_m, abs=0.17)


def test_each_pixel_of_a_tile_goes_where_the_geometry_puts_it() -> None:
    one = tile(first_return_m=np.full(40, 6.0))
    mosaic = Mosaic(Config(), 0.18)
    mosaic.add(one)
    level = next(mosaic.levels())
    picture, _ = level.picture()
    row, column = (part.ravel() for part in np.indices(one.mask.shape))
    slant = np.hypot((column + 0.5) * ROW_M, one.first_return_m[row])
    pose = PoseTrack(**{name: getattr(one.pose, name)[row] for name in one.pose.__struct_fields__})
    echoes = EchoGeometry(
        side="starboard",
        pose=pose,
        slant_range_m=slant,
        first_return_m=one.first_return_m[row],
        sound_speed_mps=np.full(len(row), NOMINAL_SOUND_SPEED_MPS),
    )
    latitude, longitude, _ = locate(echoes, Config().sonar)
    right = np.mod(longitude - level.west_deg, 360.0) / level.step_deg[0]
    down = (level.north_deg - latitude) / level.step_deg[1]
    expected = np.zeros((level.height, level.width))
    np.add.at(expected, (down.astype(int), right.astype(int)), (one.mask.ravel() & VALID) != 0)
    seen = np.zeros((level.height, level.width), dtype=bool)
    for key in level.blocks:
        found = level.bytes_of(key)
        assert found is not None
        seen[key[1] * BLOCK : (key[1] + 1) * BLOCK, key[0] * BLOCK : (key[0] + 1) * BLOCK] = found[..., 0] > 0
    assert (seen != (expected > 0.0)).mean() < 1e-4  # places a millimetre apart may fall on two sides of an edge
    assert picture.shape[:2] == (np.ptp(down.astype(int)) + 1, np.ptp(right.astype(int)) + 1)


def test_blending_is_the_mean_weighted_by_quality() -> None:
    dark, bright = (
        tile(intensity=np.full((40, 90), 0.5, np.float32)),
        tile(intensity=np.full((40, 90), 2.0, np.float32)),
    )
    coarse, turning = (
        tile(mask=np.full((40, 90), VALID | flag, np.uint8), intensity=bright.intensity)
        for flag in (LOW_RESOLUTION, TURN)
    )
    for second, least, most in ((bright, 1.24, 1.26), (coarse, 0.56, 0.58), (turning, 0.51, 0.52)):
        mosaic = Mosaic(Config(), 0.5)
        mosaic.add(dark)
        mosaic.add(second)
        weight, weighted, _ = drawn(mosaic)
        middle = np.sort((weighted / np.maximum(weight, 1e-9))[weight > 0.5])
        assert least < np.median(middle) < most


def test_memory_and_order_make_no_difference() -> None:
    tiles = [tile(index) for index in range(4)]
    whole, small, back = Mosaic(Config(), 0.05), Mosaic(Config(), 0.05, max_blocks=1), Mosaic(Config(), 0.05)
    back.add(tiles[0])
    for one in tiles:
        whole.add(one)
        small.add(one)
    for one in tiles[:0:-1]:
        back.add(one)
    expected = drawn(whole)
    np.testing.assert_array_equal(drawn(small), expected)
    np.testing.assert_allclose(drawn(back), expected, rtol=1e-5, atol=1e-6)


def test_a_coarsened_mosaic_is_that_of_half_the_resolution() -> None:
    fine, coarse = Mosaic(Config(), 0.05), Mosaic(Config(), 0.05, max_blocks=2, coarsen=True)
    for index in range(12):
        fine.add(tile(index))
        coarse.add(tile(index))
    assert coarse.resolution_m in (0.1, 0.2)
    finest, half = drawn(fine), drawn(fine, 1)
    assert drawn(coarse)[0].sum() == pytest.approx(finest[0].sum(), rel=1e-3)
    rows, columns = (size // 2 for size in finest.shape[1:])
    fours = finest.reshape(3, rows, 2, columns, 2).sum(axis=(2, 4))
    np.testing.assert_allclose(half[:, :rows, :columns], fours, rtol=1e-5)


def test_without_errors_the_echoes_are_the_same() -> None:
    whole, plain = Mosaic(Config(), 0.25), Mosaic(Config(), 0.25, errors=False)
    for index in range(3):
        whole.add(tile(index))
        plain.add(tile(index))
    np.testing.assert_array_equal(drawn(plain)[:2], drawn(whole)[:2])
    assert not drawn(plain)[2].any()


def test_a_mosaic_without_positions_is_empty() -> None:
    unknown, stale = tile(), tile()
    unknown.pose.latitude_deg[:] = math.nan
    stale.pose.stale[:] = True
    mosaic = Mosaic(Config(), 0.25)
    mosaic.add(unknown)
    mosaic.add(stale)
    assert mosaic.is_empty
    assert list(mosaic.levels()) == []


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A short pass by one bright point, with perfect navigation; the log and the truth."""
    scene = Scene(
        sonar=Sonar(range_m=30.0, ping_rate_hz=15.0, beam_lines=3),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=16.0, heading_deg=40.0), altitude_m=5.0),
        navigation_error=EXACT,
        objects=(SceneObject(kind="point", leg=0, along_m=8.0, across_m=14.0, strength_db=0.0),),
    )
    folder = tmp_path_factory.mktemp("point")
    simulate(scene, folder)
    return folder / "mission.xtf", json.loads((folder / "truth.json").read_bytes())


def test_gdal_opens_the_geotiff_and_a_point_target_lies_where_it_is(mission: tuple[Path, Any], tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="rasterio, which brings GDAL, is not installed")
    log, truth = mission
    assert main(["export", str(log), "--geotiff", str(tmp_path / "m.tif"), "--resolution", "0.1"]) == 0
    with rasterio.open(tmp_path / "m.tif") as file:
        assert file.crs.to_epsg() == 4326
        assert file.block_shapes == [(BLOCK, BLOCK)] * 2
        assert file.overviews(1) == [2, 4]
        assert file.units == ("dB", "m")
        assert file.tags()["AREA_OR_POINT"] == "Area", "or all would lie half a pixel off"
        assert file.nodata == 0
        echo_db = file.read(1, masked=True) * file.scales[0] + file.offsets[0]
        sigma_m = file.read(2, masked=True) * file.scales[1]
        point = truth["objects"][0]
        middle = file.index(point["lon"], point["lat"])
        assert min(middle) >= 40, "indices below 0 would count from the other end"
        around = tuple(slice(at - 40, at + 41) for at in middle)  # 4 m: below the vehicle echoes are as strong
        brightest = np.unravel_index(np.argmax(echo_db[around].filled(-99.0)), (81, 81))
        longitude, latitude = file.xy(*(part.start + at for part, at in zip(around, brightest, strict=True)))
    assert echo_db[around].max() > 6.0
    frame = LocalFrame(latitude_deg=point["lat"], longitude_deg=point["lon"])
    assert math.hypot(*frame.to_enu(latitude, longitude, 0.0)[:2]) <= 0.5
    assert 0.9 < sigma_m.mean() < 2.0  # a metre by configuration, and what heading adds


def test_the_kmz_lays_pictures_over_the_same_place(mission: tuple[Path, Any], tmp_path: Path) -> None:
    log, truth = mission
    assert main(["export", str(log), "--kmz", str(tmp_path / "m.kmz")]) == 0
    with zipfile.ZipFile(tmp_path / "m.kmz") as file:
        assert file.testzip() is None
        document = ElementTree.fromstring(file.read("doc.kml"))
        pictures = {name: cv2.imdecode(np.frombuffer(file.read(name), np.uint8), 0) for name in file.namelist()[:-1]}
    overlays = list(document.iter("{http://www.opengis.net/kml/2.2}GroundOverlay"))
    assert {overlay.findtext("{*}Icon/{*}href") for overlay in overlays} == pictures.keys()
    point = truth["objects"][0]
    for overlay in overlays:
        west, south, east, north = (
            float(overlay.findtext(f"{{*}}LatLonBox/{{*}}{side}", "nan")) for side in ("west", "south", "east", "north")
        )
        picture = pictures[overlay.findtext("{*}Icon/{*}href", "")]
        assert picture is not None
        pixel_m = float(overlay.findtext("{*}name", "").split()[0])
        sizes_deg = north - south, (east - west) * math.cos(math.radians(point["lat"]))
        sizes_m = [size_deg * math.pi * SEMI_MAJOR_M / 180.0 for size_deg in sizes_deg]
        assert sizes_m == pytest.approx([n_pixels * pixel_m for n_pixels in picture.shape], rel=1e-4)
    assert west < point["lon"] < east
    assert south < point["lat"] < north


def test_an_export_without_a_file_or_into_no_folder_is_one_clear_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for words, says in (
        ([], "nothing to export"),
        (["--geotiff", "no/such/m.tif"], "there is no folder no/such"),
        (["--geotiff", "."], ". cannot be written: it is a folder or a device. Name a file."),
        (["--gpkg", "/dev/null"], "/dev/null cannot be written: it is a folder or a device. Name a file."),
        (["--qgis", "."], ". cannot be written: it is a folder or a device. Name a file."),
        (["--geotiff", str(tmp_path / "m.tif")], "mission.xtf. Name a folder of results"),
    ):
        assert main(["export", str(tmp_path / "mission.xtf"), *words]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--resolution", each] for each in ("0", "1e6", "fine")] + [["--max-sigma", "nan"]])
def test_a_size_that_is_none_is_rejected(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["export", "mission.xtf", "--geotiff", "m.tif", *words])
    assert "is not a number of metres" in capsys.readouterr().err
