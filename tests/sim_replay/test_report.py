"""The mission report: self-contained, complete, safe with any name, true to the geometry, bounded for any length of
mission.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.contacts.contact_picture import COLOURS, display_levels, snippet_picture, snippet_png
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import LOW_RESOLUTION, NAN, TURN, VALID, CoveragePatch, Notice, Side
from auv_mcm.snippet import pack_snippet
from sim_replay.report import PictureCollector, render_report, write_report
from sim_replay.report.chart import WIDTH, draw_chart
from sim_replay.report.page import MAX_CARDS, MAX_ROWS
from sim_replay.report.pictures import MAX_JPEG_BYTES
from sim_replay.report.report_words import (
    area,
    degrees_minutes,
    distance,
    duration,
    explained_counters,
    is_loss,
    nice_step,
)
from sim_replay.verdicts import Verdict
from tests.sim_replay.report_samples import (
    ROW_M,
    START_S,
    Page,
    collected,
    contact,
    detection,
    mission,
    tile,
    waypoints,
)


def full_page(**changes: Any) -> str:
    contacts = [contact(), contact("C0002", 0.1, classification="clutter"), contact("C0003", 0.6, views=())]
    notices = [Notice(code="reader.zero_navigation", text="no <navigation> at first", place="line7.xtf, byte 1024")] * 9
    given: dict[str, Any] = {
        "mission": mission(),
        "contacts": contacts,
        "patches": [],
        "waypoints": waypoints(),
        "notices": notices,
        "counters": {"ping.gap": 2, "reader.pings": 461, "detect.over_budget": 0},
        "pictures": collected(),
    }
    return render_report(**(given | changes))


def test_the_page_is_well_formed_and_needs_nothing_but_itself(tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", mission(), [contact()], [], waypoints(), [], {}, collected())
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.sources
    assert all(source.startswith("data:image/") for source in page.sources)
    assert all(link.startswith("#") for link in page.links)
    assert set(page.tags).isdisjoint({"link", "iframe", "object", "base"})
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}';" in text
    assert "url(" not in re.sub(r"url\(#frame\)", "", text)
    assert "@import" not in text
    assert "://" not in re.sub(r"data:image/[a-z]+;base64,[A-Za-z0-9+/=]+", "", text)


def test_the_summary_is_one_page_without_script_that_lists_the_likeliest(tmp_path: Path) -> None:
    contacts = [contact(f"C{number:05d}", 0.9 - 0.01 * number) for number in range(1, 21)] + [contact("C00021", 0.1)]
    write_report(tmp_path / "report.html", mission(name="<b>"), contacts, [], waypoints(), [], {}, collected())
    text = (tmp_path / "one-page.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "script" not in page.tags
    assert "<b>" in page.text
    assert "8 more mine-like contacts in the report" in page.text
    assert re.findall(r"<tr><td>(C\d+)</td>", text) == [one.id for one in contacts[:12]]
    assert "judged by" in page.text


def test_every_contact_has_its_card_and_every_link_a_place_to_go() -> None:
    page = Page(full_page())
    assert {"C0001", "C0002", "C0003"} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links} <= set(page.ids)


def test_likely_contacts_come_first_and_clutter_is_folded_away() -> None:
    text = full_page()
    places = [text.index(f'" id="{name}"') for name in ("C0001", "C0003", "C0002")]
    assert places == sorted(places)
    assert places[1] < text.index("1 contact that is probably not a mine") < places[2]
    assert text.index("<details", places[1]) < places[2]


def test_a_page_of_thousands_of_contacts_stays_small_and_lists_the_likeliest() -> None:
    rng = np.random.default_rng(1)
    contacts = [
        contact(f"C{number:05d}", float(p))
        for number, p in enumerate(rng.uniform(0.01, 0.9, MAX_CARDS + MAX_ROWS + 900), 1)
    ]
    text = full_page(contacts=contacts)
    page = Page(text)
    ranked = [each.id for each in sorted(contacts, key=lambda each: -each.p_mine)]
    assert re.findall(r'<tr[^>]* data-id="(.*?)"', text) == ranked[: MAX_CARDS + MAX_ROWS]
    assert {name for name in page.ids if name in set(ranked)} == set(ranked[: MAX_CARDS + MAX_ROWS])
    assert {link[1:] for link in page.links if link != "#C0001"} <= set(page.ids)
    assert text.count('<article class="card') == MAX_CARDS
    assert "900 more, the least likely, are in contacts.csv" in page.text
    assert len(text) + (MAX_JPEG_BYTES * 4) // 3 < 5_000_000


def test_only_what_asks_for_something_stands_under_please_note() -> None:
    remark = Notice(code="detect.cascade", text="the detector is a cascade", for_the_record=True)
    text = full_page(notices=[remark])
    assert "Please note" not in text
    assert text.index('id="how"') < text.index("the detector is a cascade")
    text = full_page(notices=[remark, Notice(code="port_down", text="check the cable")])
    assert (
        text.index("Please note")
        < text.index("check the cable")
        < text.index('id="how"')
        < text.index("the detector is a cascade")
    )


def test_what_a_person_reads_is_in_words_with_units() -> None:
    text = Page(full_page()).text
    for expected in (
        "Line 7",
        "1 h 02 min",
        "3.20 km",
        "0.310 km²",
        "372×",
        "truncated cone",
        "55° 00.0000′ N",
        "12° 00.0000′ E",
        "1.50 m × 0.50 m, height unknown",
        "echo +8.0 dB, shadow none",
        "new reason",
        "holes between pings",
        "second look",
        "and 4 more of",
        "no <navigation> at first",
    ):
        assert expected in text
    assert "nan" not in text.lower().replace("navigation", "")
    assert "detect.over_budget" not in text


@pytest.mark.parametrize(
    "name",
    [
        "<script>alert(1)</script>",
        "\"'><img src=x onerror=alert(1)>",
        "</title></style><b>",
        "{{ 7 * 7 }}",
        "\ud800 lone",
    ],
)
def test_hostile_names_stay_text(name: str, tmp_path: Path) -> None:
    hostile = contact(reasons=(name,), classification="unknown")
    notices = [Notice(code=name, text=name, place=name)]
    write_report(
        tmp_path / "r.html",
        mission(name=name, logs=(name,), config_yaml=name),
        [hostile],
        [],
        waypoints(),
        notices,
        {name: 1},
        collected(1),
    )
    page = Page((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert page.tags.count("script") == 1
    assert "b" in page.tags
    assert all(source.startswith("data:image/") for source in page.sources)
    assert name.replace("\ud800", "?") in page.text
    assert "49" not in re.findall(r"<h1>(.*?)</h1>", page.text)


def verdict(number: int, latitude_deg: float, **more: Any) -> Verdict:
    time = "2026-05-04T10:00:00Z"
    return Verdict(
        object=f"V{number:04d}", time=time, **({"by": "kim"} | more), latitude_deg=latitude_deg, longitude_deg=12.0
    )


def judged_page(tmp_path: Path, said: str) -> list[Page]:
    """A report and its summary, of a contact judged against the chain either way, one not judged and a missed one."""
    places = {"C0001": (0.9, 55.0), "C0002": (0.1, 55.001), "C0003": (0.6, 55.002)}
    contacts = [contact(name, p, latitude_deg=lat) for name, (p, lat) in places.items()]
    verdicts = (
        verdict(1, 55.0, call="not_mine_like", type=said, comment=said, by=said),
        verdict(2, 55.001, call="mine_like", comment=said),
        verdict(3, 55.01, call="mine_like", drawn=True, type=said, comment=said),
    )
    write_report(tmp_path / "r.html", mission(verdicts=verdicts), contacts, [], [], [], {}, collected(1))
    return [Page((tmp_path / name).read_text(encoding="utf-8")) for name in ("r.html", "one-page.html")]


def test_the_report_and_its_summary_show_what_people_judged(tmp_path: Path) -> None:
    report, summary = judged_page(tmp_path, "a cage")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    calls = dict(re.findall(r'<tr[^>]* data-id="(C\d+)".*? data-verdict="(\w+)"', text))
    assert calls == {"C0001": "not_mine_like", "C0002": "mine_like", "C0003": "none"}
    assert "Judged not mine-like by a cage, 2026-05-04T10:00:00Z: a cage. a cage" in report.text
    assert 'select name="verdict"' in text
    assert text.count("<title>V0003: missed</title>") == 1
    assert "V0003" in report.ids
    assert "2 mine-like, 1 not mine-like, 0 undecided; 1 of them missed" in summary.text
    shown = re.findall(r"<tr><td>(C\d+)</td>", (tmp_path / "one-page.html").read_text(encoding="utf-8"))
    assert shown == ["C0002", "C0003", "C0001"]  # judged a mine first, judged none last, and all of them there


@pytest.mark.parametrize("said", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "{{ 7 * 7 }}"])
def test_verdicts_stay_text(said: str, tmp_path: Path) -> None:
    report, summary = judged_page(tmp_path, said)
    assert (report.tags.count("script"), summary.tags.count("script")) == (1, 0)
    assert all(source.startswith("data:image/") for source in report.sources)
    assert report.text.count(said) >= 7
    assert said in summary.text


def test_a_crowd_is_one_structure_and_what_is_called_keeps_its_line(tmp_path: Path) -> None:
    crowd = [
        contact(f"C{n:04d}", 0.05, latitude_deg=55.0 + 2e-5 * n, called=n == 3, classification="clutter", views=())
        for n in range(1, 11)
    ]
    far = [contact("C0011", 0.05, latitude_deg=55.01, classification="clutter", views=())]
    write_report(tmp_path / "r.html", mission(), [*crowd, *far], [], [], [], {}, collected(1))
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    report, summary = Page(text), Page((tmp_path / "one-page.html").read_text(encoding="utf-8"))
    assert report.ids.count("S001") == 1
    assert text.count("<title>S001: structure</title>") == 1
    assert "S001, 22 × 2 m, 10 contacts, 1 of them called." in summary.text
    lines = dict(re.findall(r'<tr[^>]* data-id="(C\d+)"([^>]*)>', text))
    assert len(lines) == 11  # every contact has its line
    assert {name for name, rest in lines.items() if 'data-grouped="S001"' not in rest} == {"C0003", "C0011"}
    assert Page(full_page()).text.count("Structure") == 0


def test_without_verdicts_nothing_speaks_of_them() -> None:
    assert 'name="verdict"' not in full_page()
    assert "Missed" not in Page(full_page()).text


def test_a_mission_without_anything_gives_a_proper_page() -> None:
    nothing = mission(
        name="",
        logs=(),
        start_s=NAN,
        stop_s=NAN,
        track_latitude_deg=np.empty(0),
        track_longitude_deg=np.empty(0),
        distance_m=0.0,
        covered_km2=0.0,
        wall_s=0.0,
        config_yaml="",
        costs={},
    )
    page = Page(render_report(nothing, [], [], [], [], {}, PictureCollector()))
    for expected in (
        "no time was recorded",
        "No position was recorded",
        "No mine-like contact was found",
        "No waterfall tile was made",
        "Nothing was lost",
    ):
        assert expected in page.text


def test_equal_missions_give_equal_pages() -> None:
    assert full_page() == full_page()


def decoded(jpeg: bytes) -> NDArray[np.int64]:
    picture = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, dtype=np.int64)


def test_strips_show_port_left_and_later_pings_above() -> None:
    for side in ("port", "starboard"):
        dark = np.full((64, 200), 0.05, dtype=np.float32)
        bright = dark.copy()
        bright[8:12, 150:158] = 30.0
        pictures = PictureCollector()
        pictures.add_tile(tile(0, "port", intensity=bright if side == "port" else dark))
        pictures.add_tile(tile(0, "starboard", intensity=bright if side == "starboard" else dark))
        (strip,) = pictures.strips()
        grey = decoded(strip.jpeg).sum(axis=2)
        assert grey.shape == (strip.height_px, strip.width_px)
        down, right = np.argwhere(grey > 0.8 * grey.max()).mean(axis=0)
        assert down / strip.height_px == pytest.approx(1.0 - 9.5 / 64.0, abs=0.03)
        far = 153.5 / 200.0 / 2.0
        assert right / strip.width_px == pytest.approx(0.5 - far if side == "port" else 0.5 + far, abs=0.01)


def test_boxes_lie_on_the_echo_they_frame() -> None:
    seen = contact(views=(detection("port", row=100.0, column=150.0), detection("starboard", row=20.0, column=50.0)))
    text = render_report(mission(), [seen], [], [], [], {}, collected(3))
    boxes = re.findall(r'class="box [^>]*style="left:([\d.]+)%;top:([\d.]+)%;width:([\d.]+)%;height:([\d.]+)%"', text)
    centres = {(float(left) + float(width) / 2.0, float(top) + float(tall) / 2.0) for left, top, width, tall in boxes}
    expected = {
        (50.0 - 50.0 * 150 / 200, 100.0 - 100.0 * 100 / 192),
        (50.0 + 50.0 * 50 / 200, 100.0 - 100.0 * 20 / 192),
    }
    assert sorted(centres) == [pytest.approx(centre, abs=0.01) for centre in sorted(expected)]


def test_masked_and_low_resolution_pixels_have_their_colours_and_turns_show_what_was_seen() -> None:
    mask = np.full((64, 200), VALID, dtype=np.uint8)
    mask[:, :40] = 0
    mask[:, 40:80] |= LOW_RESOLUTION
    mask[:, 80:120] |= TURN
    mask[:, 120:160] = TURN
    pictures = PictureCollector()
    pictures.add_tile(tile(0, "starboard", mask=mask, intensity=np.ones((64, 200), dtype=np.float32)))
    (strip,) = pictures.strips()
    picture = decoded(strip.jpeg)[32]
    level = int(display_levels(np.ones(1))[0])
    for column, code in ((20, 0), (60, 64 + level), (100, level), (140, 0), (180, level)):
        np.testing.assert_allclose(picture[strip.width_px // 2 + column], COLOURS[code], atol=12)


def test_a_turn_is_marked_beside_the_picture_and_hides_nothing_of_it() -> None:
    mask = np.full((64, 200), VALID, dtype=np.uint8)
    mask[10:30] |= TURN
    pictures = PictureCollector()
    pictures.add_tile(tile(0, "starboard", mask=mask))
    (strip,) = pictures.strips()
    ((start_m, stop_m),) = strip.turns_m
    assert (start_m, stop_m) == pytest.approx((10 * ROW_M, 30 * ROW_M))
    text = render_report(mission(), [], [], [], [], {}, pictures)
    (bar,) = re.findall(r'class="turn" style="top:([\d.]+)%;height:([\d.]+)%"', text)
    assert [float(part) for part in bar] == pytest.approx([100.0 * 34 / 64, 100.0 * 20 / 64], abs=0.01)


def test_a_gap_between_tiles_is_marked_with_its_length() -> None:
    pictures = PictureCollector()
    for first_row in (0, 64, 256):
        pictures.add_tile(tile(first_row // 64, first_row=first_row))
    strips = pictures.strips()
    lost_m = sum(stop - start for strip in strips for start, stop in strip.gaps_m)
    assert lost_m == pytest.approx(128 * ROW_M)
    assert "no data, " in render_report(mission(), [], [], [], [], {}, pictures)


def test_strips_follow_each_other_and_a_strip_without_data_is_left_out() -> None:
    pictures = PictureCollector()
    for first_row in (*range(0, 1024, 64), *range(20_000, 21_024, 64)):
        pictures.add_tile(tile(first_row // 64, first_row=first_row))
    strips = pictures.strips()
    assert [strip.number for strip in strips] == list(range(1, len(strips) + 1))
    assert all(before.stop_m <= after.start_m + 1e-9 for before, after in pairwise(strips))
    assert sum(strip.stop_m - strip.start_m for strip in strips) < 5000 * ROW_M


def test_overlap_rows_are_not_drawn_twice() -> None:
    pictures = PictureCollector()
    pictures.add_tile(tile(0, core_start=10, core_stop=40))
    pictures.add_tile(tile(1, first_row=20, core_start=20, core_stop=50))
    (strip,) = pictures.strips()
    assert [strip.start_m, strip.stop_m] == pytest.approx([10 * ROW_M, 70 * ROW_M])
    assert strip.gaps_m == ()


def test_memory_and_page_are_bounded_for_any_length() -> None:
    limit = 300_000
    pictures = PictureCollector(limit)
    for index in range(600):
        pictures.add_tile(tile(index, "port" if index % 2 else "starboard", first_row=index // 2 * 64))
        assert pictures.n_bytes <= limit
    strips = pictures.strips()
    assert strips[0].start_m == 0.0
    assert strips[-1].stop_m == pytest.approx(300 * 64 * ROW_M)
    # both sides, where one may be missing
    assert sum(strip.width_px * strip.height_px for strip in strips) <= 2.2 * limit
    assert len(strips) < 200


def test_pictures_are_made_smaller_until_the_page_is_small_enough() -> None:
    pictures = collected(20)
    big = sum(len(strip.jpeg) for strip in pictures.strips())
    small = pictures.strips(big // 6)
    assert sum(len(strip.jpeg) for strip in small) <= big // 6
    assert small[-1].stop_m == pytest.approx(20 * 64 * ROW_M)


def test_time_along_the_strip_is_that_of_the_pings() -> None:
    rows_m, times_s = collected(2).times()
    np.testing.assert_allclose(times_s, START_S + rows_m / 2.0)


def test_tiles_without_rows_times_or_pings_have_no_time_and_leave_no_nan_on_the_page() -> None:
    pictures = PictureCollector()
    pictures.add_tile(tile(0, core_start=5, core_stop=5))
    lost = tile(0)
    pose = msgspec.structs.replace(lost.pose, time_s=np.full(64, NAN))
    pictures.add_tile(
        tile(
            0,
            pose=pose,
            ping_number=np.full(64, -1),
            mask=np.zeros((64, 200), np.uint8),
            intensity=np.full((64, 200), NAN, np.float32),
        )
    )
    assert [values.size for values in pictures.times()] == [0, 0]
    assert "nan" not in Page(render_report(mission(), [], [], [], [], {}, pictures)).text


@pytest.mark.parametrize("side", ["port", "starboard"])
def test_a_contact_picture_is_oriented_like_the_strips(side: Side) -> None:
    snippet = np.full((20, 60), 0.05, dtype=np.float32)
    snippet[3:6, 8:13] = 30.0
    picture = snippet_picture(detection(side, snippet=pack_snippet(snippet))).astype(np.int64).sum(axis=2)
    assert picture.shape == (40, 60), "pixels are made square"
    down, right = np.argwhere(picture > 0.8 * picture.max()).mean(axis=0)
    assert down == pytest.approx(39.0 - 8.5, abs=1.0)
    assert right == pytest.approx(59.0 - 10.0 if side == "port" else 10.0, abs=1.0)


def test_contact_pictures_are_png_with_square_pixels_of_the_finer_spacing() -> None:
    data = snippet_png(detection())
    assert data.startswith(b"\x89PNG")
    picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (40, 60, 3)
    assert snippet_png(detection(snippet=np.empty((0, 0), dtype=np.uint8))).startswith(b"\x89PNG")
    assert snippet_png(detection(snippet=pack_snippet(np.full((5, 5), NAN)))).startswith(b"\x89PNG")


def test_pictures_of_very_many_contacts_stop_before_the_page_is_too_big() -> None:
    noise = np.random.default_rng(2).gamma(1.0, 1.0, (160, 320)).astype(np.float32)
    many = [contact(f"C{number:04d}", 0.9, views=(detection(snippet=pack_snippet(noise)),)) for number in range(120)]
    text = render_report(mission(), many, [], [], [], {}, PictureCollector())
    assert len(text) < 2_500_000
    assert "see snippets/C0099.png" in text
    assert all(f'id="{each.id}"' in text for each in many)


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (55.0, 180.0), (-70.0, -179.9995), (89.0, 30.0)])
def test_the_map_is_true_to_scale_anywhere(latitude: float, longitude: float) -> None:
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    east_north = np.array([[-200.0, -100.0], [200.0, -100.0], [200.0, 150.0], [-200.0, 150.0], [-200.0, -100.0]])
    latitudes, longitudes, _ = frame.to_geodetic(np.column_stack([east_north, np.zeros(5)]))
    ring = CoveragePatch(
        side="port",
        tile_index=0,
        start_s=0.0,
        stop_s=1.0,
        rings_deg=(np.column_stack([longitudes, latitudes]),),
        covered_m2=1.0,
        lost_m2={},
    )
    there = contact(
        latitude_deg=float(latitudes[1]), longitude_deg=float(longitudes[1]), covariance_m2=np.eye(2) * 100.0
    )
    chart = draw_chart(np.column_stack([latitudes, longitudes]), [there], [ring], [])
    assert chart is not None
    points = np.array([[float(number) for number in pair.split()] for pair in chart.track[1:].split("L")])
    units_per_m = chart.scale_units / chart.scale_m
    assert np.ptp(points[:, 0]) / units_per_m == pytest.approx(400.0, abs=0.5)
    assert np.ptp(points[:, 1]) / units_per_m == pytest.approx(250.0, abs=0.5)
    assert points.min() >= 0.0
    assert points[:, 0].max() <= WIDTH
    assert points[:, 1].max() <= chart.height
    (marker,) = chart.markers
    assert [marker.right, marker.down] == pytest.approx(points[1].tolist(), abs=0.2)
    assert points[1, 0] > points[0, 0], "east is right"
    assert points[2, 1] < points[1, 1], "north is up"
    ellipse = np.array([[float(number) for number in pair.split()] for pair in marker.ellipse[1:-1].split("L")])
    assert np.ptp(ellipse[:, 0]) / units_per_m == pytest.approx(40.0, abs=0.5)
    assert 2 <= len(chart.latitude_labels) <= 8
    assert 2 <= len(chart.longitude_labels) <= 8


def test_track_breaks_are_not_bridged_on_the_map() -> None:
    chart = draw_chart(np.column_stack([mission().track_latitude_deg, mission().track_longitude_deg]), [], [], [])
    assert chart is not None
    assert chart.track.count("M") == 2


def test_counters_are_shown_by_stage_in_words() -> None:
    counters = {
        "quality.port_stuck": 1234567,
        "reader.packet_not_side_scan.attitude": 4,
        "brand.new_counter": 1,
        "odd": 2,
        "ping.gap": 0,
        "reader.pings": 9,
    }
    explained = dict(explained_counters(counters, is_loss))
    assert list(explained) == ["Brand", "Other", "Quality of echoes"]
    worked = dict(explained_counters(counters, lambda name: not is_loss(name)))
    assert explained["Quality of echoes"][0].number == "1\u202f234\u202f567"
    assert explained["Quality of echoes"][0].meaning.endswith("(port side)")
    assert worked["Reading the log"][0].meaning.endswith(": attitude")
    assert explained["Brand"][0].meaning == "new counter"


def test_numbers_read_as_people_write_them() -> None:
    assert degrees_minutes(55.5, "N", "S") == "55° 30.0000′ N"
    assert degrees_minutes(-12.999999999, "E", "W") == "13° 00.0000′ W"
    assert degrees_minutes(-0.05, "E", "W", 0) == "0° 03′ W"
    assert degrees_minutes(NAN, "N", "S") == "unknown"
    assert [duration(seconds) for seconds in (0.44, 59.6, 61.0, 3661.0, NAN)] == [
        "0.4 s",
        "1 min 00 s",
        "1 min 01 s",
        "1 h 01 min",
        "unknown",
    ]
    assert [distance(metres) for metres in (0.0, 999.4, 1234.0, NAN)] == ["0 m", "999 m", "1.23 km", "unknown"]
    assert [area(square_metres) for square_metres in (2515.2, 310_000.0, NAN)] == [
        "2\u202f515 m²",
        "0.310 km²",
        "unknown",
    ]
    assert [nice_step(span, 5) for span in (10.0, 11.0, 26.0, 0.07)] == [2.0, 5.0, 10.0, pytest.approx(0.02)]
    assert math.isclose(nice_step(1e-3, 1), 1e-3)


def test_pictures_in_the_page_are_pictures() -> None:
    for source in Page(full_page()).sources:
        assert decoded(base64.b64decode(source.partition(",")[2])).ndim == 3


def test_the_page_says_where_the_number_of_mines_left_comes_from() -> None:
    """Six mines left stood unexplained beside six of six found."""
    searched = {
        "km2": 0.07,
        "p_detected_mean": 0.6,
        "km2_at_p": {"0.9": 0.01},
        "mines_found": 5.8,
        "mines_left": {"expected": 6.2, "at_most_95": 13, "p_none": 0.01, "among_contacts": 412, "p_mine_sum": 9.4}
        | {"mine_share": 0.12, "mine_share_presumed": 0.2},
    }
    text = Page(full_page(mission=mission(searched=searched, clearance_png=b"picture"))).text
    assert "6.2" in text
    assert "of mines missed" in text
    assert "presume that 20% of contacts are mines; of this mission's own contacts 12% are" in text
    assert "no more than 13 with 95 %" in text
    assert "412 contacts that are not mine-like: their chances add up to 9.4" in text
    assert "Mine-like contacts stand for 5.8 mines found" in text
