"""Objects joined over missions, against truth that was drawn, and what each mission adds."""

from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.settings.config import ContactsConfig
from sim_replay.batch.objects_seen import (
    SEARCHED_FRACTION,
    CoveredPatch,
    SeenContact,
    SeenMission,
    SeenObject,
    _inside,
    objects_seen,
)

FRAME = LocalFrame(latitude_deg=43.1, longitude_deg=5.9, height_m=0.0)
SIGMA_M = 0.5
CONFIG = ContactsConfig()


def contact(number: int, east_m: float, north_m: float, p_mine: float = 0.9, frame: LocalFrame = FRAME) -> SeenContact:
    latitude, longitude, _ = frame.to_geodetic(np.array([east_m, north_m, 0.0]))
    place = float(latitude), float(longitude)
    return SeenContact(f"C{number:05d}", *place, SIGMA_M**2 * np.eye(2), p_mine, "cylinder", p_mine > 0.5)


def square(half_m: float, evaluated: float = 1.0, east_m: float = 0.0) -> CoveredPatch:
    corners = half_m * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + (east_m, 0.0, 0.0)
    latitude, longitude, _ = FRAME.to_geodetic(corners)
    return CoveredPatch(np.column_stack([longitude, latitude]), evaluated)


def seen(*missions: list[SeenContact], coverage: list[list[CoveredPatch]] | None = None) -> list[SeenObject]:
    named = [SeenMission(f"m{number}", tuple(contacts)) for number, contacts in enumerate(missions)]
    return objects_seen(named, [[square(500.0)]] * len(named) if coverage is None else coverage, CONFIG)


def test_objects_of_drawn_surveys_are_found_once_each_with_their_history() -> None:
    draw = np.random.default_rng(4)
    truth = np.array([(20.0 * column, 20.0 * row) for column in range(6) for row in range(6)])
    present = draw.random((5, len(truth))) < 0.6
    missions = []
    for shown in present:
        places = truth[shown] + draw.normal(0.0, 0.5 * SIGMA_M, (shown.sum(), 2))
        missions.append([contact(number + 1, *place) for number, place in enumerate(places.tolist())])
    found = seen(*missions, coverage=[[square(500.0)]] * 5)
    assert len(found) == present.any(axis=0).sum()
    for one in found:
        east_north = FRAME.to_enu(one.latitude_deg, one.longitude_deg, 0.0)[:2]
        nearest = int(np.argmin(np.hypot(*(truth - east_north).T)))
        assert [sighting.contact is not None for sighting in one.history] == present[:, nearest].tolist()
        n_seen = int(present[:, nearest].sum())
        # Independent errors average out.
        assert one.covariance_m2 == pytest.approx(SIGMA_M**2 / n_seen * np.eye(2), rel=1e-2)
        assert np.hypot(*(truth[nearest] - east_north)) < 4.0 * SIGMA_M / np.sqrt(n_seen)


def test_memory_goes_by_the_contacts_not_by_their_square() -> None:
    missions = [[contact(n, 6.0 * (n % 50), 6.0 * (n // 50)) for n in range(1000)] for _ in range(2)]
    seen([contact(1, 0.0, 0.0)], [contact(1, 0.0, 0.0)])  # loads packages
    tracemalloc.start()
    found = seen(*missions, coverage=[[], []])
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == 1000
    assert {one.change for one in found} == {"seen again"}
    assert peak_bytes < 8e6  # a number for each pair would take as much


@pytest.mark.parametrize(
    ("sightings", "change"),
    [
        ("1", "seen once"),
        ("01", "new"),
        ("10", "gone"),
        ("11", "seen again"),
        ("101", "seen again"),
        ("011", "seen again"),
        ("110", "gone"),
    ],
)
def test_the_change_is_what_the_last_mission_over_the_place_shows(sightings: str, change: str) -> None:
    (one,) = seen(*([contact(1, 3.0, 4.0)] if sign == "1" else [] for sign in sightings))
    assert one.change == change


def test_a_place_that_was_not_searched_says_nothing_about_an_object() -> None:
    here = [contact(1, 3.0, 4.0)]
    elsewhere, hardly = square(10.0, east_m=100.0), square(10.0, evaluated=SEARCHED_FRACTION - 0.01)
    for patch in (elsewhere, hardly):
        (one,) = seen(here, [], coverage=[[square(10.0)], [patch]])
        assert one.change == "seen once"


def test_two_contacts_of_one_mission_are_two_objects_and_a_speck_beside_a_mine_is_not_it() -> None:
    mine, speck = contact(1, 0.0, 0.0, p_mine=0.95), contact(2, 1.0, 0.0, p_mine=0.02)
    found = seen([mine, speck], [contact(1, 0.4, 0.0, p_mine=0.9)])
    assert [len(one.history) for one in found] == [2, 2]
    assert [one.change for one in found] == ["seen again", "gone"]


def test_an_object_on_the_antimeridian_is_one_and_not_another_far_away() -> None:
    fiji = LocalFrame(latitude_deg=-17.0, longitude_deg=180.0, height_m=0.0)
    found = seen(
        [contact(1, -0.2, 0.0, frame=fiji), contact(2, 0.0, 0.0)], [contact(1, 0.2, 0.0, frame=fiji)], coverage=[[], []]
    )
    assert sorted(len(one.history) for one in found) == [1, 2]
    both = next(one for one in found if len(one.history) == 2)
    assert abs(both.longitude_deg) == pytest.approx(180.0, abs=1e-6)


def test_without_a_contact_there_is_no_object() -> None:
    assert seen([], []) == []


@given(
    points=st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), min_size=1, max_size=20),
    radii=st.lists(st.floats(0.2, 1.4), min_size=3, max_size=12),
)
def test_points_lie_inside_a_ring_as_another_library_finds(
    points: list[tuple[float, float]], radii: list[float]
) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, len(radii), endpoint=False)
    ring = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    outline = (ring * 1e6).astype(np.float32)
    for point, inside in zip(points, _inside(np.array(points), ring), strict=True):
        distance = cv2.pointPolygonTest(outline, (1e6 * point[0], 1e6 * point[1]), True)
        assert abs(distance) < 1.0 or inside == (distance > 0.0)
