"""Recorded side-scan logs with the habits of their recorders."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import auv_mcm
from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.augment.background_log import read_survey
from sim_replay.augment.targets import parse_target_spec, place_targets
from sim_replay.augment.track import track_of
from sim_replay.logs.port_order import DECISIVE, port_order_evidence
from sim_replay.logs.xtf import XtfLog

PAGES = Path(auv_mcm.__file__).parent / "docs"
SCOTSMAN = "sidescan/scotsman-iver2.xtf"
COLORADO = "sidescan/colorado-river-455k.xtf"
BATHYMETRY = "sidescan/bathymetry-only.xtf"

Located = Callable[[str], Path]


def events_of(path: Path) -> tuple[list[SourceEvent], XtfLog]:
    log = XtfLog(path, SonarConfig())
    return list(log), log


@pytest.mark.parametrize(
    ("name", "n_pings", "n_samples", "range_m"), [(SCOTSMAN, 461, 1024, 29.98), (COLORADO, 1800, 1400, 26.32)]
)
def test_every_ping_arrives_whole(
    shared_data: Located, name: str, n_pings: int, n_samples: int, range_m: float
) -> None:
    events, log = events_of(shared_data(name))
    pings = [event for event in events if isinstance(event, Ping)]
    assert len(pings) == n_pings
    assert log.counters["reader.damaged_packet"] == 0
    for ping in pings:
        assert ping.sound_speed_mps == 1500.0
        for trace in (ping.port, ping.starboard):
            assert trace is not None
            assert trace.samples.shape == (n_samples,)
            assert trace.spacing_m * n_samples == pytest.approx(range_m, abs=0.01)
            assert trace.first_range_m == pytest.approx(0.5 * trace.spacing_m)
    assert np.all(np.diff([ping.time_s for ping in pings]) > 0.0)


@pytest.mark.parametrize("name", [SCOTSMAN, COLORADO])
def test_port_is_found_to_be_stored_far_to_near(shared_data: Located, name: str) -> None:
    events, _ = events_of(shared_data(name))
    notice = next(event for event in events if isinstance(event, Notice))
    assert notice.code == "reader.port_order"
    assert "stored far_to_near" in notice.text
    ping = next(event for event in events if isinstance(event, Ping))
    assert ping.port is not None
    assert ping.port.samples[:5].mean() > 2.0 * ping.port.samples[-1]  # ring-down is at the near end


@pytest.mark.parametrize("with_starboard", [True, False])
@pytest.mark.parametrize("name", [SCOTSMAN, COLORADO])
def test_port_order_is_seen_wherever_the_recording_starts(
    shared_data: Located, name: str, with_starboard: bool
) -> None:
    pings = [event for event in events_of(shared_data(name))[0] if isinstance(event, Ping)]
    port = np.stack([p.port.samples for p in pings if p.port is not None])
    starboard = np.stack([p.starboard.samples for p in pings if p.starboard is not None])
    trace = pings[0].port
    assert trace is not None
    for start in range(0, len(pings) - 50, 25):
        window = slice(start, start + 50)
        other = starboard[window] if with_starboard else None
        far_to_near = port_order_evidence(port[window, ::-1], other, trace.spacing_m, 1.0)
        near_to_far = port_order_evidence(port[window], other, trace.spacing_m, 1.0)
        assert far_to_near.total > (DECISIVE if with_starboard else 0.0), start
        assert near_to_far.total == pytest.approx(-far_to_near.total)


def test_scotsman_navigation(shared_data: Located) -> None:
    events, log = events_of(shared_data(SCOTSMAN))
    samples = [event for event in events if isinstance(event, NavSample)]
    pings = [event for event in events if isinstance(event, Ping)]
    assert log.counters["reader.zero_navigation"] == 1
    assert math.isnan(pings[0].altitude_m)
    assert samples[0].time_s == pings[1].time_s
    fixes = [sample for sample in samples if not math.isnan(sample.latitude_deg)]
    assert abs(len(fixes) - 219) <= 1
    assert all(a.latitude_deg != b.latitude_deg or a.longitude_deg != b.longitude_deg for a, b in pairwise(fixes))
    assert all(48.4 < fix.latitude_deg < 48.5 and -68.9 < fix.longitude_deg < -68.8 for fix in fixes)
    assert math.degrees(samples[0].pitch_rad) == pytest.approx(-20.7, abs=0.01)  # the vehicle dives, bow down
    assert samples[0].speed_mps == pytest.approx(1.7101 * 1852 / 3600, rel=1e-4)
    assert samples[-1].altitude_m < 0.5 * samples[0].altitude_m


def test_scotsman_saturation_is_left_in(shared_data: Located) -> None:
    events, _ = events_of(shared_data(SCOTSMAN))
    samples = [t.samples for p in events if isinstance(p, Ping) for t in (p.port, p.starboard) if t is not None]
    assert np.mean(np.concatenate(samples) == 32767) == pytest.approx(0.03, abs=0.01)


def test_colorado_stands_level_and_turns_slowly(shared_data: Located) -> None:
    events, _ = events_of(shared_data(COLORADO))
    samples = [event for event in events if isinstance(event, NavSample)]
    assert {sample.pitch_rad for sample in samples} == {0.0}
    assert {sample.roll_rad for sample in samples} == {0.0}
    assert all(197.0 < math.degrees(sample.heading_rad) < 238.0 for sample in samples)


def test_bathymetry_is_refused_saying_what_it_holds(shared_data: Located) -> None:
    path = shared_data(BATHYMETRY)
    with pytest.raises(BadInputError) as caught:
        XtfLog(path, SonarConfig())
    text = str(caught.value)
    assert str(path) in text
    assert "no side-scan channel" in text
    assert "1203 attitude" in text
    assert "qinsy_r2sonic_bathy" in text


@pytest.mark.parametrize("name", [SCOTSMAN, COLORADO])
def test_a_cut_copy_delivers_the_same_pings_up_to_the_cut(shared_data: Located, tmp_path: Path, name: str) -> None:
    whole = shared_data(name)
    cut = tmp_path / whole.name
    cut.write_bytes(whole.read_bytes()[:700_001])
    pings = [p for p in events_of(whole)[0] if isinstance(p, Ping)]
    events, log = events_of(cut)
    kept = [p for p in events if isinstance(p, Ping)]
    assert log.counters["reader.damaged_packet"] == 1
    assert 100 < len(kept) < len(pings)
    for a, b in zip(kept, pings, strict=False):
        assert (a.number, a.time_s, a.place) == (b.number, b.time_s, b.place)
        assert a.port is not None
        assert b.port is not None
        assert np.array_equal(a.port.samples, b.port.samples)


def test_the_targets_of_the_page_on_training_fit_a_line_of_56_m(shared_data: Located) -> None:
    page = (PAGES / "how-to" / "train-for-your-sonar.md").read_text("utf-8")
    spec = parse_target_spec(page.split("```yaml\n")[1].split("```")[0], "the page")
    placed = place_targets(spec, track_of(read_survey(shared_data(SCOTSMAN), Config()), Config()))
    assert len(placed) == 10
