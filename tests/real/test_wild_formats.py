"""Recordings with one odd property each, of sides, channels and formats: the object at its place and on its side."""

from __future__ import annotations

import math
import shutil
import socket
import threading
from pathlib import Path

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Notice
from auv_mcm.settings.config import Config, parse_config
from drivers.framing import Framer
from drivers.navigation.nav_protocols import text_decoder
from drivers.port_check import port_findings
from drivers.sonar.ping_messages import OsMonoProfile, decode, encode
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.logs.recorded import RecordedMission

WILD = Path(__file__).parents[3] / "shared" / "data" / "wild"
pytestmark = pytest.mark.skipif(not WILD.is_dir(), reason="the folder shared/data/wild is not beside this checkout")
LATITUDE_DEG, LONGITUDE_DEG = 43.0933700, 5.8874211
M_PER_DEG = 111_195.0  # of a great circle
CASES = {
    "xtf-channel-number-zero/chnum0.xtf": {"reader.channel_numbers"},
    "xtf-channel-per-packet/one_channel_per_packet.xtf": set(),
    "xtf-dual-frequency/dual.xtf": {"reader.frequency_chosen"},
    "xtf-bipolar-samples/bipolar.xtf": set(),
    "xtf-both-sides-in-one-channel/combined.xtf": {"reader.both_sides_in_one_channel"},
    "svlog-side-in-look-angle/stbd_on_channel0.svlog": {"sonar_sides_disagree"},
    "jsf-large-other-message/bathy.jsf": set(),
}


@pytest.mark.parametrize("name", CASES)
def test_the_object_is_at_its_place_on_its_side_and_the_odd_property_is_named(name: str) -> None:
    pipeline = Pipeline(Config())
    mission = RecordedMission([WILD / name], Config())
    events = [made for event in mission.events() for made in pipeline.feed(event)] + pipeline.finish()
    (contact,) = [contact for contact in pipeline.contacts if contact.p_mine > 0.5]
    north_m = M_PER_DEG * (contact.latitude_deg - LATITUDE_DEG)
    east_m = M_PER_DEG * (contact.longitude_deg - LONGITUDE_DEG) * math.cos(math.radians(LATITUDE_DEG))
    assert math.hypot(north_m, east_m) < 1.0
    assert {view.side for view in contact.views} == {"starboard"}
    notices = {event.code for event in events if isinstance(event, Notice) and not event.for_the_record}
    assert CASES[name] <= notices
    assert not notices & {"reader.damaged_bytes", "reader.damaged_packet", "reader.time_tied"}


def test_the_json_of_a_water_linked_dvl_gives_velocity_altitude_and_attitude() -> None:
    unit = text_decoder("water_linked", "dvl")
    fixes = unit.feed((WILD / "water-linked-json" / "feed.jsonl").read_bytes(), Stamp(0, 0))
    assert len(fixes) == 80
    assert fixes[0].speed_mps == pytest.approx(1.78, abs=0.01)
    assert fixes[0].altitude_m == pytest.approx(5.9)
    assert math.isnan(fixes[1].heading_rad)  # its yaw of 53.9 counts from the last reset
    assert math.isfinite(fixes[1].pitch_rad + fixes[1].roll_rad)


def test_a_log_under_two_names_gives_every_contact_and_all_floor_once(tmp_path: Path) -> None:
    log = WILD / "xtf-channel-number-zero" / "chnum0.xtf"
    copy = shutil.copy(log, tmp_path / "a copy.xtf")
    one, two = (RecordedMission(paths, Config()) for paths in ([log], [log, Path(copy)]))
    assert [notice.code for notice in two.notices] == ["log_repeated"]
    assert sum(1 for _ in two.events()) == 1 + sum(1 for _ in one.events())  # the notice


def test_check_ends_in_one_line_of_a_sonar_that_pings_as_soon_as_it_is_connected(
    capsys: pytest.CaptureFixture[str],
) -> None:
    data = (WILD / "svlog-side-in-look-angle" / "stbd_on_channel0.svlog").read_bytes()
    messages = [decode(framed.message) for framed in Framer(PingGrammar()).feed(data)]
    heads = [message for message in messages if isinstance(message, OsMonoProfile)]
    profiles = b"".join(encode(head._replace(channel_number=1)) for head in heads)  # as its look angle says
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(profiles)
                connection.recv(1)  # until the check hangs up

        threading.Thread(target=serve, daemon=True).start()
        link = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        port = f"{{name: sonar, link: '{link}', device: ping_protocol}}"
        config = parse_config(f"{{sonar: {{beam_width_deg: 0.5}}, ports: [{port}]}}", "vehicle.yaml")
        (found,) = port_findings(config, 1.0)
    assert (found.verdict, found.name) == ("ok", "port sonar")
    assert "pings of starboard, 580 samples a side to 22.7 m" in found.detail
    assert capsys.readouterr().err == ""
