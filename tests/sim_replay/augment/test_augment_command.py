"""The files that augmenting a log writes, and whom it refuses."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Ping
from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.targets import parse_target_spec
from sim_replay.logs.open_log import open_log
from sim_replay.logs.xtf import XtfLog
from sim_replay.scoring.inputs import read_truth
from tests.sim_replay.augment.plain_logs import CONFIG, HEADING_RAD, STEP_M, written
from tests.sim_replay.logs.xtf_logs import packet, stored

SPEC = """
targets:
  - {kind: cylinder, side: starboard, ping: 80, ground_range_m: 12, azimuth_deg: 75, burial_m: 0.1}
  - {kind: rock, side: port, along_m: 6.0, ground_range_m: 9}
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return written(tmp_path / "plain.xtf")


def test_the_truth_names_every_object_where_it_lies(log: Path, tmp_path: Path) -> None:
    done = augment(log, parse_target_spec(SPEC, "spec"), tmp_path / "out", CONFIG, seabed="sand")
    assert (done.n_objects, done.n_targets, done.n_hidden) == (2, 1, 0)
    assert done.log == tmp_path / "out" / "plain.xtf"
    truth = read_truth(done.truth)
    assert [scene_object.kind for scene_object in truth.objects] == ["cylinder", "rock"]
    assert [scene_object.is_target for scene_object in truth.objects] == [True, False]
    # 16 m of track less its ends, both sides from about 3 to 22 m; square metres that are touched count whole.
    assert 1.0 < truth.area_km2 * 1e6 / (2 * 14.4 * 18.6) < 1.2
    east, north, _ = LocalFrame(latitude_deg=43.0, longitude_deg=5.5).to_enu(
        truth.objects[0].latitude_deg, truth.objects[0].longitude_deg, 0.0
    )
    ahead = east * math.sin(HEADING_RAD) + north * math.cos(HEADING_RAD)
    across = east * math.cos(HEADING_RAD) - north * math.sin(HEADING_RAD)
    assert (ahead, across) == (pytest.approx(80 * STEP_M, abs=0.1), pytest.approx(12.0, abs=0.05))
    facts = json.loads(done.truth.read_text())["objects"][0]
    assert facts["azimuth_deg"] == pytest.approx(75.0)
    assert facts["burial_m"] == 0.1
    assert facts["rise_m"] == pytest.approx(0.43)
    assert (facts["side"], facts["ping"], facts["ground_range_m"]) == ("starboard", 80, 12.0)
    assert facts["background"] == "plain.xtf"
    assert facts["seabed"] == "sand"
    assert 0.5 < facts["visible_fraction"] <= 1.0
    assert facts["contrast_db"] > 0.0


def test_targets_lie_where_a_replay_of_the_same_configuration_sees_them(log: Path, tmp_path: Path) -> None:
    swapped = msgspec.structs.replace(CONFIG, sonar=msgspec.structs.replace(CONFIG.sonar, sides="swapped"))
    done = augment(log, parse_target_spec(SPEC, "spec"), tmp_path / "out", swapped)
    changed = {"port": 0, "starboard": 0}
    for before, after in zip(open_log(log, swapped), open_log(done.log, swapped), strict=True):
        if isinstance(before, Ping) and isinstance(after, Ping) and before.number == 80:
            for side in changed:
                changed[side] = int((getattr(before, side).samples != getattr(after, side).samples).sum())
    assert changed["starboard"] > 10 * changed["port"], "the cylinder's side at ping 80"


def test_a_recorder_that_writes_a_packet_per_channel_gets_the_same_targets(log: Path, tmp_path: Path) -> None:
    head, kept = stored(log)
    apart = tmp_path / "apart.xtf"
    apart.write_bytes(bytes(head) + b"".join(packet(one.header, [side]) for one in kept for side in one.sides))
    spec = parse_target_spec(SPEC, "spec")
    together, parted = (augment(one, spec, tmp_path / f"out-{one.stem}", CONFIG).log for one in (log, apart))
    for one, other in zip(open_log(together, CONFIG), open_log(parted, CONFIG), strict=True):
        if isinstance(one, Ping) and isinstance(other, Ping):
            for side in ("port", "starboard"):
                assert np.array_equal(getattr(one, side).samples, getattr(other, side).samples)


def test_equal_input_gives_equal_files(log: Path, tmp_path: Path) -> None:
    spec = parse_target_spec(SPEC, "spec")
    one, two = (augment(log, spec, tmp_path / name, CONFIG) for name in ("one", "two"))
    assert one.log.read_bytes() == two.log.read_bytes()
    assert one.truth.read_bytes() == two.truth.read_bytes()
    assert one.log.read_bytes() != log.read_bytes()


def test_the_log_itself_and_another_of_its_name_are_never_overwritten(log: Path, tmp_path: Path) -> None:
    (out := tmp_path / "day2").mkdir()
    (out / log.name).write_bytes(b"another day")
    with pytest.raises(UsageError, match="never overwritten"):
        augment(log, parse_target_spec(SPEC, "spec"), out, CONFIG)
    assert (out / log.name).read_bytes() == b"another day"
    before = log.read_bytes()
    with pytest.raises(UsageError, match="never overwritten"):
        augment(log, parse_target_spec(SPEC, "spec"), log.parent, CONFIG)
    assert log.read_bytes() == before


def test_a_directory_that_cannot_be_written_to_is_refused(log: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UsageError, match="a file is in its place"):
        augment(log, parse_target_spec(SPEC, "spec"), tmp_path / "file", CONFIG)


def test_a_log_without_side_scan_is_refused(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no side-scan channel"):
        augment(
            shared_data("sidescan/bathymetry-only.xtf"), parse_target_spec(SPEC, "spec"), tmp_path / "out", Config()
        )


@pytest.mark.parametrize(
    ("name", "ping", "ground_range_m"), [("scotsman-iver2.xtf", 250, 11.0), ("colorado-river-455k.xtf", 494, 14.0)]
)
def test_recorded_logs_change_around_the_target_only(
    shared_data: Callable[[str], Path], tmp_path: Path, name: str, ping: int, ground_range_m: float
) -> None:
    log = shared_data(f"sidescan/{name}")
    spec = parse_target_spec(
        f"targets: [{{kind: cylinder, side: port, ping: {ping}, ground_range_m: {ground_range_m}, azimuth_deg: 20}}]",
        "spec",
    )
    done = augment(log, spec, tmp_path / "out", Config())
    before, after = (np.frombuffer(path.read_bytes(), dtype=np.uint8) for path in (log, done.log))
    assert before.size == after.size
    assert 0 < np.count_nonzero(before != after) < 10_000
    pairs = zip(
        *([event for event in XtfLog(path, Config().sonar) if isinstance(event, Ping)] for path in (log, done.log)),
        strict=True,
    )
    touched = []
    for old, new in pairs:
        assert old.port is not None
        assert new.port is not None
        assert old.starboard is not None
        assert new.starboard is not None
        assert np.array_equal(old.starboard.samples, new.starboard.samples)
        if not np.array_equal(old.port.samples, new.port.samples):
            touched.append(old.number)
    assert max(abs(number - ping) for number in touched) < 60
    look = json.loads(done.truth.read_text())["objects"][0]["looks"][0]
    assert look["visible_fraction"] > 0.5
