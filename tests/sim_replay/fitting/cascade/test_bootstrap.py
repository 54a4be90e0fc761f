from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pytest

from auv_mcm.detect.cascade.codes import CodePlane, make_plane
from auv_mcm.detect.cascade.model import CascadeModel
from auv_mcm.detect.cascade.run import run_plane, trace_plane
from sim_replay.fitting.cascade.boost import BoostedStump
from sim_replay.fitting.cascade.bootstrap import CLEAR_M, Errand, clear_of_targets, glean, target_bags
from sim_replay.fitting.cascade.pool import feature_pool, model_stump, pool_box_means
from sim_replay.fitting.cascade.store import pack, write_set
from sim_replay.fitting.cascade.tiles import LabelledTile
from tests.make.models import model_with
from tests.sim_replay.fitting.cascade.training_tiles import (
    COLUMN_M,
    CORE,
    ROW_M,
    drawn_tile,
    labelled_tile,
    tile_object,
)

POOL = feature_pool()


def _plane(tile: LabelledTile) -> CodePlane:
    return make_plane(
        tile.codes, tile.valid, tile.usable, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m
    )


def _model(reject: int = 0, kind: Literal["soft", "stages"] = "soft") -> CascadeModel:
    """Stumps about as likely to hold as not, in groups of three."""
    chosen = range(5, len(POOL.features), 700)
    edges = np.array([[1.0 if feature.is_ratio else 0.0] for feature in POOL.features], dtype=np.float32)
    stumps = [
        model_stump(POOL, edges, BoostedStump(feature, 0, -100 - k, 100 + 7 * k)) for k, feature in enumerate(chosen)
    ]
    return model_with((tuple(stumps[:3]), tuple(stumps[3:6]), tuple(stumps[6:])), reject, kind=kind)


def test_a_target_s_bag_holds_the_usable_windows_within_half_a_metre() -> None:
    near_border, inside, in_overlap = (
        tile_object(CORE.start + 1.5, 200.2),
        tile_object(40.9, 100.0),
        tile_object(CORE.start - 0.1, 300.0),
    )
    tile = labelled_tile((near_border, tile_object(30.0, 250.0, is_target=False), inside, in_overlap))
    bags = target_bags(tile, _plane(tile))
    assert bags.targets == (near_border, inside)
    for number, target in enumerate(bags.targets):
        expected = [
            (row, column)
            for row in range(CORE.start, CORE.stop)
            for column in range(360)
            if abs(row + 0.5 - target.row) * ROW_M < 0.5 and abs(column + 0.5 - target.column) * COLUMN_M < 0.5
        ]
        chosen = bags.bag == number
        assert list(zip(bags.rows[chosen].tolist(), bags.columns[chosen].tolist(), strict=True)) == expected


def test_a_target_where_nothing_may_be_detected_has_no_bag() -> None:
    tile = labelled_tile((tile_object(40.0, 5.0),))
    assert target_bags(tile, _plane(tile)).targets == ()


def test_windows_of_rocks_count_as_others_and_those_near_targets_do_not() -> None:
    target, rock = tile_object(4.0, 100.0), tile_object(30.0, 300.0, is_target=False)
    clear = clear_of_targets(labelled_tile((target, rock)))
    assert clear[30, 300]
    for row, column in ((12, 100), (28, 100), (29, 100), (12, 149), (12, 150)):
        far = abs(row + 0.5 - 4.0) * ROW_M >= CLEAR_M or abs(column + 0.5 - 100.0) * COLUMN_M >= CLEAR_M
        assert clear[row, column] == far


@pytest.mark.parametrize("kind", ["soft", "stages"])
def test_trace_is_what_the_cascade_scores(kind: Literal["soft", "stages"]) -> None:
    plane = _plane(drawn_tile(3))
    everything = _model(-(10**6), kind)
    ran = run_plane(plane, everything, None)
    some = np.random.Generator(np.random.PCG64(1)).integers(0, 900, 1500)  # neighbours, in no order, some twice
    rows, columns = ran.rows[some].astype(np.intp), ran.columns[some].astype(np.intp)
    scores = trace_plane(plane, everything, rows, columns)
    assert np.array_equal(scores[:, -1], ran.scores[some])
    for last in (1, 2):
        shorter = msgspec.structs.replace(everything, groups=everything.groups[:last], reject=everything.reject[:last])
        assert np.array_equal(scores[:, :last], trace_plane(plane, shorter, rows, columns))
    if kind == "stages":
        alone = msgspec.structs.replace(everything, groups=everything.groups[1:2], reject=everything.reject[1:2])
        assert np.array_equal(scores[:, 1], trace_plane(plane, alone, rows, columns)[:, 0])


def _gleaned_places(folder: Path, model: CascadeModel | None) -> np.ndarray:
    manifest = write_set(folder, [pack([drawn_tile(1), drawn_tile(2)], "train", "drawn/0", "simulated")], {})
    errand = Errand(folder, manifest.shards[0], POOL.boxes, model, 10, 0)
    first, again = glean(errand), glean(errand)
    for name in first._fields:
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert first.targets.shape == (len(POOL.boxes), 6)
    assert first.others.shape == (len(POOL.boxes), len(first.places))
    assert first.spacings_m.tolist() == [[ROW_M, COLUMN_M]] * 2
    clear = [clear_of_targets(drawn_tile(seed)) for seed in (1, 2)]
    assert all(clear[tile][row, column] for tile, row, column in first.places.tolist())
    return first.places


def test_others_are_any_windows_before_there_is_a_cascade_and_its_false_alarms_then(tmp_path: Path) -> None:
    assert 10 < len(_gleaned_places(tmp_path, None)) <= 20
    model = _model(reject=300)
    places = _gleaned_places(tmp_path, model)
    assert len(places)
    for number, tile in enumerate((drawn_tile(1), drawn_tile(2))):
        passed = run_plane(_plane(tile), model, None)
        at = zip(passed.rows.tolist(), passed.columns.tolist(), strict=True)
        alarms = dict(zip(at, passed.scores.tolist(), strict=True))
        taken = [(row, column) for at, row, column in places.tolist() if at == number]
        assert all(place in alarms for place in taken)
        clear = clear_of_targets(tile)
        assert alarms[taken[0]] == max(score for place, score in alarms.items() if clear[place])
    assert not len(_gleaned_places(tmp_path, _model(reject=10**6)))


def test_a_target_is_shown_by_its_brightest_window_and_then_by_its_best(tmp_path: Path) -> None:
    tile = drawn_tile(1)
    manifest = write_set(tmp_path, [pack([tile], "train", "drawn/0", "simulated")], {})
    model, plane = _model(), _plane(tile)
    bags = target_bags(tile, plane)
    means, final = (
        pool_box_means(plane, POOL.boxes, bags.rows, bags.columns),
        trace_plane(plane, model, bags.rows, bags.columns)[:, -1],
    )
    for given_model in (None, model):
        shown = glean(Errand(tmp_path, manifest.shards[0], POOL.boxes, given_model, 1, 0)).targets
        for number, target in enumerate(bags.targets):
            mine = np.flatnonzero(bags.bag == number)
            (window,) = mine[(means[:, mine] == shown[:, number : number + 1]).all(axis=0)]
            if given_model is None:
                assert abs(bags.rows[window] + 0.5 - target.row) <= 2
                assert abs(bags.columns[window] + 0.5 - target.column) <= 2
            else:
                assert final[window] == final[mine].max()
