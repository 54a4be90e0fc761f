from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.cascade.model import CascadeModel, check_model
from sim_replay.fitting.cascade.boost import BoostedStump
from sim_replay.fitting.cascade.bootstrap import clear_of_targets
from sim_replay.fitting.cascade.pool import Feature, Pool, model_stump
from sim_replay.fitting.cascade.pool import feature_pool as whole_pool
from sim_replay.fitting.cascade.store import pack, write_set
from sim_replay.fitting.cascade.validation import (
    Inspection,
    ValidationSighting,
    calibrate,
    expected_pd,
    passed,
    sightings,
)
from tests.make.models import model_with
from tests.sim_replay.fitting.cascade.training_tiles import drawn_tile

POOL = whole_pool()


def _bright(times: float, reject: int = 0) -> CascadeModel:
    """Passes windows whose middle is so many times as bright as all of the window."""
    middle = min(
        range(1, len(POOL.boxes)), key=lambda k: abs(POOL.boxes[k].top_m + 0.18) + abs(POOL.boxes[k].near_m + 0.18)
    )
    pool = Pool(POOL.boxes, (Feature(True, middle, 0),))
    stump = model_stump(pool, np.array([[times]], dtype=np.float32), BoostedStump(0, 0, -10, 10))
    return model_with(((stump,),), reject)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(-40, 40), st.booleans()), min_size=1, max_size=60))
def test_calibration_is_isotonic_regression_at_its_knots(samples: list[tuple[int, bool]]) -> None:
    score = np.array([s for s, _ in samples], dtype=np.int32)
    is_target = np.array([t for _, t in samples])
    found = calibrate(score, is_target)
    check_model(msgspec.structs.replace(_bright(2.0), calibration=found), "made here")
    levels = _slow_isotonic(score, is_target)
    pools = sorted({level: (score[levels == level], is_target[levels == level]) for level in levels.tolist()}.items())
    odds = [np.log((t.sum() + 0.5) / (len(t) - t.sum() + 0.5)) for _, (_, t) in pools]
    expected = dict(zip((round(float(s.mean())) for _, (s, _) in pools), np.maximum.accumulate(odds), strict=True))
    for at, value in expected.items():
        assert found.log_odds[found.score.index(at)] == pytest.approx(value, abs=1e-4)


def _slow_isotonic(score: np.ndarray, is_target: np.ndarray) -> np.ndarray:
    """Least squares by the min-max formula: the largest of all smallest means of stretches around a score."""
    values = sorted(set(score.tolist()))
    level = {}
    for at in values:
        starts = [v for v in values if v <= at]
        stops = [v for v in values if v >= at]
        level[at] = max(min(is_target[(score >= a) & (score <= b)].mean() for b in stops) for a in starts)
    return np.array([level[s] for s in score.tolist()])


def test_expected_detection_counts_the_targets_of_each_sea_floor_and_range() -> None:
    def seen(seabed: str, ground_range_m: float, score: int) -> ValidationSighting:
        return ValidationSighting(seabed, ground_range_m, np.array([score], dtype=np.int32))

    model = _bright(2.0)
    reported = expected_pd(
        model,
        [
            seen("mud", 5.0, 1),
            seen("mud", 9.9, -1),
            seen("mud", 10.0, 0),
            seen("sand", 999.0, 4),
            seen("rock", 61.0, -3),
        ],
    )
    assert [(cell.seabed, cell.near_m, cell.far_m, cell.n_targets, cell.pd) for cell in reported] == [
        ("mud", 0.0, 10.0, 2, 0.5),
        ("mud", 10.0, 20.0, 1, 1.0),
        ("rock", 60.0, 80.0, 1, 0.0),
    ]
    assert expected_pd(model, []) == ()


def test_every_target_is_seen_at_its_best_window_and_what_passes_is_counted(tmp_path: Path) -> None:
    tiles = [drawn_tile(1), drawn_tile(2)]
    manifest = write_set(tmp_path, [pack(tiles, "validate", "drawn/0", "simulated")], {})
    model = _bright(2.0)
    inspection = Inspection(tmp_path, manifest.shards[0], model)
    seen = sightings(inspection)
    assert [sighting.trace.tolist() for sighting in seen] == [[10]] * 6
    let_through = passed(inspection)
    assert let_through.n_windows <= sum(int(clear_of_targets(tile).sum()) for tile in tiles)
    assert let_through.area_m2 == pytest.approx(sum(int(clear_of_targets(tile).sum()) for tile in tiles) * 0.12 * 0.06)
    # Every target, and every rock that is clear of targets, is one detection.
    assert let_through.is_target.sum() == 6
    rocks = [(tile, tile_object) for tile in tiles for tile_object in tile.objects if not tile_object.is_target]
    n_clear = sum(bool(clear_of_targets(tile)[int(rock.row), int(rock.column)]) for tile, rock in rocks)
    assert (~let_through.is_target).sum() >= n_clear
    assert (let_through.windows == 10).all()
    nothing = passed(Inspection(tmp_path, manifest.shards[0], _bright(2.0, reject=11)))
    assert not nothing.detections.size
    assert not nothing.windows.size
