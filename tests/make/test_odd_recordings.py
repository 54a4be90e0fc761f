"""Odd recordings of one line: in the right place on the right side, or a notice names what is odd."""

from __future__ import annotations

import pytest

from tests.make.odd_line import faults, sound
from tests.make.odd_recordings import PROPERTIES, draw, run, silent_faults


def test_the_sound_line_is_right() -> None:
    assert faults(sound()) == []


@pytest.mark.parametrize("seed", range(7 * len(PROPERTIES)))
def test_no_odd_recording_is_silently_wrong(seed: int) -> None:
    pytest.importorskip("pyproj", reason="pyproj of the bench extra is not installed")
    odd = draw(seed)
    assert silent_faults(odd, run(odd)) == [], str(odd)
