"""Floors recovered and targets embedded at the edge of what a recorder can store: no flag, no NaN, the same bits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.records import SIDES, EchoTrace, NavSample, Ping, Side, Transfer
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.augment.background_log import Survey, read_survey, to_samples
from sim_replay.augment.embed import Embedded, embed
from sim_replay.augment.floor import Floor, recover_floor
from sim_replay.augment.line import Change, SampleScatter, measure_line, mixed
from sim_replay.augment.shadows import shadow_runs
from sim_replay.augment.targets import EmbeddedTarget, TargetSpec, place_targets
from sim_replay.augment.track import track_of
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.speckle import WHITE, gaussian_taps
from tests.make.records import nav_of

Plane = NDArray[np.float64]
Mask = NDArray[np.bool_]
Samples = NDArray[Any]

SHAPE = (32, 64)  # twice the blocks of 16 pings in which looks are measured, so that a picture reversed has the same
ROWS, COLUMNS = np.indices(SHAPE)
ALL = np.ones(SHAPE, dtype=np.bool_)
ROW_M, COLUMN_M = 0.2, 0.1
STEEPEST_M = 5.5  # what slopes of twice 1.5 add up to over 1 / sqrt(0.3) m, from where on heights are held to 0


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def speckle(seed: int = 0, shape: tuple[int, int] = SHAPE) -> Plane:
    return generator(seed).exponential(size=shape)


PICTURES: dict[str, Plane] = {
    "constant": np.ones(SHAPE),
    "checkerboard": ((ROWS + COLUMNS) % 2).astype(np.float64),
    "impulse": np.where((ROWS == 15) & (COLUMNS == 40), 1e6, 1.0),
    "impulse in nothing": np.where((ROWS == 15) & (COLUMNS == 40), 1.0, 0.0),
    "one bit": (speckle() > 1.0).astype(np.float64),
    "sparse": np.where(speckle(1) > 4.0, speckle(2), 0.0),
    "saturated half": np.where(COLUMNS < 40, speckle(), 16.0),
    "far half padded with zeros": speckle() * (COLUMNS < 40),
    "half the pings zero": speckle() * (ROWS < 16),
    "gain ramp of 40 dB": speckle() * 10.0 ** (4.0 * COLUMNS / SHAPE[1] - 2.0),
    "gain ramp along track": speckle() * 10.0 ** (4.0 * ROWS / SHAPE[0] - 2.0),
    "rock": speckle() * generator(3).gamma(0.3, 1.0 / 0.3, SHAPE),
    "denormal": speckle() * 1e-310,
    "tiny": speckle() * 1e-300,
    "huge": speckle() * 1e300,
    "all numbers there are": np.exp(generator(4).uniform(-740.0, 700.0, SHAPE)),
}


def recovered(image: Plane, valid: Mask = ALL, altitude_m: float = 5.0) -> Floor:
    """The floor found, every floating-point flag but underflow being an error."""
    n_pings = len(image)
    with np.errstate(all="raise", under="ignore"):
        floor = recover_floor(
            image, valid, np.full(n_pings, altitude_m), ROW_M * np.arange(n_pings, dtype=np.float64), COLUMN_M
        )
    for plane in (floor.elevation_m, floor.reflectivity, floor.beam.gain, floor.beam.depression_rad):
        assert np.isfinite(plane).all()
    assert (floor.reflectivity >= 0.0).all()
    return floor


def same(one: Floor, other: Floor) -> bool:
    return all(
        a.tobytes() == b.tobytes()
        for a, b in (
            (one.elevation_m, other.elevation_m),
            (one.reflectivity, other.reflectivity),
            (one.beam.gain, other.beam.gain),
            (one.beam.depression_rad, other.beam.depression_rad),
        )
    )


# --- recovery ---


@pytest.mark.parametrize("picture", PICTURES)
def test_no_picture_raises_a_floating_point_flag(picture: str) -> None:
    scene = recovered(PICTURES[picture])
    assert float(np.abs(scene.elevation_m).max()) < STEEPEST_M


@pytest.mark.parametrize("altitude_m", [0.3, 1.0, 30.0, 300.0])
def test_no_altitude_raises_one(altitude_m: float) -> None:
    recovered(PICTURES["rock"], altitude_m=altitude_m)


@pytest.mark.parametrize("share", [0.001, 0.5, 0.999])
def test_what_stands_where_nothing_was_measured_changes_no_bit(share: float) -> None:
    random = generator(5)
    valid = random.random(SHAPE) >= share
    valid[random.random(SHAPE[0]) < 0.5 * share] = False  # whole pings, too
    nonsense = random.choice([math.nan, math.inf, -math.inf, -3.0, 0.0, 1e300], SHAPE)
    one, other = (recovered(np.where(valid, speckle(), junk), valid) for junk in (nonsense, 0.0))
    assert same(one, other)


def test_a_pixel_missing_in_a_thousand_hardly_changes_the_relief() -> None:
    whole = recovered(speckle()).elevation_m
    holed = recovered(speckle(), generator(6).random(SHAPE) >= 0.001).elevation_m
    assert float(np.corrcoef(whole.ravel(), holed.ravel())[0, 1]) > 0.99


@pytest.mark.parametrize("power", [-600, 600])
def test_gain_of_a_power_of_two_goes_into_the_beam_and_changes_no_other_bit(power: int) -> None:
    one, other = recovered(PICTURES["rock"]), recovered(PICTURES["rock"] * 2.0**power)
    assert one.elevation_m.tobytes() == other.elevation_m.tobytes()
    assert one.reflectivity.tobytes() == other.reflectivity.tobytes()
    np.testing.assert_array_equal(other.beam.gain, one.beam.gain * 2.0**power)


def test_reversing_the_track_reverses_the_relief() -> None:
    one, other = recovered(PICTURES["rock"]), recovered(PICTURES["rock"][::-1].copy())
    np.testing.assert_allclose(other.elevation_m[::-1], one.elevation_m, atol=1e-9)
    np.testing.assert_allclose(other.reflectivity[::-1], one.reflectivity, rtol=1e-9)


@pytest.mark.parametrize(("pings", "columns"), [(16, 0), (0, 40), (5, 7)])
def test_a_masked_border_hardly_changes_the_relief_inside(pings: int, columns: int) -> None:
    around = ((pings, pings), (0, columns))
    wide = recovered(np.pad(speckle(), around, constant_values=math.nan), np.pad(ALL, around)).elevation_m
    inside = wide[pings : pings + SHAPE[0], : SHAPE[1]]
    assert float(np.corrcoef(inside.ravel(), recovered(speckle()).elevation_m.ravel())[0, 1]) > 0.9


# --- shadows ---


@pytest.mark.parametrize("noise", [None, 0.0, 1e-6, 1.0, 1e300])
def test_shadows_of_no_picture_raise_a_flag_or_leave_the_picture(noise: float | None) -> None:
    level = None if noise is None else np.full(SHAPE[1], noise)
    for picture in PICTURES.values():
        with np.errstate(all="raise", under="ignore"):
            runs = shadow_runs(
                np.minimum(picture, 1e100), None if level is None else np.minimum(level, 1e100), ROW_M, COLUMN_M
            )
        assert (runs.start < runs.stop).all()
        assert runs.mask(SHAPE).sum() == (runs.stop - runs.start).sum()


def test_rounding_where_nothing_was_recorded_is_no_echo() -> None:
    """Running sums of bright echoes do not come back to 0 behind them, but a little above or below."""
    for seed in range(10):
        padded = 1e7 * speckle(seed) * (COLUMNS < 30)
        with np.errstate(all="raise", under="ignore"):
            runs = shadow_runs(padded, np.full(SHAPE[1], 1e3), ROW_M, 10.0 * COLUMN_M)
        assert not runs.mask(SHAPE)[:, 40:].any()


@pytest.mark.parametrize("power", [-40, 40])
def test_shadows_know_no_gain_and_no_direction_along_the_track(power: int) -> None:
    picture = np.where((abs(ROWS - 15) < 5) & (COLUMNS >= 30) & (COLUMNS < 50), 0.01, 1.0) * speckle(8)
    picture[11:20, 26:30] *= 30.0
    runs, loud = (shadow_runs(g * picture, np.full(SHAPE[1], 0.01 * g), ROW_M, COLUMN_M) for g in (1.0, 2.0**power))
    back = shadow_runs(picture[::-1], np.full(SHAPE[1], 0.01), ROW_M, COLUMN_M)
    assert runs.mask(SHAPE).sum() > 50
    np.testing.assert_array_equal(loud.mask(SHAPE), runs.mask(SHAPE))
    assert (back.mask(SHAPE)[::-1] != runs.mask(SHAPE)).mean() < 1e-3


# --- how echoes mix ---


def line(width: float = 0.0, looks: int = 1) -> SampleScatter:
    law = -np.log1p(-np.minimum(np.linspace(0.0, 1.0, 513), 0.9995))
    taps = gaussian_taps(width) if width else WHITE
    return SampleScatter(taps, taps, looks, np.ones(SHAPE[1]), law, np.ones(SHAPE[1]))


def a_change() -> Change:
    kept = np.where((COLUMNS > 45) & (COLUMNS < 60), 0.0, 1.0)
    return Change(
        np.where(COLUMNS == 60, 0.4, kept), np.where((COLUMNS > 40) & (COLUMNS <= 45) & (ROWS > 5), 30.0, 0.0)
    )


@pytest.mark.parametrize(("width", "looks"), [(0.0, 1), (1.5, 1), (1.5, 3)])
def test_targets_mix_with_every_picture(width: float, looks: int) -> None:
    for picture in PICTURES.values():
        with np.errstate(all="raise", under="ignore"):
            intensity, changed = mixed(picture, a_change(), line(width, looks), np.full(SHAPE[1], 1e-3), 1, 1)
        assert np.isfinite(intensity).all()
        assert (intensity >= 0.0).all()
        assert intensity[~changed].tobytes() == picture[~changed].tobytes()


@pytest.mark.parametrize("power", [-300, 300])
def test_gain_of_a_power_of_four_changes_no_bit_of_the_mixture(power: int) -> None:
    gain = 4.0**power
    change = a_change()
    one, _ = mixed(speckle(), change, line(1.5, 3), np.full(SHAPE[1], 1e-3), 1, 1)
    other, _ = mixed(
        speckle() * gain, change._replace(added=change.added * gain), line(1.5, 3), np.full(SHAPE[1], 1e-3 * gain), 1, 1
    )
    np.testing.assert_array_equal(other, one * gain)


@pytest.mark.parametrize(
    ("transfer", "dtype"),
    [
        (Transfer("amplitude"), "uint16"),
        (Transfer("intensity"), "uint8"),
        (Transfer("log", 0.35), "uint8"),
        (Transfer("log", 0.01), "int16"),
    ],
)
@pytest.mark.parametrize("full_scale", [None, 200.0])
def test_every_intensity_is_stored_within_what_the_recorder_holds(
    transfer: Transfer, dtype: str, full_scale: float | None
) -> None:
    intensity = np.array([0.0, 5e-324, 1e-300, 1e-30, 1.0, 1e4, 1e38, 1e300, np.finfo(np.float64).max])
    with np.errstate(all="raise", under="ignore"):
        stored = to_samples(intensity, transfer, full_scale, np.dtype(dtype))
    assert stored.dtype == np.dtype(dtype)
    assert (np.diff(stored.astype(np.int64)) >= 0).all()
    assert stored.min() >= 0
    assert stored.max() == (full_scale or np.iinfo(dtype).max)


# --- logs ---

N_PINGS, N_SAMPLES, SPACING_M, STEP_M, ALTITUDE_M = 64, 300, 0.06, 0.1, 4.0
MIDDLE = N_PINGS // 2
HEADING_RAD = math.radians(30.0)
PING, SAMPLE = np.indices((N_PINGS, N_SAMPLES))
BOX = EmbeddedTarget(kind="box", ping=MIDDLE, side="starboard", ground_range_m=10.0, azimuth_deg=30.0)


class Recording(NamedTuple):
    """What a recorder stored: samples (n_pings, n_samples) of both sides, its resolution, and where the vehicle
    went."""

    starboard: Samples
    port: Samples
    spacing_m: float = SPACING_M
    altitude_m: float = ALTITUDE_M
    longitude_deg: float = 5.5


def echoes(spacing_m: float = SPACING_M, altitude_m: float = ALTITUDE_M, seed: int = 1) -> Plane:
    """Intensities of a level floor under a water column."""
    slant_m = (np.arange(N_SAMPLES) + 0.5) * spacing_m
    mean = np.where(slant_m < altitude_m, 0.0, 3000.0**2) + 200.0**2
    return np.asarray(mean * speckle(seed, (N_PINGS, N_SAMPLES)))


def amplitudes(intensity: Plane, dtype: str = "uint16") -> Samples:
    whole = np.rint(np.clip(np.sqrt(intensity), 0.0, 32767.0)) if dtype == "uint16" else np.sqrt(intensity)
    return whole.astype(dtype)


PLAIN = amplitudes(echoes())
FLOATS = amplitudes(echoes(), "float32")


def mission(recording: Recording) -> Iterator[NavSample | Ping]:
    for number, samples in enumerate(zip(recording.port, recording.starboard, strict=True)):
        way_m, time_s = STEP_M * number, 1.7e9 + 0.1 * number
        longitude_deg = recording.longitude_deg + way_m * math.sin(HEADING_RAD) / (
            111_320.0 * math.cos(math.radians(43.0))
        )
        port, starboard = (
            EchoTrace(samples=one, first_range_m=0.5 * recording.spacing_m, spacing_m=recording.spacing_m)
            for one in samples
        )
        yield nav_of(
            time_s,
            latitude_deg=43.0 + way_m * math.cos(HEADING_RAD) / 111_111.0,
            longitude_deg=(longitude_deg + 180.0) % 360.0 - 180.0,
            heading_rad=HEADING_RAD,
            altitude_m=recording.altitude_m,
            speed_mps=STEP_M / 0.1,
        )
        yield Ping(number=number, time_s=time_s, port=port, starboard=starboard, altitude_m=recording.altitude_m)


def surveyed(folder: Path, recording: Recording) -> tuple[Path, Survey, Config]:
    """The log as a file, as embedding reads it, and the sonar it was recorded with."""
    path, dtype = folder / "log.xtf", recording.starboard.dtype
    config = Config(sonar=SonarConfig(transfer="amplitude", port_order="near_to_far", beam_width_deg=0.3))
    if dtype == np.uint8:
        config = Config(
            sonar=SonarConfig(transfer="log", db_per_count=0.4, port_order="near_to_far", beam_width_deg=0.3)
        )
    sample_types: dict[str, SampleType] = {"uint8": "uint8", "uint16": "uint16", "float32": "float32"}
    write_xtf(path, mission(recording), sample_type=sample_types[dtype.name], port_far_to_near=False)
    return path, read_survey(path, config), config


def with_target(
    folder: Path, recording: Recording, target: EmbeddedTarget = BOX
) -> tuple[Embedded, dict[Side, Samples]]:
    """The target in the log, and the log's samples by side; every floating-point flag but underflow is an error."""
    with np.errstate(all="raise", under="ignore"):
        path, survey, config = surveyed(folder, recording)
        track = track_of(survey, config)
        done = embed(survey, track, place_targets(TargetSpec(targets=(target,)), track), config, 1)
    path.write_bytes(done.data)
    (stretch,) = read_survey(path, config).stretches
    stored: dict[Side, Samples] = {}
    for side in SIDES:
        traces = [stretch.trace(k, side) for k in range(stretch.n_pings)]
        stored[side] = np.stack([trace.samples for trace in traces if trace is not None])
    return done.objects[0], stored


LOGS: dict[str, Recording] = {
    "one bit": Recording(np.where(echoes() > 3000.0**2, 32767, 0).astype(np.uint16), PLAIN),
    "checkerboard": Recording((3000 * ((PING + SAMPLE) % 2)).astype(np.uint16), PLAIN),
    "constant": Recording(np.full(PLAIN.shape, 3000, dtype=np.uint16), PLAIN),
    "impulse": Recording(np.where((PING == MIDDLE) & (SAMPLE == 210), 65535, 0).astype(np.uint16), PLAIN),
    "dead": Recording(np.zeros(PLAIN.shape, dtype=np.uint16), PLAIN),
    "sparse": Recording(np.where(speckle(5, PLAIN.shape) > 4.0, PLAIN, 0).astype(np.uint16), PLAIN),
    "saturated far half": Recording(np.where(SAMPLE < 185, PLAIN, 32767).astype(np.uint16), PLAIN),
    "far half padded with zeros": Recording(np.where(SAMPLE < 185, FLOATS, 0.0).astype(np.float32), FLOATS),
    "half the pings zero": Recording(
        np.where(generator(6).random((N_PINGS, 1)) < 0.5, 0, PLAIN).astype(np.uint16), PLAIN
    ),
    "gain ramp of 40 dB": Recording(amplitudes(echoes() * 10.0 ** (4.0 * SAMPLE / N_SAMPLES - 3.0)), PLAIN),
    "logarithms at both ends": Recording(
        np.where(speckle(7, PLAIN.shape) > 0.7, 255, 0).astype(np.uint8),
        np.clip(10.0 * np.log10(echoes()) / 0.4, 0, 255).astype(np.uint8),
    ),
    "what no echo can be": Recording(
        np.where(
            generator(8).random(PLAIN.shape) < 0.001,
            generator(9).choice([math.nan, math.inf, -math.inf, -1.0, 1e30, 1e-42], PLAIN.shape),
            FLOATS,
        ).astype(np.float32),
        FLOATS,
    ),
    "a ping of NaN": Recording(np.where(PING == MIDDLE, math.nan, FLOATS).astype(np.float32), FLOATS),
    "altitude of 1.2 m": Recording(amplitudes(echoes(0.03, 1.2)), amplitudes(echoes(0.03, 1.2, 2)), 0.03, 1.2),
    "altitude of 30 m": Recording(amplitudes(echoes(0.18, 30.0)), amplitudes(echoes(0.18, 30.0, 2)), 0.18, 30.0),
}
GROUND_RANGE_M = {"altitude of 1.2 m": 5.0, "altitude of 30 m": 35.0}


@pytest.mark.parametrize("name", LOGS)
def test_targets_go_into_every_log_and_change_nothing_else(tmp_path: Path, name: str) -> None:
    recording = LOGS[name]
    target = msgspec.structs.replace(BOX, ground_range_m=GROUND_RANGE_M.get(name, BOX.ground_range_m))
    done, stored = with_target(tmp_path, recording, target)
    (look,) = done.looks
    assert 0.0 <= look.visible_fraction <= 1.0
    assert math.isnan(look.contrast_db) or abs(look.contrast_db) < 100.0
    np.testing.assert_array_equal(stored["port"], recording.port)
    changed = (stored["starboard"] != recording.starboard) & ~np.isnan(recording.starboard.astype(np.float64))
    assert changed.sum() <= look.n_samples
    assert not changed[np.abs(PING[:, 0] - MIDDLE) > 12].any()
    assert changed.any() == (name != "dead")


def test_a_sample_that_is_no_number_stays_and_keeps_no_target_away(tmp_path: Path) -> None:
    whole, _ = with_target(tmp_path, Recording(FLOATS, FLOATS))
    holed = FLOATS.copy()
    holed[10, 7] = holed[MIDDLE, 200] = math.nan
    done, stored = with_target(tmp_path, Recording(holed, FLOATS))
    assert np.isnan(stored["starboard"].astype(np.float64)).sum() == 2
    assert done.looks[0].n_samples == pytest.approx(whole.looks[0].n_samples, rel=0.02)


@pytest.mark.parametrize("gain", [2.0**-20, 2.0**20])
def test_gain_of_the_recorder_scales_what_is_embedded(tmp_path: Path, gain: float) -> None:
    _, quiet = with_target(tmp_path, Recording(FLOATS, FLOATS))
    loud_floats = (FLOATS * np.float32(gain)).astype(np.float32)
    _, loud = with_target(tmp_path, Recording(loud_floats, loud_floats))
    np.testing.assert_allclose(loud["starboard"], quiet["starboard"].astype(np.float64) * gain, rtol=1e-5)


def test_a_mirrored_log_gets_the_mirrored_target(tmp_path: Path) -> None:
    turned_deg: dict[Side, float] = {"starboard": 25.0, "port": -25.0}
    there, here = (
        with_target(
            tmp_path, Recording(FLOATS, FLOATS), msgspec.structs.replace(BOX, side=side, azimuth_deg=30.0 + turned)
        )[1][side]
        for side, turned in turned_deg.items()
    )
    np.testing.assert_allclose(here, there, rtol=1e-3)


def test_the_date_line_changes_no_sample(tmp_path: Path) -> None:
    here, beyond = (
        with_target(tmp_path, Recording(PLAIN, PLAIN, longitude_deg=longitude)) for longitude in (5.5, 179.99997)
    )
    np.testing.assert_array_equal(beyond[1]["starboard"], here[1]["starboard"])
    assert (beyond[0].longitude_deg - 179.99997) % 360.0 == pytest.approx(here[0].longitude_deg - 5.5, abs=1e-9)


@pytest.mark.parametrize("name", LOGS)
def test_every_log_implies_a_law_of_noise_of_mean_one_below_its_floor(tmp_path: Path, name: str) -> None:
    _, survey, config = surveyed(tmp_path, LOGS[name])
    with np.errstate(all="raise", under="ignore"):
        found = measure_line(
            survey.stretches[0], "starboard", survey.transfer, config.sonar.blank_m, survey.absorption_per_m
        )
    assert (found.noise > 0.0).all()
    assert (found.noise < found.floor).all()
    assert (np.diff(found.noise_quantiles) >= 0.0).all()
    assert float(
        np.trapezoid(found.noise_quantiles, np.linspace(0.0, 1.0, found.noise_quantiles.size))
    ) == pytest.approx(1.0)
    assert np.isfinite(found.range_taps).all()
    assert np.isfinite(found.ping_taps).all()
