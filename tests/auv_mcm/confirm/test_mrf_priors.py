"""Priors of the label field against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.confirm.mrf_priors import pair_prior, without_odd_clusters
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.kernels import pair_costs as pairs

ROW_OVER_COLUMN = 1.5  # of their spacings


def region_of(shape: tuple[int, int], spacing_m: float, squint_rad: float = 0.0, altitude_m: float = 6.0) -> Region:
    return Region(
        intensity=np.ones(shape),
        valid=np.ones(shape, dtype=np.bool_),
        row_spacing_m=ROW_OVER_COLUMN * spacing_m,
        column_spacing_m=spacing_m,
        first_ground_range_m=8.0,
        altitude_m=altitude_m,
        row=0.0,
        column=0.0,
        beam_width_rad=0.0,
        squint_rad=squint_rad,
    )


def costs_by_loops(
    labels: NDArray[np.uint8], spacing_m: float, squint_rad: float, altitude_m: float
) -> NDArray[np.float64]:
    """A highlight costs 2 nats less what 0.3 x 0.3 m of shadow within 1.5 m behind takes off; a shadow 0.5 less what
    0.02 m2 of highlight before it, no further than a 1.2 m object's shadow and a metre reach, take off; one row to
    either side of the line.
    """
    (n_rows, n_columns), cell_m2 = labels.shape, ROW_OVER_COLUMN * spacing_m**2
    cost = np.zeros((3, n_rows, n_columns))

    def seen(row: int, column: int, away: int, label: int) -> int:
        if not 0 <= column + away < n_columns:
            return 0
        slope = math.tan(squint_rad) / ROW_OVER_COLUMN
        moved = round(slope * (column + away)) - round(slope * column)
        return sum(
            0 <= row + moved + side < n_rows and labels[row + moved + side, column + away] == label
            for side in (-1, 0, 1)
        )

    for row, column in np.ndindex(n_rows, n_columns):
        range_m = 8.0 + (column + 0.5) * spacing_m
        reach = int((1.2 * range_m / max(altitude_m - 1.2, 0.12) + 1.0) / spacing_m)
        n_shadow = sum(seen(row, column, away, SHADOW) for away in range(1, round(1.5 / spacing_m) + 1))
        n_highlight = sum(seen(row, column, -away, HIGHLIGHT) for away in range(1, min(reach, n_columns) + 1))
        cost[HIGHLIGHT, row, column] = 2.0 * (1.0 - min(1.0, n_shadow * cell_m2 / 0.09))
        cost[SHADOW, row, column] = 0.5 * (1.0 - min(1.0, n_highlight * cell_m2 / 0.02))
    return cost


@pytest.mark.parametrize("squint_rad", [0.0, 0.3, -0.45])
@pytest.mark.parametrize(("spacing_m", "altitude_m"), [(0.1, 6.0), (0.1, 1.0), (0.4, 20.0)])
def test_priors_count_along_the_line_of_sight(squint_rad: float, spacing_m: float, altitude_m: float) -> None:
    random = np.random.Generator(np.random.PCG64(1))
    labels = random.choice(3, (11, 34), p=(0.96, 0.02, 0.02)).astype(np.uint8)
    expected = costs_by_loops(labels, spacing_m, squint_rad, altitude_m)
    region = region_of(labels.shape, spacing_m, squint_rad, altitude_m)
    np.testing.assert_allclose(pair_prior(region, (1, 1), labels.shape[1]).costs(labels), expected)


def test_only_clusters_of_a_mines_size_stay_highlight() -> None:
    labels = np.full((60, 60), BACKGROUND, dtype=np.uint8)
    labels[5, 5] = HIGHLIGHT  # 0.01 m2
    labels[10:14, 10:14] = HIGHLIGHT  # 0.16 m2
    labels[20:22, 10:50] = HIGHLIGHT  # 4 m long
    labels[30:55, 30:55] = HIGHLIGHT  # 6 m2
    labels[40:50, 5:25] = SHADOW
    kept = without_odd_clusters(labels, 0.1, 0.1)
    assert set(zip(*np.nonzero(kept == HIGHLIGHT), strict=True)) == {
        (r, c) for r in range(10, 14) for c in range(10, 14)
    }
    assert ((kept == SHADOW) == (labels == SHADOW)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 12), (9, 1), (17, 30)])
def test_c_weighs_pairs_as_numpy_does_to_the_last_bit(shape: tuple[int, int]) -> None:
    random = np.random.Generator(np.random.PCG64(5))
    labels = random.choice(3, shape, p=(0.8, 0.1, 0.1)).astype(np.uint8)
    reach = random.integers(0, shape[1] + 3, shape[1])
    given = labels, reach, 4, pairs.Lack(2.0, 0.13), pairs.Lack(0.5, 0.4)
    np.testing.assert_array_equal(pairs.pair_costs(*given), pairs.pair_costs_numpy(*given))
