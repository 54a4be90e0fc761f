"""Check that the classifier of the augmentation bench separates what differs and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from sim_replay.benches.augment import ChipStatistics, discriminate, statistics_of


def chips(shift: float, n: int = 400) -> ChipStatistics:
    """Speckle images of four missions, every other one brighter by `shift` nepers in its middle."""
    random = np.random.Generator(np.random.PCG64(4))
    embedded = np.arange(n) % 2 == 1
    rows = []
    for one in embedded:
        image = np.log(random.exponential(size=(29, 40)))
        image[12:17, 10:20] += shift * one
        rows.append(statistics_of(image))
    return ChipStatistics(np.array(rows), embedded, np.arange(n) // (n // 4))


def test_images_of_one_law_cannot_be_separated() -> None:
    verdict = discriminate(chips(0.0))
    assert verdict.accuracy == pytest.approx(0.5, abs=3.0 * verdict.sigma)
    assert verdict.n_chips == 400


def test_a_bright_spot_is_separated() -> None:
    assert discriminate(chips(2.5)).accuracy > 0.95
