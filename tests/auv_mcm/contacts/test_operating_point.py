"""Which contacts are called and announced while a mission goes on, and by what."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import gamma, norm

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.contacts.background import LOWEST_NATS, shipped_background
from auv_mcm.contacts.contact import call_words, is_mine_like
from auv_mcm.contacts.expected_alarms import expected_alarms, poisson_end
from auv_mcm.contacts.ledger import contact_from_views
from auv_mcm.contacts.operating_point import CallWatch, MarkedContacts, OperatingPoint
from auv_mcm.detect.belief import odds_of, probability
from auv_mcm.records import Contact, ContactClass, contact_id, contact_number
from auv_mcm.settings.config import ContactsConfig
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.test_seen_area import patch

PRIOR = shipped_background().cascade
BARE = expected_alarms([], 0.1)


class Mission:
    """Contacts as a ledger would hold them, and what a watch announces of them."""

    def __init__(self, config: ContactsConfig | None = None, **watch: Any) -> None:
        self.contacts: dict[int, Contact] = {}
        self.watch = CallWatch(config or ContactsConfig(), watch.get("prior", PRIOR))
        self.announced: dict[int, list[Contact]] = {}
        self._next_m2 = 0

    def search(self, area_km2: float) -> None:
        self.watch.cover(patch(None, covered_m2=1e6 * area_km2))

    def see(self, *log_odds: float) -> list[Contact]:
        """Find new contacts with these log-odds."""
        first = len(self.contacts) + 1
        return self._announce([drawn(first + place, nats) for place, nats in enumerate(log_odds)])

    def see_again(self, number: int, log_odds: float) -> list[Contact]:
        """View a contact again, which changes its log-odds."""
        return self._announce([drawn(number, log_odds)])

    def end(self) -> list[Contact]:
        return self._keep(self.watch.announce((), self._read, is_last=True))

    def _announce(self, changed: list[Contact]) -> list[Contact]:
        self.contacts |= {contact_number(contact.id): contact for contact in changed}
        return self._keep(self.watch.announce(changed, self._read))

    def _keep(self, announced: list[Contact]) -> list[Contact]:
        for contact in announced:
            self.announced.setdefault(contact_number(contact.id), []).append(contact)
        return announced

    def _read(self, numbers: Sequence[int]) -> list[Contact]:
        return [self.contacts[number] for number in numbers]


def drawn(number: int, log_odds: float) -> Contact:
    return drawn_looks.contact(id=contact_id(number), p_mine=probability(log_odds), views=())


def test_contacts_are_called_while_the_lower_end_of_the_expected_false_alarms_is_accepted() -> None:
    """The lower end of the 95 % interval of a Poisson count, the Gamma quantile by scipy; half lies on bare floor."""
    mission = Mission(ContactsConfig(false_alarms_per_km2=30.0))
    mission.search(0.05)
    announced = mission.see(*np.linspace(-4.5, 4.5, 40).tolist())
    expected = np.cumsum([1.0 - contact.p_mine for contact in announced[::-1]])[::-1]
    accepted = 0.5 * gamma.ppf(0.025, expected) <= 30.0 * 0.05
    assert [contact.called for contact in announced] == accepted.tolist()
    assert {contact.called for contact in announced} == {True, False}
    densities = [contact.false_alarms_per_km2 for contact in announced]
    assert densities == sorted(densities, reverse=True)
    assert densities == pytest.approx((expected / 0.05).tolist())
    assert all(
        low <= contact.false_alarms_per_km2 <= high
        for contact in announced
        for low, high in [contact.false_alarms_95_per_km2]
    )


@pytest.mark.parametrize("p_mine", [0.03, 0.74, 0.9, 0.9995])
def test_the_likeliest_contact_makes_expect_one_false_alarm_less_its_p_mine(p_mine: float) -> None:
    """Read between levels of the odds, it was 0.005 per km² for 18.6 on a mission of the jury, or 0.13 for 0.03."""
    mission = Mission()
    mission.search(0.02)
    contact = mission.see(odds_of(0.02), odds_of(p_mine))[1]
    assert contact.false_alarms_per_km2 == pytest.approx((1.0 - p_mine) / 0.02)
    low, high = contact.false_alarms_95_per_km2
    assert low <= contact.false_alarms_per_km2 <= high
    assert not re.search(r"[0-9]e-", call_words(contact)), "a power of ten, 3.4e-05"


def test_a_floor_rich_in_mines_does_not_turn_them_into_background() -> None:
    """A test range: 25 likely mines on 0.035 km², where the middle of a mixture called a third of them background."""
    mission = Mission()
    mission.search(0.035)
    mission.see(*np.linspace(odds_of(0.02), odds_of(0.15), 40).tolist())
    mines = mission.see(*np.linspace(odds_of(0.45), odds_of(0.95), 25).tolist())
    assert sum(bool(contact.called) for contact in mines if contact_number(contact.id) > 40) >= 15


def test_scores_that_part_mines_from_rocks_keep_every_mine() -> None:
    """Rocks below 0.1, mines from 0.15 on: the operating point may not throw away what the scores part."""
    mission = Mission()
    mission.search(0.08)
    mission.see(*np.linspace(odds_of(0.02), odds_of(0.1), 20).tolist())
    mines = mission.see(*np.linspace(odds_of(0.15), odds_of(0.8), 12).tolist())
    assert [contact.called for contact in mines if contact_number(contact.id) > 20] == [True] * 12


def test_a_line_too_short_for_the_rate_asked_still_calls_what_is_likely_and_says_so() -> None:
    mission = Mission(ContactsConfig(false_alarms_per_km2=30.0))
    mission.search(0.003)
    unlikely, likely = mission.see(odds_of(0.05), odds_of(0.6))
    assert likely.called
    assert not unlikely.called
    assert mission.watch.point.is_short
    mission.search(0.5)
    mission.end()
    assert not mission.watch.point.is_short


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(0.0, 200.0), min_size=1, max_size=8), st.floats(-2.5, 2.5).filter(lambda sigmas: sigmas != 0.0)
)
def test_ends_of_poisson_counts_are_the_quantiles_of_gamma(expected: list[float], sigmas: float) -> None:
    shape = np.array(expected) + (sigmas > 0.0)
    exact = gamma.ppf(norm.cdf(sigmas), np.maximum(shape, 1e-9))
    np.testing.assert_allclose(poisson_end(expected, sigmas), exact, rtol=0.03, atol=0.06)
    assert (np.diff(poisson_end(np.sort(expected), sigmas)) >= 0.0).all()


@given(st.lists(st.floats(-9.0, 12.0), max_size=60), st.sampled_from([0.0, 0.001, 0.1, 20.0]))
def test_the_more_mine_like_the_fewer_false_alarms_are_expected(log_odds: list[float], area_km2: float) -> None:
    levels = (-9.0, LOWEST_NATS, -1.0, 0.1, 3.0, 9.0, 13.0)
    found = np.array([expected_alarms(log_odds, area_km2).reaching(level) for level in levels])
    assert np.isfinite(found).all()
    assert (np.diff(found, axis=0) <= 1e-9).all()
    assert (found[:, 1] <= found[:, 0]).all()
    assert (found[:, 0] <= found[:, 2]).all()
    assert found[-1, 0] == 0.0


def test_a_call_that_turns_is_announced_again_and_nothing_else_is() -> None:
    mission = Mission()
    mission.search(0.0001)
    (announced,) = mission.see(odds_of(0.15))
    assert announced.called is False
    mission.search(3.0)  # and hardly anything there
    again = mission.see(-4.5)
    assert [contact.id for contact in again] == ["C00001", "C00002"]
    assert again[0].called is True
    assert [contact.id for contact in mission.see(-4.4)] == ["C00003"]
    quiet = [mission.see(-4.0 + 0.01 * number) for number in range(20)]
    assert all(len(announced) == 1 for announced in quiet)


def test_the_background_is_estimated_anew_after_a_tenth_more_contacts_or_area() -> None:
    mission = Mission()
    mission.search(0.5)
    mission.see(*np.linspace(-4.5, 0.0, 100).tolist())
    estimated = []
    for area_km2 in (*[0.004] * 11, 0.05):
        mission.search(area_km2)
        mission.see(-4.0)
        estimated.append(mission.watch.point.n_contacts)
    assert estimated == [100] * 10 + [111, 111]
    mission.search(0.01)
    mission.see(-4.0)
    assert mission.watch.point.n_contacts == 113


def test_in_the_end_the_last_announcement_of_every_contact_says_what_the_whole_mission_does() -> None:
    random = np.random.Generator(np.random.PCG64(4))
    mission = Mission()
    for _ in range(60):
        mission.search(float(random.exponential(0.004)))
        mission.see(*(-4.5 + random.exponential(1.3, random.integers(0, 5))).tolist())
    mission.end()
    last = {number: announced[-1].called for number, announced in mission.announced.items()}
    point = mission.watch.point
    assert last == {number: point.calls(contact) for number, contact in mission.contacts.items()}
    assert {contact.called for contact in MarkedContacts(mission.contacts.values(), point)} == {True, False}
    n_announced = sum(map(len, mission.announced.values()))
    assert n_announced < 1.2 * len(mission.contacts)


def test_a_contact_that_changes_counts_once() -> None:
    mission, other = Mission(), Mission()
    for one in (mission, other):
        one.search(0.05)
    mission.see(-4.0, -1.0, 2.0)
    mission.see_again(2, 1.5)
    mission.see_again(2, -7.0)  # no longer among those counted
    other.see(-4.0, -7.0, 2.0)
    for one in (mission, other):
        one.end()
    assert mission.watch.point.n_contacts == other.watch.point.n_contacts == 2
    assert mission.watch.point.level_nats == other.watch.point.level_nats


def test_more_that_is_accepted_calls_more() -> None:
    random = np.random.Generator(np.random.PCG64(2))
    log_odds = (-4.5 + random.exponential(1.5, 80)).tolist()
    called = []
    for accepted in (1.0, 10.0, 30.0, 100.0, 1000.0, 1e5):
        mission = Mission(ContactsConfig(false_alarms_per_km2=accepted))
        mission.search(0.05)
        called.append(sum(bool(contact.called) for contact in mission.see(*log_odds)))
    assert called == sorted(called)
    assert called[0] < called[-1] == 80


def test_what_is_too_unlikely_to_be_counted_is_never_called() -> None:
    mission = Mission(ContactsConfig(false_alarms_per_km2=1e6, min_p_mine=0.0))
    mission.search(0.05)
    assert [contact.called for contact in mission.see(-9.0, odds_of(0.01) - 0.01, odds_of(0.01), 1.0)] == [
        False,
        False,
        True,
        True,
    ]


def test_without_a_prior_the_usual_p_mine_calls_and_no_density_is_claimed() -> None:
    mission = Mission(prior=None)
    unlikely, likely = mission.see(odds_of(MINE_LIKE_P) - 0.01, odds_of(MINE_LIKE_P) + 0.01)
    assert (unlikely.called, likely.called) == (False, True)
    assert math.isnan(likely.false_alarms_per_km2)
    assert (call_words(likely), call_words(drawn(1, 0.0))) == ("yes", "")
    assert mission.watch.take_notices() == []


@pytest.mark.parametrize("prior", [None, PRIOR])
def test_what_files_write_as_the_usual_p_mine_is_called_where_that_calls(prior: Any) -> None:
    mission = Mission(prior=prior)
    contacts = mission.see(odds_of(0.19994), odds_of(0.19996))
    assert [contact.called for contact in contacts] == [False, True] == [is_mine_like(contact) for contact in contacts]


def test_a_background_unlike_all_that_was_learnt_is_reported_once() -> None:
    mission = Mission()
    mission.search(0.02)
    for _ in range(5):
        mission.see(*np.linspace(-3.0, 0.0, 2000).tolist())
    (notice,) = mission.watch.take_notices()
    assert notice.code == "contacts.background_unlike"
    assert "check sonar.transfer" in notice.text
    mission.see(*np.linspace(-3.0, 0.0, 2000).tolist())
    assert mission.watch.take_notices() == []


@pytest.mark.parametrize("times", [0.0, 1.0, 10.0])
def test_a_background_like_those_learnt_is_not_reported(times: float) -> None:
    random = np.random.Generator(np.random.PCG64(5))
    mission = Mission()
    mission.search(0.1)
    mission.see(*(-4.5 + random.exponential(1.0, round(150 * times))).tolist())
    mission.end()
    assert mission.watch.take_notices() == []


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-8.0, 8.0), st.floats(0.0, 359.0)), min_size=1, max_size=3),
    st.sampled_from(["cylinder", "sphere", "truncated_cone", "wedge"]),
    st.floats(1.0, 10_000.0),
)
def test_class_belief_p_mine_and_call_agree(
    seen: list[tuple[float, float]], kind: ContactClass, asked_per_km2: float
) -> None:
    """Whatever the operator accepts, and marked by one operating point after another."""
    views = tuple(
        drawn_looks.detection(
            p_mine=probability(ratio - 4.0),
            aspect_deg=aspect,
            time_s=float(number),
            confirmation=drawn_looks.confirmation(ratio, drawn_looks.like(kind)),
        )
        for number, (ratio, aspect) in enumerate(seen)
    )
    contact = contact_from_views("C00001", views, prior=-4.0)
    for asked in (asked_per_km2, 1.0, asked_per_km2):
        contact = OperatingPoint(asked, 0, 0.1, BARE).marked(contact)
        if contact.called or contact.p_mine >= MINE_LIKE_P:
            assert contact.classification == contact.mine_kind == kind
        else:
            assert contact.belief[contact.classification] == max(contact.belief.values())
        mines = sum(share for name, share in contact.belief.items() if name not in ("clutter", "unknown"))
        assert mines <= contact.p_mine + 1e-12 <= 1.0 - contact.belief["clutter"] + 2e-12
