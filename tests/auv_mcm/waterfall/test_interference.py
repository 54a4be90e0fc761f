"""Pulses of other sonars leave the picture, and nothing else does."""

from __future__ import annotations

from collections import Counter
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.kernels.interference import PINGS, lone_echoes, lone_echoes_numpy
from auv_mcm.records import Notice
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.interference import InterferenceFilter
from auv_mcm.waterfall.law_watch import law_of_pings
from tests.auv_mcm.waterfall.law_pings import intensity_pings, pings

Plane = NDArray[np.float64]
SHAPE: Final = (32, 600)
SPACING_M: Final = 0.14


def floor(n_blocks: int, looks: float = 1.5) -> list[Plane]:
    """Blocks of speckle whose mean is 1."""
    return list(np.random.default_rng(5).gamma(looks, 1.0 / looks, (n_blocks, *SHAPE)))


def struck(blocks: list[Plane], every: int = 2, level: float = 100.0) -> tuple[list[Plane], list[NDArray[np.bool_]]]:
    """Blocks with a pulse of six columns in every second ping, and where it lies."""
    random, dirty, where = np.random.default_rng(6), [], []
    for block in blocks:
        at = np.zeros(SHAPE, dtype=np.bool_)
        for ping in range(0, SHAPE[0], every):
            start = random.integers(20, SHAPE[1] - 20)
            at[ping, start : start + 6] = True
        dirty.append(np.where(at, level * random.uniform(0.5, 1.5, SHAPE), block))
        where.append(at)
    return dirty, where


def cleaned(blocks: list[Plane], spacing_m: float = SPACING_M) -> tuple[list[Plane], list[Notice], Counter[str]]:
    counters: Counter[str] = Counter()
    given_to = InterferenceFilter("port", counters)
    out, notices = [], []
    for number, block in enumerate(blocks):
        along_m = (number * SHAPE[0] + np.arange(len(block), dtype=np.float64)) * spacing_m
        picture, raised = given_to.cleaned(block, np.ones(block.shape, dtype=np.bool_), along_m)
        out.append(picture)
        notices += raised
    return out, notices, counters


def test_pulses_leave_the_picture_and_the_sea_floor_stays() -> None:
    dirty, where = struck(floor(12))
    out, notices, counters = cleaned(dirty)
    for before, after, at in zip(dirty, out, where, strict=True):
        assert np.mean(after[at] > 10.0) < 0.02
        assert after[at].mean() == pytest.approx(1.0, abs=0.3)
        away = ~(
            at | np.roll(at, 1, axis=1) | np.roll(at, -1, axis=1) | np.roll(at, 2, axis=1) | np.roll(at, -2, axis=1)
        )
        assert np.mean(before[away] != after[away]) < 0.002
    assert counters == {"quality.port_interference": pytest.approx(12 * 16, abs=8)}
    assert [notice.code for notice in notices] == ["quality.interference"]
    assert "port hears another sonar or echo sounder: 128 of 256 pings" in notices[0].text


def test_what_lies_on_the_sea_floor_stays_among_pulses() -> None:
    dirty, _ = struck(floor(4))
    for block in dirty:
        block[10:13, 300:304] = 200.0
    for after in cleaned(dirty)[0]:
        assert (after[10:13, 300:304] == 200.0).all()


@pytest.mark.parametrize("looks", [0.5, 1.0, 4.0])
def test_without_pulses_nothing_changes(looks: float) -> None:
    clean = floor(8, looks)
    for number, block in enumerate(clean):
        block[5 * (number % 5), 100:104] = 300.0  # a glint, in one ping of each
    out, notices, counters = cleaned(clean)
    assert all(before is after for before, after in zip(clean, out, strict=True))
    assert (notices, counters) == ([], {})


def test_pings_too_few_or_too_far_apart_stay_as_they_are_since_a_mine_may_show_in_one() -> None:
    dirty, _ = struck(floor(4))
    for blocks, spacing_m in ((dirty, 0.3), ([block[: PINGS - 1] for block in dirty], SPACING_M)):
        out, notices, counters = cleaned(blocks, spacing_m)
        assert all(before is after for before, after in zip(blocks, out, strict=True))
        assert (notices, counters) == ([], {})


def test_single_pings_between_large_shadows_stay() -> None:
    ping = np.arange(SHAPE[0])[:, np.newaxis]
    dark = [np.where((ping < 16) | (ping % 8 == 3), block, 1e-3 * block) for block in floor(6)]
    assert all(before is after for before, after in zip(dark, cleaned(dark)[0], strict=True))


@pytest.mark.parametrize("level", [100.0, 1e4])
@pytest.mark.parametrize("every", [1, 2, 3])
def test_pulses_do_not_change_what_samples_are_taken_for(every: int, level: float) -> None:
    random = np.random.default_rng(8)
    intensity = intensity_pings(1, "level")
    for ping in range(0, len(intensity), every):
        start = random.integers(0, intensity.shape[1] - 8)
        intensity[ping, start : start + 8] = level * random.gamma(1.0, 1.0, 8)
    law = law_of_pings(pings(np.sqrt(intensity)), SonarConfig())
    assert law.is_sure
    assert law.transfer.kind == "amplitude"
    assert law.transfer.intensity_power == pytest.approx(2.0, abs=0.1)


@pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")
@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(st.integers(PINGS, 12), st.integers(1, 60)))
@settings(deadline=None)
def test_c_finds_lone_echoes_as_numpy_does(seed: int, shape: tuple[int, int]) -> None:
    random = np.random.default_rng(seed)
    intensity = random.exponential(size=shape) * np.exp(random.uniform(-20.0, 20.0, shape[0]))[:, np.newaxis]
    intensity[random.random(shape) < 0.1] = 0.0
    intensity[random.random(shape) < 0.1] *= 1000.0
    for by_c, by_numpy in zip(
        lone_echoes(intensity, 10.0, 50.0), lone_echoes_numpy(intensity, 10.0, 50.0), strict=True
    ):
        np.testing.assert_array_equal(by_c, by_numpy, strict=True)
