"""Layers of results: what GDAL reads from GeoPackage, GPX and KML is what the GeoJSON files hold."""

from __future__ import annotations

import json
import resource
import shutil
import sqlite3
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.contacts.geojson import Json, collection, feature
from auv_mcm.errors import HardwareError
from sim_replay.geopackage import write_geopackage
from sim_replay.mosaic import Box
from sim_replay.qgis import write_project
from sim_replay.report import PictureCollector, Shown
from sim_replay.report.report_file import report_contents, write_contents
from sim_replay.vector_layers import read_layers, write_gpx
from tests.make.records import patch_of
from tests.make.results import write_results
from tests.sim_replay.report_samples import contact, mission, waypoints

HOSTILE = "<b>\"x'; DROP TABLE contacts; --"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a replay leaves it, of made-up records."""
    folder = tmp_path_factory.mktemp("results")
    ring = np.array([(12.0, 55.0), (12.001, 55.0), (12.001, 55.001), (12.0, 55.0)])
    patch = patch_of(rings_deg=(ring, ring + 0.01), covered_m2=1.0)
    contacts = [
        contact("C00001"),
        contact("C00002", 0.1),
        contact("C00004", 0.1, called=True),
        contact("C00003", 0.5, latitude_deg=float("nan")),
    ]
    write_results(folder, contacts, [patch], waypoints(), HOSTILE)
    line: Json = {"type": "LineString", "coordinates": [[12.0, 55.0], [12.001, 55.0]]}
    (folder / "track.geojson").write_bytes(collection([feature(line, {})]))
    (folder / "summary.json").write_text(json.dumps({"logs": [{"path": "gone.xtf"}]}))
    return folder


def gdal_layers(path: Path) -> Mapping[str, Any]:
    pyogrio = pytest.importorskip("pyogrio", reason="pyogrio, which brings GDAL, is not installed")
    return {
        name: pyogrio.read_info(path, layer=name, force_feature_count=True) for name, _ in pyogrio.list_layers(path)
    }


def test_gdal_reads_every_layer_of_the_geopackage(results: Path, tmp_path: Path) -> None:
    assert main(["export", str(results), "--gpkg", str(tmp_path / "m.gpkg")]) == 0
    layers = gdal_layers(tmp_path / "m.gpkg")
    assert {name: (info["features"], info["geometry_type"]) for name, info in layers.items()} == {
        "contacts": (4, "Point"),
        "track": (1, "LineString"),
        "coverage": (1, "MultiPolygon"),
        "second_views": (1, "LineString"),
        **{f"waypoints_{kind}": (1, "Point") for kind in ("start", "turn", "leg_entry", "leg_exit")},
        "layer_styles": (1, None),
    }
    assert all(info["crs"] == "EPSG:4326" for name, info in layers.items() if name != "layer_styles")
    types = dict(zip(layers["contacts"]["fields"], layers["contacts"]["dtypes"], strict=True))
    assert types["p_mine"] == "float64"
    assert types["views"] == "object"
    assert types["time"].startswith("datetime64")
    assert tuple(layers["contacts"]["total_bounds"]) == (12.0, 55.0, 12.0, 55.0)
    assert tuple(layers["track"]["total_bounds"]) == (12.0, 55.0, 12.001, 55.0)


@pytest.mark.parametrize(
    "options",
    [
        ["--geojson", "contacts.geojson"],
        ["--gpx", "verdicts.jsonl"],
        ["--kml", "../log.xtf"],
        ["--kml", "../log.yaml"],
        ["--gpkg", "m", "--gpx", "m"],
        ["--qgis", "m.tif"],
    ],
)
def test_no_export_overwrites_a_log_its_results_or_another_export(
    results: Path, tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(results, tmp_path / "results"))
    (tmp_path / "log.xtf").write_bytes(b"the only copy")
    (folder / "summary.json").write_text(json.dumps({"logs": [{"path": str(tmp_path / "log.xtf")}]}))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    named = [word if word.startswith("--") else str(folder / word) for word in options]
    assert main(["export", str(folder), *named]) == 2
    assert "another file" in (said := capsys.readouterr().err) or "file for each" in said
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_track_that_the_results_lack_is_named(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(results, tmp_path / "session"))
    words = ["export", str(folder), "--gpx", str(tmp_path / "m.gpx")]
    assert main(words) == 0
    assert "notice" not in capsys.readouterr().out
    (folder / "track.geojson").unlink()  # as a session has none
    assert main(words) == 0
    assert f"notice: the track is not in it, as {folder} holds none" in capsys.readouterr().out


def test_gdal_reads_the_gpx_and_the_kml(results: Path, tmp_path: Path) -> None:
    assert main(["export", str(results), "--gpx", str(tmp_path / "m.gpx")]) == 0
    layers = gdal_layers(tmp_path / "m.gpx")
    found = {name: info["features"] for name, info in layers.items()}
    assert found == {"waypoints": 2, "routes": 1, "tracks": 1, "route_points": 4, "track_points": 2}
    assert {name: info["features"] for name, info in gdal_layers(results / "contacts.kml").items()} == {
        "Mine-like (3)": 3,
        "Clutter (1)": 1,
    }
    assert "snippets/C00001.png" in (results / "contacts.kml").read_text()


def test_the_gpx_states_p_mine_as_the_other_files_do(tmp_path: Path) -> None:
    said: dict[str, Json] = {"id": "C00001", "time": None, "p_mine": 0.9996, "class": "sphere", "called": True}
    write_gpx(tmp_path / "m.gpx", {"contacts": [feature({"type": "Point", "coordinates": [1.0, 2.0]}, said)]}, "")
    assert "<desc>p_mine 0.9996, sphere</desc>" in (tmp_path / "m.gpx").read_text()


def test_a_track_cut_at_the_antimeridian_has_longitudes_that_gpx_allows(tmp_path: Path) -> None:
    pieces: Json = [[[179.9, 1.0], [180.0, 1.0]], [[-180.0, 1.0], [-179.9, 1.0]]]
    track = feature({"type": "MultiLineString", "coordinates": pieces}, {})
    write_gpx(tmp_path / "m.gpx", {"track": [track]}, "mission")
    points = ElementTree.parse(tmp_path / "m.gpx").iter("{http://www.topografix.com/GPX/1/1}trkpt")
    longitudes = [float(point.attrib["lon"]) for point in points]
    assert longitudes == pytest.approx([179.9, 180.0, -180.0, -179.9])
    assert all(-180.0 <= longitude < 180.0 for longitude in longitudes)


def test_a_geopackage_is_whole_and_takes_any_name_and_value(tmp_path: Path) -> None:
    early = "0001-01-01T00:00:00+05:00"  # in UTC before any year
    features = [
        feature({"type": "Point", "coordinates": [1.0, 2.0]}, {HOSTILE: 1, "fid": 7, "mixed": 1, "list": [1, None]}),
        feature(None, {HOSTILE: 2.5, "mixed": "two", "yes": True, "time": early}),
    ]
    for _ in range(2):  # the second time another file is in the way
        write_geopackage(tmp_path / "m.gpkg", {HOSTILE: features, "empty": []})
    base = sqlite3.connect(tmp_path / "m.gpkg")
    try:
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert base.execute("SELECT table_name FROM gpkg_contents").fetchall() == [(HOSTILE,)]
        quoted = HOSTILE.replace('"', '""')
        rows = base.execute(f'SELECT "{quoted}", mixed, list, yes, time, geom IS NULL FROM "{quoted}"').fetchall()
        assert rows == [(1.0, "1", "[1, null]", None, None, 0), (2.5, "two", None, 1, early, 1)]
        base.execute("INSERT INTO gpkg_contents (table_name, data_type) VALUES ('notes', 'attributes')")
        (changed,) = base.execute("SELECT last_change FROM gpkg_contents WHERE table_name = 'notes'").fetchone()
        assert datetime.fromisoformat(changed).year > 2000, "the standard's default, for programs that add a layer"
    finally:
        base.close()
    assert [path.name for path in tmp_path.iterdir()] == ["m.gpkg"]


def test_a_geopackage_that_finds_no_room_is_no_defect_and_leaves_nothing(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        assert main(["export", str(results), "--gpkg", str(tmp_path / "m.gpkg")]) == HardwareError.exit_code
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert f"{tmp_path / 'm.gpkg'}: File too large" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_layers_without_results_or_of_damaged_ones_are_one_clear_line(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(tmp_path / "mission.xtf"), "--gpkg", str(tmp_path / "m.gpkg")]) == 2
    assert "there is no" in capsys.readouterr().err
    (tmp_path / "mission.xtf").touch()
    assert main(["export", str(tmp_path / "mission.xtf"), "--gpkg", str(tmp_path / "m.gpkg")]) == 2
    assert "replay the log first" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("{}")
    for place in ("contacts", "track", "waypoints"):
        for text in ('{"features"', '{"features":[{"geometry":null,"properties":null}]}', '{"features":[{}]}'):
            (tmp_path / f"{place}.geojson").write_text(text)
            assert main(["export", str(tmp_path), "--gpx", str(tmp_path / "m.gpx")]) == 3
            assert f"{place}.geojson cannot be read" in capsys.readouterr().err
        (tmp_path / f"{place}.geojson").write_text('{"features":[]}')


def test_the_style_of_contacts_covers_every_chance_once(results: Path, tmp_path: Path) -> None:
    assert main(["export", str(results), "--gpkg", str(tmp_path / "m.gpkg")]) == 0
    with sqlite3.connect(tmp_path / "m.gpkg") as base:
        (name, qml, default), *others = base.execute("SELECT f_table_name, styleQML, useAsDefault FROM layer_styles")
        assert (name, default, others) == ("contacts", 1, [])
        filters = [rule.attrib["filter"] for rule in ElementTree.fromstring(qml).iter("rule")]
        base.execute("CREATE TABLE chance (p_mine DOUBLE)")
        base.executemany("INSERT INTO chance VALUES (?)", [(p / 1000.0,) for p in range(1001)])
        counts = [base.execute(f"SELECT COUNT(*) FROM chance WHERE {one}").fetchone()[0] for one in filters]
    assert sum(counts) == 1001
    assert counts == [201, 300, 300, 200]


@pytest.mark.parametrize(("epsg", "palette", "n_legs"), [(4326, "", 1), (32633, "copper", 2)])
def test_the_qgis_project_shows_every_layer_and_mosaic_by_a_relative_path(
    epsg: int, palette: str, n_legs: int, results: Path, tmp_path: Path
) -> None:
    layers = read_layers(results)
    (tmp_path / "maps").mkdir()
    mosaics = [tmp_path / "maps" / f"m-{number}.tif" for number in range(n_legs)]
    write_geopackage(tmp_path / "m.gpkg", layers)
    outline = Box(11.0, 54.0, 13.0, 56.0)
    write_project(
        tmp_path / "m.qgs", mosaics, layers, tmp_path / "m.gpkg", HOSTILE, outline, epsg, is_coloured=bool(palette)
    )
    project = ElementTree.parse(tmp_path / "m.qgs").getroot()
    assert project.findtext("title") == HOSTILE
    assert project.findtext("projectCrs/spatialrefsys/authid") == f"EPSG:{epsg}"
    corners = [project.findtext(f"mapcanvas/extent/{side}") for side in ("xmin", "ymin", "xmax", "ymax")]
    assert corners == ["11.0", "54.0", "13.0", "56.0"]
    assert project.findtext("mapcanvas/units") == ("degrees" if epsg == 4326 else "meters")
    sources = [layer.findtext("datasource", "") for layer in project.iter("maplayer")]
    assert sources[-n_legs:] == [f"./maps/m-{number}.tif" for number in range(n_legs)], "the mosaic lies at the bottom"
    assert sources[0] == "./m.gpkg|layername=contacts"
    codes = [layer.findtext("srs/spatialrefsys/authid") for layer in project.iter("maplayer")]
    assert codes == ["EPSG:4326"] * (len(codes) - n_legs) + [f"EPSG:{epsg}"] * n_legs
    tables = {name for name in gdal_layers(tmp_path / "m.gpkg") if name != "layer_styles"}
    assert {source.partition("layername=")[2] for source in sources[:-n_legs]} == tables
    ids = [layer.findtext("id") for layer in project.iter("maplayer")]
    assert [layer.get("id") for layer in project.iter("layer-tree-layer")] == ids
    assert len(set(ids)) == len(ids)
    assert all(layer.find(".//renderer-v2") is not None for layer in project.iter("maplayer") if layer.get("geometry"))
    kinds = {renderer.get("type") for renderer in project.iter("rasterrenderer")}
    assert kinds == {"multibandcolor" if palette else "singlebandgray"}
    assert str(tmp_path) not in (tmp_path / "m.qgs").read_text()


def test_an_export_with_chips_of_what_nobody_judged_writes_nothing(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(results, tmp_path / "results")
    write_contents(folder, report_contents(Shown(mission(), [contact("C00001")], [], [], [], {}, PictureCollector())))
    wanted = ["--gpkg", str(tmp_path / "m.gpkg"), "--coco", str(tmp_path / "chips")]
    assert main(["export", str(folder), *wanted]) == 3
    assert "Judge some" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [folder]
