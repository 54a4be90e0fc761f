"""Floors of detection on three missions that this project did not make and fits nothing on: the quickest of ten."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from auv_mcm.settings.config import Config
from sim_replay.replay import replay

JURY = Path(__file__).parents[3] / "shared" / "jury"

pytestmark = pytest.mark.skipif(not JURY.is_dir(), reason=f"{JURY} with missions made elsewhere is not there")


class Floors(NamedTuple):
    """Pd at the default call, and that the best threshold reaches at 300 false alarms per km², at the minimum."""

    called: float
    at_300: float


FLOORS = {
    "line-wreck": Floors(8 / 16, 8 / 16),  # 9 and 9 of 16 on 2026-11-26
    "mines-practice": Floors(6 / 9, 7 / 9),  # 8 and 8 of 9
    "sim-wide-flat": Floors(12 / 16, 14 / 16),  # 14 and 15 of 16
}
MAX_CALLED_PER_KM2 = 310.0  # two alarms on the wreck's 0.0065 km²


def score(contacts: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Score by the judge that lies beside the missions."""
    spec = importlib.util.spec_from_file_location("judge", JURY / "judge.py")
    assert spec is not None
    assert spec.loader is not None
    judge = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(judge)
    found: dict[str, Any] = judge.score(contacts, truth)
    return found


@pytest.mark.parametrize("name", FLOORS)
def test_mines_are_found_and_called_on_missions_made_elsewhere(name: str, tmp_path: Path) -> None:
    mission = JURY / "missions" / name
    replay([mission / "mission.xtf"], tmp_path, Config())
    found = score(tmp_path / "contacts.geojson", json.loads((mission / "truth.json").read_text()))
    assert found["pd"] >= FLOORS[name].called
    assert found["pd300"] >= FLOORS[name].at_300
    assert found["fa"] <= MAX_CALLED_PER_KM2
