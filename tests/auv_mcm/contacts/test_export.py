"""Exported files: the contract's keys and values, strict JSON, equal bytes, and geometry cut at the antimeridian."""

from __future__ import annotations

import csv
import html
import io
import json
import math
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import FRAME, bounded_by, singleton_belief
from auv_mcm.contacts.antimeridian import split_line, split_ring
from auv_mcm.contacts.contact import best_view, error_ellipse, error_ellipse_ring_m
from auv_mcm.contacts.export import CSV_COLUMNS, contact_feature, contacts_geojson, iso_time, waypoints_geojson
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.records import NAN, Contact, CoveragePatch, Detection, Waypoint
from auv_mcm.shell.mission_totals import contact_totals
from auv_mcm.snippet import pack_snippet
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.whole_exports import contacts_csv, contacts_kml, coverage_geojson
from tests.make.records import patch_of, waypoint_of

KML = "{http://www.opengis.net/kml/2.2}"


def detection(**changes: Any) -> Detection:
    known: dict[str, Any] = {
        "side": "port",
        "time_s": 1_700_000_000.0,
        "latitude_deg": 55.1,
        "longitude_deg": 12.2,
        "aspect_deg": 287.2,
        "ground_range_m": 18.6,
        "score": 14.2,
        "p_mine": 0.8,
        "reasons": ("bright",),
        "snippet": pack_snippet(np.ones((8, 16))),
        "snippet_row": 4.0,
        "snippet_column": 8.0,
    }
    return drawn_looks.detection(**{**known, **changes})


def contact(**changes: Any) -> Contact:
    known: dict[str, Any] = {
        "id": "C0001",
        "time_s": 1_700_000_000.1234,
        "latitude_deg": 55.123456789012,
        "longitude_deg": 12.5,
        "covariance_m2": np.array([[4.0, 0.0], [0.0, 1.0]]),
        "p_mine": 0.87654321,
        "classification": "cylinder",
        "belief": {"unknown": 0.25, "cylinder": 0.75},
        "length_m": 2.0,
        "aspects_deg": (12.0,),
        "reasons": ("long and narrow", "shadow 1.9 m"),
        "views": (detection(), detection(score=20.0, side="starboard", ground_range_m=30.0, time_s=1_700_000_100.0)),
    }
    return drawn_looks.contact(**{**known, **changes})


def patch(ring: list[tuple[float, float]], **changes: Any) -> CoveragePatch:
    known = {
        "stop_s": 1.5,
        "rings_deg": (np.array(ring),),
        "covered_m2": 12.0,
        "lost_m2": {"turn": 3.0, "invalid": NAN},
    }
    return patch_of(**(known | changes))


def strict(data: bytes) -> Any:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(data, parse_constant=refuse)


def area(ring: NDArray[np.float64] | list[list[float]]) -> float:
    """Shoelace, signed: positive when counter-clockwise."""
    points = np.asarray(ring) - np.asarray(ring)[0]
    return 0.5 * float(np.sum(points[:-1, 0] * points[1:, 1] - points[1:, 0] * points[:-1, 1]))


def test_contact_properties_are_those_of_the_contract() -> None:
    (feature,) = strict(contacts_geojson([contact()]))["features"]
    assert feature["geometry"] == {"type": "Point", "coordinates": [12.5, 55.123456789]}
    assert feature["properties"] == {
        "id": "C0001",
        "time": "2023-11-14T22:13:20.123Z",
        "p_mine": 0.8765,
        "class": "cylinder",
        "belief": {"cylinder": 0.75, "unknown": 0.25},
        "length_m": 2.0,
        "width_m": 0.5,
        "height_m": None,
        "n_views": 2,
        "aspects_deg": [12.0],
        "sigma_m": 2.0,
        "side": "starboard",
        "ground_range_m": 30.0,
        "snippet": "snippets/C0001.png",
        "reasons": ["long and narrow", "shadow 1.9 m"],
        "score": 20.0,
        "covariance_m2": [[4.0, 0.0], [0.0, 1.0]],
        "length_sigma_m": None,
        "width_sigma_m": None,
        "height_sigma_m": None,
        "conflict": None,
        "next_look_deg": [],
        "false_alarms_per_km2": None,
        "false_alarms_95_per_km2": [None, None],
        "called": None,
        "depth_m": None,
        "mine_kind_open": 0.1265,
        "summary": "Very likely a mine, 88 %. Cylinder about 2.0 m. Seen twice.",
        "views": [
            {
                "time": time,
                "side": side,
                "aspect_deg": 287.2,
                "ground_range_m": ground_range_m,
                "p_mine": 0.8,
                "log_ratio": None,
                "belief": None,
                "reasons": ["bright"],
            }
            for time, side, ground_range_m in (
                ("2023-11-14T22:13:20.000Z", "port", 18.6),
                ("2023-11-14T22:15:00.000Z", "starboard", 30.0),
            )
        ],
    }


def test_what_confirmation_found_is_written_per_view_and_for_all_together() -> None:
    mass = drawn_looks.like("wedge", quality=0.9)
    found = drawn_looks.confirmation(3.14159, mass=mass, reasons=("buried", "bright"))
    assert bounded_by(mass, 0.7) == pytest.approx(mass), "as sure of a mine as p_mine allows"
    exported = contact(
        length_sigma_m=0.12345,
        width_sigma_m=0.05,
        conflict=0.123456,
        next_look_deg=(37.00012, 120.0),
        views=(detection(confirmation=found), detection(aspect_deg=NAN)),
    )
    properties = strict(contacts_geojson([exported]))["features"][0]["properties"]
    assert [properties[name] for name in ("length_sigma_m", "width_sigma_m", "height_sigma_m")] == [0.123, 0.05, None]
    assert properties["conflict"] == 0.1235
    assert properties["next_look_deg"] == [37.0, 120.0]
    close, far = properties["views"]
    assert close["log_ratio"] == 3.142
    assert list(close["belief"]) == [*FRAME, "unknown"]
    assert close["belief"] == {name: pytest.approx(share, abs=5e-5) for name, share in singleton_belief(mass).items()}
    assert close["reasons"] == ["bright", "buried"]
    assert [far[name] for name in ("aspect_deg", "log_ratio", "belief")] == [None, None, None]
    assert CSV_COLUMNS[16] == "reasons", "columns of before stay where they were"
    description = contacts_kml([exported])
    assert "2.00 ± 0.12 × 0.50 ± 0.05 × ? m" in description
    assert "belief in the class&lt;/td&gt;&lt;td&gt;0.75" in description


def test_the_belief_of_a_view_never_contradicts_its_p_mine() -> None:
    found = drawn_looks.confirmation(6.0, drawn_looks.like("cylinder"))
    seen = tuple(detection(p_mine=p_mine, confirmation=found) for p_mine in (0.9, 0.3, 0.01))
    properties = strict(contacts_geojson([contact(views=seen)]))["features"][0]["properties"]
    for view in properties["views"]:
        mines = sum(share for name, share in view["belief"].items() if name not in ("clutter", "unknown"))
        assert mines <= view["p_mine"] + 2e-4
        assert view["belief"]["clutter"] <= 1.0 - view["p_mine"] + 2e-4


def test_a_call_and_the_density_behind_it_are_in_every_file() -> None:
    exported = contact(false_alarms_per_km2=12.34567, false_alarms_95_per_km2=(3.0, 51.23456), called=True)
    properties = strict(contacts_geojson([exported]))["features"][0]["properties"]
    assert properties["false_alarms_per_km2"] == 12.346
    assert properties["false_alarms_95_per_km2"] == [3.0, 51.235]
    assert properties["called"] is True
    assert "yes; 12 false alarms per km² as mine-like are expected (3 to 51)" in contacts_kml([exported])


def test_bytes_do_not_depend_on_the_order_of_contacts_or_beliefs() -> None:
    one, two = contact(), contact(id="C0002", belief={"cylinder": 0.75, "unknown": 0.25})
    assert contacts_geojson([one, two]) == contacts_geojson([two, one])
    assert contacts_geojson([one]) == contacts_geojson([contact(belief={"cylinder": 0.75, "unknown": 0.25})])
    assert contacts_geojson([one]).endswith(b"\n")


def test_unknown_numbers_become_null_and_never_nan() -> None:
    blank = contact(
        time_s=NAN,
        latitude_deg=NAN,
        covariance_m2=np.full((2, 2), NAN),
        p_mine=math.inf,
        belief={"unknown": NAN},
        aspects_deg=(NAN,),
        views=(),
    )
    (feature,) = strict(contacts_geojson([blank]))["features"]
    assert feature["geometry"] is None
    properties = feature["properties"]
    assert [properties[key] for key in ("time", "p_mine", "sigma_m", "side", "ground_range_m", "aspects_deg")] == [
        None
    ] * 5 + [[None]]
    assert "position not known" in contacts_kml([blank])
    assert next(csv.DictReader(io.StringIO(contacts_csv([blank]))))["p_mine"] == ""


@pytest.mark.parametrize(
    ("given_deg", "written"),
    [(180.0, -180.0), (179.99999999996, -180.0), (-180.0, -180.0), (190.25, -169.75), (-1e-12, 0.0)],
)
def test_longitudes_are_written_within_half_open_range(given_deg: float, written: float) -> None:
    (feature,) = strict(contacts_geojson([contact(longitude_deg=given_deg)]))["features"]
    assert feature["geometry"]["coordinates"][0] == written
    assert b"-0.0" not in contacts_geojson([contact(longitude_deg=given_deg)])


def test_times_are_utc_with_milliseconds() -> None:
    assert iso_time(0.0) == "1970-01-01T00:00:00.000Z"
    assert iso_time(1.9996) == "1970-01-01T00:00:02.000Z"
    assert iso_time(1e18) is None


@given(st.floats(0.1, 9.0), st.floats(0.1, 9.0), st.floats(0.0, math.pi))
def test_error_ellipse_has_the_covariance_it_came_from(first: float, second: float, turn: float) -> None:
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    covariance = rotation @ np.diag([first**2, second**2]) @ rotation.T
    ring = error_ellipse_ring_m(contact(covariance_m2=covariance), sigmas=1.0)
    distance = np.einsum("ni,ij,nj->n", ring, np.linalg.inv(covariance), ring)
    np.testing.assert_allclose(distance, 1.0, rtol=1e-6)
    assert area(ring) > 0.0


def test_major_axis_direction_is_a_compass_direction() -> None:
    assert error_ellipse(contact(covariance_m2=np.array([[4.0, 0.0], [0.0, 1.0]]))) == pytest.approx((2.0, 1.0, 90.0))
    assert error_ellipse(contact(covariance_m2=np.array([[1.0, 0.9], [0.9, 1.0]])))[2] == pytest.approx(45.0)


@pytest.mark.parametrize("north_deg", [0.0, 359.99996, 360.0, -1e-9])
def test_north_is_0_degrees_in_every_file_and_never_360(north_deg: float) -> None:
    seen = contact(
        aspects_deg=(north_deg,), next_look_deg=(north_deg,), views=(detection(aspect_deg=north_deg, score=20.0),)
    )
    properties: Any = contact_feature(seen)["properties"]
    assert properties["aspects_deg"] == properties["next_look_deg"] == [properties["views"][0]["aspect_deg"]] == [0.0]
    assert next(csv.DictReader(io.StringIO(contacts_csv([seen]))))["aspects_deg"] == "0.0"
    assert "<td>000°</td>" in html.unescape(contacts_kml([seen]))
    way = [waypoint_of("leg_entry", 0.5, 9.0, 1, heading_rad=math.radians(north_deg))]
    assert strict(waypoints_geojson(way))["features"][0]["properties"]["heading_deg"] == 0.0


def test_csv_reads_back_and_disarms_formulas() -> None:
    hostile = contact(id="=1+1", latitude_deg=-12.5, reasons=('a "quoted", comma', "line\nbreak"))
    text = contacts_csv([hostile, contact()])
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert text.startswith(",".join(CSV_COLUMNS) + "\r\n")
    assert [row["id"] for row in rows] == ["'=1+1", "C0001"]
    assert rows[0]["latitude_deg"] == "-12.5"
    assert rows[0]["reasons"] == 'a "quoted", comma; line\nbreak'
    for start in "=+-@\t\r":
        disarmed = csv.DictReader(io.StringIO(contacts_csv([contact(id=start + "x")]), newline=""))
        assert next(disarmed)["id"] == "'" + start + "x"


def test_a_row_of_the_table_says_what_the_feature_does() -> None:
    exported = contact(
        height_m=0.4,
        aspects_deg=(12.0, 287.25),
        length_sigma_m=0.123,
        height_sigma_m=0.05,
        false_alarms_per_km2=12.346,
        false_alarms_95_per_km2=(3.0, 51.2),
        called=False,
        views=(detection(depth_m=1.0), detection(score=20.0, side="starboard", ground_range_m=30.0, depth_m=14.75)),
    )
    (row,) = csv.DictReader(io.StringIO(contacts_csv([exported])))
    (feature,) = strict(contacts_geojson([exported]))["features"]
    said = feature["properties"]
    longitude, latitude = feature["geometry"]["coordinates"]
    low, high = said["false_alarms_95_per_km2"]
    said |= {"longitude_deg": longitude, "latitude_deg": latitude, "aspects_deg": "12.0 287.2", "called": "false"}
    said |= {"false_alarms_low_per_km2": low, "false_alarms_high_per_km2": high, "reasons": "; ".join(said["reasons"])}
    assert row == {name: "" if said[name] is None else str(said[name]) for name in CSV_COLUMNS}
    assert (said["depth_m"], said["side"]) == (14.75, "starboard"), "of the view with the greatest score"


def test_the_view_of_the_greatest_score_stands_for_a_contact_of_equals_the_earliest() -> None:
    scores = {5.0: NAN, 1.0: 7.0, 2.0: 9.0, 3.0: 9.0}
    seen = contact(views=tuple(detection(time_s=time_s, score=score) for time_s, score in scores.items()))
    best = best_view(seen)
    assert best is not None
    assert best.time_s == 2.0


def test_a_view_of_a_sub_aperture_says_of_which() -> None:
    seen = (detection(), detection(squint_rad=math.radians(-2.5)))
    views = strict(contacts_geojson([contact(views=seen)]))["features"][0]["properties"]["views"]
    assert [view.get("squint_deg") for view in views] == [None, -2.5]


def test_kml_is_xml_with_two_folders_whatever_the_names() -> None:
    hostile, called = contact(reasons=("<b>&]]>\x00",)), contact(id="C3", p_mine=0.1, called=True)
    clutter = contact(id="C<2>", p_mine=0.1, classification="clutter")
    text = contacts_kml([hostile, clutter, called], 'Lines "A" & <B>\x07')
    document = ElementTree.fromstring(text)[0]
    assert document.findtext(f"{KML}name") == 'Lines "A" & <B>\\x07'
    folders = document.findall(f"{KML}Folder")
    assert [folder.findtext(f"{KML}name") for folder in folders] == ["Mine-like (2)", "Clutter (1)"]
    description = folders[0].findtext(f"{KML}Placemark/{KML}description")
    assert description is not None
    assert "&lt;b&gt;&amp;]]&gt;" in description
    ring = folders[0].findtext(f".//{KML}LinearRing/{KML}coordinates")
    assert ring is not None
    assert len(ring.split()) == 37


def test_a_contact_that_reaches_the_threshold_as_files_round_it_is_mine_like_everywhere() -> None:
    nothing_called = OperatingPoint(1.0, 1, 1.0, None, 9.0)
    marked = nothing_called.marked(
        contact(p_mine=0.19996, mine_kind="cylinder", belief={"clutter": 0.6, "cylinder": 0.1, "unknown": 0.3})
    )
    said: Any = contact_feature(marked)["properties"]
    assert (said["p_mine"], said["called"], said["class"]) == (0.2, False, "cylinder")
    assert said["summary"].startswith("Possibly a mine, 20 %.")
    assert contact_totals([marked], [])["contacts_mine_like"] == 1
    assert "<name>Mine-like (1)</name>" in contacts_kml([marked])


def test_the_kml_states_p_mine_as_the_other_files_do() -> None:
    for p_mine in (0.9996, 0.1961):
        one = contact(p_mine=p_mine)
        assert f"<tr><td>p_mine</td><td>{p_mine}</td></tr>" in html.unescape(contacts_kml([one]))
    assert "<tr><td>p_mine</td><td>not known</td></tr>" in html.unescape(contacts_kml([contact(p_mine=NAN)]))


def test_the_parts_of_a_kml_placemark_stand_in_the_order_of_its_schema() -> None:
    placemark = ElementTree.fromstring(contacts_kml([contact()])).find(f".//{KML}Placemark")
    assert placemark is not None
    order = ["name", "description", "TimeStamp", "styleUrl", "MultiGeometry"]  # AbstractFeatureType, OGC 07-147r2
    assert [part.tag.removeprefix(KML) for part in placemark] == order
    assert placemark.findtext(f"{KML}TimeStamp/{KML}when") == "2023-11-14T22:13:20.123Z"


def test_kml_error_ellipse_is_two_sigma_on_the_ground() -> None:
    text = contacts_kml([contact(latitude_deg=60.0, longitude_deg=10.0)])
    ring_text = ElementTree.fromstring(text).findtext(f".//{KML}LinearRing/{KML}coordinates")
    assert ring_text is not None
    ring = np.array([[float(number) for number in point.split(",")] for point in ring_text.split()])
    metres_per_degree = 111_412.84 * math.cos(math.radians(60.0)) - 93.5 * math.cos(math.radians(180.0))
    assert np.ptp(ring[:, 0]) * metres_per_degree == pytest.approx(8.0, rel=1e-3)  # east sigma 2 m, both ways, 2 sigma
    assert np.ptp(ring[:, 1]) * 111_412.0 == pytest.approx(4.0, rel=1e-3)


def test_coverage_crossing_the_antimeridian_becomes_a_multipolygon() -> None:
    ring = [(179.9, 10.0), (-179.9, 10.0), (-179.9, 10.1), (179.9, 10.1), (179.9, 10.0)]
    (feature,) = strict(coverage_geojson([patch(ring)]))["features"]
    assert feature["geometry"]["type"] == "MultiPolygon"
    west, east = (polygon[0] for polygon in feature["geometry"]["coordinates"])
    assert {point[0] for point in west} == {179.9, 180.0}
    assert {point[0] for point in east} == {-180.0, -179.9}
    assert area(west) == pytest.approx(0.01)
    assert area(east) == pytest.approx(0.01)


def test_coverage_rings_are_counter_clockwise_and_closed_and_in_tile_order() -> None:
    clockwise = [(1.0, 1.0), (1.0, 2.0), (2.0, 2.0), (2.0, 1.0), (1.0, 1.0)]
    patches = [patch(clockwise, side="starboard"), patch(clockwise, tile_index=3), patch(clockwise)]
    features = strict(coverage_geojson(patches))["features"]
    order = [(feature["properties"]["tile"], feature["properties"]["side"]) for feature in features]
    assert order == [(0, "port"), (0, "starboard"), (3, "port")]
    (ring,) = features[0]["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    assert area(ring) == pytest.approx(1.0)


def test_a_patch_without_a_known_outline_keeps_its_numbers() -> None:
    rings = (np.full((5, 2), NAN),)
    times = {"start_s": 1_700_000_000.0, "stop_s": 1_700_000_001.5}
    placeless = patch([(0.0, 0.0)], rings_deg=rings, tile_index=3, evaluated_fraction=0.25, **times)
    (feature,) = strict(coverage_geojson([placeless]))["features"]
    assert feature["geometry"] is None
    assert feature["properties"] == {
        "side": "port",
        "tile": 3,
        "start": "2023-11-14T22:13:20.000Z",
        "stop": "2023-11-14T22:13:21.500Z",
        "covered_m2": 12.0,
        "evaluated_fraction": 0.25,
        "lost_m2": {"invalid": None, "turn": 3.0},
    }


@given(
    st.lists(st.tuples(st.floats(0.2, 1.0), st.floats(0.2, 1.0)), min_size=4, max_size=14),
    st.floats(-1.2, 1.2),
    st.booleans(),
    st.booleans(),
)
def test_split_rings_cover_what_the_ring_covered(
    spikes: list[tuple[float, float]], centre: float, backwards: bool, wrapped: bool
) -> None:
    """Star-shaped rings, so that the meridian may cut them several times; inside is tested point by point."""
    angles = np.linspace(0.0, 2.0 * np.pi, len(spikes), endpoint=False)
    radius = np.array([first * second for first, second in spikes])
    ring = np.column_stack([180.0 + centre + radius * np.cos(angles), 20.0 + radius * np.sin(angles)])
    ring = np.vstack([ring, ring[:1]])
    if wrapped:
        ring[:, 0] = (ring[:, 0] + 180.0) % 360.0 - 180.0
    pieces = split_ring(ring[::-1] if backwards else ring)
    continuous = np.column_stack([np.where(ring[:, 0] < 0.0, ring[:, 0] + 360.0, ring[:, 0]), ring[:, 1]])
    assert sum(area(piece) for piece in pieces) == pytest.approx(abs(area(continuous)), abs=1e-9)
    for piece in pieces:
        assert area(piece) > 0.0
        assert (np.abs(piece[:, 0]) <= 180.0).all()
        assert (np.abs(np.diff(piece[:, 0])) < 10.0).all()
    generator = np.random.default_rng(1)
    for east, north in np.column_stack(
        [180.0 + centre + generator.uniform(-1, 1, 40), 20.0 + generator.uniform(-1, 1, 40)]
    ):
        wrapped_east = east - 360.0 if east >= 180.0 else east
        assert inside(continuous, east, north) == (sum(inside(piece, wrapped_east, north) for piece in pieces) == 1)


def inside(ring: NDArray[np.float64], east: float, north: float) -> bool:
    """Even-odd rule."""
    odd = False
    for (east1, north1), (east2, north2) in pairwise(ring.tolist()):
        if (north1 > north) != (north2 > north) and east < east1 + (north - north1) / (north2 - north1) * (
            east2 - east1
        ):
            odd = not odd
    return odd


def test_a_comb_across_the_antimeridian_falls_into_its_teeth() -> None:
    longitudes = (179.0, 181.0, 181.0, 179.5, 179.5, 181.0, 181.0, 179.0, 179.0)
    pieces = split_ring(np.column_stack([longitudes, (0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 0.0)]))
    assert sorted(round(area(piece), 9) for piece in pieces) == [1.0, 1.0, 2.5]


@pytest.mark.parametrize("edge", [180.0, -180.0])
def test_a_ring_that_only_touches_the_antimeridian_stays_whole(edge: float) -> None:
    inner = edge - math.copysign(1.0, edge)
    (piece,) = split_ring(np.array([(inner, 0.0), (edge, 0.0), (edge, 1.0), (inner, 1.0), (inner, 0.0)]))
    assert area(piece) == pytest.approx(1.0)


@pytest.mark.parametrize("latitude", [89.5, -89.5])
def test_a_ring_around_the_pole_is_closed_over_the_pole(latitude: float) -> None:
    ring = np.array([(longitude, latitude) for longitude in range(-180, 181, 30)], dtype=float)
    pieces = split_ring(ring)
    assert sum(area(piece) for piece in pieces) == pytest.approx(360.0 * 0.5)


def test_lines_are_cut_at_the_antimeridian_and_join_there() -> None:
    pieces = split_line(np.array([(179.0, 0.0), (-179.0, 2.0), (-178.0, 2.0), (179.0, 5.0)]))
    longitudes = [piece[:, 0].tolist() for piece in pieces]
    assert longitudes == [[179.0, 180.0], [-180.0, -179.0, -178.0, -180.0], [180.0, 179.0]]
    assert pieces[0][-1, 1] == pieces[1][0, 1] == 1.0


def waypoint(leg: int, kind: str, longitude: float) -> Waypoint:
    return waypoint_of(kind, 0.5, longitude, leg, heading_rad=-0.1, contact_id="C0001", why="a <second> look")


def test_waypoints_come_in_order_with_one_line_per_leg_from_where_the_last_ended() -> None:
    way = [
        waypoint(1, "start", 179.8),
        waypoint(1, "leg_entry", 179.9),
        waypoint(1, "leg_exit", -179.9),
        waypoint(2, "leg_entry", -179.8),
    ]
    features = strict(waypoints_geojson(way))["features"]
    assert [feature["geometry"]["type"] for feature in features] == ["Point"] * 4 + ["MultiLineString", "LineString"]
    assert [feature["properties"]["order"] for feature in features[:4]] == [0, 1, 2, 3]
    assert features[0]["properties"]["heading_deg"] == pytest.approx(354.2704)
    assert features[4]["geometry"]["coordinates"] == [
        [[179.8, 0.5], [179.9, 0.5], [180.0, 0.5]],
        [[-180.0, 0.5], [-179.9, 0.5]],
    ]
    assert features[5]["geometry"]["coordinates"] == [[-179.9, 0.5], [-179.8, 0.5]]


def test_nothing_to_write_is_an_empty_collection() -> None:
    empty = {"type": "FeatureCollection", "features": []}
    assert strict(contacts_geojson([])) == strict(coverage_geojson([])) == strict(waypoints_geojson([])) == empty
    assert contacts_csv([]) == ",".join(CSV_COLUMNS) + "\r\n"
    assert ElementTree.fromstring(contacts_kml([])).tag == f"{KML}kml"
