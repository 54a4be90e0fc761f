"""Verdicts in exports: every format carries them, GDAL opens them, and what people wrote stays text."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from auv_mcm.cli import main
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from sim_replay.mcap_export import write_mcap
from sim_replay.mosaic import Box, Mosaic
from sim_replay.mosaic_files import write_kmz
from sim_replay.qgis import write_project
from sim_replay.vector_layers import read_layers
from sim_replay.verdict_layers import COLUMNS, kml_folders
from sim_replay.verdicts import Verdict, append_verdict
from tests.make.results import write_results
from tests.sim_replay.report_samples import contact, detection
from tests.sim_replay.test_mcap_export import START_S, decoded, timed
from tests.sim_replay.test_mosaic import ROW_M, tile
from tests.sim_replay.test_vector_layers import HOSTILE, gdal_layers

SCRIPT = "</value>]]><script>alert('x')</script>&amp;\"=1+1\x1b\u202e"
SHOWN = "</value>]]><script>alert('x')</script>&amp;\"=1+1\\x1b\\u202e"  # as clean() writes it out


def judged(number: int, latitude_deg: float, **more: Any) -> Verdict:
    return Verdict(
        object=f"V{number:04d}",
        time="2026-05-04T10:00:00Z",
        by=HOSTILE,
        latitude_deg=latitude_deg,
        longitude_deg=12.0,
        type=SCRIPT,
        comment=SCRIPT,
        **more,
    )


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with a contact judged a mine against the chain, one judged not, one nobody judged, and places alone."""
    folder = tmp_path_factory.mktemp("results")
    places = {"C00001": (0.9, 55.0), "C00002": (0.1, 55.001), "C00003": (0.5, 55.002)}
    contacts = [
        contact(name, p, latitude_deg=lat, views=(detection(latitude_deg=lat),)) for name, (p, lat) in places.items()
    ]
    write_results(folder, contacts, [], [], HOSTILE)
    (folder / "snippets").mkdir()
    (folder / "snippets" / "C00001.png").write_bytes(b"png")
    (folder / "summary.json").write_text(json.dumps({"logs": [{"path": "gone.xtf"}]}))
    for verdict in (
        judged(1, 55.0, call="not_mine_like"),
        judged(2, 55.001, call="undecided"),
        judged(2, 55.001, call="mine_like"),
        judged(3, 55.01, call="mine_like", drawn=True, side="port", ground_range_m=6.0),
        judged(4, 55.02, call="not_mine_like"),
        judged(5, 55.03, call="mine_like", drawn=True),
        judged(5, 55.03, withdrawn=True),
    ):
        append_verdict(folder, verdict)
    return folder


def test_layers_carry_the_newest_verdict_and_keep_every_contact(results: Path) -> None:
    layers = read_layers(results)
    found = {one["properties"]["id"]: one["properties"] for one in layers["contacts"]}
    assert {name: one["verdict"] for name, one in found.items()} == {
        "C00001": "not_mine_like",
        "C00002": "mine_like",
        "C00003": None,
    }
    assert found["C00001"]["verdict_comment"] == SHOWN
    assert [found["C00003"][name] for name in COLUMNS] == [None] * 5
    assert [one["properties"]["id"] for one in layers["missed_contacts"]] == ["V0003"]
    assert [one["properties"]["id"] for one in layers["unmatched_verdicts"]] == ["V0004"]


def test_gdal_opens_every_format_with_its_verdicts(results: Path, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio", reason="pyogrio, which brings GDAL, is not installed")
    names = {kind: tmp_path / f"m.{kind}" for kind in ("gpkg", "gpx", "kml", "geojson")}
    options = [word for kind, path in names.items() for word in (f"--{kind}", str(path))]
    assert main(["export", str(results), *options]) == 0
    assert {"missed_contacts", "unmatched_verdicts"} <= set(gdal_layers(names["gpkg"]))
    meta, _, _, values = pyogrio.raw.read(names["gpkg"], layer="contacts")
    rows = dict(zip(meta["fields"], map(list, values), strict=True))
    assert rows["verdict"] == ["not_mine_like", "mine_like", None]
    assert rows["verdict_comment"][0] == SHOWN
    assert {name: info["features"] for name, info in gdal_layers(names["kml"]).items()} == {
        "Mine-like (3)": 3,
        "Missed (1)": 1,
        "Other verdicts (1)": 1,
    }
    assert gdal_layers(names["gpx"])["waypoints"]["features"] == 4
    (whole,) = gdal_layers(names["geojson"]).values()
    assert whole["features"] == 5
    assert {"layer", *COLUMNS} <= set(whole["fields"])


def test_pictures_in_a_folder_whose_name_is_no_text_are_found(results: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(results, tmp_path / os.fsdecode(b"\xe9"))
    assert main(["export", str(folder), "--kml", str(tmp_path / "m.kml")]) == 0
    assert "%E9/snippets/C00001.png" in (tmp_path / "m.kml").read_text()
    with pytest.raises(UsageError, match="Rename it"):
        write_project(tmp_path / "m.qgs", [], read_layers(folder), folder / "m.gpkg", "", Box(0.0, 0.0, 1.0, 1.0))


def test_what_people_wrote_stays_text_in_xml(results: Path, tmp_path: Path) -> None:
    assert main(["export", str(results), "--kml", str(tmp_path / "m.kml"), "--gpx", str(tmp_path / "m.gpx")]) == 0
    for name in ("m.kml", "m.gpx"):
        tree = ElementTree.fromstring((tmp_path / name).read_text())
        assert not [one for one in tree.iter() if one.tag.endswith("script")]
        assert any(SHOWN in (one.text or "") for one in tree.iter())
    balloons = [one.text or "" for one in ElementTree.fromstring((tmp_path / "m.kml").read_text()).iter()]
    assert not any("<script" in text for text in balloons if text.startswith(("<table", "<img")))
    assert any("snippets/C00001.png" in text for text in balloons)


def test_a_kmz_carries_contacts_over_its_mosaic(results: Path, tmp_path: Path) -> None:
    mosaic = Mosaic(Config(), 0.25)
    mosaic.add(tile())
    write_kmz(tmp_path / "m.kmz", list(mosaic.levels()), "mission", folders=kml_folders(read_layers(results)))
    tree = ElementTree.fromstring(zipfile.ZipFile(tmp_path / "m.kmz").read("doc.kml"))
    placemarks = [one for one in tree.iter() if one.tag.endswith("Placemark")]
    assert len(placemarks) == 5
    schema = ["name", "description", "TimeStamp", "styleUrl", "ExtendedData", "Point"]  # their order, OGC 07-147r2
    for one in placemarks:
        parts = [part.tag.split("}")[1] for part in one]
        assert parts == [part for part in schema if part in parts]
    in_document = [part.tag.split("}")[1] for part in tree[0]]
    assert list(dict.fromkeys(in_document)) == ["name", "Style", "Folder", "GroundOverlay"], (
        "styles before what is shown"
    )


def test_the_balloon_of_a_contact_states_p_mine_as_the_other_files_do() -> None:
    seen = {"type": "Feature", "geometry": None, "properties": {"id": "C00001", "p_mine": 0.9996, "sigma_m": 1.25}}
    text = "".join(kml_folders({"contacts": [seen]}))
    assert all(f"&lt;td&gt;{said}&lt;/td&gt;" in text for said in ("0.9996", "1.25"))


def test_annotations_of_a_picture_say_the_verdict(tmp_path: Path) -> None:
    def view(row: float) -> dict[str, object]:
        time = datetime.fromtimestamp(START_S + row * ROW_M / 2.0, UTC).isoformat()
        return {"time": time, "side": "starboard", "ground_range_m": 6.0}

    said = {"verdict": "mine_like", "verdict_type": "anchor", "verdict_comment": "", "judged_by": "kim"}
    place = {"type": "Point", "coordinates": [12.0, 55.0]}
    seen = {"geometry": place, "properties": {"id": "C00001", "p_mine": 0.1, "views": [view(10.5)], **said}}
    missed = {"geometry": place, "properties": {"id": "V0002", **view(20.5), **said}}
    lost = {"geometry": place, "properties": {"id": "V0003", **view(20.5), **said, "time": "no time"}}
    write_mcap(tmp_path / "m.mcap", [timed(0)], {"contacts": [seen], "missed_contacts": [missed, lost]})
    messages = {topic: message for topic, _, message, _ in decoded(tmp_path / "m.mcap")}
    texts = [one.text for one in messages["/sonar/starboard/contacts"].texts]
    assert texts == ["C00001 0.1000 judged mine like by kim: anchor", "V0002 missed, judged mine like by kim: anchor"]
