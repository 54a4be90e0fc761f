"""A mission that hears an echo sounder finds what it finds without, by replay and score as shipped.

Pulses of 0.4 m, 20 dB above the middle sample, are 35 m of range apart and move from ping to ping. Measured on a leg of
`flat`: 36 of 38 targets with 2 false alarms without, 35 with 3 beside pulses, and 26 with none where they stay in the
picture; on one of `ripple` 32 of 40, 31 and 20. Pulses of 40 dB are clipped: 36 of `flat` with 2 beside them.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import structs

from auv_mcm.settings.config import Config
from sim_replay.replay import replay
from sim_replay.scoring import score_files
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Fault
from sim_replay.simulator.scene_file import read_scene
from tests.accuracy.test_accuracy import LIMITS, THRESHOLD, short


@pytest.mark.parametrize("gain_db", [20.0, 40.0])
def test_an_echo_sounder_costs_few_mines_and_raises_no_flood(tmp_path: Path, gain_db: float) -> None:
    sounder = Fault(kind="interference", at_ping=0, n_pings=10_000, gain_db=gain_db)
    simulated = simulate(structs.replace(short(read_scene("flat")), faults=(sounder,)), tmp_path)
    summary = replay([simulated.log], tmp_path / "results", Config())
    assert [notice["code"] for notice in summary["notices"]] == ["quality.interference"] * 2
    scored = score_files([tmp_path / "results" / "contacts.geojson", simulated.truth], threshold=THRESHOLD)
    assert (scored.at_threshold.pd.value or 0.0) >= LIMITS["flat"].min_pd
    assert (scored.at_threshold.false_alarms.per_km2 or 0.0) <= LIMITS["flat"].max_false_alarms_per_km2
