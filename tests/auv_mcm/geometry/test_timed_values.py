"""A value read at one instant is, to the last bit, the one that is read at many."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.geometry.timed_values import Limits, TimedValues

LIMITS = Limits(bridge_s=2.0, fresh_s=1.0, look_ahead_s=0.5)
steps = st.lists(
    st.tuples(st.floats(0.01, 3.0), st.floats(-1e6, 1e6), st.floats(-1e3, 1e3), st.booleans()), max_size=30
)


@given(steps, st.floats(-3.0, 60.0), st.integers(0, 29), st.floats(0.0, 20.0))
def test_one_instant_is_read_as_many_are(
    steps: list[tuple[float, float, float, bool]], between_s: float, which: int, forgotten_s: float
) -> None:
    values, times = TimedValues(LIMITS, width=2), [1.7e9]
    for step_s, first, second, joined in steps:
        times.append(times[-1] + step_s)
        values.append(times[-1], (first, second), joined)
        if joined:  # read before it is put with the others, or not
            np.testing.assert_array_equal(values.at_one(times[-1]), (first, second))
    values.forget_before(1.7e9 + forgotten_s)
    for time_s in (1.7e9 + between_s, times[which % len(times)], times[-1]):
        found = values.at(np.array([time_s]))
        np.testing.assert_array_equal(values.at_one(time_s), np.where(found.fresh[0], found.values[0], np.nan))
