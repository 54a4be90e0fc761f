"""Every sonar by its name, and the logs some of them leave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import BadInputError, UsageError
from drivers.sonar.logs import NOT_RECEIVED, read_log
from drivers.sonar.ping_messages import JsonWrapper, encode
from drivers.sonar.sonar_decoder import SonarFrame, SonarSettings
from drivers.sonar.sonars import SONARS, sonar_named
from tests.drivers.sonar.sonar_frames import profile


def svlog(path: Path, n_pings: int) -> Path:
    sides = [profile(ping_number=n, timestamp_ms=n * 67, channel_number=c) for n in range(n_pings) for c in (0, 1)]
    path.write_bytes(encode(JsonWrapper({"sonar": "Omniscan 450"})) + b"".join(map(encode, sides)))
    return path


def test_an_unknown_sonar_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(UsageError, match=r"no driver for a sonar 'klein'\. Known: ping_protocol, jsf, sportscan"):
        sonar_named("klein")


@pytest.mark.parametrize("name", SONARS)
def test_every_sonar_decodes_and_takes_settings(name: str) -> None:
    device = sonar_named(name)
    decoder = device.decoder()
    assert decoder.feed(bytes(range(256)) * 20, NOT_RECEIVED) + decoder.finish() == []
    assert decoder.counters[f"{name}.bytes_skipped"] == 5120
    sent = device.commands(SonarSettings(range_m=60.0, gain=3))
    assert sent
    assert all(isinstance(command, bytes) for command in sent)
    changed = {
        "range": device.commands(SonarSettings(range_m=30.0, gain=3)) != sent,
        "gain": device.commands(SonarSettings(range_m=60.0, gain=4)) != sent,
        "enable": device.commands(SonarSettings(range_m=60.0, gain=3, enabled=False)) != sent,
    }
    assert changed == {"range": device.sets_range, "gain": device.sets_gain, "enable": device.sets_enable}


def test_a_log_is_read_like_the_wire(tmp_path: Path) -> None:
    decoder = sonar_named("ping_protocol").decoder()
    frames = list(read_log(svlog(tmp_path / "run.svlog", 5), decoder))
    assert all(isinstance(frame, SonarFrame) and frame.port is not None and frame.starboard is not None for frame in frames)
    assert len(frames) == 5
    assert decoder.counters == {"ping_protocol.messages": 11, "ping_protocol.other_messages": 1}


def test_a_log_that_breaks_off_gives_what_was_whole(tmp_path: Path) -> None:
    path = svlog(tmp_path / "run.svlog", 5)
    path.write_bytes(path.read_bytes()[:-20])
    frames = [item for item in read_log(path, sonar_named("ping_protocol").decoder()) if isinstance(item, SonarFrame)]
    assert len(frames) == 5
    assert frames[-1].starboard is None


def test_logs_without_a_frame_are_refused(tmp_path: Path) -> None:
    other, empty = tmp_path / "other.svlog", tmp_path / "empty.svlog"
    other.write_bytes(np.random.Generator(np.random.PCG64(1)).bytes(3000))
    empty.touch()
    for path, told in (
        (other, "bytes_skipped 3000"),
        (empty, "it is empty"),
        (tmp_path / "absent", "cannot be read"),
        (tmp_path, "cannot be"),
    ):
        with pytest.raises(BadInputError, match=told):
            list(read_log(path, sonar_named("ping_protocol").decoder()))
