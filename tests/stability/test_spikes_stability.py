"""One pixel as bright as numbers go: it may be a highlight, but it makes no class's mean and moves no border."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.classify.fit import Effort, fit_shapes
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import converge
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.kernels.trws import energy_of, trws
from sim_replay.scoring.overlap import overlap
from tests.stability.region_doors import DOORS, START, cone_region, through

FLOORS = [1.0, 1e-300, 1e-310]


def with_spike(region: Region, level: float) -> Region:
    intensity = region.intensity.copy()
    intensity[34, 80] = level
    return msgspec.structs.replace(region, intensity=intensity)


def at_gain(region: Region, gain: float) -> Region:
    return msgspec.structs.replace(region, intensity=region.intensity * gain)


@pytest.mark.parametrize("spike", [1e2, 1e4, 1e6, 1e12, 1e300])
@pytest.mark.parametrize("seed", range(2))
def test_a_spike_over_the_floor_relabels_next_to_nothing(seed: int, spike: float) -> None:
    region = cone_region(seed)
    plain, spiked = segment(region), segment(with_spike(region, spike))
    assert (plain.labels != spiked.labels).mean() < 0.012
    assert spiked.background_mean == pytest.approx(plain.background_mean, rel=0.05)
    assert spiked.shadow_mean == pytest.approx(plain.shadow_mean, rel=0.1)


@pytest.mark.parametrize("spike", [1e3, 1e6, 1e300])
def test_a_spike_moves_no_contour(spike: float) -> None:
    region = cone_region(1)
    plain, spiked = converge(region, START), converge(with_spike(region, spike), START)
    shape = region.intensity.shape
    assert overlap(contour_mask(plain.shadow, shape), contour_mask(spiked.shadow, shape)) > 0.9
    assert spiked.rejected == plain.rejected


@pytest.mark.parametrize("spike", [1e3, 1e6, 1e300])
def test_a_spike_makes_no_other_solid(spike: float) -> None:
    region, effort = cone_region(1), Effort(160, 4, 8, 6, 2, 8, 6)
    plain, spiked = (fit_shapes(one, None, 1.5, effort=effort).fits[0] for one in (region, with_spike(region, spike)))
    assert spiked.solid == plain.solid
    assert spiked.best.cost == pytest.approx(plain.best.cost, abs=5.0)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("floor", FLOORS)
def test_no_quotient_of_spike_and_floor_overflows(door: str, floor: float) -> None:
    through(door, with_spike(at_gain(cone_region(), floor), 1e300))


@pytest.mark.parametrize("door", DOORS)
def test_echoes_over_the_whole_range_of_numbers_are_answered(door: str) -> None:
    region = cone_region()
    random = np.random.Generator(np.random.PCG64(5))
    through(
        door, msgspec.structs.replace(region, intensity=np.exp(random.uniform(-740.0, 709.0, region.intensity.shape)))
    )


@pytest.mark.parametrize("scale", [1e4, 1e12, 1e200])
def test_unary_costs_of_any_size_keep_bound_and_energy_in_order(scale: float) -> None:
    random = np.random.Generator(np.random.PCG64(6))
    unary: NDArray[np.float64] = scale * random.random((9, 11, 3))
    weight = np.array([1.0, 0.7, 1.0, 0.7])
    with np.errstate(all="raise", under="ignore"):
        minimum = trws(unary, weight, 8)
    assert minimum.energy == pytest.approx(energy_of(minimum.labels, unary, weight), rel=1e-12)
    assert minimum.lower_bound <= minimum.energy * (1.0 + 1e-12)
    np.testing.assert_array_equal(minimum.labels, unary.argmin(axis=2))
