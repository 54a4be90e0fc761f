"""Places counted by range and strength: each once, measured or gated."""

from __future__ import annotations

from typing import Any

from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.detect.gate import Forecast, Gate
from auv_mcm.detect.place_counts import RANGE_BAND_M, STRENGTH_STEP, PlaceCounts
from auv_mcm.settings.config import Config
from tests.auv_mcm.detect.drawn_cascade import MODEL
from tests.auv_mcm.detect.scene_tiles import COLUMN_M, make_tile, speckle

NOTHING_PASSES = Forecast(offset=-900.0, weights={}, margin_nats=0.0)


def n_places(table: dict[str, Any]) -> int:
    return sum(n for band in table["counts"].values() for n in band.values())


def test_every_place_is_counted_once_in_its_band_and_step() -> None:
    plane = speckle(3, (180, 320), spread_pixels=1.0)
    plane[88:93, 197:204] *= 20.0
    plane[88:93, 204:234] *= 0.02
    tile = make_tile(plane)
    found = detect_tile(tile, Config(), MODEL)
    counts = PlaceCounts()
    counts.add(tile, found)
    table = counts.table()
    assert n_places(table) == len(found.detections) > 0
    best = found.detections[0]
    band = f"{best.column * COLUMN_M // RANGE_BAND_M * RANGE_BAND_M:g}"
    assert table["counts"][band][f"{best.strength // STRENGTH_STEP * STRENGTH_STEP:g}"] >= 1


def test_places_that_the_gate_drops_are_counted_like_those_that_it_leaves() -> None:
    tile = make_tile(speckle(3, (180, 320), spread_pixels=1.0))
    everything = detect_tile(tile, Config())
    gated = detect_tile(tile, Config(), gate=Gate(fitted_on="nothing", both=NOTHING_PASSES, contrast=NOTHING_PASSES))
    assert gated.detections == ()
    one, other = PlaceCounts(), PlaceCounts()
    one.add(tile, everything)
    other.add(tile, gated)
    assert n_places(one.table()) == n_places(other.table())
