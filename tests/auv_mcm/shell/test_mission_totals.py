"""Entries of summary.json on the search and on the area to be cleared."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.residual import PRIOR_SHARE, remaining_mines
from auv_mcm.contacts.expected_alarms import expected_alarms
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.detect.belief import probability
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.shell.mission_totals import area_totals, clearance_notices, contact_totals, point_totals, search_totals
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.test_seen_area import patch
from tests.make.records import clearance_of


def test_the_search_is_summed_up_over_what_was_seen() -> None:
    assert search_totals(None, []) == {}
    searched = search_totals(searched_half(), [])["searched"]
    assert searched["km2"] == pytest.approx(3 * 16e-6, abs=1e-6)
    assert searched["p_detected_mean"] == pytest.approx((0.5 + 0.9 + 0.96) / 3.0, abs=1e-4)
    assert searched["share_missed"] == pytest.approx(1.0 - (0.5 + 0.9 + 0.96) / 3.0, abs=1e-4)
    assert searched["km2_at_p"]["0.9"] == pytest.approx(2 * 16e-6, abs=1e-6)
    assert sum(searched["seabed_km2"].values()) == pytest.approx(searched["km2"], abs=1e-6)
    seen_p = np.array([0.5, 0.9001, 0.96])
    assert searched["mines_left"]["expected"] == pytest.approx(0.5 * (1.0 - seen_p).sum() / seen_p.sum(), abs=1e-3)
    assert (searched["mines_found"], searched["mines_left"]["among_contacts"]) == (0.0, 0)


def test_of_contacts_those_that_are_mine_like_are_found_and_the_others_may_be_left() -> None:
    contacts = [drawn_looks.contact(p_mine=p_mine) for p_mine in (0.9, 0.7, 0.1, 0.05, 0.01)]
    searched = search_totals(searched_half(), contacts)["searched"]
    left = remaining_mines([0.9, 0.7, 0.1, 0.05, 0.01], [True, True, False, False, False], [0.5, 0.9001, 0.96])
    assert searched["mines_found"] == pytest.approx(1.6)
    assert searched["mines_left"] == {
        "expected": pytest.approx(left.expected, abs=1e-4),
        "at_most_95": left.at_most_95,
        "p_none": pytest.approx(left.p_none, abs=1e-4),
        "among_contacts": 3,
        "p_mine_sum": pytest.approx(0.16),
        "mine_share": pytest.approx(left.share, abs=1e-4),
        "mine_share_presumed": PRIOR_SHARE,
    }
    assert searched["seabed_km2"]["flat"] == searched["seabed_km2"]["ripple"] == pytest.approx(16e-6)
    assert searched["seabed_km2"]["unknown"] == 0.0


def test_of_a_cell_at_the_edge_only_what_was_seen_was_searched() -> None:
    """0.0037 km² were said to be searched where 0.0023 were covered (scotsman-iver2)."""
    edge = structs.replace(searched_half(), share=np.array([[0.625, 0.9375], [1.0, 0.0]], dtype=np.float32))
    searched = search_totals(edge, [])["searched"]
    assert searched["km2"] == pytest.approx((0.625 + 0.9375 + 1.0) * 16e-6, abs=1e-6)
    assert searched["p_detected_mean"] == pytest.approx((0.5 + 0.9001 + 0.96) / 2.5625, abs=1e-4)
    assert searched["share_missed"] == pytest.approx(1.0 - searched["p_detected_mean"], abs=2e-4)
    assert searched["km2_at_p"]["0.9"] == pytest.approx(1.9375 * 16e-6, abs=1e-6)
    assert sum(searched["seabed_km2"].values()) == pytest.approx(searched["km2"], abs=2e-6)


def test_sub_apertures_of_one_pass_cover_its_floor_once() -> None:
    parts = [
        structs.replace(patch(None, covered_m2=1000.0), start_s=start_s, stop_s=start_s + 10.0, squint_rad=squint_rad)
        for squint_rad in (-0.03, 0.0, 0.03)
        for start_s in (100.0, 110.0)
    ]
    assert contact_totals([], parts)["covered_km2"] == pytest.approx(0.002)
    later = structs.replace(parts[-1], start_s=120.0, stop_s=130.0)
    again = structs.replace(parts[0], side="port" if parts[0].side == "starboard" else "starboard")
    assert contact_totals([], [*parts, later, again])["covered_km2"] == pytest.approx(0.004)
    assert contact_totals([], [parts[0], parts[0]])["covered_km2"] == pytest.approx(0.002), "passed twice"


class Counted(float):
    """A time that counts how often it is compared."""

    n_compared = 0

    def __lt__(self, other: float) -> bool:
        Counted.n_compared += 1
        return float(self) < float(other)

    def __gt__(self, other: float) -> bool:
        Counted.n_compared += 1
        return float(self) > float(other)


def test_a_mission_twice_as_long_takes_twice_as_long_to_sum_up() -> None:
    def n_compared(n_tiles: int) -> int:
        Counted.n_compared = 0
        one, times_s = patch(None, covered_m2=1000.0), [Counted(10.0 * tile) for tile in range(n_tiles + 1)]
        parts = [
            structs.replace(one, start_s=start_s, stop_s=stop_s, squint_rad=squint_rad)
            for start_s, stop_s in pairwise(times_s)
            for squint_rad in (-0.03, 0.0, 0.03)
        ]
        assert contact_totals([], parts)["covered_km2"] == pytest.approx(0.001 * n_tiles)
        return Counted.n_compared

    assert n_compared(400) < 2.5 * n_compared(200)


def test_what_was_searched_too_far_off_for_the_map_is_summed_up_and_reported() -> None:
    assert search_totals(searched_half(), [])["searched"]["km2_elsewhere"] == 0.0
    assert clearance_notices(searched_half()) == clearance_notices(None) == []
    split = structs.replace(searched_half(), n_elsewhere=500)
    assert search_totals(split, [])["searched"]["km2_elsewhere"] == pytest.approx(0.008)
    (notice,) = clearance_notices(split)
    assert notice.code == "clearance.elsewhere"
    assert "0.008 km²" in notice.text


def test_an_area_to_clear_is_summed_up_and_what_of_it_was_not_seen_counts_as_not_found() -> None:
    assert area_totals(searched_half(), PlanConfig()) == {}
    frame = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
    latitude_deg, longitude_deg, _ = frame.to_geodetic(
        [[0.0, 0.0, 0.0], [0.0, 15.0, 0.0], [7.0, 15.0, 0.0], [7.0, 0.0, 0.0]]
    )
    required = float(searched_half().p_detected[0, 1])
    area_deg = tuple(zip(latitude_deg.tolist(), longitude_deg.tolist(), strict=True))
    plan = PlanConfig(area_deg=area_deg, required_clearance=required)
    area = area_totals(searched_half(), plan, "cannot, because")["area"]
    assert area["km2"] == pytest.approx(8 * 16e-6, abs=1e-6)
    assert area["p_detected_mean"] == pytest.approx((0.5 + 0.9001 + 0.96) / 8.0, abs=1e-4)
    assert area["percent_at_required"] == pytest.approx(25.0)
    assert (area["required"], area["reached"], area["verdict"]) == (required, False, "cannot, because")
    assert area_totals(None, plan)["area"]["p_detected_mean"] == 0.0


def test_false_alarms_are_expected_among_what_the_operating_point_calls() -> None:
    point = OperatingPoint(10.0, 3, 0.5, expected_alarms([3.0, 1.0, -1.0], 0.5), level_nats=1.0)
    totals = point_totals(point)["operating_point"]
    assert totals["called_from_p_mine"] == pytest.approx(probability(1.0), abs=1e-6)
    n_expected = 2.0 - probability(1.0) - probability(3.0)
    assert totals["expected_per_km2"]["middle"] == pytest.approx(n_expected / 0.5, abs=1e-3)


def searched_half() -> Clearance:
    """Four cells, of which one was not seen."""
    share, looks = np.array([[1.0, 1.0], [1.0, 0.0]], dtype=np.float32), np.array([[1, 1], [2, 0]], dtype=np.uint8)
    seabed = np.array([[0, 1], [2, 4]], dtype=np.uint8)
    return clearance_of([[0.5, 0.9001], [0.96, 0.0]], share=share, looks=looks, seabed=seabed)
