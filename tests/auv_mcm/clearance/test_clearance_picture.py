"""The picture of clearance: every cell is drawn where it lies, in the colour of what it holds."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from auv_mcm.clearance.clearance_picture import clearance_picture, clearance_png
from tests.make.records import clearance_of


def test_north_is_up_and_every_band_has_its_colour() -> None:
    drawn = clearance_picture(clearance_of([[0.1, 0.6], [0.95, 0.8]]))
    cell = 24
    centres = {
        (row, column): tuple(drawn[12 + (1 - row) * cell + 12, 12 + column * cell + 12])
        for row in range(2)
        for column in range(2)
    }
    assert len(set(centres.values())) == 4
    for colour in centres.values():
        # The key names it as well.
        assert (drawn[12 + 2 * cell + 12 :] == np.array(colour)).all(axis=-1).any()


def test_what_was_not_seen_is_blank() -> None:
    drawn = clearance_picture(clearance_of([[0.5, 0.5]], looks=np.array([[1, 0]], dtype=np.uint8)))
    assert tuple(drawn[24, 48]) == (238, 238, 238)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (700, 5), (1500, 1500)])
def test_maps_of_any_size_are_pictures(shape: tuple[int, int]) -> None:
    decoded = cv2.imdecode(np.frombuffer(clearance_png(clearance_of(np.full(shape, 0.5))), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert max(decoded.shape) < 1600
