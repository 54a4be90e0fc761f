"""Lowrance, Humminbird and Klein logs: the numbers of the public layouts, through every door, however damaged."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.benches.recorder_files import write_humminbird, write_lowrance, write_sdf
from sim_replay.log_info import describe
from sim_replay.logs import humminbird, klein_sdf, lowrance
from sim_replay.logs.archive import logs_of
from sim_replay.logs.open_log import find_format, kind_doubt, open_log
from sim_replay.logs.recorded import open_mission
from tests.sim_replay.logs.sonar_logs import mission, pings


def _son(path: Path, events: tuple[NavSample | Ping, ...]) -> None:
    write_humminbird(path.with_name("R.DAT"), events, son=path.parent)


WRITERS: dict[str, Callable[[Path, tuple[NavSample | Ping, ...]], None]] = {
    "log.sl2": write_lowrance,
    "log.sl3": partial(write_lowrance, version=3, composite=False),
    "B002.SON": _son,
    "3000.sdf": partial(write_sdf, version=3000),
    "3502.sdf": partial(write_sdf, version=3502),
    "5004.sdf": partial(write_sdf, version=5004),
}
FORMAT = {".sl2": "lowrance", ".sl3": "lowrance", ".SON": "humminbird", ".sdf": "sdf"}
N_PINGS = 48
EVENTS = tuple(mission()[: 2 * N_PINGS])


def written(name: str, folder: Path, events: tuple[NavSample | Ping, ...] = EVENTS) -> Path:
    WRITERS[name](folder / name, events)
    return folder / name


def codes(events: list[SourceEvent]) -> list[str]:
    return [event.code for event in events if isinstance(event, Notice)]


def pings_of(path: Path, config: Config | None = None) -> tuple[list[Ping], Counter[str]]:
    log = open_log(path, config or Config())
    return pings(iter(log)), log.counters


# --- numbers ---


@pytest.mark.parametrize("name", WRITERS)
def test_pings_and_navigation_are_those_that_were_written(name: str, tmp_path: Path) -> None:
    """Samples of 8 bits are decibels, positions of fish finders whole metres of a map, depths of Humminbird 0.1 m."""
    events = list(open_log(written(name, tmp_path), Config()))
    found, sent = pings(iter(events)), pings(iter(EVENTS))
    samples = [event for event in events if isinstance(event, NavSample)]
    navigation = [event for event in EVENTS if isinstance(event, NavSample)]
    is_exact = name.endswith("sdf")
    assert [ping.time_s for ping in found] == pytest.approx([ping.time_s for ping in sent], abs=1e-3)
    for one, other in zip(found, sent, strict=True):
        assert one.altitude_m == pytest.approx(other.altitude_m, abs=1e-5 if name != "B002.SON" else 0.051)
        for trace, expected in ((one.port, other.port), (one.starboard, other.starboard)):
            assert trace is not None
            assert expected is not None
            range_m = trace.spacing_m * trace.samples.size
            assert range_m == pytest.approx(20.0, abs=1e-4 if name != "B002.SON" else 0.02)
            assert trace.first_range_m == pytest.approx(0.5 * trace.spacing_m)
            at = (np.arange(40, 760) + 0.5) * expected.spacing_m
            values = trace.samples[(at / trace.spacing_m).astype(int)].astype(float)
            whole = expected.samples[(at / expected.spacing_m).astype(int)].astype(float)
            if not is_exact:
                whole = np.rint(20.0 * np.log10(1.0 + whole) * 255.0 / 90.0)
            same = np.abs(values - whole) <= (0.0 if is_exact else 1.0)
            assert same.mean() > (0.3 if name == "B002.SON" else 0.999)  # samples of another length
    known = [s for s in samples if math.isfinite(s.latitude_deg)]
    assert len(known) > (N_PINGS - 2 if is_exact else 5)
    for sample in known:
        near = min(navigation, key=lambda one: abs(one.time_s - sample.time_s))
        tolerance_m = 1e-3 if is_exact else 0.8  # a metre of the map is less of the ground
        assert abs(sample.latitude_deg - near.latitude_deg) * 111_100.0 < tolerance_m
        assert abs(sample.longitude_deg - near.longitude_deg) * 81_300.0 < tolerance_m
        assert sample.heading_rad == pytest.approx(near.heading_rad, abs=1e-6 if name != "B002.SON" else 9e-4)
        assert sample.speed_mps == pytest.approx(near.speed_mps, abs=1e-6 if name[0] in "l5" else 0.051)
        level = (near.pitch_rad, near.roll_rad) if is_exact else (math.nan, math.nan)
        assert (sample.pitch_rad, sample.roll_rad) == pytest.approx(level, abs=1e-6, nan_ok=True)
        depth_m = near.depth_m if name == "3502.sdf" else math.nan
        assert sample.depth_m == pytest.approx(depth_m, abs=1e-5, nan_ok=True)


@pytest.mark.parametrize(
    ("place", "x", "y", "latitude_deg", "longitude_deg"),
    [
        # The radius times a twelfth of a turn, and times asinh(tan(latitude)), there divided by Humminbird's stretch.
        (lowrance._degrees, 3_328_388, 5_602_674, 45.0, 30.0),
        (lowrance._degrees, -3_328_388, -8_371_575, -60.0, -30.0),
        (humminbird._degrees, 3_339_716, 5_591_388, 45.0, 30.0),
        (humminbird._degrees, -3_339_716, -8_362_861, -60.0, -30.0),
    ],
)
def test_metres_of_the_map_become_degrees(
    place: Callable[[int, int], tuple[float, float]], x: int, y: int, latitude_deg: float, longitude_deg: float
) -> None:
    assert place(x, y) == pytest.approx((latitude_deg, longitude_deg), abs=1e-5)


@pytest.mark.parametrize("fish_rad", [math.nan, 0.1])
def test_the_place_is_that_of_a_klein_fish_or_else_of_its_ship(fish_rad: float, tmp_path: Path) -> None:
    path = written("3000.sdf", tmp_path)
    data, at = bytearray(path.read_bytes()), 0
    while at < len(data):
        struct.pack_into("<I", data, at + 96, 37)
        struct.pack_into("<f", data, at + 220, 0.0)  # hundredths count without a finer fraction
        struct.pack_into("<2d", data, at + 164, fish_rad, fish_rad)
        at += 4 + struct.unpack_from("<I", data, at + 4)[0]
    path.write_bytes(data)
    found, sent = (
        next(event for event in events if isinstance(event, NavSample)) for events in (open_log(path, Config()), EVENTS)
    )
    expected_deg = sent.latitude_deg if math.isnan(fish_rad) else math.degrees(fish_rad)
    assert found.latitude_deg == pytest.approx(expected_deg)
    assert found.time_s % 1.0 == pytest.approx(0.37)


def test_frames_of_version_13_have_a_longer_header(tmp_path: Path) -> None:
    write_lowrance(tmp_path / "10.sl3", EVENTS, version=3)
    data = (tmp_path / "10.sl3").read_bytes()
    longer, at = bytearray(data[:8]), 8
    while at < len(data):
        (n_bytes,) = struct.unpack_from("<H", data, at + 8)
        header = bytearray(data[at : at + 168] + b"\x55" * 12)
        struct.pack_into("<IIH", header, 0, len(longer), 13, n_bytes + 12)
        longer += header + data[at + 168 : at + n_bytes]
        at += n_bytes
    (tmp_path / "13.sl3").write_bytes(longer)
    expected, found = pings_of(tmp_path / "10.sl3")[0], pings_of(tmp_path / "13.sl3")[0]
    for one, other in zip(found, expected, strict=True):
        for trace, same in ((one.port, other.port), (one.starboard, other.starboard)):
            assert trace is not None
            assert same is not None
            assert trace.samples.tolist() == same.samples.tolist()


def test_five_beams_of_a_ping_fill_the_way_to_the_next_from_astern(tmp_path: Path) -> None:
    data = written("5004.sdf", tmp_path).read_bytes()
    (n_bytes,) = struct.unpack_from("<I", data, 4)
    whole = bytearray(data)
    for at in range(0, len(data), n_bytes + 4):
        struct.pack_into("<I", whole, at + 24, 0b10011)
        for beam in range(5):
            struct.pack_into("<H", whole, at + 516 + 2 + beam * 1602, beam)  # first sample to port
    (tmp_path / "beams.sdf").write_bytes(whole)
    found, _ = pings_of(tmp_path / "beams.sdf")
    assert [int(ping.port.samples[0]) for ping in found[3:9] if ping.port] == [4, 1, 0, 4, 1, 0]
    steps = np.diff([ping.time_s for ping in found[3:]])
    assert len(found) == 3 * N_PINGS
    assert steps == pytest.approx(0.08 / 3, abs=1e-3)


@pytest.mark.parametrize(("subsystem", "factor"), [(None, 1), (20, 2), (21, 1)])
def test_of_two_frequencies_of_a_klein_log_the_highest_is_used_or_the_one_configured(
    subsystem: Literal[20, 21] | None, factor: int, tmp_path: Path
) -> None:
    path = written("3000.sdf", tmp_path)
    events = list(open_log(path, Config(sonar=SonarConfig(subsystem=subsystem))))
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.code == "reader.frequency_chosen"
    assert notice.for_the_record == (subsystem is not None)
    first, sent = pings(iter(events))[0].port, pings(iter(EVENTS))[0].port
    assert first is not None
    assert sent is not None
    assert np.array_equal(first.samples, sent.samples // factor)


@pytest.mark.parametrize("subsystem", [None, 20, 21])
@pytest.mark.parametrize("first", [0, 2])
def test_a_klein_log_of_one_frequency_alone_is_read(
    first: int, subsystem: Literal[20, 21] | None, tmp_path: Path
) -> None:
    data, whole = written("3000.sdf", tmp_path).read_bytes(), bytearray()
    n_bytes = 4 + struct.unpack_from("<I", data, 4)[0]
    for at in range(0, len(data), n_bytes):
        head, vectors = bytearray(data[at : at + 516]), [data[at + 516 + n * 1602 :][:1602] for n in range(4)]
        body = b"".join(vector if first <= n < first + 2 else bytes(2) for n, vector in enumerate(vectors))
        struct.pack_into("<I", head, 4, 512 + len(body))
        whole += head + body
    (tmp_path / "3000.sdf").write_bytes(whole)
    events = list(open_log(tmp_path / "3000.sdf", Config(sonar=SonarConfig(subsystem=subsystem))))
    assert len(pings(iter(events))) == N_PINGS
    assert codes(events) == []


def test_a_sound_speed_that_is_set_scales_ranges(tmp_path: Path) -> None:
    for name in ("log.sl2", "3502.sdf"):
        path = written(name, tmp_path)
        (before, _), (after, _) = pings_of(path), pings_of(path, Config(sonar=SonarConfig(sound_speed_mps=1530.0)))
        assert before[0].port is not None
        assert after[0].port is not None
        assert after[0].port.spacing_m == pytest.approx(1.02 * before[0].port.spacing_m)
        assert after[0].sound_speed_mps == 1530.0


# --- doors ---


def test_a_humminbird_recording_is_one_log_by_any_of_its_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dat = tmp_path / "R00001.DAT"
    write_humminbird(dat, EVENTS, model="Solix")
    folder = dat.with_suffix("")
    expected, _ = pings_of(dat)
    monkeypatch.chdir(folder)
    for path in (folder, folder / "B002.SON", folder / "B003.SON", Path("B002.SON"), Path()):
        assert find_format(path).name == "humminbird"
        found, _ = pings_of(path)
        assert [ping.time_s for ping in found] == [ping.time_s for ping in expected]
        assert all(ping.port and ping.starboard for ping in found)
    assert [log.name for log in logs_of(tmp_path, tmp_path / "out")] == ["R00001/B002.SON"]
    assert kind_doubt(folder, Config(sonar=SonarConfig(kind="sas"))) != ""
    dat.unlink()
    (folder / "B002.SON").unlink()
    events = list(open_log(folder, Config()))
    assert codes(events) == ["reader.time_unknown", "reader.range_assumed"]
    assert {ping.port for ping in pings(iter(events))} == {None}
    (folder / "B003.SON").unlink()
    dat.write_bytes(b"\xc1" + bytes(63))
    with pytest.raises(BadInputError, match=r"R00001 has no B002\.SON .port. or B003\.SON"):
        open_log(dat, Config())


@pytest.mark.parametrize("n_bytes", [96, 100])
def test_the_dat_file_of_an_xplore_gives_the_time_of_its_recording(n_bytes: int, tmp_path: Path) -> None:
    dat = tmp_path / "R00001.DAT"
    write_humminbird(dat, EVENTS, model="Solix")
    expected, _ = pings_of(dat)
    dat.write_bytes(b"\xc4" + dat.read_bytes()[1:] + bytes(n_bytes - 96))
    assert find_format(dat).name == "humminbird"
    assert [ping.time_s for ping in pings_of(dat)[0]] == [ping.time_s for ping in expected]


@pytest.mark.parametrize("name", ["B002.SON", "3502.sdf"])
def test_info_describes_a_log(name: str, tmp_path: Path) -> None:
    info = describe(written(name, tmp_path), Config())
    assert info["format"] == FORMAT[Path(name).suffix]
    assert info["used"]["pings"] == N_PINGS
    assert info["navigation"]["heading_minus_course_deg"] == pytest.approx(0.0, abs=4.0)
    assert info["altitude"]["stated_minus_first_return_m"] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("name", WRITERS)
def test_a_log_is_known_by_its_content_also_without_its_beginning(name: str, tmp_path: Path) -> None:
    whole = written(name, tmp_path).read_bytes()
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(1500) + whole[1500:])
    assert find_format(path).name == FORMAT[Path(name).suffix]
    for module in (humminbird, klein_sdf, lowrance):
        is_own = module.__name__.endswith(FORMAT[Path(name).suffix])
        assert bool(module.recognise(whole)) == is_own or (name.endswith("sdf") and module is klein_sdf)


# --- damage ---


def damaged(whole: bytes, how: str) -> bytes:
    data, middle = bytearray(whole), len(whole) // 2
    random = np.random.Generator(np.random.PCG64(3))
    match how:
        case "cut off":
            return bytes(data[: middle + 7])
        case "bytes removed":
            del data[middle : middle + 100]
        case "bytes inserted":
            data[middle:middle] = random.bytes(300)
        case "zeros":
            data[middle : middle + 4000] = bytes(4000)
        case "ones":
            data[middle : middle + 4000] = b"\xff" * 4000
        case "twice":
            data *= 2
        case "flipped":
            at = random.integers(len(data), size=30)
            for place in at:
                data[place] ^= 1 << int(random.integers(8))
    return bytes(data)


DAMAGE = {"cut off": 32, "bytes removed": 3, "bytes inserted": 2, "zeros": 5, "ones": 5, "twice": 1, "flipped": 30}
"""Pings that it may cost, at most."""


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("how", DAMAGE)
def test_damage_costs_the_pings_that_it_hits_and_is_counted(name: str, how: str, tmp_path: Path) -> None:
    path = written(name, tmp_path)
    path.write_bytes(damaged(path.read_bytes(), how))
    events = list(open_log(path, Config()))
    assert pings(iter(events))[-1].time_s < pings(iter(EVENTS))[-1].time_s + 1.0
    n_whole = sum(ping.port is not None and ping.starboard is not None for ping in pings(iter(events)))
    assert N_PINGS - DAMAGE[how] <= n_whole <= 2 * N_PINGS
    if how in ("cut off", "zeros", "bytes inserted"):
        assert "reader.damaged_bytes" in codes(events)


@pytest.mark.parametrize("name", WRITERS)
def test_a_length_that_would_swallow_what_follows_costs_its_own_message(name: str, tmp_path: Path) -> None:
    path = written(name, tmp_path)
    data = bytearray(path.read_bytes())
    at, form, value = {
        ".sl2": (8 + 28, "<H", 60_000),
        ".sl3": (8 + 8, "<H", 60_000),
        ".SON": (67, ">I", 60_000),
        ".sdf": (4, "<I", 4_000_000),
    }[path.suffix]
    for length in (value, (1 << 8 * struct.calcsize(form)) - 1, 0):
        struct.pack_into(form, data, at, length)
        path.write_bytes(data)
        found, _ = pings_of(path)
        assert sum(ping.port is not None for ping in found) >= N_PINGS - 1


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_left_of_a_log_is_read_or_refused_in_words(name: str, tmp_path: Path) -> None:
    path = written(name, tmp_path)
    whole = path.read_bytes()
    (tmp_path / "B003.SON").unlink(missing_ok=True)
    for n_bytes in (0, 1, 7, 8, 9, 40, 150, 200, 260, 520, 600, 1500, 4000):
        path.write_bytes(whole[:n_bytes])
        try:
            found = pings(open_mission([path], Config()).events())
        except BadInputError as error:
            said = str(error)
            assert str(path) in said, n_bytes
        else:
            assert found, n_bytes


@pytest.mark.parametrize("name", WRITERS)
def test_the_read_buffer_changes_nothing(name: str, tmp_path: Path) -> None:
    path = written(name, tmp_path, EVENTS[:12])
    data = bytearray(path.read_bytes())
    data[5000:5100] = bytes(100)
    path.write_bytes(data)

    def read(chunk_bytes: int) -> tuple[list[str], Counter[str]]:
        log = open_log(path, Config(), chunk_bytes)
        return [repr(structs.astuple(event)) for event in log], log.counters

    assert read(61) == read(1 << 18)


def test_one_impossible_time_is_left_out_and_a_date_that_cannot_be_too(tmp_path: Path) -> None:
    data = bytearray(written("3502.sdf", tmp_path).read_bytes())
    n_page = 4 + struct.unpack_from("<I", data, 4)[0]
    struct.pack_into("<I", data, 20 * n_page + 72, 2031)
    struct.pack_into("<I", data, 30 * n_page + 76, 13)
    (tmp_path / "3502.sdf").write_bytes(data)
    found, counters = pings_of(tmp_path / "3502.sdf")
    assert len(found) == N_PINGS - 2
    assert (counters["reader.time_outlier"], counters["reader.time_invalid"]) == (1, 1)


def test_a_log_without_date_side_scan_or_position_says_so(tmp_path: Path) -> None:
    data = bytearray(written("log.sl2", tmp_path).read_bytes())
    frames, at = [], 8
    while at < len(data):
        frames.append(at)
        at += struct.unpack_from("<H", data, at + 28)[0]

    def with_all(place: int, form: str, value: float) -> Path:
        changed = bytearray(data)
        for frame in frames:
            struct.pack_into(form, changed, frame + place, value)
        (tmp_path / "log.sl2").write_bytes(changed)
        return tmp_path / "log.sl2"

    events = list(open_log(with_all(60, "<I", 0xFFFFFFFF), Config()))
    assert codes(events) == ["reader.time_unknown"]
    assert pings(iter(events))[0].time_s == pytest.approx(0.0, abs=1e-3)
    with pytest.raises(BadInputError, match=r"no usable side-scan ping .*not_used.channel_2"):
        open_mission([with_all(32, "<H", 2)], Config())
    with pytest.raises(BadInputError, match=r"not one position: .*satellite receiver"):
        open_mission([with_all(108, "<q", 0)], Config())
    for value in (0.0, -5.0, math.nan, math.inf, 1e30):
        with pytest.raises(BadInputError, match=r"no usable side-scan ping .*ping_empty"):
            open_mission([with_all(44, "<f", value)], Config())
