"""Mines embedded in recorded synthetic-aperture pictures: what is kept, the shadow, and the tone map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.errors import BadInputError
from sim_replay.studies.embedded_snippets import Floor, embed, magnitude, noise_of, recorded_floors, tone_of
from sim_replay.studies.sas_objects import speckled

PIXEL_M = 0.05  # the faster to draw
NOISE = 0.02


def flat(seed: int = 1, shape: tuple[int, int] = (425, 512)) -> Floor:
    return Floor("flat", speckled(np.ones(shape), np.random.Generator(np.random.PCG64(seed))))


def test_recorded_floor_is_kept_but_for_the_object_and_its_shadow() -> None:
    floor = flat()
    drawn = embed("sphere", PIXEL_M, floor, NOISE, 3)
    region, truth = drawn.region.intensity, drawn.truth
    kept = np.ones(truth.shape, dtype=np.bool_)
    rows, columns = np.nonzero(truth != BACKGROUND)
    kept[rows.min() - 3 : rows.max() + 4, columns.min() - 3 : columns.max() + 4] = False
    # the picture's own samples, at one level, somewhere in it
    corner = region[:8, :8]
    assert kept[:8, :8].all()
    shares = [
        floor.intensity[top : top + 8, left : left + 8] / corner
        for top in range(floor.intensity.shape[0] - 8)
        for left in range(floor.intensity.shape[1] - 8)
        if abs(floor.intensity[top, left] / corner[0, 0] - floor.intensity[top, left + 1] / corner[0, 1]) < 1e-9
    ]
    assert any(np.ptp(share) < 1e-9 for share in shares)
    assert region[kept].mean() == pytest.approx(1.0, abs=0.1)


def test_the_shadow_is_noise_and_the_highlight_bright() -> None:
    drawn = embed("sphere", PIXEL_M, flat(), NOISE, 3)
    region, truth = drawn.region.intensity, drawn.truth
    assert region[truth == HIGHLIGHT].mean() > 2.0
    assert np.median(region[truth == SHADOW]) < 4.0 * NOISE


def test_the_tone_map_of_a_picture_of_speckle_is_found() -> None:
    amplitude = np.sqrt(flat(2).intensity)
    share = amplitude / amplitude.max()
    for tone in (3.0, 20.0):
        counts = np.round(255.0 * tone * share / ((tone - 1.0) * share + 1.0)).astype(np.uint8)
        assert tone_of(counts) == pytest.approx(tone, rel=0.3)
    assert magnitude(np.array([0, 255], dtype=np.uint8), 5.0).tolist() == [0.0, 1.0]


def test_noise_is_that_of_the_darkest_places() -> None:
    floor = flat()
    floor.intensity[100:130, 100:130] *= 0.03
    assert noise_of([floor, flat(5)]) == pytest.approx(0.03, rel=0.3)


def test_a_picture_too_small_and_a_folder_without_any_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"flat is smaller than \d+ x \d+ pixels"):
        embed("sphere", PIXEL_M, flat(1, (40, 40)), NOISE, 3)
    with pytest.raises(BadInputError, match="--pictures"):
        recorded_floors(tmp_path)
