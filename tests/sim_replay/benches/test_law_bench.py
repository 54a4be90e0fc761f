"""A small part of the matrix of recorders, on floors and seeds that nothing was set on; `auv-mcm bench law` judges all
of it."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from sim_replay.benches.law import (
    FIRST_SEED,
    STORES,
    WITHIN,
    Store,
    decibel_errors,
    floor_intensity,
    interval_coverage,
    judge_law,
    print_tables,
    stored,
)
from sim_replay.text_tables import columns

SEED = FIRST_SEED + 900


def test_recorders_are_recognised_on_floors_that_nothing_was_set_on() -> None:
    judged = []
    for scene, looks in (("flat", 1), ("seagrass", 4), ("boulders", 2), ("shallow", 8)):
        intensity = floor_intensity(scene, SEED, looks, n_pings=256)
        chosen = [store for store in STORES if store.db_per_count in (None, 0.3) and store.clips == (looks in (1, 4))]
        judged += [judge_law(scene, SEED, looks, store, intensity) for store in chosen]
    assert [(m.scene, m.store, m.ended.kind) for m in judged if m.ended.kind != m.store.law] == []
    assert [(m.scene, m.store) for m in judged if m.doubts] == []
    errors = np.abs(decibel_errors(judged))
    assert len(errors) == 8
    assert np.median(errors) < 0.1
    assert np.mean(errors <= WITHIN) >= 0.9
    assert interval_coverage(judged) >= 0.85


def test_every_combination_is_stored_once_and_as_its_law_says() -> None:
    assert len(set(STORES)) == len(STORES) == 24
    intensity = np.full((2, 2, 40), 1.0)
    intensity[..., 30] = 100.0
    for law, bits, clips in product(("amplitude", "intensity"), (8, 16), (False, True)):
        counts = stored(intensity, Store(law, None, bits, clips)).astype(float)  # type: ignore[arg-type]  # of a product of strings
        expected = 10.0 if law == "amplitude" else 100.0
        full = counts[..., 0].max()
        assert counts[0, 0, 30] == pytest.approx(min(expected * counts[0, 0, 20], full), rel=0.02)
    counts = stored(intensity, Store("log", 0.4, 8, False)).astype(float)
    assert counts[0, 0, 30] - counts[0, 0, 20] == pytest.approx(20.0 / 0.4, abs=1.0)


def test_the_table_names_every_law_and_floor(capsys: pytest.CaptureFixture[str]) -> None:
    intensity = floor_intensity("flat", SEED, 1, n_pings=64)
    print_tables([judge_law("flat", SEED, 1, store, intensity) for store in (STORES[0], STORES[-1])], columns)
    out = capsys.readouterr().out
    for name in (
        "all",
        "amplitude",
        "log 0.5",
        "1 looks",
        "8 bits, not clipping",
        "flat",
        "within 15 %",
        "interval holds",
        "processor time",
    ):
        assert name in out


def test_decibels_hold_where_texture_grows_faster_than_the_distance_of_pings() -> None:
    """A wide beam smooths texture along the track: it grows threefold from neighbouring to every second ping.

    Taken for speckle that lasts over pings, it made decibels 22 and 40 % too many.
    """
    intensity = floor_intensity("deep", 7101, 8)
    for clips in (False, True):
        judged = judge_law("deep", 7101, 8, Store("log", 0.2, 8, clips), intensity.copy())
        assert judged.ended.db_per_count == pytest.approx(0.2, rel=WITHIN)
        assert judged.db_interval[0] < 0.2 < judged.db_interval[1]
