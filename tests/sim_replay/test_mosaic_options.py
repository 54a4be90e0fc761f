"""A mosaic to show: projected, cropped, in colour, with the pass that was asked for on top."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from sim_replay.mosaic import Mosaic, leg_numbers
from sim_replay.mosaic_files import PALETTES, write_geotiff
from sim_replay.projections import check_crs, projection
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


@pytest.mark.parametrize("palette", ["", *PALETTES])
def test_gdal_opens_it_projected_and_without_empty_margins(palette: str, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="rasterio, which brings GDAL, is not installed")
    write_geotiff(tmp_path / "m.tif", drawn(tile(), crs="utm"), palette=palette)
    with rasterio.open(tmp_path / "m.tif") as file:
        assert file.crs.is_projected
        assert file.res == (0.25, 0.25)
        assert file.count == (4 if palette else 2)
        seen = file.read(file.count) > 0 if palette else file.read(1) > 0
        overviews = file.overviews(1)
        corner = file.bounds.left / 0.25, file.bounds.top / 0.25
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


def test_a_leg_ends_where_the_course_turns() -> None:
    number_of = leg_numbers()
    assert [number_of(tile(heading_deg=heading)) for heading in (10.0, 350.0, 20.0, 100.0, 190.0, 185.0)] == [
        *(1, 1, 1, 2, 3, 3)
    ]
