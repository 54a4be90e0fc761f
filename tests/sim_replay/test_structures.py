"""Structures: a crowded place is one outline, scattered contacts are none, and no contact is ever dropped."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from auv_mcm.cli import main
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.structures import LINK_M, MIN_MEMBERS, Member, find_structures, structure_feature
from sim_replay.vector_layers import read_layers
from tests.make.results import write_results
from tests.sim_replay.report_samples import contact, detection
from tests.sim_replay.test_vector_layers import gdal_layers

Array = NDArray[np.float64]
HOME = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)
GPX = "{http://www.topografix.com/GPX/1/1}"


def members(places: Array, home: LocalFrame = HOME, length_m: float = 1.0, called: bool = False) -> list[Member]:
    latitude, longitude, _ = home.to_geodetic(np.column_stack([places, np.zeros(len(places))]))
    return [
        Member(f"C{number:05d}", lat, lon, length_m, 0.05, called)
        for number, (lat, lon) in enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True), 1)
    ]


def scattered(seed: int, n: int = 200, side_m: float = 300.0) -> Array:
    return np.random.Generator(np.random.PCG64(seed)).uniform(0.0, side_m, (n, 2))


def wreck(seed: int = 1, n: int = 14) -> Array:
    """Contacts along a hull of 30 by 6 m, in the middle of `scattered`."""
    random = np.random.Generator(np.random.PCG64(seed))
    along = np.linspace(0.0, 30.0, n)
    return np.column_stack([135.0 + along, 147.0 + random.uniform(0.0, 6.0, n)])


def test_a_crowded_place_is_one_structure_with_its_outline_and_size() -> None:
    crowd = wreck()
    (found,) = find_structures(members(np.vstack([crowd, scattered(1, n=60)])))
    assert {f"C{number:05d}" for number in range(1, 15)} <= {one.contact_id for one in found.members}
    assert found.length_m == pytest.approx(31.0, abs=1.5)  # half a metre of a contact at either end
    assert 4.0 < found.width_m < 9.0
    ring = HOME.to_enu(found.outline_deg[:, 1], found.outline_deg[:, 0], 0.0)[:, :2]
    own = HOME.to_enu([m.latitude_deg for m in found.members], [m.longitude_deg for m in found.members], 0.0)[:, :2]
    assert ConvexHull(np.vstack([ring, own])).volume == pytest.approx(found.area_m2, rel=1e-3)  # all lie within
    assert (ring[0] == ring[-1]).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(5, 400))
def test_scattered_contacts_are_none(seed: int, n: int) -> None:
    assert find_structures(members(scattered(seed, n))) == ()


@pytest.mark.parametrize("n_scattered", [0, 600])
def test_contacts_in_a_row_are_one_structure_however_many_lie_elsewhere(n_scattered: int) -> None:
    row = np.column_stack([np.arange(MIN_MEMBERS) * 0.98 * LINK_M, np.zeros(MIN_MEMBERS)])
    (found,) = find_structures(members(np.vstack([row, 400.0 + scattered(3, n=n_scattered, side_m=3000.0)])))
    assert [one.contact_id for one in found.members] == [f"C{number:05d}" for number in range(1, MIN_MEMBERS + 1)]


def test_the_order_of_contacts_makes_no_difference() -> None:
    everything = members(np.vstack([wreck(), scattered(2)]))
    (found,), (again,) = find_structures(everything), find_structures(everything[::-1])
    assert (found.members, found.length_m) == (again.members, again.length_m)
    assert (found.outline_deg == again.outline_deg).all()


def test_few_contacts_near_one_another_or_without_position_are_no_structure() -> None:
    near = np.column_stack([np.arange(MIN_MEMBERS - 1) * 0.5 * LINK_M, np.zeros(MIN_MEMBERS - 1)])
    assert find_structures(members(near)) == ()
    assert find_structures([one._replace(latitude_deg=math.nan) for one in members(wreck())]) == ()
    assert find_structures([]) == ()


def test_across_the_antimeridian_the_outline_is_split() -> None:
    home = LocalFrame(latitude_deg=10.0, longitude_deg=180.0)
    (found,) = find_structures(members(wreck() - [150.0, 150.0], home))
    assert found.length_m == pytest.approx(31.0, abs=1.5)
    pieces = [np.array(piece[0])[:, 0] for piece in structure_feature(found)["geometry"]["coordinates"]]
    assert sorted(float(np.sign(piece).mean()) for piece in pieces) == [-1.0, 1.0]
    assert min(np.abs(piece).min() for piece in pieces) > 179.999


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with a wreck, a called mine beside it and one far away."""
    folder = tmp_path_factory.mktemp("wreck")
    places = members(np.vstack([wreck(), [[136.0, 155.0], [20.0, 20.0]]]))
    contacts = [
        contact(
            one.contact_id,
            0.9 if number >= 14 else 0.05,
            called=number >= 14,
            latitude_deg=one.latitude_deg,
            longitude_deg=one.longitude_deg,
            views=(detection(),),
        )
        for number, one in enumerate(places)
    ]
    write_results(folder, contacts, [], [], "")
    (folder / "summary.json").write_text(json.dumps({"logs": [{"path": "gone.xtf"}]}))
    return folder


def test_members_stay_contacts_and_a_called_one_stays_called(results: Path) -> None:
    layers = read_layers(results)
    assert len(layers["contacts"]) == 16
    of_structure = {one["properties"]["id"]: one["properties"]["structure"] for one in layers["contacts"]}
    assert of_structure["C00015"] == "S001"
    assert of_structure["C00016"] is None
    assert [one["properties"]["id"] for one in layers["contacts"] if one["properties"]["called"]] == [
        "C00015",
        "C00016",
    ]
    (found,) = layers["structures"]
    assert found["properties"]["n_contacts"] == 15
    assert found["properties"]["called_contacts"] == ["C00015"]


def test_a_chart_plotter_gets_a_structure_as_one_way_point_at_its_middle(results: Path, tmp_path: Path) -> None:
    assert main(["export", str(results), "--gpx", str(tmp_path / "m.gpx")]) == 0
    root = ElementTree.parse(tmp_path / "m.gpx").getroot()
    (point,) = (one for one in root.iter(f"{GPX}wpt") if one.findtext(f"{GPX}type") == "structure")
    (found,) = read_layers(results)["structures"]
    sizes = found["properties"]
    assert point.findtext(f"{GPX}name") == sizes["id"]
    assert point.findtext(f"{GPX}desc") == (
        f"{sizes['length_m']:.0f} x {sizes['width_m']:.0f} m, 15 contacts, 1 of them called"
    )
    longitude, latitude = np.array(found["geometry"]["coordinates"][0]).T
    assert longitude.min() < float(point.attrib["lon"]) < longitude.max()
    assert latitude.min() < float(point.attrib["lat"]) < latitude.max()


def test_gdal_opens_structures_as_polygons(results: Path, tmp_path: Path) -> None:
    names = {kind: tmp_path / f"m.{kind}" for kind in ("gpkg", "kml", "geojson")}
    assert main(["export", str(results), *(w for k, p in names.items() for w in (f"--{k}", str(p)))]) == 0
    assert gdal_layers(names["gpkg"])["structures"]["geometry_type"] == "Polygon"
    layers = gdal_layers(names["kml"])
    assert {name: info["features"] for name, info in layers.items()} == {
        "Structures (1)": 1,
        "Mine-like (2)": 2,
        "Clutter (14)": 14,
    }
    (whole,) = gdal_layers(names["geojson"]).values()
    assert whole["features"] == 17
