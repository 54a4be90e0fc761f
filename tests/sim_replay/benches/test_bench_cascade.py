"""The bench of cascades on small tiles: it measures what it says, and finds what others find."""

from __future__ import annotations

import numpy as np
import pytest

from sim_replay.benches.cascade import (
    against_opencv,
    contrast_rows,
    drawn_model,
    drawn_tiles,
    tile_rows,
    visited_by_opencv,
)

SHAPE = (96, 400)


def test_tiles_go_from_little_to_see_to_nothing_rejected() -> None:
    quiet, rippled, busy, adversarial = tile_rows(drawn_model("soft"), SHAPE, 1)
    assert quiet.result.n_evaluations < min(rippled.result.n_evaluations, busy.result.n_evaluations)
    assert all(row.same for row in (quiet, rippled, busy, adversarial))
    assert adversarial.budget is not None
    assert 0.9 * adversarial.budget < adversarial.result.n_evaluations <= adversarial.budget


def test_contrasts_are_the_same_where_they_matter() -> None:
    rows = contrast_rows(SHAPE, 1)
    assert [row.name for row in rows] == list(drawn_tiles(SHAPE))
    assert all(row.same and row.n_peaks > 0 for row in rows)


@pytest.mark.parametrize("name", ["quiet", "busy"])
def test_opencv_finds_the_same_windows(name: str) -> None:
    row = against_opencv(drawn_model("stages"), drawn_tiles(SHAPE)[name], 1)
    assert row.n_different == 0
    assert row.n_visited > 1000
    assert name == "quiet" or row.n_found > 0


def test_opencv_skips_a_place_after_each_that_its_first_stage_rejects() -> None:
    begun = np.zeros((3, 12), dtype=np.bool_)
    begun[0, 4] = True
    visited = visited_by_opencv(begun)
    assert np.flatnonzero(visited[0]).tolist() == [0, 4, 6, 10]
    assert np.flatnonzero(visited[2]).tolist() == [0, 4, 8]
    assert not visited[1].any()
