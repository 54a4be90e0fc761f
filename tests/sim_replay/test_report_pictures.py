"""Pictures, the map and times of a report are true to the geometry, and bounded."""

from __future__ import annotations

import re
from itertools import pairwise

import cv2
import msgspec
import numpy as np
import pytest

from auv_mcm.contacts.contact_picture import COLOURS, display_levels, snippet_picture, snippet_png
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import LOW_RESOLUTION, NAN, TURN, VALID, Side
from auv_mcm.snippet import pack_snippet
from sim_replay.report import PictureCollector, Shown, render_report
from sim_replay.report.chart import WIDTH, draw_chart
from sim_replay.report.report_words import explained_counters, is_loss
from tests.make.records import patch_of
from tests.sim_replay.report_samples import ROW_M, START_S, Page, collected, contact, decoded, detection, mission, tile


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
    text = render_report(Shown(mission(), [seen], [], [], [], {}, collected(3)))
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
    text = render_report(Shown(mission(), [], [], [], [], {}, pictures))
    (bar,) = re.findall(r'class="turn" style="top:([\d.]+)%;height:([\d.]+)%"', text)
    assert [float(part) for part in bar] == pytest.approx([100.0 * 34 / 64, 100.0 * 20 / 64], abs=0.01)


def test_a_gap_between_tiles_is_marked_with_its_length() -> None:
    pictures = PictureCollector()
    for first_row in (0, 64, 256):
        pictures.add_tile(tile(first_row // 64, first_row=first_row))
    strips = pictures.strips()
    lost_m = sum(stop - start for strip in strips for start, stop in strip.gaps_m)
    assert lost_m == pytest.approx(128 * ROW_M)
    assert "no data, " in render_report(Shown(mission(), [], [], [], [], {}, pictures))


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
    assert "nan" not in Page(render_report(Shown(mission(), [], [], [], [], {}, pictures))).text


def test_tiles_in_which_nothing_was_measured_make_no_strips_and_the_page_says_so() -> None:
    mask = np.zeros((64, 200), dtype=np.uint8)
    mask[:, :4] = LOW_RESOLUTION
    pictures = PictureCollector()
    for index in range(3):
        pictures.add_tile(tile(index, mask=mask))
    assert pictures.strips() == ()
    assert "and no sea floor was seen." in Page(render_report(Shown(mission(), [], [], [], [], {}, pictures))).text


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
    text = render_report(Shown(mission(), many, [], [], [], {}, PictureCollector()))
    assert len(text) < 2_500_000
    assert "see snippets/C0099.png" in text
    assert all(f'id="{each.id}"' in text for each in many)


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (55.0, 180.0), (-70.0, -179.9995), (89.0, 30.0)])
def test_the_map_is_true_to_scale_anywhere(latitude: float, longitude: float) -> None:
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    east_north = np.array([[-200.0, -100.0], [200.0, -100.0], [200.0, 150.0], [-200.0, 150.0], [-200.0, -100.0]])
    latitudes, longitudes, _ = frame.to_geodetic(np.column_stack([east_north, np.zeros(5)]))
    ring = patch_of(rings_deg=(np.column_stack([longitudes, latitudes]),), covered_m2=1.0)
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
