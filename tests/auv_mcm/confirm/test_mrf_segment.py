"""Regions drawn with known labels, segmented by the field and by the source paper's variant of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import msgspec
import numpy as np
import pytest

from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW
from sim_replay.scoring.overlap import overlap
from tests.make.drawn_regions import Drawing, aperture_drawings, draw_region


def side_scan(n: int) -> Iterator[Drawing]:
    """Objects of 1 to 2 m with shadows of 0.9 to 3 m on pings 12 cm apart, range cells of 6 cm."""
    random = np.random.Generator(np.random.PCG64(6))
    for seed in range(n):
        yield Drawing(
            n_rows=64,
            n_columns=128,
            row_spacing_m=0.12,
            column_spacing_m=0.06,
            object_rows=int(random.integers(8, 17)),
            shadow_columns=int(random.integers(15, 50)),
            highlight_columns=6,
            spread_rows=0.3,
            spread_columns=1.0,
            seed=seed,
        )


def medians(drawings: Iterator[Drawing]) -> tuple[float, float]:
    """Of the overlap with the true shadow and the true highlight."""
    overlaps = []
    for drawing in drawings:
        region, truth = draw_region(drawing)
        labels = segment(region).labels
        overlaps.append([overlap(labels == label, truth == label) for label in (SHADOW, HIGHLIGHT)])
    shadow, highlight = np.median(overlaps, axis=0)
    return float(shadow), float(highlight)


def test_shadow_at_9_db_in_correlated_single_look_speckle_is_found_whole(n_runs: Callable[[int, int], int]) -> None:
    drawings = [drawing for spread in (0.8, 1.1, 1.4) for drawing in aperture_drawings(n_runs(10, 3), spread, seed=5)]
    shadow, highlight = medians(iter(drawings))
    assert shadow >= 0.93
    assert highlight >= 0.7


def test_shadow_in_side_scan_of_coarse_pings_is_found_whole(n_runs: Callable[[int, int], int]) -> None:
    shadow, highlight = medians(side_scan(n_runs(12, 5)))
    assert shadow >= 0.93
    assert highlight >= 0.75


def test_spiky_sea_floor_makes_no_objects(n_runs: Callable[[int, int], int]) -> None:
    drawings = aperture_drawings(n_runs(8, 3), 0.0, seed=5)
    shadow, highlight = medians(msgspec.structs.replace(drawing, texture_nu=1.5) for drawing in drawings)
    assert shadow >= 0.96
    assert highlight >= 0.9
    region, _ = draw_region(Drawing(texture_nu=1.5, spread_rows=0.0, spread_columns=0.0, seed=1))
    assert segment(region).law.nu == pytest.approx(1.5, rel=0.3)


def test_energy_is_within_its_gap_of_the_bound_and_more_sweeps_close_it() -> None:
    region, _ = draw_region(Drawing(seed=3, shadow_level=0.25))
    few, many = segment(region, n_sweeps=1), segment(region, n_sweeps=40)
    for result in (few, many):
        assert result.lower_bound <= result.energy + 1e-9
        assert result.gap == pytest.approx(result.energy - result.lower_bound)
    assert many.gap < few.gap
    assert many.gap < 0.01 * many.energy


def test_parameters_found_are_those_drawn() -> None:
    drawing = Drawing(object_rows=50, shadow_columns=60, highlight_columns=12, n_rows=160, seed=4)
    result = segment(draw_region(drawing)[0])
    assert result.flags == ()
    assert result.factors == (3, 3)
    assert result.correlation.rows == pytest.approx(math.sqrt(2.0 * math.pi) * 1.2, rel=0.12)
    assert result.background_mean == pytest.approx(1.0, rel=0.1)
    assert result.shadow_mean == pytest.approx(drawing.shadow_level, rel=0.15)
    assert result.highlight_mean == pytest.approx(drawing.highlight_level, rel=0.3)


def test_bare_sea_floor_is_background_and_says_so() -> None:
    region, _ = draw_region(Drawing(object_rows=0, seed=7))
    result = segment(region)
    assert not result.labels.any()
    assert set(result.flags) == {"no_shadow", "no_highlight"}


def test_shadow_alone_is_found_without_highlight() -> None:
    region, truth = draw_region(Drawing(highlight_columns=0, seed=8))
    result = segment(region)
    assert overlap(result.labels == SHADOW, truth == SHADOW) > 0.85
    assert "no_highlight" in result.flags


def test_a_few_lost_pings_are_bridged() -> None:
    region, truth = draw_region(Drawing(object_rows=40, seed=9))
    valid = region.valid.copy()
    valid[[60, 61, 71]] = False
    lost = msgspec.structs.replace(region, valid=valid, intensity=np.where(valid, region.intensity, np.nan))
    labels = segment(lost).labels
    assert overlap(labels == SHADOW, truth == SHADOW) > 0.85
    assert (labels[[60, 61, 71]] == SHADOW).sum() > 0.8 * (truth[[60, 61, 71]] == SHADOW).sum()


def test_smoothness_can_be_given() -> None:
    region, _ = draw_region(Drawing(seed=10, object_rows=36, shadow_columns=60))
    assert segment(region, smoothness=0.8).smoothness == 0.8


def test_planes_that_do_not_fit_are_refused() -> None:
    region, _ = draw_region(Drawing())
    with pytest.raises(ValueError, match="planes of one shape"):
        segment(msgspec.structs.replace(region, valid=region.valid[:5]))
    with pytest.raises(ValueError, match="n_sweeps"):
        segment(region, n_sweeps=0)
