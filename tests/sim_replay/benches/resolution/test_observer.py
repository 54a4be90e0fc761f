"""The observer's pixels follow from distances, and the chain's figures from contacts."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.errors import SelfCheckError
from sim_replay.benches.resolution.bench import check, observer_report
from sim_replay.benches.resolution.chain import Setting, scene_at, share_above
from sim_replay.benches.resolution.distances import DISTINCT_NATS
from sim_replay.benches.resolution.observer import (
    COARSER,
    Distances,
    drawn_anew,
    nats_of,
    observed,
    pixel_for,
    share_rows,
)
from sim_replay.benches.resolution.pictures import FINE_M, MINES, Floor


def compared(kind: str, nats_of_finest: float) -> Distances:
    """A mine whose distances fall with the area of a pixel; two views separate twice as much."""
    one = nats_of_finest / np.array(COARSER, dtype=np.float64) ** 2
    nats = np.stack([one, 2.0 * one])
    return Distances(kind, nats, nats, nats)


def test_the_largest_pixel_is_where_the_distance_has_fallen_to_what_is_needed() -> None:
    pixel_m = 0.1
    some = [compared("sphere", DISTINCT_NATS * (pixel_m / FINE_M) ** 2)]
    for views, looks, times in ((1, 1, 1.0), (2, 1, 2.0**0.5), (1, 4, 2.0)):
        nats = nats_of(some, "rocks", views=views, looks=looks)
        assert float(pixel_for(nats, DISTINCT_NATS, share=0.9)) == pytest.approx(pixel_m * times)


def test_a_pixel_that_no_size_reaches_is_none_and_one_beyond_all_is_the_largest() -> None:
    few, many = (nats_of([compared("sphere", nats)], "rocks", views=1, looks=1) for nats in (1e-3, 1e9))
    assert np.isnan(pixel_for(few, DISTINCT_NATS, share=0.9))
    assert float(pixel_for(many, DISTINCT_NATS, share=0.9)) == pytest.approx(FINE_M * COARSER[-1])


def test_many_draws_give_what_each_gives_by_itself() -> None:
    nats = nats_of([compared("wedge", level) for level in (30.0, 90.0, 400.0, 1e4)], "floor", views=1, looks=1)
    drawn = drawn_anew(nats)[:50]
    by_itself = [float(pixel_for(one, DISTINCT_NATS, share=0.9)) for one in drawn]
    np.testing.assert_allclose(pixel_for(drawn, DISTINCT_NATS, share=0.9), by_itself)


def test_a_sphere_looks_the_same_from_both_aspects_and_the_picture_is_that_of_its_seed() -> None:
    floor = Floor()
    sphere = floor.pictured("sphere", -12.0, 3)
    np.testing.assert_allclose(sphere.means[0], sphere.means[1], rtol=1e-6)
    np.testing.assert_array_equal(sphere.means, floor.pictured("sphere", -12.0, 3).means)
    assert sphere.means.max() > 3.0 * floor.bare().max()  # its highlight


def test_the_check_accepts_real_objects_and_refuses_what_cannot_be() -> None:
    real = {"bright": observed(1, 1, -12.0)}
    check(real)
    assert all(kind in observer_report(real, in_markdown=True) for kind in MINES)
    rows = list(share_rows(real["bright"], 1, views=1))
    assert len(rows) == 3 * len(MINES)
    one = real["bright"][0]
    with pytest.raises(SelfCheckError, match="coarser"):
        check({"bright": [one._replace(rocks=one.rocks[:, ::-1])]})
    with pytest.raises(SelfCheckError, match="two views"):
        check({"bright": [one._replace(floor=one.floor[::-1])]})


def test_ties_between_mine_and_rock_count_half() -> None:
    none = -np.inf
    assert share_above(np.array([1.0, none]), np.array([0.0, none])) == pytest.approx((1.0 + 1.0 + 0.0 + 0.5) / 4.0)


def test_only_the_sonar_differs_between_resolutions() -> None:
    fine, coarse = scene_at(Setting(0.015), 7), scene_at(Setting(0.24, 4), 7)
    assert (fine.objects, fine.world, fine.track) == (coarse.objects, coarse.world, coarse.track)
    assert coarse.sonar.looks == 4
