"""The bench of inversions: what it measures on one sea floor of a kind, and that it separates the goals from
noise."""

from __future__ import annotations

import numpy as np
import pytest

from sim_replay.augment.direct import invert
from sim_replay.augment.forward import SeafloorScene, render_image
from sim_replay.studies.inversion import FLOORS, figures, line_figures, made_up_scene, simulated_line, speckled


@pytest.mark.parametrize(("floor", "min_relief"), [("ripple", 0.85), ("rough", 0.7), ("slope", 0.7), ("flat", 0.5)])
def test_relief_comes_back_at_four_looks(floor: str, min_relief: float) -> None:
    kind = next(one for one in FLOORS if one == floor)
    scene = made_up_scene(kind, 2)
    found = figures(scene, speckled(scene, 4, 2), invert)
    assert found.relief > min_relief
    assert found.reflectivity > 0.8
    assert found.error < 0.4


def test_truth_itself_is_reported_as_perfect() -> None:
    scene = made_up_scene("ripple", 1)

    def reported(*_: object) -> SeafloorScene:
        return scene

    found = figures(scene, render_image(scene).intensity, reported)
    np.testing.assert_allclose(found[:5], (1.0, 1.0, 1.0, 0.0, 0.0), atol=1e-9)


def test_simulated_line_shows_the_relief_that_lies_there() -> None:
    picture, heights = simulated_line("ripple", 1, 4)
    found = line_figures(picture, heights, invert)
    assert found.relief > 0.6
    assert 0.5 < found.gain < 1.3
