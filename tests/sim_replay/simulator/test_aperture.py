"""Synthetic-aperture images against geometry worked out point by point, and against the laws of their speckle and
levels."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from sim_replay.simulator import backend
from sim_replay.simulator.aperture import Aperture, Strip, View
from sim_replay.simulator.echo import absorption_db_per_km, flat_floor_intensity, floor_tables
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import (
    Lawnmower,
    Ripples,
    SampleRecorder,
    Scatter,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    SyntheticAperture,
    Track,
    World,
)
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.speckle import low_pass_taps

Floats = NDArray[np.float64]

needs_c = pytest.mark.skipif(backend.library() is None, reason=f"no C library: {backend.simulator_library().reason}")

ALTITUDE_M: Final = 5.0
BARE: Final = World(
    depth_m=20.0,
    relief_rms_m=0.0,
    seabeds=(Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0),),
    backscatter="lambert",
)
WIDE: Final = Sonar(  # 100 kHz at 5 cm: an integration angle of 0.15 rad
    frequency_khz=100.0,
    range_m=20.0,
    vertical_beam_width_deg=120.0,
    noise_db=-60.0,
    ring_down_m=0.0,
    synthetic_aperture=SyntheticAperture(sub_apertures=3),
)

WIDEST: Final = msgspec.structs.replace(  # 0.47 rad
    WIDE, synthetic_aperture=SyntheticAperture(along_track_resolution_m=0.016, sub_apertures=3)
)


def scene_of(*objects: SceneObject, leg_m: float = 6.0, heading_deg: float = 0.0, **changes: Any) -> Scene:
    track = Track(altitude_m=ALTITUDE_M, plan=Lawnmower(n_legs=1, leg_m=leg_m, heading_deg=heading_deg))
    return msgspec.structs.replace(Scene(world=BARE, objects=objects, sonar=WIDE, track=track), **changes)


def first_leg(scene: Scene, threads: int = 1) -> tuple[Aperture, Strip]:
    aperture = Aperture(Sea(scene, threads=threads))
    return aperture, aperture.strip(planned_legs(scene.track.plan)[0], 0)


def mean_image(aperture: Aperture, strip: Strip, view: View) -> Floats:
    return aperture.mean_intensity(strip, 0, strip.n_lines, view)


def ground_range_m(aperture: Aperture) -> Floats:
    slant = (np.arange(aperture.sea.sonar.n_samples) + 0.5) * aperture.bin_m
    return np.asarray(np.sqrt(np.maximum(slant**2 - ALTITUDE_M**2, 0.0)))


def wall(along_m: float, across_m: float, *, length_m: float, height_m: float = 2.0) -> SceneObject:
    return SceneObject(
        kind="box", leg=0, along_m=along_m, across_m=across_m, length_m=length_m, width_m=0.2, height_m=height_m
    )


def seen_share(along_m: Floats, across_m: float, angles_rad: Floats, box: SceneObject) -> Floats:
    """Share of bearings from which an upright wall along the track, cut into thin slices, lets points of the flat floor
    be seen."""
    assert box.along_m is not None
    assert box.across_m is not None
    assert box.length_m is not None
    assert box.height_m is not None
    hidden = np.zeros((len(along_m), len(angles_rad)), dtype=np.bool_)
    for slice_m in box.across_m + np.linspace(-0.1, 0.1, 21):
        passed_m = along_m[:, None] - (across_m - slice_m) * np.tan(angles_rad)
        height_m = ALTITUDE_M * (1.0 - slice_m / across_m)
        hidden |= (np.abs(passed_m - box.along_m) < 0.5 * box.length_m) & (height_m < box.height_m)
    return np.asarray(1.0 - hidden.mean(axis=1))


def bearings(aperture: Aperture, view: View, n: int = 120) -> Floats:
    """Many, evenly over those of a view."""
    total, n_views = aperture.integration_rad, aperture.aperture.sub_apertures
    first, width = (-0.5 * total, total) if view == "full" else (total * (view / n_views - 0.5), total / n_views)
    return np.asarray(first + (np.arange(n) + 0.5) / n * width)


@settings(max_examples=6, deadline=None)
@given(
    along_m=st.floats(2.0, 4.0),
    across_m=st.floats(6.0, 13.0),
    length_m=st.floats(0.4, 2.5),
    height_m=st.floats(0.5, 2.5),
    heading_deg=st.floats(0.0, 360.0),
    starboard=st.booleans(),
    view=st.sampled_from([0, 1, 2, "full"]),
)
def test_shadows_are_what_each_bearing_of_the_view_leaves_unseen(
    along_m: float, across_m: float, length_m: float, height_m: float, heading_deg: float, starboard: bool, view: View
) -> None:
    box = wall(along_m, across_m, length_m=length_m, height_m=height_m)
    side = 1.0 if starboard else -1.0
    placed = msgspec.structs.replace(box, across_m=side * across_m, azimuth_deg=heading_deg)
    aperture, strip = first_leg(scene_of(placed, heading_deg=heading_deg))
    bare, plain = first_leg(scene_of(heading_deg=heading_deg))
    share = (mean_image(aperture, strip, view) / np.maximum(mean_image(bare, plain, view), 1e-30))[:, int(starboard)]
    ground = ground_range_m(aperture)
    along = np.asarray(np.arange(strip.n_lines) * aperture.line_m, dtype=np.float64)
    columns = np.flatnonzero((ground > across_m + 0.2) & (ground < 19.0)).tolist()
    expected = [seen_share(along, float(ground[column]), bearings(aperture, view), box) for column in columns]
    error = np.abs(share[:, columns] - np.transpose(expected))
    assert error.mean() < 0.01
    assert np.mean(error > 0.3) < 0.005


def test_a_squinted_view_shears_the_shadow_by_the_tangent_of_its_squint() -> None:
    aperture, strip = first_leg(scene_of(wall(3.0, 8.0, length_m=0.3, height_m=2.5)))
    flat, plain = first_leg(scene_of())
    ground = ground_range_m(aperture)
    columns = np.flatnonzero((ground > 8.5) & (ground < 14.5))
    along = np.arange(strip.n_lines) * aperture.line_m
    for view in range(3):
        dark = 1.0 - (mean_image(aperture, strip, view) / mean_image(flat, plain, view).clip(1e-30))[:, 1, columns]
        middle = (along[:, None] * dark).sum(axis=0) / dark.sum(axis=0)
        expected = 3.0 + (ground[columns] - 8.0) * math.tan((view - 1) * aperture.integration_rad / 3.0)
        assert np.abs(middle - expected).max() < 0.1 * aperture.line_m


@pytest.mark.parametrize("behind_m", [1.5, 3.0, 6.0])
def test_the_full_image_blurs_a_shadow_edge_over_distance_times_integration_angle(behind_m: float) -> None:
    box = wall(0.0, 8.0, length_m=6.0, height_m=3.0)
    aperture, strip = first_leg(scene_of(box))
    flat, plain = first_leg(scene_of())
    column = int(np.argmin(np.abs(ground_range_m(aperture) - (8.0 + behind_m))))
    share = (mean_image(aperture, strip, "full") / mean_image(flat, plain, "full").clip(1e-30))[:, 1, column]
    along = np.arange(strip.n_lines) * aperture.line_m
    at = [float(np.interp(level, share, along)) for level in (0.1, 0.5, 0.9)]
    assert at[1] == pytest.approx(3.0, abs=1.5 * aperture.line_m)
    assert at[2] - at[0] == pytest.approx(0.8 * behind_m * aperture.integration_rad, abs=2.0 * aperture.line_m)


def test_objects_stay_where_they_are_in_all_views() -> None:
    sphere = SceneObject(kind="sphere", leg=0, along_m=3.0, across_m=-11.0, width_m=0.6, strength_db=10.0)
    point = SceneObject(kind="point", leg=0, along_m=2.0, across_m=9.0, above_m=1.0, strength_db=10.0)
    aperture, strip = first_leg(scene_of(sphere, point))
    places = []
    for view in (0, 1, 2, "full"):
        bright = mean_image(aperture, strip, view)
        bright[bright < 50.0 * aperture.sea.reference] = 0.0
        bright[:, :, : int(9.0 / aperture.bin_m)] = 0.0  # where the floor itself is bright
        lines, columns = np.indices(bright.shape[::2])
        for image in (bright[:, 0], bright[:, 1]):
            places.append([(image * lines).sum() / image.sum(), (image * columns).sum() / image.sum()])
    spheres, points = np.array(places[::2]), np.array(places[1::2])
    assert np.abs(spheres - spheres[3]).max() < 1.0
    assert spheres[3, 0] * aperture.line_m == pytest.approx(3.0, abs=aperture.line_m)
    # Nearest to the sonar, a sphere of radius a is a closer than its centre; a steep cap around that place is bright.
    assert math.hypot(11.0, 4.7) - 0.3 - 0.05 < (spheres[3, 1] + 0.5) * aperture.bin_m < math.hypot(11.0, 4.7) - 0.15
    assert np.abs(points - points[3]).max() < 1e-6
    assert points[3] * [aperture.line_m, aperture.bin_m] == pytest.approx(
        [2.0, math.hypot(9.0, 4.0) - 0.5 * aperture.bin_m], abs=1e-3
    )


def test_a_wall_is_at_its_closest_range_in_the_widest_views() -> None:
    aperture, strip = first_leg(scene_of(wall(3.0, 16.0, length_m=5.0, height_m=0.5), sonar=WIDEST))
    far = int(14.0 / aperture.bin_m)
    views: list[View] = [0, 1, 2, "full"]
    brightest = [
        far + int(np.argmax(aperture.mean_intensity(strip, strip.n_lines // 2, 1, view)[0, 1, far:])) for view in views
    ]
    assert len(set(brightest)) == 1
    top, foot = math.hypot(15.9, ALTITUDE_M - 0.5), math.hypot(15.9, ALTITUDE_M)
    assert top < (brightest[0] + 0.5) * aperture.bin_m < foot


def test_a_point_brings_back_its_target_strength() -> None:
    point = SceneObject(kind="point", leg=0, along_m=3.0, across_m=9.0, strength_db=0.0)
    sonar = msgspec.structs.replace(WIDE, vertical_beam_width_deg=180.0)
    aperture, strip = first_leg(scene_of(point, sonar=sonar))
    bare, plain = first_leg(scene_of(sonar=sonar))
    added = (mean_image(aperture, strip, "full") - mean_image(bare, plain, "full"))[:, 1] / aperture.sea.spreading
    # A square metre of floor with sigma = 1 would bring back one unit of energy per metre of track over a metre of
    # track.
    assert added.sum() * aperture.line_m == pytest.approx(pattern(sonar, 9.0, ALTITUDE_M), rel=1e-6)


def pattern(sonar: Sonar, across_m: float, below_m: float) -> float:
    """sinc^4 over the sine of the angle off the axis, one half at half the width."""
    off = math.sin(math.atan2(below_m, across_m) - math.radians(sonar.tilt_deg))
    phase = 1.0019127 * off / math.sin(math.radians(0.5 * sonar.vertical_beam_width_deg))
    return (math.sin(phase) / phase) ** 4


@pytest.mark.parametrize("view", [0, 1, "full"])
def test_a_flat_floor_follows_the_sonar_equation_at_all_ranges(view: View) -> None:
    aperture, strip = first_leg(scene_of(leg_m=1.0, sonar=WIDEST))
    sea = aperture.sea
    slant = np.asarray((np.arange(sea.sonar.n_samples) + 0.5) * aperture.bin_m, dtype=np.float64)
    table = floor_tables(sea.scene, sea.world.covers)[0]
    expected = flat_floor_intensity(slant, ALTITUDE_M, table, sea.sonar, absorption_db_per_km(sea.sonar, 20.0))
    # From where it is seen the floor is farther away than at closest approach, so that Lambert's law has the cosine
    # squared of the bearing.
    expected *= np.mean(np.cos(bearings(aperture, view)) ** 2)
    far = slant > 1.2 * ALTITUDE_M
    level_db = 10.0 * np.log10(mean_image(aperture, strip, view)[:, :, far] / expected[far])
    assert np.abs(level_db).max() < 0.02


def test_gain_levels_a_floor_that_scatters_alike_at_all_angles() -> None:
    sonar = msgspec.structs.replace(
        WIDE, vertical_beam_width_deg=180.0, recorder=SampleRecorder(samples="amplitude_float32")
    )
    aperture, strip = first_leg(scene_of(leg_m=12.0, sonar=sonar))
    power = np.mean(
        [ping.starboard.samples**2 for _, ping in aperture.lines(strip, 0.0, 0) if ping.starboard is not None], axis=0
    )
    slant = (np.arange(power.size) + 0.5) * aperture.bin_m
    ground = np.maximum(ground_range_m(aperture), 0.1)
    # Less what Lambert's law, the floor within a sample and the vertical beam make of it.
    alike = (
        power * (slant / ALTITUDE_M) ** 2 * (ground / slant) / [pattern(sonar, y, ALTITUDE_M) for y in ground.tolist()]
    )
    blocks = [alike[(slant > low) & (slant < low + 3.0)].mean() for low in (7.0, 10.0, 13.0, 16.5)]
    assert 10.0 * np.log10(np.array(blocks) / np.mean(blocks)) == pytest.approx(0.0, abs=0.25)


@pytest.mark.parametrize("view", ["full", 1])
def test_resolution_is_the_same_near_and_far(view: View) -> None:
    aperture, strip = first_leg(scene_of(leg_m=25.0))
    sonar = aperture.aperture
    image = aperture.intensity(strip, 0, strip.n_lines, view)[:, 1].astype(np.float64)
    level = mean_image(aperture, strip, view)[:, 1] / aperture.sea.reference
    coarser = 1 if view == "full" else sonar.sub_apertures
    taps = low_pass_taps(sonar.pixels_per_resolution * coarser), low_pass_taps(sonar.pixels_per_resolution)
    for near, far in ((7.0, 11.0), (15.5, 19.5)):
        columns = slice(int(near / aperture.bin_m), int(far / aperture.bin_m))
        speckle = image[:, columns] / level[:, columns] - 1.0
        assert speckle.mean() == pytest.approx(0.0, abs=0.03)
        for lines, samples in ((1, 0), (2, 0), (0, 1), (0, 2), (3 * coarser, 0)):
            both = speckle[lines:, samples:] * speckle[: len(speckle) - lines, : speckle.shape[1] - samples]
            field = (
                np.correlate(taps[0], taps[0], "full")[taps[0].size - 1 + lines]
                * np.correlate(taps[1], taps[1], "full")[taps[1].size - 1 + samples]
            )
            assert both.mean() == pytest.approx(float(field) ** 2, abs=0.05)


def test_speckle_of_views_sides_and_legs_is_independent() -> None:
    aperture, strip = first_leg(scene_of(leg_m=15.0))
    columns = slice(int(7.0 / aperture.bin_m), None)
    views: list[View] = ["full", 0, 1, 2]
    images = [aperture.intensity(strip, 0, strip.n_lines, view) for view in views]
    fields = [image[:, side, columns] for image in images for side in range(2)]
    fields.append(aperture.intensity(strip._replace(number=1), 0, strip.n_lines, "full")[:, 1, columns])
    fields = [field / field.mean(axis=0) - 1.0 for field in fields]
    correlation = np.corrcoef([field.ravel() for field in fields])
    assert np.abs(correlation - np.eye(len(fields))).max() < 0.03


def test_edges_of_the_mean_image_are_blurred_by_the_point_spread_function() -> None:
    sonar = msgspec.structs.replace(WIDE, looks=64)
    aperture, strip = first_leg(scene_of(wall(3.0, 8.0, length_m=9.0), sonar=sonar))
    lines = slice(20, strip.n_lines - 20)
    image = aperture.intensity(strip, lines.start, lines.stop - lines.start, "full")[:, 1].mean(axis=0)
    mean = mean_image(aperture, strip, "full")[lines, 1].mean(axis=0) / aperture.sea.reference
    taps = low_pass_taps(aperture.aperture.pixels_per_resolution)
    blurred = np.convolve(mean + 10.0 ** (0.1 * sonar.noise_db), taps.astype(np.float64) ** 2, "same")
    columns = slice(int(7.0 / aperture.bin_m), -10)
    assert image[columns] == pytest.approx(blurred[columns], rel=0.1)


def motley(**changes: Any) -> Scene:
    """All that a block of lines could get wrong: relief, texture, bodies, points, other paths, a leg across patches
    south-west of zero."""
    scene = Scene(
        world=World(
            seabeds=(Seabed(type="rippled_sand", ripples=Ripples(wavelength_m=0.6, height_m=0.08)),), slope_deg=2.0
        ),
        scatter=(Scatter(kind="rock", count=6, apart_m=0.5), Scatter(kind="cylinder", count=3, apart_m=0.5)),
        objects=(
            SceneObject(kind="point", leg=0, along_m=3.0, across_m=8.0),
            SceneObject(kind="fish_school", leg=0, along_m=5.0, across_m=-9.0),
        ),
        sonar=Sonar(
            frequency_khz=200.0,
            range_m=16.0,
            looks=2,
            surface_echo_db=-20.0,
            crosstalk_db=-30.0,
            synthetic_aperture=SyntheticAperture(
                along_track_resolution_m=0.08, range_resolution_m=0.06, sub_apertures=2
            ),
        ),
        track=Track(
            altitude_m=4.0, plan=Lawnmower(n_legs=1, leg_m=8.0, heading_deg=213.0, start_east_m=1.3, start_north_m=2.7)
        ),
    )
    return msgspec.structs.replace(scene, **changes)


@pytest.mark.parametrize("view", ["full", 1])
def test_blocks_of_lines_give_the_same_bytes_as_the_whole(view: View) -> None:
    aperture, strip = first_leg(motley())
    whole = aperture.intensity(strip, 0, strip.n_lines, view)
    cuts = [0, 1, 8, 57, strip.n_lines]
    again, same = first_leg(motley(), threads=2)
    pieces = [again.intensity(same, first, stop - first, view) for first, stop in reversed(list(pairwise(cuts)))]
    np.testing.assert_array_equal(np.concatenate(pieces[::-1]), whole)


@needs_c
def test_numpy_gives_the_same_bytes_as_c(monkeypatch: pytest.MonkeyPatch) -> None:
    aperture, strip = first_leg(motley())
    with_c = aperture.intensity(strip, 10, 12, "full")
    monkeypatch.setattr(backend, "library", lambda: None)
    aperture, strip = first_leg(motley())
    np.testing.assert_array_equal(aperture.intensity(strip, 10, 12, "full"), with_c)


def test_the_full_mean_image_is_the_mean_of_the_views() -> None:
    aperture, strip = first_leg(motley())
    views = np.mean([mean_image(aperture, strip, view) for view in range(2)], axis=0)
    np.testing.assert_allclose(mean_image(aperture, strip, "full"), views, rtol=1e-9)


def test_another_seed_gives_another_image() -> None:
    images = []
    for seed in (1, 2):
        aperture, strip = first_leg(scene_of(seed=seed, leg_m=1.0))
        images.append(aperture.intensity(strip, 0, 5, "full"))
    assert not np.any(images[0] == images[1])


@pytest.mark.parametrize("view", ["full", 0])
def test_lines_come_when_the_vehicle_passes_them_and_hold_the_image(view: View) -> None:
    scene = motley()
    assert scene.sonar.synthetic_aperture is not None
    sonar = msgspec.structs.replace(
        scene.sonar,
        synthetic_aperture=msgspec.structs.replace(scene.sonar.synthetic_aperture, view=view),
        recorder=SampleRecorder(samples="amplitude_float32"),
        ring_down_m=0.0,
        absorption_db_per_km=0.0,
    )
    aperture, strip = first_leg(motley(sonar=sonar))
    lines = list(aperture.lines(strip, 1000.0, 7))
    assert len(lines) == strip.n_lines == math.floor(8.0 / 0.064) + 1
    image = aperture.intensity(strip, 0, strip.n_lines, view)
    sine, cosine = math.sin(math.radians(213.0)), math.cos(math.radians(213.0))
    for index, (pose, ping) in enumerate(lines):
        way = index * 0.064
        assert (pose.east_m, pose.north_m) == pytest.approx((1.3 + way * sine, 2.7 + way * cosine))
        assert pose.time_s == ping.time_s == pytest.approx(1000.0 + way / scene.track.speed_mps)
        assert (pose.heading_rad, pose.pitch_rad, pose.roll_rad) == pytest.approx((math.radians(213.0), 0.0, 0.0))
        assert (pose.depth_m, pose.speed_mps, pose.on_leg, ping.number) == (
            strip.depth_m,
            scene.track.speed_mps,
            0,
            7 + index,
        )
        assert math.isnan(ping.altitude_m)
    port = lines[5][1].port
    assert port is not None
    assert port.samples.size == round(16.0 * 1.25 / 0.06)
    assert port.spacing_m == pytest.approx(0.048, rel=2e-3)
    gain = (port.samples.astype(np.float64) ** 2 / image[5, 0])[100:]
    np.testing.assert_allclose(gain, gain[0] * ((np.arange(100, port.samples.size) + 0.5) / 100.5) ** 3, rtol=1e-3)


def test_the_track_keeps_one_depth_at_the_mean_altitude() -> None:
    aperture, strip = first_leg(motley())
    altitudes = [aperture.sea.altitude_m(pose) for pose in aperture.poses(strip, 0.0, 0, strip.n_lines)]
    assert np.mean(altitudes) == pytest.approx(4.0, abs=1e-6)
    assert np.ptp(altitudes) > 0.1


def test_a_scene_without_synthetic_aperture_is_refused() -> None:
    scene = scene_of(sonar=msgspec.structs.replace(WIDE, synthetic_aperture=None))
    with pytest.raises(UsageError, match="synthetic_aperture` is missing"):
        Aperture(Sea(scene))


def test_an_aperture_too_wide_is_refused_with_the_finest_resolution_there_is() -> None:
    def sonar(resolution_m: float) -> Sonar:
        return msgspec.structs.replace(
            WIDE, synthetic_aperture=SyntheticAperture(along_track_resolution_m=resolution_m)
        )

    with pytest.raises(UsageError, match=r"is 0\.014, .* takes an aperture of 31 degrees; give 0\.015 or more"):
        Aperture(Sea(scene_of(sonar=sonar(0.014))))
    Aperture(Sea(scene_of(sonar=sonar(0.0151))))


def test_a_leg_that_would_run_into_a_slope_is_refused() -> None:
    world = msgspec.structs.replace(BARE, depth_m=60.0, slope_deg=10.0)
    with pytest.raises(UsageError, match=r"on leg 0 .* m above the floor .* give another `track.altitude_m`"):
        first_leg(scene_of(leg_m=80.0, world=world))
