"""Likelihoods of a million pixels, and the same answer to the last bit whenever and beside whatever else it is asked
for."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.likelihood import labels_cost
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import SHADOW, Region
from auv_mcm.confirm.snake import Start, converge
from tests.stability.region_doors import DOORS, START, cone_region, labels_of, plain, through

ASK_AGAIN = """
import sys
from tests.stability.region_doors import DOORS, cone_region, plain, through
sys.stdout.write(repr([plain(through(door, cone_region(2))) for door in sorted(DOORS)]))
"""


def tiled(n_rows: int, n_columns: int) -> Region:
    """The region again and again, side by side."""
    region = cone_region()
    return msgspec.structs.replace(
        region,
        intensity=np.tile(region.intensity, (n_rows, n_columns)),
        valid=np.tile(region.valid, (n_rows, n_columns)),
    )


def test_labels_of_very_many_pixels_are_those_of_few(n_runs: Callable[[int, int], int]) -> None:
    n = n_runs(17, 3)  # with C, 17 x 17 of 40 x 90 pixels are a million
    n_shadow = int((segment(cone_region()).labels == SHADOW).sum())
    large = tiled(n, n)
    with np.errstate(all="raise", under="ignore"):
        answer = segment(large)
    assert np.isfinite([answer.energy, answer.lower_bound]).all()
    assert answer.lower_bound <= answer.energy
    assert int((answer.labels == SHADOW).sum()) == pytest.approx(n * n * n_shadow, rel=0.3)
    assert answer.labels.shape == large.intensity.shape


def test_contours_among_very_many_pixels_are_those_among_few() -> None:
    with np.errstate(all="raise", under="ignore"):
        few, many = converge(cone_region(), START), converge(tiled(17, 17), Start(*(nodes.copy() for nodes in START)))
    assert np.isfinite(many.criterion)
    assert many.length_m == pytest.approx(few.length_m, abs=0.3)
    assert many.height_m == pytest.approx(few.height_m, rel=0.3)


def test_what_labels_explain_of_very_many_pixels_adds_up() -> None:
    labels = labels_of(cone_region())
    one, all_of_them = (
        labels_cost(cone_region(), labels, 1.5),
        labels_cost(tiled(17, 17), np.tile(labels, (17, 17)), 1.5),
    )
    assert all_of_them == pytest.approx(17 * 17 * one, rel=1e-9)


@pytest.mark.parametrize("door", DOORS)
def test_the_same_again_and_on_two_threads_at_once(door: str, n_runs: Callable[[int, int], int]) -> None:
    regions = [cone_region(seed) for seed in range(n_runs(4, 2))]
    once = [plain(through(door, region)) for region in regions]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda region: plain(through(door, region)), regions)) == once


def test_the_same_in_another_process_whatever_its_hashes_and_threads() -> None:
    here = repr([plain(through(door, cone_region(2))) for door in sorted(DOORS)])
    environment = {**os.environ, "PYTHONHASHSEED": "7", "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    environment["PYTHONPATH"] = str(Path(__file__).resolve().parents[2])
    there = subprocess.run(
        [sys.executable, "-c", ASK_AGAIN], env=environment, capture_output=True, text=True, check=True
    )
    assert there.stdout == here
