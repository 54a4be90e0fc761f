"""Missions become labelled tiles: labelled objects show at their places, and the same spec gives the same bytes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.shell.whole_files import write_json
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.spec import AugmentedLine, SimulatedLine, lines_of, parse_training_spec
from sim_replay.fitting.cascade.store import read_manifest, read_shard
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject
from sim_replay.fitting.cascade.training_images import (
    OVERLAP_M,
    render_line,
    render_set,
    simulated_tiles,
    tile_set_words,
)
from sim_replay.simulate import simulate

SCENE = """
name: bay
world: {depth_m: 16, relief_rms_m: 0.05, cell_m: 0.1, seabeds: [{type: sand}]}
sonar: {range_m: 26, n_samples: 512, ping_rate_hz: 12, beam_lines: 3, noise_db: -30}
track: {altitude_m: 5, speed_mps: 1.8, plan: {pattern: lawnmower, heading_deg: 75, n_legs: 2, leg_m: 70, spacing_m: 40}}
scatter:
  - {kind: cylinder, count: 1, ground_range_m: [8, 22], strength_db: [-8, -6]}
  - {kind: tyre, count: 1}
"""
SPEC = """
scenes: [bay.yaml]
seeds: {train: {first: 600, count: 1}}
targets: {per_mission: 14, kinds: {cylinder: {}, sphere: {}, truncated_cone: {}, wedge: {}, box: {}}}
rocks: {per_mission: 4}
"""
SHORT_SCENE = SCENE.replace("leg_m: 70", "leg_m: 24").replace("n_legs: 2", "n_legs: 1")
SHORT_SPEC = SPEC.replace("per_mission: 14", "per_mission: 3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("specs")
    (folder / "bay.yaml").write_text(SCENE)
    (folder / "set.yaml").write_text(SPEC)
    return folder


@pytest.fixture(scope="module")
def line(folder: Path) -> SimulatedLine:
    (line,) = lines_of(parse_training_spec(SPEC, "spec"), folder)
    assert isinstance(line, SimulatedLine)
    return line


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> SimulatedLine:
    folder = tmp_path_factory.mktemp("short")
    (folder / "bay.yaml").write_text(SHORT_SCENE)
    (line,) = lines_of(parse_training_spec(SHORT_SPEC, "spec"), folder)
    assert isinstance(line, SimulatedLine)
    return line


@pytest.fixture(scope="module")
def tiles(line: SimulatedLine) -> list[LabelledTile]:
    return list(simulated_tiles(line))


def looks(tiles: list[LabelledTile]) -> list[tuple[LabelledTile, TileObject]]:
    """Targets in cores, where they and their shadows are usable."""
    found = []
    for tile in tiles:
        for target in tile.objects:
            row, column = math.floor(target.row), math.floor(target.column)
            inside = target.is_target and tile.core_start <= row < tile.core_stop
            if inside and tile.usable[row, column : column + 40].sum() == 40:
                found.append((tile, target))
    return found


def test_the_brightest_spot_lies_at_the_labelled_target_and_the_darkest_behind_it(tiles: list[LabelledTile]) -> None:
    seen = looks(tiles)
    assert len(seen) > 15
    reach = 14, 24  # rows and columns, 1.7 and 1.4 m
    rows, columns, darkest = [], [], []
    for tile, target in seen:
        row, column = math.floor(target.row), math.floor(target.column)
        padded = np.pad(tile.codes.astype(np.float64), 60, constant_values=1024.0)[
            row : row + 121, column : column + 121
        ]
        smooth = uniform_filter(padded, (3, 5)) / 1024.0
        near = smooth[60 - reach[0] : 61 + reach[0], 60 - reach[1] : 61 + reach[1]]
        peak_row, peak_column = np.unravel_index(near.argmax(), near.shape)
        rows.append((peak_row - reach[0]) * tile.row_spacing_m)
        columns.append((peak_column - reach[1]) * tile.column_spacing_m)
        behind = smooth[56:65, 60:110].mean(axis=0)
        darkest.append(int(behind.argmin()) * tile.column_spacing_m)
        assert smooth[60 - 5 : 61 + 5, 60 - 8 : 61 + 8].max() > 2.5
    assert abs(float(np.median(rows))) <= 0.12
    assert abs(float(np.median(columns))) <= 0.12
    # Long targets shine at either end as well.
    assert np.mean(np.hypot(rows, columns) < 0.6) > 0.85
    assert 0.4 < float(np.median(darkest)) < 2.5


def test_the_next_tile_has_what_lies_in_the_overlap_too(tiles: list[LabelledTile]) -> None:
    for tile in tiles:
        reach = math.ceil(OVERLAP_M / tile.row_spacing_m)
        assert tile.core_start <= reach
        assert tile.codes.shape[0] - tile.core_stop <= reach
        assert not tile.usable[: tile.core_start].any()
        assert not tile.usable[tile.core_stop :].any()
        assert tile.usable.any()
        assert not (tile.usable & ~tile.valid).any()
        assert (tile.codes[~tile.valid] == 1024).all()
        assert tile.first_return_m.shape == (tile.codes.shape[0],)


def test_every_target_is_seen_and_nothing_is_made_up(tiles: list[LabelledTile]) -> None:
    kinds = {target.kind for tile in tiles for target in tile.objects}
    assert kinds == {"cylinder", "sphere", "truncated_cone", "wedge", "box", "rock", "tyre"}
    for tile in tiles:
        for target in tile.objects:
            assert target.is_target == (target.kind not in ("rock", "tyre"))
            assert target.seabed == "sand"
            assert abs(target.ground_range_m - target.column * tile.column_spacing_m) < 1.6


def test_a_set_has_the_same_bytes_whoever_renders_it(tmp_path: Path) -> None:
    spec = tmp_path / "two.yaml"
    (tmp_path / "bay.yaml").write_text(SHORT_SCENE)
    spec.write_text(SHORT_SPEC.replace("count: 1", "count: 2"))
    alone = render_set(spec, tmp_path / "alone", Farm())
    shared = render_set(spec, tmp_path / "shared", Farm(workers=2))
    assert alone == shared
    assert [shard.background for shard in alone.shards] == ["bay/600", "bay/601"]
    for shard in alone.shards:
        assert (tmp_path / "alone" / shard.file).read_bytes() == (tmp_path / "shared" / shard.file).read_bytes()
    assert alone.made_from["targets"]["per_mission"] == 3
    shards = read_manifest(tmp_path / "alone").shards
    assert [len([*read_shard(tmp_path / "alone", shard)]) for shard in shards] == [each.n_tiles for each in shards]


def augmented(folder: Path, line: SimulatedLine, **facts: Any) -> Path:
    """A folder as `auv-mcm augment` leaves it, made from a simulated log."""
    done = simulate(line.scene, folder)
    done.log.rename(folder / "line-7.xtf")
    truth = msgspec.json.decode(done.truth.read_bytes())
    write_json(done.truth, {"background": "line-7.xtf"} | truth | facts)
    return folder


def test_augmented_logs_become_tiles_of_their_background(
    tmp_path: Path, line: SimulatedLine, tiles: list[LabelledTile]
) -> None:
    packed = render_line(AugmentedLine(augmented(tmp_path / "line", line), line.config, "validate"))
    assert (packed.shard.background, packed.shard.origin, packed.shard.split) == ("line-7.xtf", "augmented", "validate")
    (tmp_path / packed.shard.file).write_bytes(packed.data)
    replayed = list(read_shard(tmp_path, packed.shard))
    # A log has its times to 10 ms and its floor is taken to be flat: a pixel or two against the simulator's own truth.
    places = {(tile.side, target.kind): target for tile in tiles for target in tile.objects if target.kind == "tyre"}
    for tile in replayed:
        for target in tile.objects:
            if (own := places.get((tile.side, target.kind))) is not None:
                assert target.column == pytest.approx(own.column, abs=4.0)
    assert sum(target.is_target for tile in replayed for target in tile.objects) > 10


def test_folders_without_an_augmented_log_are_reported(tmp_path: Path, line: SimulatedLine) -> None:
    with pytest.raises(BadInputError, match=r"truth\.json cannot be read.*auv-mcm augment"):
        render_line(AugmentedLine(tmp_path, line.config, "train"))
    (tmp_path / "truth.json").write_text('{"objects": []}')
    with pytest.raises(BadInputError, match=r"missing required field `background`"):
        render_line(AugmentedLine(tmp_path, line.config, "train"))
    (tmp_path / "truth.json").write_text('{"background": "../line.xtf", "objects": []}')
    with pytest.raises(BadInputError, match=r"background"):
        render_line(AugmentedLine(tmp_path, line.config, "train"))
    (tmp_path / "truth.json").write_text('{"background": "line.xtf", "objects": []}')
    with pytest.raises(BadInputError, match=r"line\.xtf does not exist"):
        render_line(AugmentedLine(tmp_path, line.config, "train"))


def test_one_sea_floor_in_two_splits_is_refused(tmp_path: Path, short: SimulatedLine) -> None:
    for name in ("one", "two"):
        augmented(tmp_path / name, short)
    (tmp_path / "set.yaml").write_text("augmented: [{folder: one, split: train}, {folder: two, split: test}]")
    with pytest.raises(UsageError, match=r"'line-7\.xtf' is in the set twice, for train and for test"):
        render_set(tmp_path / "set.yaml", tmp_path / "out", Farm())
    (tmp_path / "one" / "line-7.xtf").unlink()
    with pytest.raises(BadInputError, match=r"one/line-7\.xtf does not exist"):
        render_set(tmp_path / "set.yaml", tmp_path / "out", Farm())
    assert not (tmp_path / "out").exists(), "said before anything is rendered"


def test_targets_without_room_are_reported_before_any_mission_is_flown(folder: Path, tmp_path: Path) -> None:
    (folder / "full.yaml").write_text(SPEC.replace("per_mission: 14", "per_mission: 900"))
    with pytest.raises(UsageError, match=r"mission bay/600: .*no room for number"):
        render_set(folder / "full.yaml", tmp_path / "out", Farm())
    assert not (tmp_path / "out").exists()


def test_a_set_is_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bay.yaml").write_text(SHORT_SCENE)
    (tmp_path / "set.yaml").write_text(SHORT_SPEC)
    words = tile_set_words(render_set(tmp_path / "set.yaml", tmp_path / "out", Farm()))
    assert words.startswith("train: 1 missions, ")
    assert "looks at targets (sand " in words
    assert "1 of 1 missions rendered" in capsys.readouterr().err
