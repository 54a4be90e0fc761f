"""Specs of training sets: what follows from them, and what is refused with the key that is wrong."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import SonarConfig
from sim_replay.fitting.cascade.spec import (
    AugmentedLine,
    SimulatedLine,
    lines_of,
    parse_training_spec,
    read_training_spec,
)
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import EXACT, TARGET_KINDS
from sim_replay.simulator.scene_file import read_scene


def simulated(text: str, folder: Path = Path()) -> list[SimulatedLine]:
    lines = lines_of(parse_training_spec(text, "spec"), folder)
    return [line for line in lines if isinstance(line, SimulatedLine)]


def test_the_default_set_holds_out_seagrass_and_the_seeds_of_reported_rates() -> None:
    lines = simulated_default()
    backgrounds = [line.background for line in lines]
    assert len(set(backgrounds)) == len(backgrounds)
    assert {background.split("/")[0] for background in backgrounds} == {
        *("flat", "ripple", "mixed", "rough", "boulders", "slope", "shallow", "deep", "sas")
    }
    for line in lines:
        assert all(seabed.type != "seagrass" for seabed in line.scene.world.seabeds)
        assert line.scene.seed in (range(600, 700) if line.split == "train" else range(700, 720))
    assert {line.split for line in lines} == {"train", "validate"}


def simulated_default() -> list[SimulatedLine]:
    spec, folder = read_training_spec()
    return [line for line in lines_of(spec, folder) if isinstance(line, SimulatedLine)]


def test_missions_of_the_default_set_are_exact_silent_in_turns_and_full_of_targets_that_do_not_touch() -> None:
    first_of_each = {line.scene.name: line for line in simulated_default()}
    for line in first_of_each.values():
        scene = line.scene
        assert scene.navigation_error == EXACT
        assert not scene.track.pings_in_turns
        placed = place_objects(scene)
        is_target = np.array([target.is_target for target in placed])
        assert 60 <= is_target.sum() <= 150
        assert sum(target.kind == "rock" for target in placed) >= is_target.sum()
        assert {target.kind for target in placed if target.is_target} == TARGET_KINDS
        places = np.array([(target.east_m, target.north_m) for target in placed])
        reach_m = np.minimum([target.reach_m for target in placed], 5.0)
        apart_m = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 100.0 * np.eye(len(placed))
        assert (apart_m > reach_m[:, None] + reach_m)[is_target].all()


TWO = """
scenes: [flat, sas]
seeds: {train: {first: 600, count: 3}, validate: {first: 700, count: 1}, test: {first: 800, count: 1}}
targets: {per_mission: 10, kinds: {cylinder: {share: 2, length_m: [1.5, 1.6]}, sphere: {}}}
rocks: {per_mission: 4, length_m: [1.0, 1.1]}
"""


def test_every_scene_is_flown_with_every_seed() -> None:
    lines = simulated(TWO)
    assert [line.background for line in lines] == [
        *(f"{name}/{seed}" for seed in (600, 601, 602, 700, 800) for name in ("flat", "sas"))
    ]
    assert Counter(line.split for line in lines) == {"train": 6, "validate": 2, "test": 2}


def test_targets_are_shared_out_among_kinds_with_the_scene_s_strengths_and_the_sizes_asked_for() -> None:
    line = simulated(TWO)[0]
    own = {group.kind: group for group in read_scene("flat").scatter}
    groups = {group.kind: group for group in line.scene.scatter}
    assert {kind: groups[kind].count for kind in ("cylinder", "sphere", "rock")} == {
        "cylinder": 7,
        "sphere": 3,
        "rock": 4,
    }
    assert groups["cylinder"].length_m == (1.5, 1.6)
    assert groups["cylinder"].strength_db == own["cylinder"].strength_db
    assert groups["sphere"].width_m == own["sphere"].width_m
    assert groups["rock"].length_m == (1.0, 1.1)
    assert groups["tyre"] == own["tyre"]
    assert "wedge" not in groups


def test_sonars_take_turns_and_set_the_grid() -> None:
    lines = simulated(
        TWO
        + (
            "sonars: [{}, {frequency_khz: 900, range_m: 30, ping_rate_hz: 20, row_spacing_m: 0.1, column_spacing_m: "
            "0.04}]"
        )
    )
    flat = [line for line in lines if line.scene.name == "flat" and line.split == "train"]
    assert [line.scene.sonar.frequency_khz for line in flat] == [450.0, 900.0, 450.0]
    assert [line.config.waterfall.column_spacing_m for line in flat] == [0.06, 0.04, 0.06]
    assert [line.config.waterfall.row_spacing_m for line in flat] == [0.12, 0.1, 0.12]
    for group in flat[1].scene.scatter:
        assert group.ground_range_m is None or group.ground_range_m[1] < 30.0


def test_altitudes_are_drawn_within_the_factors_and_are_those_of_the_seed() -> None:
    text = TWO + "altitude_factor: [0.8, 1.25]"
    altitudes_m = [line.scene.track.altitude_m for line in simulated(text) if line.scene.name == "flat"]
    assert altitudes_m == [line.scene.track.altitude_m for line in simulated(text) if line.scene.name == "flat"]
    assert len(set(altitudes_m)) == len(altitudes_m)
    assert all(0.8 * 6.0 <= altitude_m <= 1.25 * 6.0 for altitude_m in altitudes_m)


def test_seabeds_follow_the_theatre() -> None:
    text = "scenes: [mixed]\nseeds: {train: {first: 600, count: 1}}\nseabed_factors: {seagrass: 0, mud: 3}"
    (line,) = simulated(text)
    shares = {seabed.type: seabed.share for seabed in line.scene.world.seabeds}
    own = {seabed.type: seabed.share for seabed in read_scene("mixed").world.seabeds}
    assert shares == {
        kind: share * (3.0 if kind == "mud" else 1.0) for kind, share in own.items() if kind != "seagrass"
    }


def test_scene_files_and_augmented_logs_are_looked_for_beside_the_spec(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("track: {plan: {pattern: lawnmower, n_legs: 1}}")
    (tmp_path / "set.yaml").write_text(
        "scenes: [mine.yaml]\nseeds: {train: {first: 600, count: 1}}\ntargets: {per_mission: 5}\nrocks: {per_mission: "
        "3}\n"
        "sonars: [{row_spacing_m: 0.2, column_spacing_m: 0.1}, {}]\naugmented: [{folder: line1, split: validate}]"
    )
    first, second = lines_of(*read_training_spec(tmp_path / "set.yaml"), SonarConfig(heading_offset_deg=2.0))
    assert isinstance(first, SimulatedLine)
    assert isinstance(second, AugmentedLine)
    assert first.background == "mine/600"
    assert Counter(target.is_target for target in place_objects(first.scene)) == {True: 5, False: 3}
    assert (second.folder, second.split) == (tmp_path / "line1", "validate")
    assert second.config.waterfall == first.config.waterfall, "of the first sonar"
    assert second.config.waterfall.column_spacing_m == 0.1
    assert (first.config.sonar.heading_offset_deg, second.config.sonar.heading_offset_deg) == (0.0, 2.0)


SEEDS = "seeds: {train: {first: 600, count: 2}}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "nothing to render"),
        ("scenes: [flat]", "`scenes` are given without `seeds`"),
        (SEEDS + "augmented: [{folder: a, split: train}]", "`seeds` are given without `scenes`"),
        ("scenes: [flat]\nseeds: {train: {first: 9099, count: 2}}", "`seeds.train` ends at 9100"),
        (
            "scenes: [flat]\nseeds: {train: {first: 600, count: 5}, validate: {first: 604, count: 1}}",
            "`seeds.train` and `seeds.validate` share seeds",
        ),
        ("scenes: [flat]\nseed: 1\n" + SEEDS, "unknown field `seed`"),
        ("scenes: [flat]\nseeds: {train: {first: 600}}", "missing required field `count` - at `seeds.train`"),
        ("scenes: [flat]\ntargets: {per_mission: 0}\n" + SEEDS, "`int` >= 1 - at `targets.per_mission`"),
        ("scenes: [flat]\ntargets: {kinds: {tyre: {}}}\n" + SEEDS, "`targets.kinds"),
        ("scenes: [flat]\ntargets: {kinds: {box: {lenght_m: [1, 2]}}}\n" + SEEDS, "unknown field `lenght_m`"),
        (
            "scenes: [flat]\naltitude_factor: [1.2, 0.8]\n" + SEEDS,
            "`altitude_factor` is [1.2, 0.8]; the lowest comes first",
        ),
        ("scenes: [flat]\nsonars: [{frequency_khz: 450000}]\n" + SEEDS, "<= 3000.0 - at `sonars[0].frequency_khz`"),
        ("scenes: [flat]\nsonars: [{n_samples: 0}]\n" + SEEDS, "`int` >= 64 - at `sonars[0].n_samples`"),
        ("scenes: [flat]\nsonars: [{ping_rate_hz: -1}]\n" + SEEDS, "> 0.0 - at `sonars[0].ping_rate_hz`"),
        (
            "scenes: [flat]\ntargets: {kinds: {sphere: {length_m: [0.6, 1]}}}\n" + SEEDS,
            "`targets.kinds.sphere.length_m` changes nothing: it goes by the diameter. Give that as `width_m`",
        ),
        ("scenes: [flat]\nsonars: []\n" + SEEDS, "length >= 1 - at `sonars`"),
        ("augmented: [{folder: a, split: train}, {folder: a, split: test}]", "`augmented[1].folder`: a is given twice"),
        ("augmented: [{folder: a, split: learn}]", "Invalid enum value 'learn' - at `augmented[0].split`"),
        ("scenes: [flat]\nscenes: [flat]", "key 'scenes' is given twice"),
        ("- flat", "expected keys such as 'scenes:'"),
    ],
)
def test_specs_that_cannot_be_are_refused_with_the_key(text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_training_spec(text, "set.yaml")
    assert str(caught.value).startswith("set.yaml: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scenes: [flat, flat]\n" + SEEDS, "two are named 'flat'"),
        ("scenes: [atlantis]\n" + SEEDS, "no such scene"),
        (
            "scenes: [flat]\nseabed_factors: {sand: 0, mud: 0}\n" + SEEDS,
            "leave nothing of the sea floor of scene 'flat'",
        ),
        ("scenes: [deep]\nsonars: [{range_m: 9}]\n" + SEEDS, "scene deep as the spec changes it: `track.altitude_m`"),
    ],
)
def test_missions_that_cannot_be_are_refused_before_any_is_flown(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulated(text)


def test_a_spec_that_cannot_be_read_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.yaml cannot be read"):
        read_training_spec(tmp_path / "none.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"scenes: [\xe9]")
    with pytest.raises(UsageError, match="not UTF-8 text"):
        read_training_spec(tmp_path / "latin.yaml")


def test_no_background_is_in_two_splits() -> None:
    by_split = {split: {line.background for line in lines} for split, lines in _grouped(simulated(TWO))}
    assert all(not one & other for one, other in itertools.combinations(by_split.values(), 2))


def _grouped(lines: list[SimulatedLine]) -> list[tuple[str, list[SimulatedLine]]]:
    return [(split, [line for line in lines if line.split == split]) for split in ("train", "validate", "test")]
