"""Snippets keep what the eye can see."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.snippet import pack_snippet, unpack_snippet


@given(level_db=st.floats(-40.0, 23.5))
def test_levels_come_back_within_an_eighth_of_a_decibel(level_db: float) -> None:
    intensity = np.full((2, 3), 10.0 ** (level_db / 10.0))
    back_db = 10.0 * np.log10(unpack_snippet(pack_snippet(intensity)))
    np.testing.assert_allclose(back_db, level_db, rtol=0.0, atol=0.1251)


def test_no_echo_stays_no_echo_and_extremes_are_bounded() -> None:
    codes = pack_snippet(np.array([[0.0, -1.0, np.nan, 1e-30, 1e30, np.inf]]))
    assert codes.tolist() == [[0, 0, 0, 1, 255, 255]]
    assert unpack_snippet(codes)[0, :3].tolist() == [0.0, 0.0, 0.0]


def test_nothing_packs_to_nothing() -> None:
    assert pack_snippet(np.empty((0, 4))).shape == (0, 4)
