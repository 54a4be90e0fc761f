"""The observer's statistic against closed forms, and its sign on targets and bare floor of small scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.special import gammainc, kolmogorov

from sim_replay.simulator.ideal_observer import (
    IdealObserver,
    log_mean_exp,
    log_ratio,
    mine_library,
    rock_library,
)
from sim_replay.simulator.objects import PlacedObject
from sim_replay.simulator.scene import STEADY, Lawnmower, Scene, SceneObject, Seabed, Sonar, Track, World
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.vehicle import SonarPose

SONAR = Sonar(range_m=25.0, n_samples=500, ping_rate_hz=10.0, range_resolution_m=0.08, beam_lines=3)
ABEAM = SceneObject(kind="box", east_m=12.0, north_m=10.0, azimuth_deg=20.0, strength_db=-14.0)
STONE = SceneObject(kind="rock", east_m=-14.0, north_m=10.0, strength_db=-14.0)


def scene_with(*objects: SceneObject, seed: int = 3, sonar: Sonar = SONAR) -> Scene:
    sand = Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0)
    return Scene(
        seed=seed,
        world=World(depth_m=30.0, seabeds=(sand,), relief_rms_m=0.0, cell_m=0.1),
        objects=objects,
        sonar=sonar,
        track=Track(plan=Lawnmower(n_legs=1, leg_m=20.0), altitude_m=5.0, speed_mps=2.0, motion=STEADY),
    )


def straight(n: int = 100) -> list[SonarPose]:
    """North at 0.2 m per ping, 5 m over the floor."""
    return [SonarPose(0.1 * k, 0.0, 0.2 * k, 25.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0) for k in range(n)]


# ---------------------------------------------------------------- the statistic


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("contrast", [0.2, 3.0])
def test_the_ratio_of_an_even_patch_has_the_distribution_of_the_closed_form(looks: int, contrast: float) -> None:
    """With the object L x / m1 summed over n samples is Gamma distributed with n L degrees."""
    random, n = np.random.Generator(np.random.PCG64(1)), 12
    drawn = random.gamma(looks, contrast / looks, (3000, n))
    ratios = np.array([log_ratio(x, contrast, 1.0, looks=looks) for x in drawn])
    gamma = (ratios + n * looks * math.log(contrast)) / (contrast - 1.0)
    expected = gammainc(n * looks, np.sort(gamma))
    step = np.arange(len(gamma)) / len(gamma)
    distance = max(np.abs(expected - step).max(), np.abs(expected - step - 1.0 / len(gamma)).max())
    assert kolmogorov(distance * math.sqrt(len(gamma))) > 0.01
    divergence = n * looks * (contrast - 1.0 - math.log(contrast))
    assert ratios.mean() == pytest.approx(divergence, rel=0.1)


def test_a_ratio_above_t_comes_by_chance_in_no_more_than_exp_minus_t_of_the_cases() -> None:
    random = np.random.Generator(np.random.PCG64(2))
    with_it = random.uniform(0.5, 2.0, 6)
    ratios = np.array([log_ratio(x, with_it, 1.0) for x in random.exponential(1.0, (20_000, 6))])
    assert np.exp(ratios).mean() == pytest.approx(1.0, abs=0.05)
    assert ratios.mean() < 0.0
    for t in (0.0, 1.0, 2.0):
        assert (ratios > t).mean() <= math.exp(-t)


def test_samples_that_repeat_each_other_count_once() -> None:
    x = np.random.Generator(np.random.PCG64(3)).exponential(1.0, 20)
    repeated = log_ratio(np.repeat(x, 3), 2.0, 1.0, samples_per_look=3.0)
    assert repeated == pytest.approx(log_ratio(x, 2.0, 1.0))


def test_hypotheses_are_averaged_where_numbers_would_overflow() -> None:
    assert log_mean_exp([1.0, 2.0]) == pytest.approx(math.log(0.5 * (math.e + math.e**2)))
    assert log_mean_exp([5000.0, -5000.0]) == pytest.approx(5000.0 - math.log(2.0))


# ---------------------------------------------------------------- the sea as the observer knows it


def test_a_sea_with_other_objects_is_the_sea_of_a_scene_that_has_them() -> None:
    both, alone = Sea(scene_with(ABEAM, STONE)), Sea(scene_with(ABEAM))
    poses = straight()[40:60]
    assert np.array_equal(both.with_objects(both.objects[:1]).mean_intensity(poses), alone.mean_intensity(poses))
    assert len(both.objects) == 2


@pytest.mark.parametrize("along_m", [0.0, 0.3])
def test_received_pings_have_the_mean_and_the_independent_samples_that_the_sea_says(along_m: float) -> None:
    sea = Sea(scene_with(sonar=replace(SONAR, speckle_along_track_m=along_m)))
    pose = straight(1)[0]
    block = [pose] * 1500
    drawn = np.concatenate([sea.received(block, 2000 * part)[:, 0, 150:400] for part in range(2)]).astype(np.float64)
    drawn /= sea.mean_received([pose])[:, 0, 150:400]
    independent = drawn.size / sea.samples_per_look
    assert drawn.mean() == pytest.approx(1.0, abs=5.0 / math.sqrt(independent))
    patches = drawn.reshape(100, 30, 250).mean(axis=(1, 2))
    assert patches.var() * 30 * 250 == pytest.approx(sea.samples_per_look, rel=0.5)


# ---------------------------------------------------------------- the observer


def seen(scene: Scene, poses: list[SonarPose] | None = None) -> tuple[IdealObserver, PlacedObject]:
    sea = Sea(scene)
    return IdealObserver(sea, poses or straight()), sea.objects[0]


def test_targets_are_positive_and_bare_floor_is_negative() -> None:
    """On the mean over speckle, by Gibbs' inequality; here by far in each case."""
    for seed in range(4):
        observer, target = seen(scene_with(ABEAM, seed=seed))
        elsewhere = target._replace(east_m=-12.0)
        assert observer.log_ratios(target, [target])[0] > 20.0
        assert observer.log_ratios(elsewhere, [elsewhere])[0] < -20.0


def test_the_truth_is_more_likely_than_any_other_kind_and_the_rock_than_any_mine() -> None:
    observer, target = seen(scene_with(ABEAM))
    wrong = [mine for mine in mine_library(target) if mine.kind != "box"]
    ratios = observer.log_ratios(target, [target, *wrong, *rock_library(target, 4)])
    assert ratios.argmax() == 0
    observer, stone = seen(scene_with(STONE))
    ratios = observer.log_ratios(stone, [stone, *mine_library(stone)])
    assert ratios.argmax() == 0


def test_a_place_is_seen_from_every_leg_that_passes_it_and_from_no_other_ping() -> None:
    observer, target = seen(scene_with(ABEAM))
    (passage,) = observer.passages(target)
    assert passage.side == 1
    norths = [pose.north_m for pose in passage.poses]
    assert passage.first_number == round(norths[0] / 0.2)
    assert min(norths) < target.north_m - target.reach_m < target.north_m + target.reach_m < max(norths)
    assert max(norths) - min(norths) < 6.0
    there_and_back = [*straight(), *[pose._replace(on_leg=1) for pose in straight()]]
    twice, target = seen(scene_with(ABEAM), there_and_back)
    assert len(list(twice.passages(target))) == 2
    far = target._replace(east_m=26.0)
    assert list(observer.passages(far)) == []
    assert observer.log_ratios(far, [far]).tolist() == [0.0]


def test_the_library_holds_every_kind_at_the_place_and_rocks_of_its_size() -> None:
    _, target = seen(scene_with(ABEAM))
    mines, rocks = mine_library(target), rock_library(target, 5)
    assert {mine.kind for mine in mines} == {"cylinder", "sphere", "truncated_cone", "wedge", "box"}
    assert {(one.east_m, one.north_m, one.burial_m) for one in (*mines, *rocks)} == {
        (target.east_m, target.north_m, target.burial_m)
    }
    assert len({rock.seed for rock in rocks}) == 5
    assert {(rock.length_m, rock.width_m, rock.height_m) for rock in rocks} == {
        (target.length_m, target.width_m, target.height_m)
    }
