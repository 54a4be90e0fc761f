"""Target specs: what is refused and why, and how scattered objects lie."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import SIDES
from sim_replay.augment.background_log import read_survey
from sim_replay.augment.targets import Placement, parse_target_spec, place_targets, read_target_spec
from sim_replay.augment.track import PingTrack, heard_at, track_of
from tests.sim_replay.augment.plain_logs import ALTITUDE_M, CONFIG, N_PINGS, mission, written


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> PingTrack:
    log = written(tmp_path_factory.mktemp("track") / "plain.xtf")
    return track_of(read_survey(log, CONFIG), CONFIG)


def placed(text: str, track: PingTrack) -> tuple[Placement, ...]:
    return place_targets(parse_target_spec(text, "spec.yaml"), track)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "targets: [{kind: mine, side: port, ping: 1, ground_range_m: 5}]",
            "Invalid enum value 'mine' - at `targets[0].kind`",
        ),
        ("target: []", "unknown field `target`"),
        ("targets: [{kind: box, side: port, ground_range_m: 5}]", "`targets[0]`: give its place along the track once"),
        ("targets: [{kind: box, side: port, ping: 3, along_m: 2, ground_range_m: 5}]", "as `ping` or as `along_m`"),
        ("targets: [{kind: box, side: port, ping: 3, ground_range_m: -5}]", "`targets[0].ground_range_m`"),
        ("scatter: [{kinds: [], count: 3}]", "`scatter[0].kinds`"),
        (
            "scatter: [{kinds: [box], count: 3, burial_m: [0.2, 0.1]}]",
            "`scatter[0].burial_m` is [0.2, 0.1]; the lowest comes first",
        ),
        (
            "targets: [{kind: sphere, side: port, ping: 3, ground_range_m: 5, length_m: 2}]",
            "`targets[0].length_m` changes nothing: it goes by the diameter. Give that as `width_m`",
        ),
        ("scatter: [{kinds: [cylinder, sphere], count: 3, height_m: [1, 2]}]", "`scatter[0].height_m` changes nothing"),
        ("seed: 1\nseed: 2", "given twice"),
        ("[1, 2]", "got list"),
    ],
)
def test_specs_that_cannot_be_are_refused_with_the_key(text: str, words: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse_target_spec(text, "spec.yaml")
    assert "spec.yaml" in str(refused.value)
    assert words in str(refused.value)


def test_a_spec_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_target_spec(tmp_path / "absent.yaml")


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("ping: 80, ground_range_m: 400", "outside the swath"),
        ("ping: 80, ground_range_m: 1", "too close to the nadir"),
        ("ping: 2, ground_range_m: 10", "too close to the start or end of the recording"),
        ("ping: 4000, ground_range_m: 10", f"usable pings 0 to {N_PINGS - 1}"),
        ("along_m: 900, ground_range_m: 10", "the log's track is"),
        ("ping: 80, ground_range_m: 10, height_m: 3.9", "rises 3.90 m"),
        ("ping: 80, ground_range_m: 10, height_m: 3.5, tilt_deg: 20", "rises 3.67 m"),
    ],
)
def test_places_the_log_does_not_show_are_refused_with_the_reason(track: PingTrack, place: str, words: str) -> None:
    with pytest.raises(UsageError) as refused:
        placed(f"targets: [{{kind: box, side: port, {place}}}]", track)
    assert "targets[0]" in str(refused.value)
    assert words in str(refused.value)


def test_an_empty_spec_is_refused(track: PingTrack) -> None:
    with pytest.raises(UsageError, match="names no object"):
        placed("", track)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"turn_rate_rad_s": 0.3}, "in a turn"),
        ({"shading": lambda ground_m, ping: 0.0 * ground_m}, "bottom below the sonar is not seen"),
    ],
)
def test_places_in_a_turn_or_without_a_bottom_are_refused(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    odd = track_of(read_survey(written(tmp_path / "odd.xtf", mission(**changes)), CONFIG), CONFIG)
    with pytest.raises(UsageError, match=words):
        placed("targets: [{kind: box, side: port, ping: 80, ground_range_m: 10}]", odd)


def test_scattered_objects_keep_apart_and_clear(track: PingTrack) -> None:
    text = """
      seed: 5
      targets: [{kind: box, side: port, ping: 60, ground_range_m: 10}]
      scatter: [{kinds: [sphere, rock], count: 12, apart_m: 1.5}]
      keep_clear: [{side: starboard, ping: 90, ground_range_m: 12, radius_m: 4}]
    """
    found = placed(text, track)
    assert len(found) == 13
    clear = track.plane_place(90, "starboard", 12.0)
    for index, one in enumerate(found):
        assert track.refusal(one.ping, one.side, one.ground_range_m) == ""
        if index:
            assert math.dist((one.scene_object.east_m, one.scene_object.north_m), clear) >= 4.0 + 1.5
        for other in found[:index]:
            assert (
                math.dist(
                    (one.scene_object.east_m, one.scene_object.north_m),
                    (other.scene_object.east_m, other.scene_object.north_m),
                )
                >= 1.5
            )
    assert {one.scene_object.is_target for one in found if one.scene_object.kind == "sphere"} == {True}
    assert {one.scene_object.is_target for one in found if one.scene_object.kind == "rock"} == {False}
    assert [one.scene_object for one in placed(text, track)] == [one.scene_object for one in found]
    others = placed(text.replace("seed: 5", "seed: 6"), track)
    assert len({one.scene_object.seed for one in (*found[1:], *others[1:])}) == 24


def test_scattered_objects_are_even_over_area_and_azimuth(track: PingTrack) -> None:
    found = placed(
        "scatter: [{kinds: [cylinder], count: 600, apart_m: 0, length_m: [0.001, 0.001], width_m: [0.001, 0.001]}]",
        track,
    )
    assert len(found) == 600
    sides = [one.side for one in found]
    assert 240 <= sides.count("port") <= 360
    ranges = np.array([one.ground_range_m for one in found])
    low, high = np.nanmin(track.nearest_m), np.nanmax(track.farthest_m)
    counts, _ = np.histogram(ranges, bins=6, range=(low, high))
    assert counts.min() > 60
    azimuths, _ = np.histogram([one.scene_object.azimuth_rad for one in found], bins=4, range=(0.0, 2.0 * math.pi))
    assert azimuths.min() > 100
    contrasts = np.array([one.scene_object.strength_db for one in found])
    assert contrasts.std() == pytest.approx(4.0, rel=0.15)


def test_too_many_objects_are_refused_with_what_stands_in_the_way(track: PingTrack) -> None:
    with pytest.raises(UsageError, match=r"no room for number \d+ of 500; mostly because: another object"):
        placed("scatter: [{kinds: [box], count: 500, apart_m: 5}]", track)


def test_ranges_that_are_never_seen_are_refused(track: PingTrack) -> None:
    with pytest.raises(BadInputError, match="no sea floor between ground ranges"):
        placed("scatter: [{kinds: [box], count: 1, ground_range_m: [100, 200]}]", track)


def test_a_log_too_short_to_put_anything_on_is_reported_without_ranges(track: PingTrack) -> None:
    short = track._replace(why=("too close to the start or end of the recording",) * N_PINGS)
    with pytest.raises(
        BadInputError, match=r"no sea floor of the log is shown .*; mostly because: too close to the start or end"
    ):
        placed("scatter: [{kinds: [box], count: 1}]", short)


def test_looks_find_the_ping_that_a_place_was_made_from(track: PingTrack) -> None:
    for side in SIDES:
        east_m, north_m = track.plane_place(70, side, 9.0)
        ((ping, found_side, ground_range_m),) = track.looks(east_m, north_m)
        assert (abs(ping - 70) <= 1, found_side) == (True, side)
        assert ground_range_m == pytest.approx(9.0, abs=0.05)
    assert track.first_return_m[70] == pytest.approx(ALTITUDE_M, abs=0.15)


@pytest.mark.parametrize("pitch_rad", [0.0, 0.25, -0.25])
def test_a_place_abeam_is_where_the_payload_locates_it_however_the_array_pitches(
    pitch_rad: float, tmp_path: Path
) -> None:
    survey = read_survey(written(tmp_path / "plain.xtf"), CONFIG)
    (stretch,) = survey.stretches
    pitched = stretch._replace(poses=replace(stretch.poses, pitch_rad=np.full(stretch.n_pings, pitch_rad)))
    track = track_of(survey._replace(stretches=(pitched,)), CONFIG)
    for side in SIDES:
        for ping, ground_range_m in ((40, 5.0), (80, 15.0)):
            latitude, longitude, _ = heard_at(pitched, slice(ping, ping + 1), side, ground_range_m, CONFIG.sonar)
            there = track.frame.to_enu(latitude, longitude, 0.0)[0, :2]
            assert math.dist(track.plane_place(ping, side, ground_range_m), there) < 0.05
