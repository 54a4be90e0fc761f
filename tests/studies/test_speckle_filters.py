"""Filters keep the level of an even floor and smooth its speckle; pings keep everything but their samples."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.records import EchoTrace, Ping
from sim_replay.studies.sas_objects import draw
from sim_replay.studies.speckle_filters import FILTERS, filtered, filtered_pings, levels_db


@pytest.mark.parametrize("name", [name for name in FILTERS if name != "none"])
def test_a_filter_smooths_speckle_and_keeps_an_even_floor_even(name: str) -> None:
    speckle = np.random.default_rng(1).exponential(3.0, (200, 200)).astype(np.float32)
    smooth = FILTERS[name](speckle)
    assert smooth.std() / smooth.mean() < 0.8 * speckle.std() / speckle.mean()
    halves = smooth[:100].mean() / smooth[100:].mean()
    assert halves == pytest.approx(1.0, abs=0.05)


def test_lee_averages_where_there_is_speckle_alone_and_keeps_a_bright_point() -> None:
    speckle = np.random.default_rng(2).exponential(1.0, (60, 60)).astype(np.float32)
    speckle[30, 30] = 400.0
    smooth = FILTERS["Lee 5 x 5"](speckle)
    assert smooth[30, 30] > 150.0
    assert FILTERS["mean 3 x 3"](speckle)[30, 30] < 60.0


def test_a_mean_fills_the_shadow_and_dims_the_highlight() -> None:
    drawn = draw("cylinder", 0.1, 300.0, 3)
    bright_db, dark_db, speckle = levels_db(drawn)
    after = levels_db(filtered(drawn, FILTERS["mean 3 x 3"]))
    assert after[0] < bright_db
    assert after[1] > dark_db
    assert after[2] < speckle


def test_pings_keep_number_time_and_scale() -> None:
    random = np.random.default_rng(4)
    pings = [
        Ping(
            number=number,
            time_s=float(number),
            port=EchoTrace(samples=random.rayleigh(9.0, 80), first_range_m=0.1, spacing_m=0.05),
            starboard=EchoTrace(samples=random.rayleigh(9.0, 80), first_range_m=0.1, spacing_m=0.05),
        )
        for number in range(20)
    ]
    smoothed = filtered_pings(pings, FILTERS["mean 3 x 3"])
    assert [(ping.number, ping.time_s) for ping in smoothed] == [(ping.number, ping.time_s) for ping in pings]
    port = smoothed[5].port
    assert port is not None
    assert float(np.mean(port.samples**2)) == pytest.approx(2.0 * 9.0**2, rel=0.2)
