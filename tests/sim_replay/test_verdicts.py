"""Verdicts of people: kept line by line, replaced by later ones, found again by place after another replay."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.verdicts import (
    VERDICTS_FILE,
    Place,
    Verdict,
    append_verdict,
    match_verdicts,
    newest_verdicts,
    next_object,
    read_verdicts,
)

HOME = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)


def at(east_m: float, north_m: float) -> tuple[float, float]:
    latitude, longitude, _ = HOME.to_geodetic(np.array([[east_m, north_m, 0.0]]))
    return float(latitude[0]), float(longitude[0])


def verdict(name: str, east_m: float = 0.0, north_m: float = 0.0, **more: object) -> Verdict:
    latitude, longitude = at(east_m, north_m)
    plain = Verdict(object=name, time="2026-05-04T10:00:00Z", by="kim", latitude_deg=latitude, longitude_deg=longitude)
    return msgspec.structs.replace(plain, **more)


def place(name: str, east_m: float, north_m: float = 0.0, sigma_m: float = 0.5) -> Place:
    return Place(name, *at(east_m, north_m), sigma_m)


def test_verdicts_come_back_in_the_order_of_judging(tmp_path: Path) -> None:
    judged = [verdict("V0001", call="mine_like"), verdict("V0002", comment="an anchor"), verdict("V0001")]
    for one in judged:
        append_verdict(tmp_path, one)
    assert read_verdicts(tmp_path) == tuple(judged)
    assert next_object(judged) == "V0003"


def test_nobody_judged_means_no_verdicts(tmp_path: Path) -> None:
    assert read_verdicts(tmp_path) == ()
    assert next_object([]) == "V0001"


def test_the_last_verdict_of_an_object_counts_and_a_withdrawn_one_does_not() -> None:
    judged = [verdict("V0001", call="mine_like"), verdict("V0002"), verdict("V0001", call="not_mine_like")]
    assert newest_verdicts(judged)["V0001"].call == "not_mine_like"
    assert set(newest_verdicts([*judged, verdict("V0001", withdrawn=True)])) == {"V0002"}
    again = verdict("V0001", call="mine_like")
    assert newest_verdicts([*judged, verdict("V0001", withdrawn=True), again])["V0001"] == again


def test_whoever_withdraws_takes_back_what_they_judged_and_nobody_elses_verdict() -> None:
    kim, lee = verdict("V0001", call="mine_like"), verdict("V0001", call="not_mine_like", by="lee")
    assert newest_verdicts([kim, lee, verdict("V0001", by="lee", withdrawn=True)]) == {"V0001": kim}
    assert newest_verdicts([kim, lee, verdict("V0001", withdrawn=True)]) == {"V0001": lee}
    # one object under two names: of the verdicts that are left the later line counts
    of_copy = verdict("V90001", call="undecided", by="ann")
    assert newest_verdicts([kim, of_copy, lee, verdict("V0001", by="lee", withdrawn=True)]) == {"V90001": of_copy}


def test_a_line_that_was_cut_off_loses_nothing_else_and_is_named_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    append_verdict(tmp_path, verdict("V0001"))
    with open(tmp_path / VERDICTS_FILE, "ab") as file:
        file.write(b'{"object":"V0002","ti')
    assert [one.object for one in read_verdicts(tmp_path)] == ["V0001"]
    assert not caplog.messages  # it may still be written
    append_verdict(tmp_path, verdict("V0003"))
    for _ in range(2):
        assert [one.object for one in read_verdicts(tmp_path)] == ["V0001", "V0003"]
    assert ["line 2 was cut off" in message for message in caplog.messages] == [True]


@pytest.mark.parametrize("damage", [b"nonsense", b"[1, 2]", b'{"object":"V1"}', b'{"object":"../x","by":"a"}'])
def test_a_damaged_line_is_named(tmp_path: Path, damage: bytes) -> None:
    append_verdict(tmp_path, verdict("V0001"))
    with open(tmp_path / VERDICTS_FILE, "ab") as file:
        file.write(damage + b"\n")
    append_verdict(tmp_path, verdict("V0003"))
    with pytest.raises(BadInputError, match="line 2"):
        read_verdicts(tmp_path)


@pytest.mark.parametrize(
    "slip", [b"%s,", b"%s]", b"%s;\r", b'{"drawn":"yes"}', b'{"call":"Mine_like"}', b'{"Call":"mine_like"}']
)
@pytest.mark.parametrize("end", [b"", b"\n"])
def test_a_slip_in_a_line_edited_by_hand_is_named_and_loses_no_verdict(tmp_path: Path, slip: bytes, end: bytes) -> None:
    append_verdict(tmp_path, verdict("V0001"))
    line = msgspec.json.encode(verdict("V0002", comment="{a wheel}"))
    edited = slip % line if b"%s" in slip else line[:-1] + b"," + slip[1:]
    with open(tmp_path / VERDICTS_FILE, "ab") as file:
        file.write(edited + end)
    with pytest.raises(BadInputError, match=r"line 2.*Mend"):
        read_verdicts(tmp_path)


def test_verdicts_saved_by_a_text_editor_of_windows_are_read(tmp_path: Path) -> None:
    append_verdict(tmp_path, verdict("V0001", comment="\u00e9pave"))
    path = tmp_path / VERDICTS_FILE
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b" \r\n\r\n"))
    append_verdict(tmp_path, verdict("V0002"))
    assert [one.object for one in read_verdicts(tmp_path)] == ["V0001", "V0002"]


def test_files_put_together_in_which_one_name_is_of_two_objects_are_refused(tmp_path: Path) -> None:
    for one in (verdict("V0001"), verdict("V0001", 4.0, call="mine_like"), verdict("V0001", 40.0)):
        append_verdict(tmp_path, one)
    with pytest.raises(BadInputError, match=r"line 3: V0001 lies 36 m .* such as V90001 for V0001"):
        read_verdicts(tmp_path)


def test_of_two_people_who_judged_one_contact_under_two_names_the_later_line_counts() -> None:
    kim, lee = verdict("V0001", call="mine_like"), verdict("V90001", call="not_mine_like")
    assert newest_verdicts([kim, lee]) == {"V90001": lee}
    assert set(newest_verdicts([lee, kim, verdict("V0002", 9.0)])) == {"V0001", "V0002"}
    assert newest_verdicts([kim, lee, verdict("V90001", withdrawn=True)]) == {"V0001": kim}


def test_control_characters_in_a_comment_cannot_forge_a_line(tmp_path: Path) -> None:
    append_verdict(tmp_path, verdict("V0001", comment='x\n{"object":"V0009"}\x1b[2J'))
    assert (tmp_path / VERDICTS_FILE).read_bytes().count(b"\n") == 1
    assert "\x1b" not in read_verdicts(tmp_path)[0].comment


def test_a_verdict_is_refused_with_a_time_that_is_none() -> None:
    with pytest.raises(ValueError, match="time"):
        Verdict(object="V0001", time="yesterday", by="kim", latitude_deg=0.0, longitude_deg=0.0)


def test_a_verdict_finds_its_contact_under_another_id() -> None:
    judged = [verdict("V0001", 0.0, contact_id="C00001"), verdict("V0002", 50.0, contact_id="C00002")]
    found = match_verdicts(judged, [place("C00007", 50.3), place("C00009", 0.2), place("C00008", 20.0)])
    assert {name: one.object for name, one in found.items()} == {"C00009": "V0001", "C00007": "V0002"}


def test_of_two_contacts_the_nearer_one_takes_the_verdict_and_no_verdict_serves_two() -> None:
    found = match_verdicts([verdict("V0001")], [place("C00001", 1.5), place("C00002", -0.5)])
    assert list(found) == ["C00002"]


def test_contacts_without_a_position_have_no_verdict() -> None:
    assert match_verdicts([verdict("V0001")], [Place("C00001", float("nan"), float("nan"))]) == {}


some_places = st.lists(st.floats(-6.0, 6.0), max_size=6)


@given(
    judged_m=st.lists(st.floats(-6.0, 6.0), max_size=6, unique_by=lambda east_m: at(east_m, 0.0)), placed_m=some_places
)
def test_matches_are_those_of_taking_the_nearest_free_pair_again_and_again(
    judged_m: list[float], placed_m: list[float]
) -> None:
    judged = [verdict(f"V{number:04d}", east_m) for number, east_m in enumerate(judged_m, start=1)]
    placed = [place(f"C{number:05d}", east_m, sigma_m=0.1) for number, east_m in enumerate(placed_m, start=1)]
    left, expected = {(v, p) for v in range(len(judged)) for p in range(len(placed))}, {}
    while left:
        distance_m, v, p = min((abs(judged_m[v] - placed_m[p]), v, p) for v, p in left)
        if distance_m > 2.0:
            break
        expected[placed[p].contact_id] = distance_m
        left = {(other_v, other_p) for other_v, other_p in left if other_v != v and other_p != p}
    found = match_verdicts(judged, placed)
    distances = [abs(judged_m[int(one.object[1:]) - 1] - placed_m[int(name[1:]) - 1]) for name, one in found.items()]
    assert len(found) == len(expected)
    assert np.allclose(sorted(distances), sorted(expected.values()), atol=1e-6)
