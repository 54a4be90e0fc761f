"""A chatty unit is thinned where it is merged; usual navigation passes whole."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.records import NavSample
from auv_mcm.settings.port_settings import NavUnitSettings
from drivers.navigation.merge import NavMerge
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from drivers.navigation.thinning import MAX_PER_S, Thinning
from tests.drivers.navigation.nav_damage import at

STEPS_S = st.one_of(st.sampled_from([0.0, 1e-4, 0.004, 0.005, 0.01, 0.5]), st.floats(-0.01, 0.3))


@given(st.lists(STEPS_S, max_size=400), st.integers(1, 3))
def test_no_second_has_more_than_its_share_and_what_a_pause_saved(steps_s: list[float], repeats: int) -> None:
    times_s = np.cumsum(steps_s * repeats)
    thinning = Thinning()
    taken_s = np.sort([time_s for time_s in times_s if thinning.takes("heading", float(time_s))])
    for first_s in taken_s[::20]:
        assert np.count_nonzero((taken_s >= first_s) & (taken_s < first_s + 1.0)) <= 2 * MAX_PER_S + 2


@given(st.lists(st.floats(1.0 / MAX_PER_S, 2.0), max_size=100), st.integers(1, 100))
def test_what_comes_as_often_as_units_send_passes_whole_even_in_bursts(steps_s: list[float], burst: int) -> None:
    """Times are of arrival, and a busy computer reads what came meanwhile at once, microseconds apart."""
    due_s = np.cumsum(steps_s)
    arrived_s = [due_s[min(number // burst * burst + burst, len(due_s)) - 1] for number in range(len(due_s))]
    thinning = Thinning()
    assert all(thinning.takes("position", at_s + 1e-6 * number) for number, at_s in enumerate(arrived_s))


def test_a_compass_that_sends_8000_headings_a_second_takes_the_room_of_200() -> None:
    merge = NavMerge(NavMergeSettings(units={"compass": NavUnitSettings()}))
    samples = []
    for number in range(8000 * 3):
        heading_rad = math.radians(number % 360)
        samples += merge.feed(NavFix(source="compass", received=at(number / 8000), heading_rad=heading_rad))
    samples += merge.finish()
    times_s = [sample.time_s for sample in samples if isinstance(sample, NavSample)]
    assert 3 * MAX_PER_S <= len(times_s) <= 3 * MAX_PER_S + MAX_PER_S
    assert max(np.diff(times_s[MAX_PER_S:])) < 1.5 / MAX_PER_S
    assert merge.counters == Counter({"nav.thinned.heading.compass": 24_000 - len(times_s)})


def test_headings_of_one_read_are_one_sample() -> None:
    merge = NavMerge(NavMergeSettings(units={"compass": NavUnitSettings()}))
    for number in range(100):
        merge.feed(NavFix(source="compass", received=at(number // 10 * 0.1), heading_rad=0.01 * number))
    headings = [sample.heading_rad for sample in merge.finish() if isinstance(sample, NavSample)]
    assert len(headings) <= 10
    assert merge.counters == {"nav.thinned.heading.compass": 90}
