"""The mission report: self-contained, complete, safe with any name, true to the geometry, bounded for any length of
mission.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auv_mcm.records import NAN, Notice
from sim_replay.report import PictureCollector, render_report, write_report
from sim_replay.report.page import MAX_CARDS, MAX_ROWS, ONE_PAGE, Shown
from sim_replay.report.pictures import MAX_JPEG_BYTES
from sim_replay.report.report_words import area, degrees_minutes, distance, duration, nice_step
from sim_replay.verdicts import Verdict
from tests.sim_replay.report_samples import Page, collected, contact, decoded, mission, waypoints


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
    return render_report(Shown(**(given | changes)))


def test_the_page_is_well_formed_and_needs_nothing_but_itself(tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", Shown(mission(), [contact()], [], waypoints(), [], {}, collected()))
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
    write_report(tmp_path / "report.html", Shown(mission(name="<b>"), contacts, [], waypoints(), [], {}, collected()))
    text = (tmp_path / "one-page.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "script" not in page.tags
    assert "<b>" in page.text
    assert "8 more called or mine-like contacts in the report" in page.text
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
        Shown(
            mission(name=name, logs=(name,), config_yaml=name),
            [hostile],
            [],
            waypoints(),
            notices,
            {name: 1},
            collected(1),
        ),
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
    """A report and its summary, of contacts judged against the chain, one not judged, a missed and an unmatched one."""
    places = {"C0001": (0.9, 55.0), "C0002": (0.1, 55.001), "C0003": (0.6, 55.002)}
    contacts = [contact(name, p, latitude_deg=lat) for name, (p, lat) in places.items()]
    verdicts = (
        verdict(1, 55.0, call="not_mine_like", type=said, comment=said, by=said),
        verdict(2, 55.001, call="mine_like", comment=said),
        verdict(3, 55.01, call="mine_like", drawn=True, type=said, comment=said),
        verdict(4, 55.02, call="not_mine_like"),
    )
    write_report(tmp_path / "r.html", Shown(mission(verdicts=verdicts), contacts, [], [], [], {}, collected(1)))
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
    assert "; 1 more unmatched: no contact stands for what was judged" in summary.text
    shown = re.findall(r"<tr><td>(C\d+)</td>", (tmp_path / "one-page.html").read_text(encoding="utf-8"))
    assert shown == ["C0002", "C0003", "C0001"]  # judged a mine first, judged none last, and all of them there


@pytest.mark.parametrize("said", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "{{ 7 * 7 }}"])
def test_verdicts_stay_text(said: str, tmp_path: Path) -> None:
    report, summary = judged_page(tmp_path, said)
    assert (report.tags.count("script"), summary.tags.count("script")) == (1, 0)
    assert all(source.startswith("data:image/") for source in report.sources)
    assert report.text.count(said) >= 7
    assert said in summary.text


def test_what_is_called_comes_first_however_unlikely(tmp_path: Path) -> None:
    contacts = [contact("C0001", 0.9), contact("C0002", 0.05, called=True), contact("C0003", 0.05, called=False)]
    path = tmp_path / "report.html"
    write_report(path, Shown(mission(), contacts, [], [], [], {}, PictureCollector()))
    page, summary = path.read_text("utf-8"), path.with_name(ONE_PAGE).read_text("utf-8")
    assert "1 contact that is probably not a mine" in page
    assert "<td>C0002</td>" in summary
    assert "<td>C0003</td>" not in summary


def test_a_crowd_is_one_structure_and_what_is_called_keeps_its_line(tmp_path: Path) -> None:
    crowd = [
        contact(f"C{n:04d}", 0.05, latitude_deg=55.0 + 2e-5 * n, called=n == 3, classification="clutter", views=())
        for n in range(1, 11)
    ]
    far = [contact("C0011", 0.05, latitude_deg=55.01, classification="clutter", views=())]
    write_report(tmp_path / "r.html", Shown(mission(), [*crowd, *far], [], [], [], {}, collected(1)))
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


def test_the_page_states_what_was_recorded_and_not_the_time_between_logs() -> None:
    days = mission(stop_s=mission().start_s + 86_400.0, duration_s=600.0)
    page = Page(render_report(Shown(days, [], [], [], [], {}, PictureCollector())))
    assert "10 min 00 s" in page.text
    assert "60×" in page.text


def test_a_mission_without_anything_gives_a_proper_page() -> None:
    nothing = mission(
        name="",
        logs=(),
        start_s=NAN,
        stop_s=NAN,
        duration_s=0.0,
        track_latitude_deg=np.empty(0),
        track_longitude_deg=np.empty(0),
        distance_m=0.0,
        covered_km2=0.0,
        wall_s=0.0,
        config_yaml="",
        costs={},
    )
    page = Page(render_report(Shown(nothing, [], [], [], [], {}, PictureCollector())))
    for expected in (
        "no time was recorded",
        "No position was recorded",
        "No mine-like contact was found",
        "No sea floor was seen: the waterfall is empty",
        "Nothing was lost",
    ):
        assert expected in page.text


def test_equal_missions_give_equal_pages() -> None:
    assert full_page() == full_page()


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


def test_the_page_says_that_the_area_covered_counts_overlap_twice() -> None:
    """It stood unexplained above a smaller area seen: 20 885 m² covered of 15 609 m²."""
    assert "overlap counted twice" in Page(full_page()).text


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
    assert "presume that 20 % of contacts are mines; of this mission's own contacts 12 % are" in text
    assert "no more than 13 with 95 %" in text
    assert "412 contacts that are not mine-like: their chances add up to 9.4" in text
    assert "Mine-like contacts stand for 5.8 mines found" in text
