"""What is written is read back, by this project's reader and by pyxtf's own."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import pyxtf
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.errors import UsageError
from auv_mcm.records import SIDES, EchoTrace, NavSample, Ping
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.logs.xtf_writer import write_xtf
from tests.sim_replay.logs.xtf_logs import (
    START_S,
    mission,
    navigated,
    navigation_of,
    ping,
    pings_of,
    read,
    same_trace,
    trace,
    written,
)

ANGLE = st.floats(-math.pi, math.pi)


@given(
    time_s=st.floats(4e8, 2.5e9),
    latitude=st.floats(-90.0, 90.0),
    longitude=st.floats(-180.0, 180.0, exclude_max=True).filter(lambda x: x != 0.0),
    angles=st.tuples(st.floats(0.0, 2 * math.pi), ANGLE, ANGLE),
    depth=st.floats(0.0, 6000.0),
    altitude=st.floats(0.1, 500.0),
    speed=st.floats(0.0, 20.0),
    sound=st.floats(1400.0, 1600.0),
    range_m=st.floats(1.0, 600.0),
)
def test_everything_comes_back_within_the_resolution_of_its_field(
    tmp_path_factory: pytest.TempPathFactory,
    time_s: float,
    latitude: float,
    longitude: float,
    angles: tuple[float, float, float],
    depth: float,
    altitude: float,
    speed: float,
    sound: float,
    range_m: float,
) -> None:
    nav = NavSample(
        time_s=time_s,
        latitude_deg=latitude,
        longitude_deg=longitude,
        heading_rad=angles[0],
        pitch_rad=angles[1],
        roll_rad=angles[2],
        depth_m=depth,
        altitude_m=altitude,
        speed_mps=speed,
    )
    sent = Ping(
        number=0,
        time_s=time_s,
        port=trace(1, 40, range_m=range_m),
        starboard=trace(2, 40, range_m=range_m),
        sound_speed_mps=sound,
        altitude_m=altitude,
    )
    events, _ = read(written(tmp_path_factory.mktemp("round") / "log.xtf", [nav, sent]))
    (got_nav,), (got,) = navigation_of(events), pings_of(events)
    assert got.time_s == pytest.approx(time_s, abs=0.005001)
    assert got_nav.time_s == got.time_s
    assert (got_nav.latitude_deg, got_nav.longitude_deg) == (latitude, longitude)
    for name in ("heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"):
        assert getattr(got_nav, name) == pytest.approx(getattr(nav, name), rel=2e-7, abs=1e-40)
    assert got.altitude_m == pytest.approx(altitude, rel=2e-7)
    assert got.sound_speed_mps == pytest.approx(sound, rel=2e-7)
    assert same_trace(got.port, sent.port)
    assert same_trace(got.starboard, sent.starboard)


@pytest.mark.parametrize("sample_type", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("far_to_near", [True, False])
def test_samples_come_back_exactly(tmp_path: Path, sample_type: SampleType, far_to_near: bool) -> None:
    pings = [ping(n, dtype=sample_type, n_samples=70 + n) for n in range(5)]
    path = written(tmp_path / "log.xtf", navigated(pings), sample_type=sample_type, port_far_to_near=far_to_near)
    events, _ = read(path, port_order="far_to_near" if far_to_near else "near_to_far")
    for got, sent in zip(pings_of(events), pings, strict=True):
        assert same_trace(got.port, sent.port)
        assert same_trace(got.starboard, sent.starboard)


def test_pyxtf_reads_the_same_samples(tmp_path: Path) -> None:
    path = written(tmp_path / "log.xtf", 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        header, packets = pyxtf.xtf_read(str(path))
    assert header.NumberOfSonarChannels == 2
    records = packets[pyxtf.XTFHeaderType.sonar]
    for record, sent in zip(records, pings_of(mission(4)), strict=True):
        assert sent.port is not None
        assert sent.starboard is not None
        assert np.array_equal(record.data[0], sent.port.samples[::-1])
        assert np.array_equal(record.data[1], sent.starboard.samples)
        assert record.NumBytesThisRecord % 64 == 0
        assert (record.get_time() - np.datetime64(0, "s")) / np.timedelta64(1, "ms") == round(sent.time_s * 1000)


def test_it_returns_the_number_of_pings(tmp_path: Path) -> None:
    assert write_xtf(tmp_path / "log.xtf", mission(7)) == 7


def test_writing_is_streaming(tmp_path: Path) -> None:
    path = tmp_path / "log.xtf"
    written_so_far = []

    def watched() -> Iterator[NavSample | Ping]:
        for event in mission(400):
            written_so_far.append(sum(file.stat().st_size for file in tmp_path.iterdir()))
            yield event

    write_xtf(path, watched())
    assert written_so_far[-1] > 0.9 * path.stat().st_size


def test_quantities_not_measured_anew_keep_their_value(tmp_path: Path) -> None:
    first = NavSample(time_s=START_S, latitude_deg=43.0, longitude_deg=5.0, heading_rad=1.0, altitude_m=3.0)
    second = NavSample(time_s=START_S + 0.1, heading_rad=1.5)
    samples = navigation_of(read(written(tmp_path / "log.xtf", [first, ping(0), second, ping(1)]))[0])
    assert [s.heading_rad for s in samples] == pytest.approx([1.0, 1.5])
    assert math.isnan(samples[1].latitude_deg)  # the same fix as before
    assert math.isnan(samples[0].pitch_rad)
    assert math.isnan(samples[0].speed_mps)


def test_a_first_range_beyond_half_a_sample_is_kept(tmp_path: Path) -> None:
    far = EchoTrace(samples=np.arange(50, dtype=np.uint16), first_range_m=4.0, spacing_m=0.1)
    sent = Ping(number=0, time_s=START_S, port=far, starboard=None, sound_speed_mps=1480.0)
    (got,) = pings_of(read(written(tmp_path / "log.xtf", navigated([sent])))[0])
    assert got.port is not None
    assert got.port.first_range_m == pytest.approx(4.0, rel=1e-6)
    assert got.port.spacing_m == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize(
    ("values", "sample_type"),
    [([1.5], "uint16"), ([70000], "uint16"), ([-1], "uint8"), ([300], "uint8"), ([math.nan], "uint8")],
)
def test_samples_that_do_not_fit_are_refused(tmp_path: Path, values: list[float], sample_type: SampleType) -> None:
    echo = EchoTrace(samples=np.array(values), first_range_m=0.05, spacing_m=0.1)
    with pytest.raises(UsageError, match="do not fit"):
        written(
            tmp_path / "log.xtf", [Ping(number=0, time_s=START_S, port=echo, starboard=None)], sample_type=sample_type
        )


def test_sides_declared_are_those_asked_for(tmp_path: Path) -> None:
    for sides in (SIDES, ("port",), ("starboard",)):
        data = written(tmp_path / "log.xtf", 1, sides=sides).read_bytes()
        header = pyxtf.XTFFileHeader.from_buffer_copy(data)
        assert [info.TypeOfChannel for info in header.ChanInfo if info.TypeOfChannel] == [
            1 + SIDES.index(side) for side in sides
        ]
