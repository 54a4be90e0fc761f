"""Targets put into logs: what changes, what stays as it was to the last bit, and how the new echoes scatter."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SIDES, NavSample, Ping, Side, Transfer
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.solids.shapes import Box, view_shape
from auv_mcm.waterfall.transfer import to_intensity
from sim_replay.augment.background_log import read_survey, to_samples
from sim_replay.augment.embed import Augmented, embed, located
from sim_replay.augment.line import Change, SampleScatter, mixed
from sim_replay.augment.targets import EmbeddedTarget, Placement, TargetSpec, place_targets
from sim_replay.augment.track import track_of
from sim_replay.logs.xtf import XtfLog
from sim_replay.simulator.speckle import WHITE, gaussian_taps
from tests.sim_replay.augment.plain_logs import (
    ALTITUDE_M,
    CONFIG,
    FLOOR_COUNTS,
    HEADING_RAD,
    N_PINGS,
    N_SAMPLES,
    NOISE_COUNTS,
    SPACING_M,
    STEP_M,
    mission,
    written,
)

Floats = NDArray[np.float64]


BOX = EmbeddedTarget(kind="box", ping=80, side="starboard", ground_range_m=12.0, azimuth_deg=30.0)
"""Broadside to ping 80."""


def box(side: Side = "starboard", contrast_db: float = 14.0) -> EmbeddedTarget:
    return msgspec.structs.replace(BOX, side=side, contrast_db=contrast_db)


def augmented(log: Path, *targets: EmbeddedTarget, config: Config = CONFIG, seed: int = 1) -> Augmented:
    survey = read_survey(log, config)
    track = track_of(survey, config)
    placements = place_targets(TargetSpec(seed=seed, targets=targets), track) if targets else ()
    return embed(survey, track, placements, config, seed)


def samples(path: Path, config: Config = CONFIG) -> dict[Side, NDArray[np.float64]]:
    pings = [event for event in XtfLog(path, config.sonar) if isinstance(event, Ping)]
    traces = {side: [ping.port if side == "port" else ping.starboard for ping in pings] for side in SIDES}
    return {
        side: np.stack([trace.samples.astype(np.float64) for trace in some if trace is not None])
        for side, some in traces.items()
    }


def changes(log: Path, done: Augmented, config: Config = CONFIG) -> dict[Side, NDArray[np.bool_]]:
    after = log.with_name("after.xtf")
    after.write_bytes(done.data)
    before, now = samples(log, config), samples(after, config)
    return {side: before[side] != now[side] for side in SIDES}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("plain") / "plain.xtf")


def test_embedding_nothing_returns_the_log_byte_for_byte(log: Path) -> None:
    assert augmented(log).data == log.read_bytes()


def test_only_samples_of_footprint_and_shadow_change(log: Path) -> None:
    done = augmented(log, box())
    changed = changes(log, done)
    assert not changed["port"].any()
    pings, columns = np.nonzero(changed["starboard"])
    length_m, beam_m = 1.1, math.radians(CONFIG.sonar.used_beam_width_deg) * 14.0
    assert np.abs(pings - 80).max() <= (0.5 * length_m + beam_m) / STEP_M + 1.0
    seen = view_shape(Box(length_m=1.1, width_m=0.9, height_m=0.45), 0.0, 12.0, ALTITUDE_M)
    slant_m = (columns + 0.5) * SPACING_M
    assert slant_m.min() > float(seen.front_slant_range_m) - 4.0 * SPACING_M
    # Recovered relief and bottom tracking move the shadow's end by a few samples.
    assert slant_m.max() < math.hypot(float(seen.shadow_end_m), ALTITUDE_M) + 0.5
    assert len(pings) > 100
    assert len(done.data) == log.stat().st_size
    assert done.objects[0].looks[0].visible_fraction > 0.8


def test_a_synthetic_aperture_has_no_beam_to_smear_objects(log: Path) -> None:
    wide = msgspec.structs.replace(CONFIG, sonar=msgspec.structs.replace(CONFIG.sonar, beam_width_deg=6.0))
    sas = msgspec.structs.replace(CONFIG, sonar=msgspec.structs.replace(wide.sonar, kind="sas"))
    n_pings = {
        name: np.ptp(np.nonzero(changes(log, augmented(log, box(), config=config), config)["starboard"])[0])
        for name, config in (("wide", wide), ("sas", sas))
    }
    assert n_pings["sas"] <= 1.3 / STEP_M + 1.0
    assert n_pings["wide"] > n_pings["sas"] + 0.5 / STEP_M


def test_the_shadow_is_dark_and_the_highlight_bright(log: Path) -> None:
    done = augmented(log, box(contrast_db=20.0))
    after = log.with_name("bright.xtf")
    after.write_bytes(done.data)
    rows = slice(78, 83)
    image = samples(after)["starboard"][rows] ** 2
    seen = view_shape(Box(length_m=1.1, width_m=0.9, height_m=0.45), 0.0, 12.0, ALTITUDE_M)
    front = round(float(seen.front_slant_range_m) / SPACING_M)
    shadow = slice(
        round(math.hypot(12.6, ALTITUDE_M) / SPACING_M) + 1,
        round(math.hypot(float(seen.shadow_end_m) - 0.15, ALTITUDE_M) / SPACING_M),
    )
    assert image[:, front : front + 6].mean() > 10.0 * FLOOR_COUNTS**2
    assert image[:, shadow].mean() == pytest.approx(NOISE_COUNTS**2, rel=0.5)
    assert done.objects[0].looks[0].contrast_db > 10.0


@pytest.mark.parametrize("side", SIDES)
def test_recorders_that_store_port_either_way_get_the_same_target(tmp_path: Path, side: Side) -> None:
    images = []
    for far_to_near in (True, False):
        config = msgspec.structs.replace(
            CONFIG,
            sonar=msgspec.structs.replace(CONFIG.sonar, port_order="far_to_near" if far_to_near else "near_to_far"),
        )
        log = written(tmp_path / f"{far_to_near}.xtf", far_to_near=far_to_near)
        after = tmp_path / "after.xtf"
        after.write_bytes(augmented(log, box(side=side), config=config).data)
        images.append(samples(after, config)[side])
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], samples(log, config)[side])


def test_equal_seeds_give_equal_bytes_and_others_other_speckle(log: Path) -> None:
    first, again, other = (augmented(log, box(), seed=seed).data for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_highlights_clip_where_the_recorder_does(tmp_path: Path) -> None:
    log = written(tmp_path / "low.xtf", mission(full_scale=8191.0))
    after = tmp_path / "after.xtf"
    after.write_bytes(augmented(log, box(contrast_db=45.0)).data)
    assert samples(after)["starboard"].max() == 8191.0
    assert np.count_nonzero(samples(after)["starboard"][80] == 8191.0) > np.count_nonzero(
        samples(log)["starboard"][80] == 8191.0
    )


def test_logarithmic_bytes_are_written_as_logarithms(tmp_path: Path) -> None:
    config = Config(sonar=SonarConfig(transfer="log", db_per_count=0.4, port_order="far_to_near", beam_width_deg=0.3))
    in_db = mission(full_scale=255.0, dtype="uint8", to_counts=lambda i: 10.0 * np.log10(np.maximum(i, 1e-9)) / 0.4)
    log = written(tmp_path / "log.xtf", in_db, sample_type="uint8")
    after = tmp_path / "after.xtf"
    after.write_bytes(augmented(log, box(contrast_db=15.0), config=config).data)
    image = samples(after, config)["starboard"][80]
    floor_db = 20.0 * math.log10(FLOOR_COUNTS)
    shadow = slice(round(math.hypot(12.7, ALTITUDE_M) / SPACING_M), round(math.hypot(13.5, ALTITUDE_M) / SPACING_M))
    assert 0.4 * np.median(image[shadow]) < floor_db - 15.0
    assert 0.4 * image.max(where=np.arange(N_SAMPLES) > 100, initial=0) > floor_db + 6.0


def test_what_is_behind_an_embedded_object_is_hidden_by_it(log: Path) -> None:
    tall = msgspec.structs.replace(BOX, ground_range_m=9.0, length_m=3.0, width_m=1.0, height_m=1.5)
    low = msgspec.structs.replace(BOX, ground_range_m=11.0, height_m=0.3, length_m=0.6)
    done = augmented(log, tall, low)
    assert done.objects[0].looks[0].visible_fraction > 0.8
    assert done.objects[1].looks[0].visible_fraction < 0.1


def test_an_object_in_a_recorded_shadow_makes_no_highlight(tmp_path: Path) -> None:
    def shaded(ground_m: Floats, ping: int) -> Floats:
        shading = np.ones_like(ground_m)
        if 70 <= ping < 91:
            shading[(ground_m > 9.0) & (ground_m < 9.6)] = 30.0
            shading[(ground_m >= 9.6) & (ground_m < 15.0)] = 0.0
        return shading

    log = written(tmp_path / "shaded.xtf", mission(shaded))
    low = msgspec.structs.replace(BOX, ground_range_m=11.5, height_m=0.3, length_m=0.6, contrast_db=25.0)
    done = augmented(log, low)
    assert done.objects[0].looks[0].visible_fraction < 0.05
    after = tmp_path / "after.xtf"
    after.write_bytes(done.data)
    ground = slice(round(math.hypot(10.0, ALTITUDE_M) / SPACING_M), round(math.hypot(14.5, ALTITUDE_M) / SPACING_M))
    assert np.array_equal(samples(after)["starboard"][:, ground], samples(log)["starboard"][:, ground])


MOUNTED = msgspec.structs.replace(CONFIG.sonar, heading_offset_deg=3.0, lever_arm_m=(2.0, -1.0, 0.0))


@pytest.mark.parametrize("sonar", [CONFIG.sonar, MOUNTED])
def test_every_pass_over_a_place_gets_the_target_where_the_truth_has_it(sonar: SonarConfig, tmp_path: Path) -> None:
    events, config = list(mission()), msgspec.structs.replace(CONFIG, sonar=sonar)
    back: list[NavSample | Ping] = []  # on the same line, later
    for event, mirrored in zip(events, [one for k in range(N_PINGS) for one in events[-2 * k - 2 :][:2]], strict=True):
        time_s = event.time_s + 200.0
        if isinstance(event, Ping):
            back.append(msgspec.structs.replace(event, time_s=time_s, number=event.number + N_PINGS))
        else:
            turned = HEADING_RAD + math.pi
            back.append(msgspec.structs.replace(mirrored, time_s=time_s, heading_rad=turned))
    log = written(tmp_path / "twice.xtf", iter([*events, *back]))
    (one,) = augmented(log, box(), config=config).objects
    assert [look.side for look in one.looks] == ["starboard", "port"]
    survey = read_survey(log, config)
    track = track_of(survey, config)
    frame = LocalFrame(latitude_deg=one.latitude_deg, longitude_deg=one.longitude_deg)
    for look in one.looks:
        place = Placement(one.scene_object, int(np.flatnonzero(track.number == look.ping)[0]), *look[1:3])
        assert frame.to_enu(*located(survey, track, place, config), 0.0)[:2] == pytest.approx([0.0, 0.0], abs=0.15)


# --- how echoes mix ---


def white_line(quantiles: Floats | None = None, **others: object) -> SampleScatter:
    probability = np.linspace(0.0, 1.0, 513)
    law = -np.log1p(-np.minimum(probability, 1.0 - 0.25 / 513)) if quantiles is None else quantiles
    line = SampleScatter(WHITE, WHITE, 1, np.ones(400), law / np.trapezoid(law, probability), np.ones(400))
    return line._replace(**others)  # type: ignore[arg-type]  # named fields of a NamedTuple


def distance(a: Floats, b: Floats) -> float:
    """Kolmogorov and Smirnov's distance between two samples."""
    joined = np.sort(np.concatenate([a, b]))
    return float(
        np.abs(
            np.searchsorted(np.sort(a), joined, "right") / a.size
            - np.searchsorted(np.sort(b), joined, "right") / b.size
        ).max()
    )


def critical(n: int, m: int) -> float:
    """Distance that two samples of one law exceed once in a thousand."""
    return 1.95 * math.sqrt((n + m) / (n * m))


def test_no_change_gives_the_recorded_intensity_back() -> None:
    recorded = np.random.Generator(np.random.PCG64(1)).exponential(size=(20, 400))
    none = Change(np.ones_like(recorded), np.zeros_like(recorded))
    intensity, changed = mixed(recorded, none, white_line(), np.ones(400), 1, 1)
    assert np.array_equal(intensity, recorded)
    assert not changed.any()


@pytest.mark.parametrize("shape", [0.7, 1.0, 4.0])
def test_embedded_shadow_scatters_as_real_shadow_does(shape: float) -> None:
    random = np.random.Generator(np.random.PCG64(2))
    real = random.gamma(shape, 1.0 / shape, 20_000)
    line = white_line(np.quantile(real, np.linspace(0.0, 1.0, 513)))
    recorded = 100.0 * random.exponential(size=(30, 400))
    shadow, _ = mixed(recorded, Change(np.zeros_like(recorded), np.zeros_like(recorded)), line, np.full(400, 3.0), 5, 1)
    embedded = shadow.ravel() / 3.0
    assert distance(embedded, real) < critical(embedded.size, real.size)


def test_shadow_embedded_in_a_log_scatters_as_its_water_column_does(log: Path) -> None:
    wide = msgspec.structs.replace(BOX, ground_range_m=10.0, length_m=4.0, width_m=1.0, height_m=1.0)
    after = log.with_name("wide.xtf")
    after.write_bytes(augmented(log, wide).data)
    image = samples(after)["starboard"] ** 2
    shadow = slice(round(math.hypot(10.8, ALTITUDE_M) / SPACING_M), round(math.hypot(13.0, ALTITUDE_M) / SPACING_M))
    embedded = image[66:95, shadow].ravel()
    water = image[:, 30:60].ravel()
    assert distance(embedded / embedded.mean(), water / water.mean()) < critical(embedded.size, water.size)


@pytest.mark.parametrize("looks", [1, 3])
def test_highlights_have_the_mean_and_the_looks_asked_for(looks: int) -> None:
    line = white_line(looks=looks)
    recorded = np.full((60, 400), 1e-9)
    intensity, changed = mixed(
        recorded, Change(np.zeros_like(recorded), np.full_like(recorded, 7.0)), line, np.full(400, 1e-9), 3, 2
    )
    assert changed.all()
    assert intensity.mean() == pytest.approx(7.0, rel=0.03)
    assert intensity.var() / intensity.mean() ** 2 == pytest.approx(1.0 / looks, rel=0.08)


def test_speckle_of_highlights_is_correlated_as_the_sonar_s() -> None:
    line = white_line(range_taps=gaussian_taps(2.0))
    recorded = np.full((80, 400), 1e-9)
    intensity, _ = mixed(
        recorded, Change(np.zeros_like(recorded), np.ones_like(recorded)), line, np.full(400, 1e-9), 3, 2
    )
    x = intensity - intensity.mean()
    assert (x[:, :-2] * x[:, 2:]).mean() / x.var() == pytest.approx(0.25, abs=0.04)


def test_samples_are_the_inverse_of_intensities() -> None:
    for transfer, dtype in (
        (Transfer("amplitude"), "uint16"),
        (Transfer("log", 0.35), "uint8"),
        (Transfer("intensity"), "uint16"),
    ):
        stored = np.arange(0, 256).astype(dtype)
        intensity, _ = to_intensity(stored, transfer)
        assert np.array_equal(to_samples(intensity.astype(np.float64), transfer, 65535.0, np.dtype(dtype)), stored)
