"""Messages sent lately are believed, whatever the sender's clock; recorded ones are not."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.vehicle.sender_clock import ANOTHER_CLOCK_S, JITTER_S, MAX_AGE_S, SenderClock

UTC_S = 1.7e9


@given(
    drift=st.floats(-1e-4, 1e-4),
    ahead_s=st.floats(-1e8, 1e8),
    delays_s=st.lists(st.floats(0.0, 0.4), min_size=1, max_size=60),
    period_s=st.sampled_from([0.1, 1.0, 60.0, 1800.0]),
)
def test_the_sender_s_own_messages_are_believed_for_hours(
    drift: float, ahead_s: float, delays_s: list[float], period_s: float
) -> None:
    clock = SenderClock()
    for number, delay_s in enumerate(delays_s):
        sent_s = 100.0 + number * period_s
        assert clock.hear(UTC_S + ahead_s + (1.0 + drift) * sent_s, sent_s + delay_s)


@given(age_s=st.floats(MAX_AGE_S + 0.5, 1e8), every_s=st.sampled_from([0.05, 0.5, 2.0]))
def test_recorded_messages_are_refused_as_long_as_the_sender_speaks(age_s: float, every_s: float) -> None:
    clock = SenderClock()
    for number in range(300):
        now_s = 0.1 * number
        assert clock.hear(UTC_S + now_s, now_s)
        if number % max(round(every_s / 0.1), 1) == 0:
            assert not clock.hear(UTC_S + now_s - age_s, now_s)
            assert not clock.hear(UTC_S + now_s + age_s, now_s), "nor does one from the future set the clock"


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_clock_that_was_set_is_believed_after_a_while(step_s: float) -> None:
    clock = SenderClock()
    assert clock.hear(UTC_S, 0.0)
    believed = [clock.hear(UTC_S + step_s + 0.1 * number, 0.1 * number) for number in range(100)]
    first = believed.index(True)
    assert 0.1 * first == pytest.approx(ANOTHER_CLOCK_S, abs=0.2)
    assert all(believed[first:])


@pytest.mark.parametrize("time_s", [float("nan"), float("inf"), 0.0, -1.0])
def test_no_time_is_no_recent_one(time_s: float) -> None:
    assert not SenderClock().hear(time_s, 10.0)


def test_an_answer_comes_after_its_question() -> None:
    clock = SenderClock()
    clock.hear(UTC_S, 0.0)
    assert clock.is_after(UTC_S + 10.1, 10.0)
    assert not clock.is_after(UTC_S + 9.9 - JITTER_S, 10.0)
