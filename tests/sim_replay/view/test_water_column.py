"""The picture over slant range holds each ping's samples in the row of its time, dark to bright, whatever they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.records import EchoTrace, Ping
from auv_mcm.snippet import unpack_snippet
from sim_replay.view.water_column import WaterColumn
from sim_replay.view.waterfall_store import WaterfallStore
from tests.sim_replay.view.shown_missions import ROW_M, SPEED_MPS, START_S, tile

N_ROWS, COLUMN_M, RANGE_M = 64, 0.1, 20.0


def trace(first_return_m: float, spacing_m: float, kind: str) -> EchoTrace:
    slant_m = (np.arange(round(RANGE_M / spacing_m)) + 0.5) * spacing_m
    linear = np.where(slant_m < first_return_m, 1.0, 100.0)
    samples = {
        "amplitude": np.sqrt(linear),
        "counts": (20.0 * linear).astype(np.uint16),
        "decibels": 10.0 * np.log10(linear) - 60.0,
    }[kind]
    return EchoTrace(samples=samples, first_range_m=0.5 * spacing_m, spacing_m=spacing_m)


@settings(max_examples=20)
@given(
    first_return_m=st.floats(2.0, 12.0),
    spacing_m=st.sampled_from([0.02, 0.05, 0.13]),
    kind=st.sampled_from(["amplitude", "counts", "decibels"]),
    side=st.sampled_from(["port", "starboard"]),
)
def test_the_first_return_is_where_dark_turns_bright(
    first_return_m: float, spacing_m: float, kind: str, side: str
) -> None:
    store = WaterfallStore()
    column = WaterColumn(COLUMN_M, 100.0)
    rows = np.arange(N_ROWS)
    depths_m = first_return_m + 0.02 * rows
    for row, depth_m in zip(rows, depths_m, strict=True):
        echo = trace(float(depth_m), spacing_m, kind)
        time_s = START_S + (row + 0.5) * ROW_M / SPEED_MPS
        column.add_ping(Ping(number=int(row), time_s=time_s, port=echo, starboard=echo))
    column.add_tile(tile("port" if side == "port" else "starboard", 0, np.ones((N_ROWS, 8), dtype=np.float32)), store)
    picture = unpack_snippet(store.picture(0, 0, -1 if side == "port" else 0))[:N_ROWS]
    picture = picture[:, ::-1] if side == "port" else picture
    shown = int(RANGE_M / COLUMN_M)
    turns_m = (picture[:, :shown] > 1.0).argmax(axis=1) * COLUMN_M
    np.testing.assert_allclose(turns_m, depths_m, atol=COLUMN_M + spacing_m)
    assert picture[:, shown + 2 :].max() == 0.0


def test_rows_without_a_ping_and_sides_that_are_missing_stay_empty() -> None:
    store = WaterfallStore()
    column = WaterColumn(COLUMN_M, 100.0)
    made = tile("port", 0, np.ones((N_ROWS, 8), dtype=np.float32))
    column.add_tile(made, store)  # before any ping
    echo = trace(5.0, 0.05, "counts")
    column.add_ping(Ping(number=0, time_s=START_S, port=None, starboard=echo))
    column.add_tile(made, store)
    assert store.stop_row == 0
    column.add_ping(Ping(number=1, time_s=START_S - 60.0, port=echo, starboard=None))
    column.add_tile(made, store)
    assert not store.picture(0, 0, -1).any()


@pytest.mark.parametrize(
    "odd",
    [
        EchoTrace(samples=np.zeros(0), first_range_m=0.0, spacing_m=0.1),
        EchoTrace(samples=np.full(50, np.nan), first_range_m=0.0, spacing_m=0.1),
        EchoTrace(samples=np.ones(50, dtype=np.uint8), first_range_m=0.0, spacing_m=0.0),
        EchoTrace(samples=np.ones(50, dtype=np.uint8), first_range_m=0.0, spacing_m=1e9),
    ],
)
def test_odd_traces_are_drawn_as_far_as_they_can_be(odd: EchoTrace) -> None:
    column = WaterColumn(COLUMN_M, 100.0)
    column.add_ping(Ping(number=0, time_s=START_S, port=odd, starboard=odd))
    column.add_tile(tile("port", 0, np.ones((N_ROWS, 8), dtype=np.float32)), WaterfallStore())
