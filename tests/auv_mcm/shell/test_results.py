"""Files that are whole or absent, and totals that a jump of the navigation does not spoil."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, NavSample, Ping
from auv_mcm.settings.config import PlanConfig
from auv_mcm.shell.results import (
    Journal,
    Snippets,
    Tally,
    area_totals,
    clearance_notices,
    make_directory,
    make_results_directory,
    plan_waypoints,
    search_totals,
    write_clearance,
    write_file,
    write_json,
    write_snippets,
)

METRE_DEG = 1.0 / 111_194.9  # of latitude, on the way north


def fix(time_s: float, north_m: float, heading_rad: float = NAN) -> NavSample:
    return NavSample(time_s=time_s, latitude_deg=north_m * METRE_DEG, longitude_deg=179.9999, heading_rad=heading_rad)


def sailed(*samples: NavSample) -> Tally:
    tally = Tally()
    for sample in samples:
        tally.add(sample)
    return tally


def test_distance_is_the_sum_of_steps_without_jumps_holes_and_absent_positions() -> None:
    assert sailed(fix(0, 10), fix(1, 12), fix(2, 15)).distance_m == pytest.approx(5.0, rel=0.01)
    assert sailed(fix(0, 10), fix(1, 5000), fix(2, 5002)).distance_m == pytest.approx(2.0, rel=0.01), "a jump"
    assert sailed(fix(0, 10), fix(500, 60), fix(501, 62)).distance_m == pytest.approx(2.0, rel=0.01), "a hole"
    gap = NavSample(time_s=1.0)
    zero = NavSample(time_s=1.0, latitude_deg=0.0, longitude_deg=0.0)
    assert sailed(fix(0, 10), gap, zero, fix(2, 12)).distance_m == pytest.approx(2.0, rel=0.01)


def test_direction_is_the_heading_or_else_the_course() -> None:
    assert sailed(fix(0, 10, 1.0), fix(1, 12)).direction_rad == 1.0
    assert sailed(fix(0, 10), fix(1, 12)).direction_rad == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(sailed(fix(0, 10)).direction_rad)


def test_duration_leaves_out_holes_and_steps_back() -> None:
    tally = Tally()
    for time_s in (100.0, 101.0, 100.5, 101.5, 9000.0, 9001.0, NAN):
        tally.add(Ping(number=0, time_s=time_s, port=None, starboard=None))
    assert tally.pings == 7
    assert tally.duration_s == 1.0 + 1.0 + 1.0
    assert (tally.first_s, tally.last_s) == (100.0, 9001.0)


def test_without_a_pose_there_is_no_plan_and_it_is_counted() -> None:
    counters: Counter[str] = Counter()
    assert plan_waypoints([], Tally(), PlanConfig(), counters) == ()
    assert counters == {"plan.start_pose_unknown": 1}


def test_a_file_is_replaced_whole_and_leaves_nothing_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bin"
    write_file(path, b"old")
    write_file(path, b"new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]

    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_file(path, b"newer")
    assert path.read_bytes() == b"new"


def test_json_holds_null_for_what_is_not_a_number(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": NAN, "b": [1.0, math.inf], "c": {"d": (2, "é")}})
    text = (tmp_path / "a.json").read_text("utf-8")
    assert json.loads(text) == {"a": None, "b": [1.0, None], "c": {"d": [2, "é"]}}


def test_journal_lines_survive_a_second_opening(tmp_path: Path) -> None:
    for number in range(2):
        journal = Journal(tmp_path / "j.jsonl")
        journal.append([{"n": number}, {"n": NAN}])
        journal.close()
    lines = (tmp_path / "j.jsonl").read_text("utf-8").splitlines()
    assert [json.loads(line)["n"] for line in lines] == [0, None, 1, None]


def test_snippets_of_an_earlier_replay_go_and_other_files_stay(tmp_path: Path) -> None:
    write_snippets(tmp_path, {"C1": b"1", "C2": b"2"})
    (tmp_path / "snippets" / "notes.txt").write_bytes(b"mine")
    write_snippets(tmp_path, {"C2": b"3"})
    assert {path.name: path.read_bytes() for path in (tmp_path / "snippets").iterdir()} == {"C2.png": b"3", "notes.txt": b"mine"}


def test_files_that_are_no_pictures_of_contacts_stay_among_the_snippets(tmp_path: Path) -> None:
    write_snippets(tmp_path, {"C1": b"1"})
    snippets = tmp_path / "snippets"
    (snippets / "C9photo.png").write_bytes(b"mine")
    (snippets / "C8.png").symlink_to("C9photo.png")
    (snippets / "C7.png").mkdir()
    write_snippets(tmp_path, {"C2": b"2"})
    assert {path.name for path in snippets.iterdir()} == {"C2.png", "C9photo.png", "C8.png", "C7.png"}
    assert (snippets / "C9photo.png").read_bytes() == b"mine"


def test_no_link_in_the_directory_of_the_results_is_followed(tmp_path: Path) -> None:
    victims, folder = tmp_path / "victims", tmp_path / "out"
    victims.mkdir()
    make_results_directory(folder)
    for name in (".writable", ".contacts.csv.new", "contacts.csv", "j.jsonl", "snippets/C1.png"):
        victim = victims / name.replace("/", "-")
        victim.write_bytes(b"precious")
        (folder / name).symlink_to(victim)
    make_results_directory(folder)
    write_file(folder / "contacts.csv", b"new")
    write_snippets(folder, {"C1": b"picture"})
    with pytest.raises(OSError, match="symbolic links"):
        Journal(folder / "j.jsonl")
    assert {path.read_bytes() for path in victims.iterdir()} == {b"precious"}
    assert (folder / "contacts.csv").read_bytes() == b"new"
    assert not (folder / "contacts.csv").is_symlink()
    assert (folder / "snippets" / "C1.png").read_bytes() == b"picture"


def test_a_link_in_the_place_of_snippets_is_refused_and_nothing_behind_it_is_touched(tmp_path: Path) -> None:
    other, folder = tmp_path / "other", tmp_path / "out"
    other.mkdir()
    folder.mkdir()
    (other / "C9.png").write_bytes(b"mine")
    (folder / "snippets").symlink_to(other)
    with pytest.raises(UsageError, match="snippets is a link"):
        make_results_directory(folder)
    with pytest.raises(OSError, match="Not a directory"):
        write_snippets(folder, {"C1": b"1"})
    with pytest.raises(OSError, match="Not a directory"):
        Snippets(folder).write({"C1": b"1"})
    assert {path.name: path.read_bytes() for path in other.iterdir()} == {"C9.png": b"mine"}


def test_pictures_that_a_full_disk_does_not_take_are_written_later_and_none_is_left_in_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    snippets = Snippets(tmp_path)
    snippets.write({"C1": b"one"})

    def no_space(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("auv_mcm.safe_files.os.replace", no_space)
        for pictures in ({"C2": b"two", "C3": b"three"}, {"C2": b"again"}):
            with pytest.raises(OSError, match="No space"):
                snippets.write(pictures)
        assert [path.name for path in (tmp_path / "snippets").iterdir()] == ["C1.png"]
    snippets.write()
    assert {path.name: path.read_bytes() for path in (tmp_path / "snippets").iterdir()} == {
        "C1.png": b"one",
        "C2.png": b"again",
        "C3.png": b"three",
    }


def test_a_map_of_clearance_comes_with_its_picture_and_goes_where_nothing_was_searched(tmp_path: Path) -> None:
    write_clearance(tmp_path, None, b"picture")
    assert json.loads((tmp_path / "clearance.geojson").read_text())["features"] == []
    assert (tmp_path / "clearance.png").read_bytes() == b"picture"
    write_clearance(tmp_path, None, b"")
    assert not (tmp_path / "clearance.png").exists()


def test_the_search_is_summed_up_over_what_was_seen() -> None:
    assert search_totals(None, []) == {}
    searched = search_totals(searched_half(), [])["searched"]
    assert searched["km2"] == pytest.approx(3 * 16e-6, abs=1e-6)
    assert searched["p_detected_mean"] == pytest.approx((0.5 + 0.9 + 0.96) / 3.0, abs=1e-4)
    assert searched["km2_at_p"]["0.9"] == pytest.approx(2 * 16e-6, abs=1e-6)
    assert sum(searched["seabed_km2"].values()) == pytest.approx(searched["km2"], abs=1e-6)
    seen_p = np.array([0.5, 0.9001, 0.96])
    assert searched["mines_left"]["expected"] == pytest.approx(0.5 * (1.0 - seen_p).sum() / seen_p.sum(), abs=1e-3)
    assert searched["mines_found"] == 0.0
    assert searched["mines_left"]["among_contacts"] == 0


def test_what_was_searched_too_far_off_for_the_map_is_summed_up_and_reported() -> None:
    assert search_totals(searched_half(), [])["searched"]["km2_elsewhere"] == 0.0
    assert clearance_notices(searched_half()) == clearance_notices(None) == []
    split = structs.replace(searched_half(), n_elsewhere=500)
    assert search_totals(split, [])["searched"]["km2_elsewhere"] == pytest.approx(0.008)
    (notice,) = clearance_notices(split)
    assert notice.code == "clearance.elsewhere"
    assert "0.008 km²" in notice.text


def test_an_area_to_clear_is_summed_up_and_what_of_it_was_not_seen_counts_as_not_found() -> None:
    assert area_totals(searched_half(), PlanConfig()) == {}
    frame = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
    latitude_deg, longitude_deg, _ = frame.to_geodetic([[0.0, 0.0, 0.0], [0.0, 16.0, 0.0], [8.0, 16.0, 0.0], [8.0, 0.0, 0.0]])
    plan = PlanConfig(area_deg=tuple(zip(latitude_deg.tolist(), longitude_deg.tolist(), strict=True)))
    area = area_totals(searched_half(), plan, "cannot, because")["area"]
    assert area["km2"] == pytest.approx(8 * 16e-6, abs=1e-6)
    assert area["p_detected_mean"] == pytest.approx((0.5 + 0.9001 + 0.96) / 8.0, abs=1e-4)
    assert area["percent_at_required"] == pytest.approx(25.0)
    assert (area["required"], area["reached"], area["verdict"]) == (0.9, False, "cannot, because")
    assert area_totals(None, plan)["area"]["p_detected_mean"] == 0.0


def searched_half() -> Clearance:
    """Four cells, of which one was not seen."""
    nothing = np.full((2, 2), np.nan, dtype=np.float32)
    return Clearance(
        origin_latitude_deg=43.0,
        origin_longitude_deg=5.0,
        cell_m=4.0,
        first_east=0,
        first_north=0,
        exponent=-np.log1p(-np.array([[0.5, 0.9001], [0.96, 0.0]])),
        looks=np.array([[1, 1], [2, 0]], dtype=np.uint8),
        towards=np.array([[1, 1], [3, 0]], dtype=np.uint64),
        seabed=np.array([[0, 1], [2, 4]], dtype=np.uint8),
        ripple_rad=nothing,
        wavelength_m=nothing,
        altitude_m=nothing,
    )


def test_a_directory_is_made_with_its_parents_and_probed(tmp_path: Path) -> None:
    folder = make_directory(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def lines_of(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_bytes().decode().splitlines()]


@pytest.mark.parametrize("n_records", [1, 400])
def test_a_full_disk_tears_no_journal_line_and_loses_none(n_records: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "j.jsonl"
    journal = Journal(path)
    journal.append([{"number": 0}])
    with monkeypatch.context() as full:

        def no_space(_: int) -> None:
            raise OSError(28, "No space left on device")

        full.setattr("auv_mcm.shell.results.os.fsync", no_space)
        with pytest.raises(OSError, match="No space"):
            journal.append([{"number": 1, "text": "x" * 50}] * n_records)
        assert lines_of(path) == [{"number": 0}]
    journal.append([{"number": 2}])
    journal.close()
    assert [line["number"] for line in lines_of(path)] == [0, *[1] * n_records, 2]
