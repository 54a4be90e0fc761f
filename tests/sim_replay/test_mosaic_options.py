"""A mosaic to show: projected, cropped, in colour, with the pass that was asked for on top."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.mosaic import Mosaic
from sim_replay.mosaic_files import PALETTES, write_geotiff
from sim_replay.mosaic_legs import leg_numbers
from sim_replay.projections import check_crs, projection
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Origin, Scene, Sonar, Track
from sim_replay.survey_gain import SurveyGain
from tests.sim_replay.report_samples import tile as plain_tile
from tests.sim_replay.test_mosaic import tile


def drawn(*tiles: Any, **options: Any) -> list[Any]:
    mosaic = Mosaic(Config(), 0.25, **options)
    for one in tiles:
        mosaic.add(one)
    return list(mosaic.levels())


def test_utm_is_the_zone_of_the_place_and_any_code_in_metres_will_do() -> None:
    assert projection("utm", 9.5, 54.0).epsg == 32632
    assert projection("UTM", -68.8, -48.0).epsg == 32719
    assert projection("utm", 180.0, 10.0).epsg == 32601
    found = projection("EPSG:25832", 9.0, 54.0)
    east_m, north_m = found.project(np.array([9.0]), np.array([54.0]))
    assert east_m[0] == pytest.approx(500_000.0, abs=1e-3), "the middle of the zone, by definition"
    # Length of a meridian from the equator to 54 degrees (GRS 80), by its series, and the scale of UTM.
    e2 = 0.00669438002290
    series = 1 - e2 / 4 - 3 * e2**2 / 64, 3 * e2 / 8 + 3 * e2**2 / 32, 15 * e2**2 / 256
    angle = math.radians(54.0)
    length_m = 6378137.0 * (series[0] * angle - series[1] * math.sin(2 * angle) + series[2] * math.sin(4 * angle))
    assert north_m[0] == pytest.approx(0.9996 * length_m, abs=1.0)
    for wrong in ("EPSG:4326", "EPSG:2277", "EPSG:999999", "mercator"):
        with pytest.raises(UsageError, match="--crs"):
            check_crs(wrong)


@pytest.mark.parametrize(
    ("longitude_deg", "latitude_deg", "zone"),
    [
        (5.3, 60.4, 32),
        (2.9, 60.4, 31),
        (5.3, 55.9, 31),
        (5.3, 64.0, 31),
        (8.9, 78.2, 31),
        (9.1, 78.2, 33),
        (33.0, 78.0, 37),
    ],
)
def test_utm_has_other_zones_off_norway_and_about_svalbard(
    longitude_deg: float, latitude_deg: float, zone: int
) -> None:
    assert projection("utm", longitude_deg, latitude_deg).epsg == 32600 + zone
    assert projection("utm", longitude_deg, -latitude_deg).epsg == 32700 + int(longitude_deg // 6) + 31


@pytest.mark.parametrize("code", ["EPSG:2053", "EPSG:5513", "EPSG:5555", "EPSG:102100", "EPSG:32700"])
def test_a_map_that_would_be_mirrored_or_that_no_geotiff_can_name_is_refused(code: str) -> None:
    with pytest.raises(UsageError, match=r"Name (another|one)"):
        check_crs(code)


def test_a_mission_that_the_reference_system_cannot_map_is_refused() -> None:
    assert check_crs("EPSG:3377") == "EPSG:3377", "Johor, Malaysia"
    with pytest.raises(UsageError, match=r"48\.4000, -68\.8000 degrees, is outside .* give utm"):
        projection("EPSG:3377", -68.8, 48.4)


@pytest.mark.parametrize("palette", ["", *PALETTES])
def test_gdal_opens_it_projected_and_without_empty_margins(palette: str, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="rasterio, which brings GDAL, is not installed")
    levels = drawn(tile(), crs="utm")
    write_geotiff(tmp_path / "m.tif", levels, palette=palette)
    with rasterio.open(tmp_path / "m.tif") as file:
        assert file.crs.is_projected
        assert file.res == (0.25, 0.25)
        assert file.count == (4 if palette else 2)
        seen = file.read(file.count) > 0 if palette else file.read(1) > 0
        assert palette != "copper" or file.read(1).mean() > 1.5 * file.read(3).mean(), "red first, blue third"
        overviews = file.overviews(1)
        corner = file.bounds.left / 0.25, file.bounds.top / 0.25
    assert seen.sum() == (levels[0].picture()[0][..., 0] > 0).sum()
    grid = max([1, *overviews])
    margins = [np.flatnonzero(seen.any(axis=axis)) for axis in (0, 1)]
    for margin, size in zip(margins, seen.shape[::-1], strict=True):
        assert margin[0] < grid
        assert margin[-1] == size - 1
    assert corner == pytest.approx([round(part) for part in corner], abs=1e-6), "on whole pixels"


def test_a_shadow_that_another_pass_does_not_see_stays_where_asked() -> None:
    bright, dark = tile(), tile(1)
    level = np.full(bright.intensity.shape, 4.0, dtype=np.float32)
    here: dict[str, Any] = {"pose": bright.pose, "first_row": bright.first_row, "first_return_m": bright.first_return_m}

    def seen(first: float, second: float, blend: Any) -> float:
        passes = [tile(intensity=level * np.float32(factor), **here) for factor in (first, second)]
        (picture, _) = drawn(*passes, blend=blend)[0].picture()
        return float(np.median(picture[..., 0][picture[..., 0] > 0]))

    assert dark.index == 1
    alone_bright, alone_dark = seen(1.0, 1.0, "mean"), seen(0.01, 0.01, "mean")
    assert alone_dark < seen(1.0, 0.01, "mean") < alone_bright
    assert seen(1.0, 0.01, "last") == alone_dark
    assert seen(0.01, 1.0, "last") == alone_bright
    assert seen(1.0, 0.01, "max") == seen(0.01, 1.0, "max") == alone_bright
    assert seen(1.0, 0.01, "nearest") == alone_bright, "of two that see as well the first stays"


def test_nothing_is_drawn_nearer_than_the_share_of_the_altitude() -> None:
    seen = tile(first_return_m=np.full(40, 6.0))
    whole, masked = (drawn(seen, nadir_share=share)[0].picture()[0][..., 0] > 0 for share in (0.0, 0.5))
    assert 0 < np.count_nonzero(masked) < np.count_nonzero(whole)
    assert drawn(seen, nadir_share=99.0) == []


def test_the_line_below_the_vehicle_fades_into_the_floor_and_under_other_passes() -> None:
    bright = tile(first_return_m=np.full(40, 6.0), intensity=np.full((40, 90), 100.0, dtype=np.float32))
    plain, faded = (drawn(bright, fade_share=share)[0].picture()[0][..., 0] for share in (0.0, 1.5))
    assert (faded > 0).sum() == (plain > 0).sum(), "nothing is left out"
    assert faded[faded > 0].min() < plain[plain > 0].min()
    assert faded.max() == plain.max(), "beyond that share of the altitude all stays"
    dark = tile(first_return_m=np.zeros(40), intensity=np.full((40, 90), 0.1, dtype=np.float32))
    both = drawn(bright, dark, fade_share=99.0)[0].picture()[0][..., 0]
    alone = drawn(dark)[0].picture()[0][..., 0]
    assert abs(float(np.median(both[both > 0])) - float(np.median(alone[alone > 0]))) <= 10, "a pass that sees it wins"


def test_the_file_is_laid_out_for_parts_of_it_to_be_fetched(tmp_path: Path) -> None:
    """The rules of GDAL's validator, by the offsets that tifffile reads."""
    tifffile = pytest.importorskip("tifffile")
    rasterio = pytest.importorskip("rasterio", reason="rasterio, which brings GDAL, is not installed")
    mosaic = Mosaic(Config(), 0.04)
    mosaic.add(tile(heading_deg=200.0))
    write_geotiff(tmp_path / "m.tif", list(mosaic.levels()))
    with tifffile.TiffFile(tmp_path / "m.tif") as file:
        pages = list(file.pages)
        directories = [page.offset for page in pages]
        first_pixels = [min(offset for offset in page.dataoffsets if offset) for page in pages]
        assert all(page.is_tiled for page in pages)
        assert [page.is_reduced for page in pages] == [False] + [True] * (len(pages) - 1)
        sizes = [page.shape[:2] for page in pages]
    assert len(pages) >= 2
    assert directories == sorted(directories)
    assert directories[0] < 300
    assert directories[-1] < min(first_pixels), "every directory lies before the first pixel"
    assert first_pixels == sorted(first_pixels, reverse=True), "the coarsest overview comes first"
    for finer, coarser in itertools.pairwise(sizes):
        assert [-(-side // 2) for side in finer] == list(coarser)
    assert max(sizes[-1]) <= 512
    with rasterio.open(tmp_path / "m.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.overviews(1) == [2**number for number in range(1, len(pages))]
        whole, half = file.read(1), file.read(1, out_shape=(sizes[1][0], sizes[1][1]))
    assert abs(np.median(whole[whole > 0].astype(float)) - np.median(half[half > 0])) < 10
    fours = np.pad(whole, [(0, side % 2) for side in whole.shape]).reshape(sizes[1][0], 2, sizes[1][1], 2)
    assert np.array_equal(half > 0, fours.max(axis=(1, 3)) > 0), "overviews begin where the picture does"


def test_a_gain_over_range_and_angle_goes_and_the_floors_stay_apart() -> None:
    """Known pattern: spreading, a wavy beam and half a time-varied gain; two floors 6 dB apart; altitude that varies.

    The bound of 0.5 dB is that of the interpolation between cells of 1 m and 2 degrees.
    """
    n_rows, n_columns, generator = 60, 400, np.random.default_rng(5)
    some = np.minimum(np.arange(4, n_columns + 4, 8), n_columns - 1)
    ground_m = (some + 0.5) * 0.12
    survey, tiles = SurveyGain(), []
    for number in range(24):
        height_m = 6.0 + 3.0 * np.sin(number / 3.0 + np.arange(n_rows) / n_rows)
        range_m, angle = np.hypot(ground_m, height_m[:, None]), np.arctan2(height_m[:, None], ground_m)
        pattern_db = -25.0 * np.log10(range_m / 10.0) + 4.0 * np.cos(5.0 * angle) + 0.1 * range_m
        floor_db = 6.0 * (number % 2)
        nats = (pattern_db + floor_db + generator.normal(0.0, 0.5, pattern_db.shape)) * math.log(10.0) / 10.0
        tiles.append(
            plain_tile(
                number,
                "starboard",
                n_rows,
                n_columns,
                intensity=np.ones((n_rows, n_columns), dtype=np.float32),
                column_spacing_m=0.12,
                first_return_m=height_m,
                level=nats.astype(np.float32),
            )
        )
        survey.learn(tiles[-1])
    made = [10.0 * np.log10(survey.applied(one).intensity) for one in tiles]
    first, second = (np.mean([one.mean(axis=0) for one in made[start::2]], axis=0) for start in (0, 1))
    recorded_db = np.ptp(np.mean([one.level.mean(axis=0) for one in tiles if one.level is not None], axis=0)) * 4.343
    assert recorded_db > 12.0
    assert np.std(first) < 0.5
    assert np.abs(first - first.mean()).max() < 1.0
    assert second - first == pytest.approx(np.full(n_columns, 6.0), abs=0.5)


def test_legs_of_an_earlier_export_with_more_of_them_are_named_and_stay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = Scene(
        seed=1,
        sonar=Sonar(range_m=12.0, ping_rate_hz=10.0, beam_lines=1),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=14.0, spacing_m=20.0), altitude_m=3.0),
    )
    write_xtf(tmp_path / "log.xtf", Mission(scene).events())
    words = ["export", str(tmp_path / "log.xtf"), "--geotiff", str(tmp_path / "m.tif"), "--per-leg", "--resolution=1"]
    assert main(words) == 0
    assert "notice" not in capsys.readouterr().out
    (tmp_path / "m-2.tif").write_bytes(b"of before")
    assert main(words) == 0
    assert re.search(r"notice: .*m-2\.tif was there before", capsys.readouterr().out)
    assert main([*words, "--json"]) == 0
    assert [str(tmp_path / "m-2.tif") in text for text in json.loads(capsys.readouterr().out)["notices"]] == [True]
    assert (tmp_path / "m-2.tif").read_bytes() == b"of before"


def test_legs_on_both_sides_of_a_utm_zone_are_in_one(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="rasterio, which brings GDAL, is not installed")
    plan = Lawnmower(n_legs=2, leg_m=14.0, spacing_m=20.0)
    scene = Scene(
        seed=1,
        origin=Origin(latitude_deg=55.0, longitude_deg=5.9999),
        sonar=Sonar(range_m=12.0, ping_rate_hz=10.0, beam_lines=1),
        track=Track(plan=plan, altitude_m=3.0),
    )
    write_xtf(tmp_path / "log.xtf", Mission(scene).events())
    words = ["--geotiff", str(tmp_path / "m.tif"), "--crs", "utm", "--per-leg", "--resolution", "1"]
    assert main(["export", str(tmp_path / "log.xtf"), *words]) == 0
    codes = []
    for path in sorted(tmp_path.glob("m-*.tif")):
        with rasterio.open(path) as file:
            codes.append(file.crs.to_epsg())
    assert len(codes) > 1
    assert set(codes) == {32631}


def test_a_leg_ends_where_the_course_turns() -> None:
    number_of = leg_numbers()
    assert [number_of(tile(heading_deg=heading)) for heading in (10.0, 350.0, 50.0, 100.0, 190.0, 170.0)] == [
        *(1, 1, 1, 2, 3, 3)
    ]
