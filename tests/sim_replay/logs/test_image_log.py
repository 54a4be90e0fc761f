"""Sonar images through the door of logs: the pings they were made of, the same contacts, bounded memory."""

from __future__ import annotations

import json
import math
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile
import yaml
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.cli import main
from auv_mcm.errors import BadInputError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.benches.recorder_files import write_lowrance
from sim_replay.logs.image_looks import doppler_centroid, mean_of_looks, sub_band, sub_bands
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.open_log import describe_log, kind_doubt, logs_config, open_log
from sim_replay.logs.recorded import RecordedMission, open_mission
from sim_replay.logs.xtf_navigation import projection
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.wire_logs import write_jsf, write_session, write_svlog
from tests.sim_replay.logs.image_writer import write_images
from tests.sim_replay.logs.sonar_logs import apart_m, contacts_of, mission, run_of

N_LINES, N_PIXELS = 40, 64
SAS = Config(sonar=SonarConfig(kind="sas"))
SIDECAR: dict[str, Any] = {
    "side": "starboard",
    "near_edge": "left",
    "pixel_along_m": 0.1,
    "pixel_across_m": 0.05,
    "range": "slant",
    "near_range_m": 12.0,
    "altitude_m": 8.0,
    "samples": "amplitude",
    "start_time": "2026-06-01T10:00:00Z",
    "track": "track.csv",
}


def plane(dtype: Any = np.uint16, n_lines: int = N_LINES, n_pixels: int = N_PIXELS) -> NDArray[Any]:
    """Numbers that differ in every pixel."""
    return (np.arange(n_lines * n_pixels).reshape(n_lines, n_pixels) % 251 + 1).astype(dtype)


def beside(path: Path, n_lines: int = N_LINES, **changes: Any) -> Path:
    """Write sidecar and track for an image; a change to None removes a key."""
    sidecar = {key: value for key, value in (SIDECAR | changes).items() if value is not None}
    sidecar_path(path).write_text(yaml.safe_dump(sidecar))
    rows = [f"{line},{43.0 + line * 0.1 / 111_120.0:.9f},5.5" for line in range(n_lines)]
    (path.parent / "track.csv").write_text("line,latitude_deg,longitude_deg\n" + "\n".join(rows) + "\n")
    return path


def pings(path: Path) -> list[Ping]:
    return [event for event in open_log(path, Config()) if isinstance(event, Ping)]


def intensities(path: Path) -> NDArray[np.float32]:
    return np.stack([trace.samples for ping in pings(path) for trace in (ping.port, ping.starboard) if trace])


# --- the same scene in every format ---


def test_one_scene_gives_the_same_contacts_in_every_format(tmp_path: Path) -> None:
    write_xtf(tmp_path / "scene.xtf", mission())
    write_lowrance(tmp_path / "scene.sl2", mission())
    logs: dict[str, tuple[list[Path], Config]] = {
        "XTF": ([tmp_path / "scene.xtf"], Config()),
        "JSF": ([write_jsf(run_of("jsf"), tmp_path / "scene.jsf")], run_of("jsf").config),
        "svlog": ([write_svlog(run_of("ping_protocol"), tmp_path / "s.svlog")], run_of("ping_protocol").config),
        "session": ([write_session(run_of("jsf"), tmp_path / "session")], run_of("jsf").config),
        "SL2": ([tmp_path / "scene.sl2"], Config()),
        "GeoTIFF": (write_images(tmp_path, mission(), place="tags", compression="zlib"), Config()),
    }
    found = {name: contacts_of(open_mission(paths, config).events(), config) for name, (paths, config) in logs.items()}
    # An image knows one line of flight, its sides are tracked apart, and a bottom bin is 5 cm. SL2 knows whole metres.
    tolerance_m = {"GeoTIFF": 0.3, "SL2": 0.7}
    for name, contacts in found.items():
        likely = sorted((one for one in contacts if one.p_mine > 0.25), key=lambda one: one.latitude_deg)
        expected = sorted((one for one in found["XTF"] if one.p_mine > 0.25), key=lambda one: one.latitude_deg)
        assert len(likely) == len(expected) == 2, name
        for one, other in zip(likely, expected, strict=True):
            assert one.classification == other.classification, name
            assert apart_m(one, other) < tolerance_m.get(name, 0.05), name


# --- what a picture means ---


@pytest.mark.parametrize("container", ["plain", "deflate", "tiles", "big", "png", "npy"])
def test_containers_hold_the_same_pings(container: str, tmp_path: Path) -> None:
    numbers = plane()
    path = tmp_path / {"png": "a.png", "npy": "a.npy"}.get(container, "a.tif")
    if container == "png":
        cv2.imwrite(str(path), numbers)
    elif container == "npy":
        np.save(path, numbers)
    else:
        options: dict[str, Any] = {
            "plain": {},
            "deflate": {"compression": "zlib", "rowsperstrip": 7},
            "tiles": {"compression": "zlib", "predictor": True, "tile": (16, 32)},
            "big": {"bigtiff": True, "byteorder": ">"},
        }[container]
        tifffile.imwrite(path, numbers, photometric="minisblack", **options)
    assert np.array_equal(intensities(beside(path)), numbers.astype(np.float32) ** 2)
    first = pings(path)[0]
    assert first.port is None
    assert first.starboard is not None
    assert first.starboard.first_range_m == pytest.approx(12.025)
    assert first.transfer == "intensity"


@pytest.mark.parametrize("edge", ["left", "right", "top", "bottom"])
@pytest.mark.parametrize("lines", ["forward", "backward"])
def test_lines_come_near_to_far_first_recorded_first(edge: str, lines: str, tmp_path: Path) -> None:
    numbers = plane()
    stored = numbers[::-1] if lines == "backward" else numbers
    stored = stored if edge in ("left", "top") else stored[:, ::-1]
    stored = stored if edge in ("left", "right") else stored.T
    tifffile.imwrite(tmp_path / "a.tif", np.ascontiguousarray(stored), photometric="minisblack")
    path = beside(tmp_path / "a.tif", near_edge=edge, lines=lines)
    assert np.array_equal(intensities(path), numbers.astype(np.float32) ** 2)
    fixes = [event.latitude_deg for event in open_log(path, Config()) if isinstance(event, NavSample)]
    assert (np.diff(fixes) > 0.0).all() == (lines == "forward")


def test_laws_of_samples_give_one_intensity(tmp_path: Path) -> None:
    numbers = plane(np.float32)
    for name, stored, law in (
        ("amplitude", numbers, {"samples": "amplitude"}),
        ("intensity", numbers**2, {"samples": "intensity"}),
        ("log", 20.0 * np.log10(numbers) / 0.5, {"samples": "log", "db_per_count": 0.5}),
        ("complex", (numbers * np.exp(1j * numbers)).astype(np.complex64), {"samples": "complex"}),
    ):
        np.save(tmp_path / f"{name}.npy", stored)
        path = beside(tmp_path / f"{name}.npy", **law)
        assert np.allclose(intensities(path), numbers**2, rtol=1e-4), name


def test_ground_range_comes_back_as_the_ground_range_it_was(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    numbers = random.exponential(1.0, (N_LINES, 600)).astype(np.float32)
    numbers[:, 300:320] = 50.0
    numbers[5] = np.nan
    np.save(tmp_path / "a.npy", numbers)
    log = open_log(beside(tmp_path / "a.npy", range="ground", samples="intensity", near_range_m=10.0), Config())
    lines = [event.starboard for event in log if isinstance(event, Ping)]
    assert len(lines) == N_LINES
    for number, trace in enumerate(lines):
        assert trace is not None
        slant_m = trace.first_range_m + trace.spacing_m * np.arange(len(trace.samples))
        ground_m = np.sqrt(slant_m**2 - 8.0**2)
        inside = (ground_m > 25.1) & (ground_m < 25.9)
        assert inside.any()
        assert np.isnan(trace.samples).all() if number == 5 else np.allclose(trace.samples[inside], 50.0)
        if number != 5:
            weight = np.gradient(ground_m)
            kept = np.nansum(trace.samples * weight)
            assert kept == pytest.approx(float(numbers[number].sum()) * 0.05, rel=0.01)


def test_positions_that_are_held_between_fixes_give_the_course_of_the_fixes(tmp_path: Path) -> None:
    path = tmp_path / "image.npy"
    np.save(path, plane())
    beside(path)
    held = [f"{line},0.5,{5.5 - line // 4 * 0.4 / 111_320.0:.9f}" for line in range(N_LINES)]  # to the west
    (tmp_path / "track.csv").write_text("\n".join(["line,latitude_deg,longitude_deg", *held]))
    fixes = [event for event in open_log(path, SAS) if isinstance(event, NavSample)]
    assert {round(math.degrees(fix.heading_rad) % 360.0, 2) for fix in fixes} == {270.0}
    assert len({fix.longitude_deg for fix in fixes}) == N_LINES - 3, "no steps, but for the end"


def test_a_track_is_filled_between_its_rows_across_the_antimeridian_and_north(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    path = beside(tmp_path / "a.npy", lines="backward")
    rows = ["0,0.0,179.99998,350.0,8.0", "39,0.0,-179.999985,10.0,10.0"]
    (tmp_path / "track.csv").write_text("\n".join(["line,latitude_deg,longitude_deg,heading_deg,altitude_m", *rows]))
    events = list(open_log(path, SAS))
    fixes = [event for event in events if isinstance(event, NavSample)]
    share = np.linspace(1.0, 0.0, N_LINES)  # the last line was recorded first
    assert [fix.longitude_deg % 360.0 for fix in fixes] == pytest.approx(179.99998 + 0.000035 * share, abs=1e-7)
    turned_deg = [math.degrees(math.remainder(fix.heading_rad, math.tau)) for fix in fixes]
    assert turned_deg == pytest.approx(-10.0 + 20.0 * share, abs=1e-6)
    assert [event.altitude_m for event in events if isinstance(event, Ping)] == pytest.approx(8.0 + 2.0 * share)


def test_a_track_with_a_spreadsheets_byte_order_mark_and_blanks_behind_commas_is_read(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    expected = list(open_log(beside(tmp_path / "a.npy"), SAS))
    track = tmp_path / "track.csv"
    track.write_text("\ufeff" + track.read_text().replace(",", ", "), "utf-8")
    assert [repr(event) for event in open_log(tmp_path / "a.npy", SAS)] == [repr(event) for event in expected]


def test_grazing_angle_stands_for_altitude(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    path = beside(tmp_path / "a.npy", altitude_m=None, near_grazing_deg=30.0)
    assert pings(path)[0].altitude_m == pytest.approx(6.0)


def test_hdf5_takes_its_only_plane_or_the_one_that_is_named(tmp_path: Path) -> None:
    numbers = (plane() * (1.0 + 1.0j)).astype(np.complex64)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["slc/image"] = numbers
        file["slc/times"] = np.zeros(N_LINES)
    path = beside(tmp_path / "a.h5", samples="complex")
    assert np.allclose(intensities(path), np.abs(numbers) ** 2, rtol=1e-5)
    with h5py.File(path, "a") as file:
        file["other"] = np.zeros((N_LINES, N_PIXELS))
    assert np.allclose(intensities(beside(path, samples="complex", dataset="/slc/image")), np.abs(numbers) ** 2)


# --- looks from complex images ---


def test_packed_numbers_are_unpacked_and_pixels_without_a_measurement_are_none(tmp_path: Path) -> None:
    stored = plane(np.int16)
    expected = (0.5 * stored.astype(np.float32) + 2.0) ** 2
    stored[3, 7], expected[3, 7] = -9, np.nan
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["image"] = stored
        file["image"].attrs.update({"scale_factor": [0.5], "add_offset": [2.0], "_FillValue": np.array([-9], np.int16)})
    np.testing.assert_allclose(intensities(beside(tmp_path / "a.nc")), expected)


def test_what_a_tiff_names_as_no_data_is_none(tmp_path: Path) -> None:
    stored, no_data = plane(), [(42113, "s", 0, "65535", True)]
    stored[3, 7] = 65535
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", extratags=no_data)
    assert np.argwhere(np.isnan(intensities(beside(tmp_path / "a.tif")))).tolist() == [[3, 7]]


def speckle(n_lines: int, n_pixels: int, band: float, centroid: float) -> NDArray[Any]:
    """White complex noise whose spectrum along the lines fills `band` around `centroid`."""
    random = np.random.default_rng(3)
    noise = random.standard_normal((n_lines, n_pixels)) + 1j * random.standard_normal((n_lines, n_pixels))
    frequency = (np.fft.fftfreq(n_lines) + 0.5) % 1.0 - 0.5
    held = np.fft.ifft(np.fft.fft(noise, axis=0) * (np.abs(frequency) < 0.5 * band)[:, np.newaxis], axis=0)
    return np.asarray(held * np.exp(2j * math.pi * centroid * np.arange(n_lines))[:, np.newaxis])


def test_looks_share_the_spectrum_and_halve_the_speckle() -> None:
    image = speckle(2048, 64, 0.8, 0.13)
    centroid = doppler_centroid(image)
    assert centroid == pytest.approx(0.13, abs=0.01)
    parts = list(sub_bands(image, 3, centroid, 0.8))
    assert np.corrcoef(parts[0].ravel(), parts[2].ravel())[0, 1] == pytest.approx(0.0, abs=0.03)
    single = np.abs(image) ** 2
    for n in (2, 4):
        looked = mean_of_looks(image, n, centroid, 0.8)
        assert float(looked.mean()) == pytest.approx(float(single.mean()), rel=0.15)
        assert float(looked.var() / looked.mean() ** 2) == pytest.approx(1.0 / n, rel=0.15)


def test_looks_do_not_depend_on_the_blocks_they_are_read_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", speckle(1200, 16, 0.8, 0.0).astype(np.complex64))
    path = beside(tmp_path / "a.npy", n_lines=1200, samples="complex", looks=3, resolution_along_m=0.125)
    whole = intensities(path)
    monkeypatch.setattr("sim_replay.logs.image_log._MAX_BLOCK_LINES", 500)
    cut = intensities(path)
    assert np.abs(cut - whole).max() < 0.02 * whole.mean()


# --- the kind of sonar ---


def test_an_image_brings_its_kind_of_sonar_along(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    path = beside(tmp_path / "a.npy")
    config = logs_config([path])
    assert config == Config(sonar=SonarConfig(kind="sas"))
    assert config.sonar.beam_width_rad == 0.0
    assert kind_doubt(path, config) == ""
    assert [event for event in open_log(path, config) if isinstance(event, Notice)] == []
    assert logs_config([beside(path, kind="side_scan")]) == Config()


def test_settings_of_another_sonar_are_reported(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    path = beside(tmp_path / "a.npy")
    assert "the sidecar says `kind: sas`" in kind_doubt(path, Config())
    events = list(open_log(path, Config()))
    assert [event.code for event in events if isinstance(event, Notice)] == ["reader.kind_disagrees"]
    write_xtf(tmp_path / "a.xtf", list(mission())[:40])
    assert kind_doubt(tmp_path / "a.xtf", Config()) == ""
    assert "mostly hold side scan" in kind_doubt(tmp_path / "a.xtf", Config(sonar=SonarConfig(kind="sas")))


# --- size, damage on the way, commands ---


def test_memory_does_not_grow_with_the_number_of_lines(tmp_path: Path) -> None:
    peaks = []
    for n_lines in (2_500, 5_000):
        path = tmp_path / f"{n_lines}.tif"
        tifffile.imwrite(path, np.ones((n_lines, 1_000), np.uint8), photometric="minisblack", rowsperstrip=64)
        log = open_log(beside(path, n_lines=n_lines), Config())
        tracemalloc.start()
        assert sum(isinstance(event, Ping) for event in log) == n_lines
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(peaks) < 1.2 * min(peaks)


def test_damage_on_the_way_keeps_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, plane(n_lines=3000), photometric="minisblack", compression="zlib", rowsperstrip=100)
    with tifffile.TiffFile(path) as file:
        offset = file.pages.first.dataoffsets[25]
    data = bytearray(path.read_bytes())
    data[offset : offset + 40] = bytes(40)
    path.write_bytes(data)
    events: list[SourceEvent] = list(open_log(beside(path, n_lines=3000), SAS))
    notices = [event for event in events if isinstance(event, Notice)]
    assert [notice.code for notice in notices] == ["reader.image_damaged"]
    assert "line 2048 of 3000" in notices[0].text
    assert sum(isinstance(event, Ping) for event in events) == 2048


@pytest.mark.parametrize("changes", [{"near_range_m": 198.0}, {"range": "ground", "altitude_m": 300.0}])
def test_what_lies_beyond_the_range_in_use_is_reported(changes: dict[str, Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane())
    events = list(open_log(beside(tmp_path / "a.npy", **changes), SAS))
    assert [event.code for event in events if isinstance(event, Notice)] == ["reader.beyond_max_range"]


def test_images_of_both_sides_are_one_mission_in_whatever_order_they_are_named(tmp_path: Path) -> None:
    for side in ("starboard", "port"):
        np.save(tmp_path / f"{side}.npy", plane())
        beside(tmp_path / f"{side}.npy", side=side)
    both = [tmp_path / "starboard.npy", tmp_path / "port.npy"]
    named = [[path for path, _ in RecordedMission(paths, SAS).named_logs] for paths in (both, both[::-1])]
    assert named == [both[::-1]] * 2


def test_replay_and_check_take_an_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tifffile.imwrite(tmp_path / "a.tif", plane(n_lines=150), photometric="minisblack")
    path = beside(tmp_path / "a.tif", n_lines=150)
    assert describe_log(path, Config()) == "sonar image (TIFF), 0.0 MB, first ping 2026-06-01 10:00:00+00:00"
    assert main(["replay", str(path), "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["pings"] == 150


def test_the_sidecar_of_the_page_places_its_image(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "auv_mcm" / "docs" / "how-to" / "replay-a-sas-image.md"
    text = page.read_text("utf-8").split("```yaml\n")[1].split("```")[0]
    tifffile.imwrite(tmp_path / "survey.tif", plane(n_lines=1200, n_pixels=1200), photometric="minisblack")
    (tmp_path / "survey.yaml").write_text(text)
    fixes = [event for event in open_log(tmp_path / "survey.tif", Config()) if isinstance(event, NavSample)]
    assert len(fixes) == 1200
    assert {round(fix.longitude_deg, 5) for fix in fixes} == {5.9}
    assert fixes[0].latitude_deg == pytest.approx(43.1, abs=1e-6)


def test_utm_places_a_known_tower() -> None:
    # CN Tower, Toronto: 43 38 33.24 N, 79 23 13.7 W is 17T 630084 4833438 (to a metre).
    assert projection(32617)(630084.0, 4833438.0) == pytest.approx((43.642567, -79.387139), abs=1.5e-5)


# --- sub-apertures ---

SUB_APERTURES: dict[str, Any] = {
    "samples": "complex",
    "sub_apertures": 3,
    "integration_deg": 12.0,
    "positive_doppler": "ahead",
}


@pytest.mark.parametrize("positive", ["ahead", "aft"])
def test_sub_apertures_of_a_complex_image_come_one_after_another_with_their_squints(
    positive: str, tmp_path: Path
) -> None:
    tone = np.exp(2j * np.pi * (1.0 / 3.0) * np.arange(N_LINES))  # at an edge of the spectrum's highest third
    np.save(tmp_path / "a.npy", (tone[:, np.newaxis] * np.ones(N_PIXELS) + 1.0).astype(np.complex64))
    path = beside(tmp_path / "a.npy", **(SUB_APERTURES | {"positive_doppler": positive}))
    found = pings(path)
    assert len(found) == 3 * N_LINES
    assert [ping.number for ping in found] == list(range(3 * N_LINES))
    assert [ping.time_s for ping in found[:N_LINES]] == [ping.time_s for ping in found[N_LINES : 2 * N_LINES]]
    squint_deg = np.degrees([found[k * N_LINES].squint_rad for k in range(3)])
    assert np.allclose(np.diff(squint_deg), 4.0 if positive == "ahead" else -4.0)
    centroid = doppler_centroid(np.load(tmp_path / "a.npy"))
    assert squint_deg[1] == pytest.approx(12.0 * centroid * (1.0 if positive == "ahead" else -1.0))
    image = np.load(tmp_path / "a.npy")
    for part, formed in enumerate(sub_bands(image, 3, centroid, 1.0)):
        assert np.array_equal(intensities(path)[part * N_LINES : (part + 1) * N_LINES], formed)
        assert np.array_equal(sub_band(image, 3, part, centroid, 1.0), formed)


@pytest.mark.parametrize(
    ("changes", "asked"),
    [
        ({"samples": "amplitude"}, "squint_deg"),
        ({"integration_deg": None}, "integration_deg"),
        ({"positive_doppler": None}, "positive_doppler"),
        ({"looks": 2}, "keep one"),
        ({"sub_apertures": 1}, "sub_apertures"),
    ],
)
def test_sub_apertures_that_cannot_be_formed_are_refused(changes: dict[str, Any], asked: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", plane().astype(np.complex64))
    with pytest.raises(BadInputError, match=asked):
        pings(beside(tmp_path / "a.npy", **(SUB_APERTURES | changes)))


def test_images_of_sub_apertures_become_views_of_each_contact(tmp_path: Path) -> None:
    squints_rad = (-0.04, 0.0, 0.04)
    seen: list[NavSample | Ping] = [event for event in mission() if isinstance(event, NavSample)]
    for squint_rad in squints_rad:
        seen += [structs.replace(event, squint_rad=squint_rad) for event in mission() if isinstance(event, Ping)]
    events = list(open_mission(write_images(tmp_path, seen), SAS).events())
    found = [contact for contact in contacts_of(iter(events), SAS) if contact.p_mine > 0.25]
    assert len(found) == 2
    for contact in found:
        views = sorted(contact.views, key=lambda view: view.squint_rad)
        assert [view.squint_rad for view in views] == pytest.approx(squints_rad)
        turned_deg = np.diff([view.aspect_deg for view in views])
        ahead_is_clockwise = contact.views[0].side == "port"
        assert np.allclose(turned_deg, math.degrees(0.04) * (1.0 if ahead_is_clockwise else -1.0), atol=0.2)
