"""A chart lies on the map where GDAL says that it does, in any reference system; a bad file is refused in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from rasterio.crs import CRS
from rasterio.transform import Affine
from rasterio.warp import transform

from auv_mcm.errors import BadInputError, UsageError
from sim_replay.view.chart import MAX_SIDE, Chart, read_chart

N_ROWS, N_COLUMNS = 300, 400
RED, SEA = (255, 0, 0), (0, 40, 90)


def write_chart(
    path: Path, bands: np.ndarray[Any, Any], crs: str | None, west: float, north: float, step: float, **more: Any
) -> Path:
    """Write bands (n, n_rows, n_columns) by GDAL."""
    n, rows, columns = bands.shape
    colours = more.pop("colormap", None)
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=columns, count=n, dtype=bands.dtype,
        crs=crs, transform=Affine(step, 0.0, west, 0.0, -step, north), **more,
    ) as file:  # fmt: skip
        file.write(bands)
        if colours:
            file.write_colormap(1, colours)
    return path


def marked(row: int, column: int) -> np.ndarray[Any, Any]:
    """A palette picture of sea with one red mark of five pixels."""
    picture = np.zeros((1, N_ROWS, N_COLUMNS), dtype=np.uint8)
    picture[0, row - 2 : row + 3, column - 2 : column + 3] = 1
    return picture


def decoded(chart: Chart) -> np.ndarray[Any, Any]:
    pixels = cv2.imdecode(np.frombuffer(chart.png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return pixels


def red_at(chart: Chart) -> tuple[float, float]:
    """Longitude and latitude of the middle of the mark."""
    picture = decoded(chart)
    assert picture.shape[2] == 4
    weight = picture[:, :, 2].astype(float) * (picture[:, :, 3] > 128)
    rows, columns = np.nonzero(weight > 128)
    height, width = weight.shape
    return (
        chart.west_deg + (chart.east_deg - chart.west_deg) * (float(columns.mean()) + 0.5) / width,
        chart.north_deg - (chart.north_deg - chart.south_deg) * (float(rows.mean()) + 0.5) / height,
    )


PLACES = (
    ("EPSG:32632", 5e5, 6e6),
    ("EPSG:32718", 3e5, 8e6),
    ("EPSG:3857", -7e6, 5e6),
    ("EPSG:3395", 1e6, 4e6),
    ("EPSG:2154", 2e5, 6.8e6),
)


@given(
    place=st.sampled_from(PLACES),
    step=st.floats(0.5, 200.0),
    at=st.tuples(st.integers(5, N_ROWS - 6), st.integers(5, N_COLUMNS - 6)),
)
def test_a_mark_lies_within_a_pixel_of_where_gdal_places_it(
    tmp_path_factory: pytest.TempPathFactory, place: tuple[str, float, float], step: float, at: tuple[int, int]
) -> None:
    crs, west, north = place
    path = write_chart(
        tmp_path_factory.mktemp("chart") / "c.tif", marked(*at), crs, west, north, step,
        compress="lzw", colormap={0: SEA, 1: RED},
    )  # fmt: skip
    longitude, latitude = red_at(read_chart(path))
    x, y = transform("EPSG:4326", crs, [longitude], [latitude])
    assert abs((x[0] - west) / step - (at[1] + 0.5)) < 1.0
    assert abs((north - y[0]) / step - (at[0] + 0.5)) < 1.0


def test_figures_are_stretched_and_what_is_not_known_is_transparent(tmp_path: Path) -> None:
    depth = np.linspace(-40.0, -5.0, N_ROWS * N_COLUMNS, dtype=np.float32).reshape(1, N_ROWS, N_COLUMNS)
    depth[0, :100] = -9999.0
    chart = read_chart(write_chart(tmp_path / "d.tif", depth, "EPSG:4326", 8.0, 54.0, 1e-4, nodata=-9999.0))
    assert chart[1:] == pytest.approx((8.0, 54.0 - 0.03, 8.04, 54.0))
    picture = decoded(chart)
    assert (picture[:98, :, 3] == 0).all()
    assert (picture[102:298, 2:-2, 3] == 255).all()
    assert picture[290, 200, 0] > picture[110, 200, 0] + 200


@pytest.mark.parametrize(("n_bands", "dtype"), [(1, "uint8"), (1, "int16"), (3, "uint8"), (4, "uint8"), (3, "uint16")])
@pytest.mark.parametrize("compress", ["none", "deflate", "lzw"])
def test_pictures_of_every_usual_kind_are_read(tmp_path: Path, n_bands: int, dtype: str, compress: str) -> None:
    bands = np.full((n_bands, 40, 50), 200, dtype=dtype)
    chart = read_chart(write_chart(tmp_path / "k.tif", bands, "EPSG:4326", 8.0, 54.0, 1e-4, compress=compress))
    assert decoded(chart).shape == (40, 50, 4)


def test_a_large_chart_is_averaged(tmp_path: Path) -> None:
    bands = np.zeros((1, 90, 9 * MAX_SIDE), dtype=np.uint8)
    bands[0, 36:54, 9000:9018] = 1
    path = write_chart(
        tmp_path / "l.tif", bands, "EPSG:4326", 8.0, 54.0, 1e-5, compress="deflate", colormap={0: SEA, 1: RED}
    )
    chart = read_chart(path)
    assert max(decoded(chart).shape) <= MAX_SIDE
    longitude, latitude = red_at(chart)
    assert longitude == pytest.approx(8.0 + 9009e-5, abs=9e-5)
    assert latitude == pytest.approx(54.0 - 45e-5, abs=9e-5)


def test_a_header_that_claims_gigabytes_is_refused_before_a_pixel_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=40_000,
        width=40_000,
        count=1,
        dtype="uint8",
        sparse_ok=True,
        crs="EPSG:4326",
        transform=Affine(1e-4, 0.0, 8.0, 0.0, -1e-4, 54.0),
    ):
        pass
    with pytest.raises(BadInputError, match="gdal_translate -outsize"):
        read_chart(path)


@pytest.mark.parametrize("cut", [0, 3, 8, 100, 400, 2000])
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, cut: int) -> None:
    whole = write_chart(tmp_path / "w.tif", marked(50, 50), "EPSG:32632", 5e5, 6e6, 1.0).read_bytes()
    path = tmp_path / "cut.tif"
    path.write_bytes(whole[:cut])
    with pytest.raises(BadInputError, match=r"cut\.tif"):
        read_chart(path)


def test_a_picture_without_a_place_or_an_epsg_code_is_refused_with_the_remedy(tmp_path: Path) -> None:
    bare = tmp_path / "bare.tif"
    tifffile.imwrite(bare, np.zeros((20, 20), dtype=np.uint8))
    with pytest.raises(BadInputError, match="does not hold its place"):
        read_chart(bare)
    own = CRS.from_proj4("+proj=poly +lat_0=30 +lon_0=8 +datum=WGS84 +units=m").to_wkt()
    with pytest.raises(BadInputError, match="gdalwarp -t_srs EPSG:4326"):
        read_chart(write_chart(tmp_path / "own.tif", marked(50, 50), own, 5.0, 7.0, 1.0))
    with pytest.raises(BadInputError, match="around the earth"):
        read_chart(write_chart(tmp_path / "all.tif", marked(50, 50), "EPSG:4326", -180.0, 90.0, 0.9))
    for absent in (tmp_path / "nowhere.tif", tmp_path):
        with pytest.raises(UsageError, match="there is no such file"):
            read_chart(absent)
