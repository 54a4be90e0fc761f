from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.detect.cascade.codes import make_plane
from auv_mcm.detect.cascade.model import CascadeModel, encode_model, parse_model
from auv_mcm.detect.cascade.run import run_plane
from auv_mcm.errors import UsageError
from sim_replay.fitting.cascade.bootstrap import well_apart
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.trainer import train
from tests.sim_replay.fitting.cascade.training_tiles import drawn_tile, write_drawn_set


def _train(folder: Path, workers: int = 1) -> tuple[CascadeModel, list[str]]:
    lines: list[str] = []
    return train(folder, Farm(workers), lines.append, n_stumps=10), lines


def _found(model: CascadeModel, seed: int) -> tuple[int, int]:
    """Targets found in a tile never seen, and false alarms."""
    tile = drawn_tile(seed)
    plane = make_plane(
        tile.codes, tile.valid, tile.usable, tile.first_return_m, tile.row_spacing_m, tile.column_spacing_m
    )
    result = run_plane(plane, model, None)
    best = well_apart(tile, result, 1000)
    rows, columns = result.rows[best], result.columns[best]
    on_target = np.zeros(best.size, dtype=np.bool_)
    n_found = 0
    for tile_object in tile.objects:
        near = (np.abs(rows + 0.5 - tile_object.row) * tile.row_spacing_m < 1.5) & (
            np.abs(columns + 0.5 - tile_object.column) * tile.column_spacing_m < 1.5
        )
        if tile_object.is_target:
            n_found += bool(near.any())
            on_target |= near
    return n_found, int((~on_target).sum())


def test_a_cascade_learns_targets_with_shadows_from_rocks_without(tmp_path: Path) -> None:
    manifest = write_drawn_set(tmp_path)
    model, lines = _train(tmp_path)
    assert model.training_sha256 == manifest.sha256
    assert parse_model(encode_model(model), "made here") == model
    assert sum(cell.n_targets for cell in model.expected_pd) == 12
    assert min(cell.pd for cell in model.expected_pd) > 0.8
    assert lines
    found, alarms = np.sum([_found(model, seed) for seed in range(7000, 7006)], axis=0).tolist()
    assert found >= 16
    assert alarms <= 2


def test_same_tiles_give_the_same_model_on_any_number_of_workers(tmp_path: Path) -> None:
    write_drawn_set(tmp_path, 3, 1, 1)
    assert encode_model(_train(tmp_path)[0]) == encode_model(_train(tmp_path, workers=2)[0])


def test_a_set_without_targets_to_validate_on_is_refused(tmp_path: Path) -> None:
    write_drawn_set(tmp_path, 2, 0)
    with pytest.raises(UsageError, match="no targets among the 'validate' tiles"):
        _train(tmp_path)
