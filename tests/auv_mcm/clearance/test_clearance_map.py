"""The map of clearance against adding up looks one cell at a time."""

from __future__ import annotations

import math
import tracemalloc
from collections import defaultdict
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clearance.area import area_state, middles_m, over_area
from auv_mcm.clearance.clearance_map import HIGHEST_P, Clearance, ClearanceMap, look_bit
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.contacts.seen_area import SeenArea
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SEABED_TYPES, CoveragePatch, SeabedType, Side
from tests.make.records import cells_of, patch_of


class Model(NamedTuple):
    """A view finds near objects with a probability that depends on range."""

    same_look_correlation: float = 0.8
    other_look_correlation: float = 0.1

    def p_look(self, view: CellView) -> NDArray[np.float64]:
        return np.asarray(1.0 - np.asarray(view.ground_range_m, dtype=np.float64) / 50.0)


class Reported(NamedTuple):
    """One patch, as a test draws it."""

    start_s: float
    side: Side
    look_deg: float
    places: list[tuple[int, int, float, float]]  # east, north, fraction, ground range


def patch(
    reported: Reported,
    *,
    seabed: SeabedType = "flat",
    confidence: float = 0.9,
    unevenness_db: float = math.nan,
    altitude_m: float = 5.0,
    origin_deg: float = 43.0,
) -> CoveragePatch:
    cells = cells_of(
        {(place[0], place[1]): place[2] for place in reported.places},
        origin_latitude_deg=origin_deg,
        ground_range_m=[place[3] for place in reported.places],
        altitude_m=altitude_m,
        look_rad=math.radians(reported.look_deg),
        seabed=SEABED_TYPES.index(seabed),
        confidence=confidence,
        unevenness_db=unevenness_db,
    )
    return patch_of(side=reported.side, start_s=reported.start_s, stop_s=reported.start_s + 30.0, cells=cells)


def snapshot(*patches: CoveragePatch, model: Model | None = None) -> Clearance:
    searched = ClearanceMap(model or Model())
    for each in patches:
        searched.add(each)
    reported = searched.snapshot()
    assert reported is not None
    return reported


def p_at(reported: Clearance, east: int, north: int) -> float:
    return float(reported.p_detected[north - reported.first_north, east - reported.first_east])


def one_by_one(patches: list[Reported], model: Model) -> dict[tuple[int, int], float]:
    """Exponent per cell: passes in order, a look per pass and cell, each reduced by what earlier ones have in common
    with it."""
    looks: dict[tuple[int, int], dict[int, list[tuple[float, float, float]]]] = defaultdict(lambda: defaultdict(list))
    last: dict[Side, tuple[int, float, float]] = {}
    n_passes = 0
    for reported in patches:
        known = last.get(reported.side)
        if (
            known is None
            or abs(reported.start_s - known[2]) > 60.0
            or abs((reported.look_deg - known[1] + 180.0) % 360.0 - 180.0) > 15.0
        ):
            known = (n_passes, reported.look_deg, 0.0)
            n_passes += 1
        last[reported.side] = (known[0], known[1], reported.start_s + 30.0)
        for east, north, fraction, ground in reported.places:
            looks[east, north][known[0]].append((fraction, 1.0 - ground / 50.0, reported.look_deg))
    exponents = {}
    for cell, by_pass in looks.items():
        before: list[float] = []
        total = 0.0
        for parts in by_pass.values():  # in the order in which they saw it first
            p = min(
                sum(fraction * min(p, HIGHEST_P) for fraction, p, _ in parts),
                max(min(p, HIGHEST_P) for _, p, _ in parts),
            )
            look = parts[0][2]
            share = 1.0
            if any(abs((look - other + 180.0) % 360.0 - 180.0) <= 15.0 for other in before):
                share = 1.0 - model.same_look_correlation
            elif before:
                share = 1.0 - model.other_look_correlation
            total -= share * math.log1p(-p)
            before.append(look)
        exponents[cell] = total
    return exponents


def drawn(seed: int) -> list[Reported]:
    rng = np.random.Generator(np.random.PCG64(seed))
    reported = []
    start_s = 0.0
    for _ in range(int(rng.integers(1, 9))):
        start_s += float(rng.choice([30.0, 200.0]))
        chosen = rng.choice(25, int(rng.integers(1, 20)), replace=False)
        places = [
            (int(c) % 5 - 2, int(c) // 5 - 3, float(rng.uniform(0.05, 1.0)), float(rng.uniform(0.0, 49.0)))
            for c in chosen
        ]
        reported.append(
            Reported(
                start_s,
                "port" if rng.uniform() < 0.5 else "starboard",
                float(rng.choice([0.0, 8.0, 90.0, 181.0, 355.0])),
                places,
            )
        )
    return reported


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), same=st.floats(0.0, 1.0), other=st.floats(0.0, 1.0))
def test_looks_add_up_as_one_by_one(seed: int, same: float, other: float) -> None:
    reported, model = drawn(seed), Model(same, other)
    clearance = snapshot(*(patch(each) for each in reported), model=model)
    expected = one_by_one(reported, model)
    assert int(clearance.seen.sum()) == len(expected)
    for (east, north), exponent in expected.items():
        assert clearance.exponent[north - clearance.first_north, east - clearance.first_east] == pytest.approx(
            exponent, rel=1e-5, abs=1e-6
        )


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_more_looks_never_lower_clearance(seed: int) -> None:
    reported = drawn(seed)
    searched = ClearanceMap(Model())
    before: dict[tuple[int, int], float] = {}
    for each in reported:
        searched.add(patch(each))
        now = searched.snapshot()
        assert now is not None
        for (east, north), p in before.items():
            assert p_at(now, east, north) >= p - 1e-9
        rows, columns = np.nonzero(now.seen)
        before = {
            (int(c) + now.first_east, int(r) + now.first_north): float(now.p_detected[r, c])
            for r, c in zip(rows, columns, strict=True)
        }


@pytest.mark.parametrize("seed", range(5))
def test_the_map_holds_the_area_that_was_seen_overlap_once_and_never_more_found_than_seen(seed: int) -> None:
    patches, area = [patch(each) for each in drawn(seed)], SeenArea()
    for each in patches:
        area.add(each)
    reported = snapshot(*patches)
    assert reported.share.sum() * reported.cell_m**2 * 1e-6 == pytest.approx(area.km2, rel=1e-5)
    assert (reported.p_detected <= reported.share + 1e-6).all()


def test_one_sure_look_clears_no_further_than_looks_can() -> None:
    assert p_at(snapshot(patch(Reported(0.0, "port", 0.0, [(0, 0, 1.0, 0.0)]))), 0, 0) == pytest.approx(HIGHEST_P)


def test_a_look_from_the_other_side_counts_more_than_the_same_again() -> None:
    first = Reported(0.0, "port", 10.0, [(0, 0, 1.0, 25.0)])
    again, opposite = (Reported(500.0, "port", look, [(0, 0, 1.0, 25.0)]) for look in (12.0, 190.0))
    once, twice, both = (
        p_at(snapshot(*map(patch, reported)), 0, 0) for reported in ([first], [first, again], [first, opposite])
    )
    assert once < twice < both
    assert once == pytest.approx(0.5)


def test_a_cell_seen_in_two_tiles_of_a_pass_is_seen_once() -> None:
    halves = [Reported(start, "port", 10.0, [(0, 0, 0.5, 25.0)]) for start in (0.0, 30.0)]
    reported = snapshot(*map(patch, halves))
    assert p_at(reported, 0, 0) == pytest.approx(0.5)
    assert int(reported.looks.max()) == 1


def test_sub_apertures_of_a_long_pass_are_one_look() -> None:
    a_pass = [Reported(30.0 * k, "port", 90.0, [(k, 0, 1.0, 10.0)]) for k in range(8)]
    reported = snapshot(*(patch(each) for each in 3 * a_pass))
    assert int(reported.looks.max()) == 1
    assert p_at(reported, 0, 0) == p_at(snapshot(*map(patch, a_pass)), 0, 0)
    again = [each._replace(start_s=each.start_s + 600.0) for each in a_pass]
    assert int(snapshot(*map(patch, a_pass + again)).looks.max()) == 2


def test_the_surest_look_shows_the_sea_floor() -> None:
    place = [(0, 0, 1.0, 25.0)]
    reported = snapshot(
        patch(Reported(0.0, "port", 0.0, place), seabed="rough", confidence=0.6),
        patch(Reported(500.0, "port", 90.0, place), seabed="ripple", confidence=0.8, unevenness_db=3.5),
        patch(Reported(900.0, "port", 180.0, place), seabed="flat", confidence=0.7),
        patch(Reported(1300.0, "port", 270.0, [(0, 0, 0.1, 25.0)]), seabed="flat", confidence=0.9, altitude_m=15.0),
    )
    assert SEABED_TYPES[int(reported.seabed[0, 0])] == "ripple"
    assert reported.unevenness_db[0, 0] == 3.5
    assert reported.altitude_m[0, 0] == pytest.approx((3.0 * 5.0 + 0.1 * 15.0) / 3.1)


def test_nothing_seen_is_no_map_and_empty_patches_add_nothing() -> None:
    searched = ClearanceMap(Model())
    searched.add(patch_of())
    assert searched.snapshot() is None


def test_cells_of_another_mission_are_refused() -> None:
    searched = ClearanceMap(Model())
    searched.add(patch(Reported(0.0, "port", 0.0, [(0, 0, 1.0, 25.0)])))
    with pytest.raises(ValueError, match="two missions"):
        searched.add(patch(Reported(0.0, "port", 0.0, [(0, 0, 1.0, 25.0)]), origin_deg=44.0))


def test_directions_a_hair_apart_share_a_bit_and_opposite_ones_never_do() -> None:
    turned = 0.001 + np.linspace(0.0, 2.0 * math.pi, 640, endpoint=False)
    bits = look_bit(turned)
    assert (np.bitwise_count(bits) == 1).all()
    assert len(np.unique(bits)) == 64
    assert (look_bit(turned + math.pi) != bits).all()
    assert (look_bit(turned + 2.0 * math.pi) == bits).all()


def test_the_map_holds_the_directions_that_each_cell_was_looked_at_in() -> None:
    reported = [
        Reported(0.0, "port", 10.0, [(0, 0, 1.0, 25.0)]),
        Reported(500.0, "port", 100.0, [(0, 0, 1.0, 25.0), (1, 0, 1.0, 25.0)]),
    ]
    towards = snapshot(*map(patch, reported)).towards
    north, east = look_bit(np.radians([10.0, 100.0]))
    assert towards.tolist() == [[north | east, east]]


def test_cells_seen_far_from_the_others_are_not_laid_out_but_counted() -> None:
    site = [(east, north, 1.0, 10.0) for east in range(40) for north in range(30)]
    far = [(east + 14_000, north - 9_000, 1.0, 10.0) for east in range(5) for north in range(5)]
    tracemalloc.start()
    try:
        reported = snapshot(patch(Reported(0.0, "port", 0.0, far)), patch(Reported(1000.0, "port", 0.0, site)))
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 20e6
    assert reported.looks.shape == (30, 40)
    assert (reported.looks == 1).all()
    assert reported.n_elsewhere == 25
    alone = snapshot(patch(Reported(1000.0, "port", 0.0, site)))
    np.testing.assert_array_equal(reported.exponent, alone.exponent)
    assert alone.n_elsewhere == 0


def test_a_place_that_is_passed_very_often_costs_no_memory_for_all_others() -> None:
    """The way to the area, or the place of recovery: 256 passes over one cell beside 30,000 seen once."""
    home = [patch(Reported(100.0 * k, "port", 7.0 * k, [(0, 0, 1.0, 40.0)])) for k in range(256)]
    wide = patch(
        Reported(40_000.0, "port", 0.0, [(east, north, 1.0, 10.0) for east in range(1, 151) for north in range(200)])
    )
    tracemalloc.start()
    try:
        reported = snapshot(*home, wide)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 60e6
    assert p_at(reported, 0, 0) == p_at(snapshot(*home), 0, 0) > 0.98
    assert reported.looks.max() == 255, "and is not taken for one that nobody saw"


def test_two_sites_that_fit_into_one_map_are_both_laid_out() -> None:
    reported = snapshot(
        patch(Reported(0.0, "port", 0.0, [(0, 0, 1.0, 10.0)])),
        patch(Reported(1000.0, "port", 0.0, [(900, 700, 1.0, 10.0)])),
    )
    assert reported.looks.shape == (701, 901)
    assert reported.n_elsewhere == 0


def test_an_area_smaller_than_a_cell_is_the_cell_that_its_middle_lies_in() -> None:
    """A sliver over three cells in a row, from where four meet to the south-west."""
    frame = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
    corners_m = ((0.0, 0.0), (-5.0, -1.0), (-5.0, -1.5), (0.0, -0.5))
    places = [frame.to_geodetic([*corner, 0.0])[:2] for corner in corners_m]
    area = over_area(None, [(float(latitude), float(longitude)) for latitude, longitude in places], 4.0)
    assert middles_m(area.ground)[area.cells].tolist() == [[-2.0, -2.0]]
    assert area_state(area, 0.8).km2 == pytest.approx(16e-6)
