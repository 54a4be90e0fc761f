"""Plain measures: finite whatever was measured or was not."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.details import detection_details
from tests.auv_mcm.classify.drawn_looks import detection

anything = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf])


@given(
    st.fixed_dictionaries(
        dict.fromkeys(("ground_range_m", "altitude_m", "length_m", "height_m", "shadow_length_m"), anything)
    )
)
def test_any_detection_is_described_by_finite_numbers(measured: dict[str, float]) -> None:
    assert all(map(math.isfinite, detection_details(detection(**measured)).values()))
