"""What the page shows of a folder, and verdicts: written beside the results, found again after another replay."""

from __future__ import annotations

import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.contacts.export import iso_time
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import SIDES
from auv_mcm.shell.health.files import HEALTH
from sim_replay.replay import replay
from sim_replay.verdicts import VERDICTS_FILE, append_verdict, newest_verdicts, read_verdicts
from sim_replay.view.background_replay import BackgroundReplay
from sim_replay.view.mission import Judgement, ReplayAgain, ShownMission
from sim_replay.view.mission_feed import MissionFeed
from sim_replay.view.mission_files import overview
from sim_replay.view.places import WaterfallPoint
from sim_replay.view.show import named_logs, open_shown, show
from sim_replay.view.waterfall_store import WaterfallStore
from tests.auv_mcm.shell.health.measurements import record
from tests.sim_replay.augment.plain_logs import CONFIG, N_PINGS, written
from tests.sim_replay.view.shown_missions import feature, filled_store, poses, position, shown, tile, write_results


def test_contacts_are_listed_with_their_place_in_the_waterfall(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(2, 200.0, -15.0), feature(1, 100.0, 20.0, p_mine=0.1)])
    found = shown(folder).contacts()
    assert found["id"] == ["C00001", "C00002"]
    assert found["row"] == pytest.approx([100.0, 200.0], abs=0.05)
    assert found["across"] == pytest.approx([20.0, -15.0])
    assert found["p"] == [0.1, 0.9]


def test_a_contact_lies_where_its_side_was_recorded_though_the_other_has_the_same_times(tmp_path: Path) -> None:
    store, intensity = WaterfallStore(), np.ones((64, 640), dtype=np.float32)
    store.add(tile("port", 0, intensity))
    later = tile("starboard", 64, intensity)
    store.add(msgspec.structs.replace(later, pose=poses(0, 64)))
    folder = write_results(tmp_path, [feature(1, 30.0, 20.0), feature(2, 40.0, -20.0)])
    assert shown(folder, store).contacts()["row"] == pytest.approx([94.0, 40.0], abs=0.1)


def test_a_contact_after_a_clock_was_set_back_lies_at_the_nearer_of_two_rows_of_its_time(tmp_path: Path) -> None:
    store, intensity, first = WaterfallStore(), np.ones((64, 640), dtype=np.float32), poses(0, 64)
    for row, pose in ((0, first), (64, msgspec.structs.replace(poses(64, 64), time_s=first.time_s))):
        for side in SIDES:
            store.add(msgspec.structs.replace(tile(side, row, intensity), pose=pose))
    late = feature(1, 94.0, 20.0, time=iso_time(first.time_s[29]))
    late["properties"]["views"][0]["time"] = late["properties"]["time"]
    assert shown(write_results(tmp_path, [late]), store).contacts()["row"] == pytest.approx([94.0], abs=1.0)


def test_contacts_that_crowd_together_are_shown_as_one_structure(tmp_path: Path) -> None:
    wreck = [feature(number, 100.0 + 8.0 * (number % 3), 20.0 + number // 3) for number in range(1, 9)]
    found = shown(write_results(tmp_path, [*wreck, feature(9, 600.0, -15.0)])).contacts()
    (structure,) = found["structures"]
    assert (structure["id"], structure["n_contacts"], structure["n_called"]) == ("S001", 8, 8)
    assert structure["geometry"]["type"] == "Polygon"
    assert found["structure"] == ["S001"] * 8 + [None]


def test_a_card_has_the_depth_of_the_sea_floor_under_the_contact(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]))
    card = mission.contact("C00001")
    assert card is not None
    assert card["depth_m"] == pytest.approx(15.0, abs=0.01)
    assert mission.contact("C00009") is None


def test_a_verdict_stands_beside_the_results_with_who_and_when(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]), by="kim")
    mission.judge(Judgement(contact_id="C00001", call="mine_like", type="cylinder", comment="sharp", height_m=0.5))
    (verdict,) = read_verdicts(tmp_path)
    assert (verdict.by, verdict.call, verdict.contact_id, verdict.height_m) == ("kim", "mine_like", "C00001", 0.5)
    assert verdict.time.endswith("Z")
    assert verdict.p_mine == 0.9
    assert mission.contacts()["verdicts"]["C00001"]["comment"] == "sharp"


def test_a_second_verdict_is_appended_and_counts(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]))
    mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    mission.judge(Judgement(contact_id="C00001", call="not_mine_like"))
    assert len((tmp_path / VERDICTS_FILE).read_text().splitlines()) == 2
    assert [verdict.object for verdict in read_verdicts(tmp_path)] == ["V0001", "V0001"]
    assert mission.contacts()["verdicts"]["C00001"]["call"] == "not_mine_like"
    card = mission.contact("C00001")
    assert card is not None
    assert [verdict["call"] for verdict in card["history"]] == ["mine_like", "not_mine_like"]


def test_an_object_drawn_beside_a_contact_does_not_become_that_contact(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1, 100.0, 20.0)]))
    mine = Judgement(row=110.0, across_m=20.0, call="mine_like")  # 1.2 m beside what is a rock
    with pytest.raises(UsageError, match="judge C00001 first"):
        mission.judge(mine)
    mission.judge(Judgement(contact_id="C00001", call="not_mine_like"))
    assert mission.judge(mine).object == "V0002"
    mission.judge(Judgement(contact_id="C00001", call="not_mine_like", comment="a rock"))
    found = mission.contacts()
    assert found["verdicts"]["C00001"]["call"] == "not_mine_like"
    assert [(one["object"], one["call"], one["drawn"]) for one in found["drawn"]] == [("V0002", "mine_like", True)]


def test_a_verdict_of_a_page_that_shows_results_of_before_goes_to_no_contact_of_their_ids(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1, 100.0), feature(2, 300.0)]))
    before = mission.state()["generation"]
    mission.judge(Judgement(contact_id="C00001", generation=before))
    write_results(tmp_path, [feature(1, 300.0), feature(2, 500.0), feature(3, 100.0)])  # as another replay leaves them
    mission.refresh()
    assert mission.state()["generation"] == before + 1
    with pytest.raises(UsageError, match="replayed meanwhile"):
        mission.judge(Judgement(contact_id="C00002", call="mine_like", generation=before))
    assert mission.judge(Judgement(contact_id="C00002", generation=before + 1)).object == "V0002"


def test_a_verdict_of_a_page_goes_to_no_contact_of_a_replay_that_began_again_meanwhile(tmp_path: Path) -> None:
    journal = tmp_path / "contacts.jsonl"
    journal.write_text("".join(json.dumps({"contact": feature(n, 100.0 * n)}) + "\n" for n in (1, 2)))
    mission = shown(tmp_path)
    journal.write_text(json.dumps({"contact": feature(1, 500.0)}) + "\n")
    mission.refresh()
    assert mission.contacts()["id"] == ["C00001"]
    with pytest.raises(UsageError, match="replayed meanwhile"):
        mission.judge(Judgement(contact_id="C00001", generation=0))


def test_a_card_asked_for_while_contacts_are_read_again_leaves_verdicts_with_their_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = shown(write_results(tmp_path, [feature(1, 100.0)]))
    mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    meanwhile = mission.judged  # as another thread asks
    monkeypatch.setattr("sim_replay.view.mission.overview", lambda one: (meanwhile(), overview(one))[1])
    write_results(tmp_path, [feature(1, 300.0), feature(2, 100.0)])
    mission.refresh()
    assert list(mission.contacts()["verdicts"]) == ["C00002"]


def test_contacts_of_a_replay_on_another_page_are_not_mixed_with_those_before(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1, 100.0), feature(2, 300.0)]))
    (tmp_path / "contacts.geojson").unlink()
    (tmp_path / "contacts.jsonl").write_text(json.dumps({"contact": feature(1, 500.0)}) + "\n")
    mission.refresh()
    assert (mission.contacts()["id"], mission.state()["generation"]) == (["C00001"], 1)
    (tmp_path / "contacts.jsonl").unlink()
    write_results(tmp_path, [feature(1, 500.0)])
    mission.refresh()
    assert (mission.contacts()["id"], mission.state()["generation"]) == (["C00001"], 1)


def test_verdicts_of_before_another_replay_from_the_page_go_to_no_contact_of_their_ids(tmp_path: Path) -> None:
    class Replay(BackgroundReplay):
        is_running = False

        def start(self) -> None:
            write_results(tmp_path, [feature(1, 300.0), feature(2, 100.0)])

    mission = shown(write_results(tmp_path, [feature(1, 100.0)]))
    again = ReplayAgain(MissionFeed(filled_store(), lambda stop: None), Replay([], tmp_path, CONFIG))
    mission = ShownMission(tmp_path, mission.feed, by="kim", is_live=False, again=lambda: again)
    mission.refresh()
    mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    assert list(mission.contacts()["verdicts"]) == ["C00001"]
    mission.refresh()
    mission.contacts()
    mission.replay_again()
    mission.refresh()
    assert list(mission.contacts()["verdicts"]) == ["C00002"]


def test_a_replay_that_cannot_begin_leaves_what_is_shown(tmp_path: Path) -> None:
    class Replay(BackgroundReplay):
        def start(self) -> None:
            raise OSError("the disk cannot be written to")

    folder = write_results(tmp_path, [feature(1)])
    feed = shown(folder).feed
    again = ReplayAgain(MissionFeed(filled_store(), lambda stop: None), Replay([], folder, CONFIG))
    mission = ShownMission(folder, feed, by="kim", is_live=False, again=lambda: again)
    mission.refresh()
    with pytest.raises(OSError, match="cannot be written"):
        mission.replay_again()
    assert mission.feed is feed
    assert (mission.state()["done"], mission.state()["replay_again"]) == (True, True)


@pytest.mark.parametrize("by", ["k" * 65, "\x07" * 20])
def test_a_name_too_long_for_a_verdict_is_refused_at_the_start(tmp_path: Path, by: str) -> None:
    with pytest.raises(UsageError, match="--by"):
        show([write_results(tmp_path, [feature(1)])], logs=[], by=by)


def test_a_verdict_given_on_another_page_is_shown_without_judging_here(tmp_path: Path) -> None:
    first = shown(write_results(tmp_path, [feature(1)]), by="kim")
    shown(tmp_path, by="lee").judge(Judgement(contact_id="C00001", call="not_mine_like"))
    before = first.state()["verdicts_version"]
    first.refresh()
    assert first.state()["verdicts_version"] != before
    assert first.contacts()["verdicts"]["C00001"]["by"] == "lee"


def test_pages_of_several_processes_never_give_two_objects_one_name(tmp_path: Path) -> None:
    write_results(tmp_path, [feature(number, 20.0 * number) for number in range(1, 41)])
    pages = [shown(tmp_path, by=by) for by in ("kim", "lee", "max", "noa")]

    def judge(page: int) -> None:
        for number in range(page + 1, 41, 4):
            pages[page].judge(Judgement(contact_id=f"C{number:05d}"))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(judge, range(4)))
    assert len(newest_verdicts(read_verdicts(tmp_path))) == 40


def test_the_count_of_verdicts_is_that_of_contacts_as_the_odds_are_corrected_by_them(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1), feature(2, 300.0)]))
    for name in ("C00001", "C00002"):
        mission.judge(Judgement(contact_id=name, call="mine_like"))
    write_results(tmp_path, [feature(1)])
    mission.refresh()
    assert mission.state()["judged"].startswith("judged 1 mine-like, 0 not")


def test_a_withdrawn_verdict_is_gone_from_the_list_and_kept_in_the_file(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]))
    mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    mission.judge(Judgement(contact_id="C00001", withdrawn=True))
    assert mission.contacts()["verdicts"] == {}
    assert len(read_verdicts(tmp_path)) == 2
    with pytest.raises(UsageError, match="you did not judge this"):
        mission.judge(Judgement(contact_id="C00001", withdrawn=True))


def test_nobody_withdraws_what_somebody_else_judged(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]))
    judged = mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    append_verdict(tmp_path, msgspec.structs.replace(judged, by="lee", call="not_mine_like"))
    with pytest.raises(UsageError, match="lee judged this"):
        mission.judge(Judgement(contact_id="C00001", withdrawn=True))
    mission.refresh()
    assert mission.contacts()["verdicts"]["C00001"]["call"] == "not_mine_like"


def test_verdicts_survive_another_replay_by_place(tmp_path: Path) -> None:
    store = filled_store()
    mission = shown(write_results(tmp_path, [feature(1, 100.0), feature(2, 300.0)]), store)
    mission.judge(Judgement(contact_id="C00002", call="mine_like"))
    mission.judge(Judgement(row=500.0, across_m=-12.0, call="mine_like", comment="missed"))
    write_results(tmp_path, [feature(5, 300.8), feature(6, 101.0), feature(7, 502.0, -12.2)])
    again = shown(tmp_path, store).contacts()
    assert {name: verdict["object"] for name, verdict in again["verdicts"].items()} == {
        "C00005": "V0001",
        "C00007": "V0002",
    }
    assert again["drawn"] == []


def test_a_judged_object_that_the_next_replay_does_not_find_stays_on_the_page(tmp_path: Path) -> None:
    store = filled_store()
    mission = shown(write_results(tmp_path, [feature(1, 100.0)]), store)
    mission.judge(Judgement(contact_id="C00001", call="mine_like"))
    write_results(tmp_path, [feature(1, 900.0)])
    again = shown(tmp_path, store).contacts()
    assert [one["object"] for one in again["drawn"]] == ["V0001"]
    assert again["drawn"][0]["row"] == pytest.approx(100.0, abs=0.1)


def test_a_drawn_object_lies_where_it_was_clicked_and_can_be_judged_again(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, []))
    verdict = mission.judge(Judgement(row=250.0, across_m=-10.0, call="mine_like"))
    latitude, longitude = position(-10.0, 250.0 * 0.12)
    assert (verdict.latitude_deg, verdict.longitude_deg) == pytest.approx((latitude, longitude), abs=1e-7)
    again = mission.judge(Judgement(object="V0001", call="not_mine_like"))
    assert (again.object, again.latitude_deg, again.drawn) == ("V0001", verdict.latitude_deg, True)
    (drawn,) = mission.contacts()["drawn"]
    assert (drawn["row"], drawn["across"]) == pytest.approx((250.0, -10.0), abs=0.1)


@pytest.mark.parametrize(
    "judgement",
    [
        Judgement(contact_id="C00009"),
        Judgement(object="V0009"),
        Judgement(call="mine_like"),
        Judgement(contact_id="C00001", comment="x" * 2001),
        Judgement(contact_id="C00001", type="x" * 65),
        Judgement(contact_id="C00001", height_m=-1.0),
        Judgement(contact_id="C00001", length_m=float("nan")),
        Judgement(row=1e9, across_m=0.0, call="mine_like"),
        Judgement(row=10.0, across_m=-500.0, call="mine_like"),
        Judgement(row=-1.0, across_m=10.0, call="mine_like"),
        Judgement(row=float("nan"), across_m=1.0),
    ],
)
def test_a_verdict_about_nothing_or_out_of_bounds_is_refused_and_leaves_nothing(
    tmp_path: Path, judgement: Judgement
) -> None:
    mission = shown(write_results(tmp_path, [feature(1)]))
    with pytest.raises(UsageError):
        mission.judge(judgement)
    assert not (tmp_path / VERDICTS_FILE).exists()


def test_contacts_of_a_running_session_come_as_its_journal_grows(tmp_path: Path) -> None:
    journal = tmp_path / "contacts.jsonl"
    journal.write_text(json.dumps({"contact": feature(1)}) + "\n")
    mission = shown(tmp_path)
    assert mission.contacts()["id"] == ["C00001"]
    with open(journal, "a") as file:
        file.write(json.dumps({"contact": feature(2)}) + "\n" + json.dumps({"contact": feature(1, p_mine=0.3)}))
    mission.refresh()
    assert mission.contacts()["p"] == [0.9, 0.9]  # the last line is not whole yet
    with open(journal, "a") as file:
        file.write("\n")
    mission.refresh()
    assert mission.contacts()["p"] == [0.3, 0.9]


def test_results_of_a_session_that_goes_on_do_not_hide_what_it_finds(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(1)])  # as a stop left them; they have no summary since the next start
    (folder / "contacts.jsonl").write_text("".join(json.dumps({"contact": feature(n)}) + "\n" for n in (1, 2)))
    mission = shown(folder)
    assert mission.contacts()["id"] == ["C00001", "C00002"]
    write_results(tmp_path, [feature(1), feature(2), feature(3)])
    (folder / "summary.json").write_text("{}")
    mission.refresh()
    assert mission.contacts()["id"] == ["C00001", "C00002", "C00003"]


def test_a_log_that_has_moved_is_named(tmp_path: Path) -> None:
    (tmp_path / "leg.xtf").write_bytes(b"")
    assert named_logs({"logs": [{"path": "/gone/leg.xtf"}]}, tmp_path) == [tmp_path / "leg.xtf"]
    with pytest.raises(BadInputError, match=r"other\.xtf.*--log"):
        named_logs({"logs": [{"path": "/gone/other.xtf"}]}, tmp_path)


def test_results_of_a_replay_that_did_not_end_are_not_waited_for_as_a_session(tmp_path: Path) -> None:
    mission = open_shown(write_results(tmp_path, [feature(1)]), [], None, "kim")
    mission.feed.join()
    state = mission.state()
    assert (state["live"], state["done"], state["replay_again"]) == (False, True, False)
    assert "the results name no log" in state["problem"]
    assert mission.contacts()["id"] == ["C00001"]
    mission.feed.close()


@pytest.mark.parametrize("age_s", [0.0, 60.0])
def test_a_session_without_news_of_its_service_is_not_shown_as_if_it_ran(tmp_path: Path, age_s: float) -> None:
    (tmp_path / HEALTH).write_bytes(record(utc_s=time.time() - age_s).to_json())
    (tmp_path / "recording").mkdir()
    mission = open_shown(tmp_path, [], None, "kim")
    state = mission.state()
    mission.feed.close()
    assert (state["live"], state["silent"]) == (True, age_s > 0.0)


@pytest.mark.parametrize("journal", [False, True])
def test_a_page_opened_during_a_replay_shows_the_waterfall_once_it_has_ended(tmp_path: Path, journal: bool) -> None:
    log, folder = written(tmp_path / "log.xtf"), write_results(tmp_path / "results", [feature(1)])
    if journal:  # as a page leaves it that was closed before its replay had ended
        (folder / "contacts.geojson").unlink()
        (folder / "contacts.jsonl").write_text("")
    mission = open_shown(folder, [], None, "kim")
    mission.feed.join()
    assert not mission.state()["live"]
    assert "It is shown once one ends" in mission.state()["problem"]
    replay([log], folder, CONFIG)
    mission.feed.join()
    mission.refresh()
    mission.feed.join()
    state = mission.state()
    assert (state["problem"], state["pings"], state["generation"]) == ("", N_PINGS, 1)
    assert state["stop_row"] > 0
    mission.feed.close()


def test_a_folder_that_shows_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="neither results nor a session"):
        open_shown(tmp_path, [], None, "kim")


def test_a_measure_is_as_far_from_a_contact_as_its_nearer_end_from_the_nearest_view(tmp_path: Path) -> None:
    twice = feature(1, 100.0, -20.0)
    twice["properties"]["views"] += feature(1, 200.0, 15.0)["properties"]["views"]
    mission = shown(write_results(tmp_path, [twice, feature(2, 5000.0, 20.0)]))
    ends = [WaterfallPoint(110.0, -23.0), WaterfallPoint(110.0, -33.0)]
    assert mission.distance_m("C00001", ends) == pytest.approx(math.hypot(1.2, 3.0), abs=0.02)
    assert mission.distance_m("C00001", ends[::-1]) == pytest.approx(math.hypot(1.2, 3.0), abs=0.02)
    assert mission.distance_m("C00001", [WaterfallPoint(200.0, 16.0)]) == pytest.approx(1.0, abs=0.02)
    assert math.isnan(mission.distance_m("C00002", ends)), "its pings are not in the waterfall"
    assert math.isnan(mission.distance_m("C00003", ends))
    card = mission.contact("C00001")
    assert card is not None
    assert card["view_rows"] == pytest.approx([100.0, 200.0], abs=0.1)


def test_results_without_their_log_still_have_their_track(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(1)])
    lines = {"type": "MultiLineString", "coordinates": [[[10.0, 54.0], [10.1, 54.1]], [[10.2, 54.2], [10.3, 54.3]]]}
    track = {"features": [{"type": "Feature", "geometry": lines, "properties": {}}]}
    (folder / "track.geojson").write_text(json.dumps(track))
    found = shown(folder, WaterfallStore()).track()
    assert found["latitude"] == [54.0, 54.1, None, 54.2, 54.3, None]
    assert found["longitude"] == [10.0, 10.1, None, 10.2, 10.3, None]
