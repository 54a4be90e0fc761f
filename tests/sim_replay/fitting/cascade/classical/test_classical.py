"""The classical classifier from labelled tiles to detections."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import LOW_RESOLUTION, VALID
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.classical.classical_candidates import Candidates, find_candidates, label, unlabelled
from sim_replay.fitting.cascade.classical.classical_model import (
    ClassicalModel,
    format_model,
    parse_classical_model,
    score_windows,
)
from sim_replay.fitting.cascade.classical.detect_classical import detect_classical
from sim_replay.fitting.cascade.classical.extractors import FAMILIES
from sim_replay.fitting.cascade.classical.train_classical import (
    ChipSamples,
    collect,
    fit_classical_model,
    of_kinds,
    train_classical,
)
from tests.sim_replay.fitting.cascade.classical.chip_samples import tile_with

CONFIG = Config()
KINDS = ("cylinder", "rock", "wedge", "rock")
TILES = tuple(tile_with(KINDS, seed, f"made up/{seed}") for seed in range(6))
UNSEEN = tile_with(KINDS, 90, "made up/90")


@pytest.fixture(scope="module")
def samples() -> ChipSamples:
    return collect(TILES, CONFIG)


@pytest.fixture(scope="module")
def model(samples: ChipSamples) -> ClassicalModel:
    return fit_classical_model(samples)


def _at(*objects: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.int32]], np.ndarray[tuple[int], np.dtype[np.int32]]]:
    chosen = [UNSEEN.objects[index] for index in objects]
    return np.array([math.floor(o.row) for o in chosen], dtype=np.int32), np.array(
        [math.floor(o.column) for o in chosen], dtype=np.int32
    )


def test_mines_never_seen_are_likely_and_rocks_without_shadow_are_not(model: ClassicalModel) -> None:
    mines, rocks = score_windows(model, UNSEEN, *_at(0, 2)), score_windows(model, UNSEEN, *_at(1, 3))
    assert mines.min() > 0.0 > rocks.max()


@pytest.mark.parametrize("family", FAMILIES)
def test_each_family_alone_separates_mines_from_rocks(samples: ChipSamples, family: str) -> None:
    alone = fit_classical_model(samples, [name for name in FAMILIES if name == family])
    assert score_windows(alone, UNSEEN, *_at(0, 2)).min() > score_windows(alone, UNSEEN, *_at(1, 3)).max()


def test_the_same_tiles_give_the_same_model_which_comes_back_from_its_file(model: ClassicalModel) -> None:
    data = format_model(model)
    assert format_model(train_classical(TILES, CONFIG)) == data
    assert parse_classical_model(data, "model.json") == model


def test_kinds_that_were_not_asked_for_teach_nothing(samples: ChipSamples) -> None:
    wedges = of_kinds(samples, {"wedge"})
    assert set(wedges.kind) == {"", "wedge"}
    assert (
        len(wedges.contrast)
        == len(wedges.background)
        == len(wedges.weight)
        == len(samples.kind) - samples.kind.count("cylinder")
    )
    assert set(fit_classical_model(wedges).templates) == {"wedge", "other"}
    one_tile = train_classical(TILES[:1], CONFIG, families=["central"], kinds={"wedge"})
    assert one_tile.trained_on.startswith("1 targets (1 wedge)")


def test_backgrounds_of_samples_are_those_of_their_tiles(samples: ChipSamples) -> None:
    assert set(samples.background) == {f"made up/{seed}" for seed in range(6)}


@pytest.mark.parametrize(("tiles", "words"), [((), "no tiles"), ((tile_with(("rock",), 1),), "targets")])
def test_nothing_to_learn_from_is_refused(tiles: tuple[()], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        train_classical(tiles, CONFIG)


def test_the_candidate_nearest_to_a_target_stands_for_it_and_those_around_it_for_nothing() -> None:
    row, column = _at(0)
    around = Candidates(
        np.array([row[0], row[0] + 3, row[0], row[0] + 60], dtype=np.int32),
        np.array([column[0]] * 2 + [column[0] + 40] + [300], dtype=np.int32),
    )
    found = label(UNSEEN, around)
    assert found.object_index.tolist() == [0, -1, -1, -1]
    assert found.is_other.tolist()[:3] == [False, False, False]


def test_targets_of_the_overlap_are_left_to_the_tile_they_belong_to() -> None:
    moved = msgspec.structs.replace(UNSEEN, core_start=60)
    assert 0 not in label(moved, Candidates(*_at(0, 2))).object_index


def test_candidates_find_all_objects_in_the_core() -> None:
    found = find_candidates(UNSEEN, CONFIG)
    for tile_object in UNSEEN.objects:
        away_m = np.hypot(
            (found.rows + 0.5 - tile_object.row) * 0.12, (found.columns + 0.5 - tile_object.column) * 0.06
        )
        assert away_m.min() < 0.5


def test_a_labelled_tile_keeps_what_the_detector_may_report() -> None:
    plain = unlabelled(UNSEEN)
    core = slice(UNSEEN.core_start, UNSEEN.core_stop)
    assert np.array_equal(((plain.mask & (VALID | LOW_RESOLUTION)) == VALID)[core], UNSEEN.usable[core])
    assert plain.intensity.dtype == np.float32


def test_windows_mostly_unknown_have_no_odds_and_none_asked_for_gives_none(model: ClassicalModel) -> None:
    corner = np.array([0], dtype=np.int32)
    assert score_windows(model, UNSEEN, corner, corner).tolist() == [-math.inf]
    assert score_windows(model, UNSEEN, corner[:0], corner[:0]).shape == (0,)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format_version": 2}, "format_version"),
        ({"families": []}, "families"),
        ({"families": ["central", "central"]}, "more than once"),
        ({"families": ["central"]}, "templates are needed"),
        ({"slopes": {}}, "slopes do not fit"),
        ({"offset": None}, "offset"),
        ({"templates": {"mine": [[0.0]]}}, "templates"),
        ({"unheard_of": 1}, "unheard_of"),
    ],
)
def test_a_model_file_that_makes_no_sense_is_refused_by_name(
    model: ClassicalModel, change: dict[str, object], words: str
) -> None:
    data = msgspec.json.encode(msgspec.to_builtins(model) | change)
    with pytest.raises(BadInputError, match=words) as refused:
        parse_classical_model(data, "model.json")
    assert str(refused.value).startswith("model.json: ")


def test_a_model_file_that_is_no_json_is_refused() -> None:
    with pytest.raises(BadInputError, match="Train the model anew"):
        parse_classical_model(b"\xff{", "model.json")


def test_detections_come_with_the_odds_of_their_windows_best_first(model: ClassicalModel) -> None:
    tile = msgspec.structs.replace(unlabelled(UNSEEN), first_row=1000)
    found, before = detect_classical(tile, CONFIG, model), detect_tile(tile, CONFIG)
    places = np.array([(d.row - 1000, d.column) for d in found.detections])
    odds = score_windows(model, UNSEEN, *np.floor(places).astype(np.int32).T)
    assert [d.score for d in found.detections] == pytest.approx(odds.tolist(), abs=1e-9)
    assert [d.p_mine for d in found.detections] == pytest.approx((1.0 / (1.0 + np.exp(-odds))).tolist(), abs=1e-12)
    assert sorted((d.score for d in found.detections), reverse=True) == [d.score for d in found.detections]
    assert len(found.detections) + found.n_without_position == len(before.detections) + before.n_without_position


def test_a_tile_without_anything_to_see_has_no_detections(model: ClassicalModel) -> None:
    masked = msgspec.structs.replace(unlabelled(UNSEEN), mask=np.zeros(UNSEEN.codes.shape, dtype=np.uint8))
    assert detect_classical(masked, CONFIG, model).detections == ()
