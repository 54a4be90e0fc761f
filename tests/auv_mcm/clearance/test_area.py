"""How the search of an area stands never reads as better than it is."""

from __future__ import annotations

import pytest

from auv_mcm.clearance.area import AreaState


@pytest.mark.parametrize(
    ("p", "required", "words"),
    [
        (0.899, 0.9, "0.89 of 0.90"),
        (0.9, 0.9, "0.90 of 0.90 reached"),
        (0.9527, 0.954, "0.952 of 0.954"),
        (0.956, 0.955, "0.956 of 0.955 reached"),
    ],
)
def test_a_clearance_reads_as_less_than_required_where_it_is_not_reached_alone(
    p: float, required: float, words: str
) -> None:
    assert AreaState(km2=1.0, required=required, p_detected=p, share=0.5).words() == f"clearance {words}"
