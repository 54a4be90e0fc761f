"""MCAP files of missions: the format's own reader takes them, each message by the schema in the file."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from auv_mcm.records import SIDES, Side, Tile
from sim_replay.mcap_export import write_mcap
from tests.sim_replay.test_mosaic import ROW_M, tile

START_S = 1_700_000_000.0


def timed(index: int) -> Tile:
    one = tile(index)
    pose = msgspec.structs.replace(one.pose, time_s=START_S + one.pose.time_s)
    return msgspec.structs.replace(one, pose=pose, core_start=4, core_stop=36)


def contact(row: float, ground_range_m: float) -> dict[str, Any]:
    time = datetime.fromtimestamp(START_S + row * ROW_M / 2.0, UTC).isoformat()
    view = {"time": time, "side": "starboard", "ground_range_m": ground_range_m}
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [12.0, 55.0]},
        "properties": {"id": "C00001", "p_mine": 0.9, "views": [view]},
    }


def decoded(path: Path) -> list[tuple[str, str, Any, int]]:
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_summary() is not None
        return [
            (channel.topic, schema.name if schema else "", message, raw.log_time)
            for schema, channel, raw, message in reader.iter_decoded_messages()
        ]


def test_every_message_is_decoded_by_the_schema_in_the_file(tmp_path: Path) -> None:
    far: dict[str, Any] = {"type": "Feature", "geometry": None, "properties": {}}
    layers = {"contacts": [contact(10.5, 6.0)], "coverage": [far]}
    first, second = timed(0), timed(1)
    first.pose.depth_m[:], second.pose.depth_m[:] = 7.0, math.nan
    write_mcap(tmp_path / "m.mcap", [first, second], layers)
    found = decoded(tmp_path / "m.mcap")
    schemas = {topic: name for topic, name, _, _ in found}
    assert schemas == {
        "/vehicle/fix": "foxglove.LocationFix",
        "/sonar/starboard": "foxglove.CompressedImage",
        "/sonar/starboard/contacts": "foxglove.ImageAnnotations",
        "/map/contacts": "foxglove.GeoJSON",
    }
    assert min(time_ns for *_, time_ns in found) >= START_S * 1e9
    fixes = [message for topic, _, message, _ in found if topic == "/vehicle/fix"]
    assert (fixes[0].latitude, fixes[0].altitude) == (pytest.approx(54.0, abs=1e-4), -7.0)
    assert math.isnan(fixes[-1].altitude), "not the 0 of a depth that is unknown"


def test_the_track_goes_on_after_a_clock_was_set_back(tmp_path: Path) -> None:
    back, stale = timed(1), timed(2)
    back.pose.time_s[:] -= 3600.0
    stale.pose.stale[:] = True
    write_mcap(tmp_path / "m.mcap", [timed(0), back, stale], {})
    assert [topic for topic, *_ in decoded(tmp_path / "m.mcap")].count("/vehicle/fix") == 4


@pytest.mark.parametrize("side", SIDES)
def test_a_contact_is_ringed_where_it_lies_in_the_picture(side: Side, tmp_path: Path) -> None:
    bright, here = msgspec.structs.replace(timed(0), side=side), contact(10.0, 50.5 * ROW_M)
    here["properties"]["views"][0]["side"] = side
    bright.intensity[:] = 0.05
    bright.intensity[9:12, 49:52] = 30.0
    write_mcap(tmp_path / "m.mcap", [bright], {"contacts": [here, contact(400.0, 6.0)]})
    messages = {topic: message for topic, _, message, _ in decoded(tmp_path / "m.mcap")}
    picture = cv2.imdecode(np.frombuffer(messages[f"/sonar/{side}"].data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    down, right = np.argwhere(picture > 0.8 * picture.max()).mean(axis=0)
    (ring,) = messages[f"/sonar/{side}/contacts"].circles  # the other contact is elsewhere
    assert math.hypot(ring.position.x - right - 0.5, ring.position.y - down - 0.5) < 0.4
    assert messages[f"/sonar/{side}/contacts"].texts[0].text == "C00001 0.9000"


@pytest.mark.parametrize(("row", "n_rings"), [(35.5, [1, 0]), (36.0, [0, 1])])
def test_a_contact_between_two_tiles_is_ringed_in_one_of_them(tmp_path: Path, row: float, n_rings: list[int]) -> None:
    later = msgspec.structs.replace(timed(0), core_start=36, core_stop=40)
    write_mcap(tmp_path / "m.mcap", [timed(0), later], {"contacts": [contact(row, 6.0)]})
    found = [message for topic, _, message, _ in decoded(tmp_path / "m.mcap") if topic.endswith("starboard/contacts")]
    assert [len(message.circles) for message in found] == n_rings


def test_a_contact_in_the_first_row_of_a_tile_is_ringed_though_its_time_is_rounded(tmp_path: Path) -> None:
    write_mcap(tmp_path / "m.mcap", [timed(0)], {"contacts": [contact(4.0 - 8e-4 / ROW_M, 6.0)]})
    messages = {topic: message for topic, _, message, _ in decoded(tmp_path / "m.mcap")}
    assert len(messages["/sonar/starboard/contacts"].circles) == 1
