"""Matching against a search over all possible matchings, and what must hold as the threshold falls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.scoring.matching import gates_m, match_by_threshold


def best_of_all(
    near: NDArray[np.bool_], distance_m: NDArray[np.float64], contact: int = 0, taken: int = 0
) -> tuple[int, float]:
    """Most matches, and with those the least total distance (negative), over every matching there is."""
    if contact == near.shape[0]:
        return 0, 0.0
    best = best_of_all(near, distance_m, contact + 1, taken)
    for scene_object in np.flatnonzero(near[contact]).tolist():
        if not taken >> scene_object & 1:
            count, closeness = best_of_all(near, distance_m, contact + 1, taken | 1 << scene_object)
            best = max(best, (count + 1, closeness - float(distance_m[contact, scene_object])))
    return best


def places(n_most: int, coordinate: st.SearchStrategy[float]) -> st.SearchStrategy[list[tuple[float, float]]]:
    return st.lists(st.tuples(coordinate, coordinate), max_size=n_most)


# Whole metres make many equal distances.
scattered = st.one_of(st.floats(0.0, 5.0), st.integers(0, 4).map(float))
some_places = places(5, scattered)
some_p_mine = st.lists(st.sampled_from([0.0, 0.2, 0.5, 0.5001, 0.9, 1.0]), min_size=5, max_size=5)


def laid_out(contacts: list[tuple[float, float]], objects: list[tuple[float, float]]) -> NDArray[np.float64]:
    offset = np.array(contacts, dtype=np.float64).reshape(-1, 1, 2) - np.array(objects, dtype=np.float64).reshape(
        1, -1, 2
    )
    return np.hypot(offset[..., 0], offset[..., 1])


@given(contacts=some_places, objects=some_places, p_mine=some_p_mine, gate_m=st.sampled_from([1.0, 2.0, 8.0]))
def test_every_threshold_has_the_best_matching_of_all(
    contacts: list[tuple[float, float]], objects: list[tuple[float, float]], p_mine: list[float], gate_m: float
) -> None:
    distance_m, p = laid_out(contacts, objects), np.array(p_mine[: len(contacts)])
    near = distance_m <= gate_m
    steps = list(match_by_threshold(near, distance_m, p))
    assert [threshold for threshold, _ in steps] == sorted(set(p.tolist()), reverse=True)
    for threshold, matched in steps:
        held = np.flatnonzero(matched >= 0)
        assert len(set(matched[held].tolist())) == len(held)
        assert near[held, matched[held]].all()
        assert (p[held] >= threshold).all()
        count, closeness = best_of_all(near & (p >= threshold)[:, None], distance_m)
        assert len(held) == count
        assert float(distance_m[held, matched[held]].sum()) == pytest.approx(-closeness, abs=1e-4)


@given(contacts=some_places, objects=some_places, p_mine=some_p_mine, gate_m=st.sampled_from([1.0, 2.0, 8.0]))
def test_objects_stay_matched_and_leftovers_stay_left_over_as_the_threshold_falls(
    contacts: list[tuple[float, float]], objects: list[tuple[float, float]], p_mine: list[float], gate_m: float
) -> None:
    distance_m, p = laid_out(contacts, objects), np.array(p_mine[: len(contacts)])
    found: set[int] = set()
    left_over: set[int] = set()
    for threshold, matched in match_by_threshold(distance_m <= gate_m, distance_m, p):
        found_now = set(matched[matched >= 0].tolist())
        left_over_now = set(np.flatnonzero((p >= threshold) & (matched < 0)).tolist())
        assert found <= found_now
        assert left_over <= left_over_now
        found, left_over = found_now, left_over_now


def test_more_matches_come_before_nearer_ones() -> None:
    distance_m = laid_out([(0.0, 0.0), (1.9, 0.0)], [(0.1, 0.0), (-1.8, 0.0)])
    *_, (_, matched) = match_by_threshold(distance_m <= 2.0, distance_m, np.array([0.9, 0.9]))
    assert matched.tolist() == [1, 0]


def test_of_equal_matchings_the_one_before_stays() -> None:
    distance_m = laid_out([(1.0, 0.0), (3.0, 2.0), (2.0, 1.0)], [(1.0, 2.0), (2.0, 1.0)])
    steps = list(match_by_threshold(distance_m <= 1.5, distance_m, np.array([0.75, 0.75, 0.5])))
    left_over = [set(np.flatnonzero(matched < 0).tolist()) - {2} for _, matched in steps]
    assert left_over[0] <= left_over[1]


def test_gate_is_three_sigma_up_to_four_metres_but_never_less_than_asked_for() -> None:
    sigma_m = np.array([np.nan, 0.1, 1.0, 5.0])
    assert gates_m(2.0, sigma_m).tolist() == [2.0, 2.0, 3.0, 4.0]
    assert gates_m(6.0, sigma_m).tolist() == [6.0, 6.0, 6.0, 6.0]
