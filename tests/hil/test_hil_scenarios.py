"""Run the quick scenarios that ship: the real service between fake devices meets every expectation. All of them:
auv-mcm hil --all."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from sim_replay.hil.scenario import shipped
from tests.golden.answers import read_stored

# The longest first, for several at a time. One of each kind of fault, 20 s of processor time or less each. Vehicles on
# other wires, a service killed under a vehicle and a mission without faults are in `auv-mcm hil --all`; kills are in
# test_hil_kill.py, protocols in tests/drivers/vehicle.
QUICK = (
    "vehicle_imc",
    "vehicle_iver_no_floor",
    "vehicle_flood",
    "garbage",
    "nav_lost",
    "damage",
    "full_disk",
)
LIMIT_S = 600.0  # a hang; on a busy computer the mission of a vehicle waits


@pytest.mark.parametrize("name", QUICK)
def test_the_service_meets_every_expectation(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "auv_mcm", "hil", "--out", str(tmp_path), name]
    run = subprocess.run(
        command, timeout=LIMIT_S, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert (tmp_path / name / "verdict.json").exists(), run.stdout
    verdicts = json.loads((tmp_path / name / "verdict.json").read_bytes())
    assert [verdict for verdict in verdicts if not verdict["passed"]] == [], run.stdout
    stored = read_stored("scenarios")
    assert stored is not None
    assert [verdict["test"] for verdict in verdicts] == [each["test"] for each in stored[name]]
    assert run.returncode == 0
    assert not [path for path in (tmp_path / name).iterdir() if path.is_symlink()], "a port is left behind"


def test_quick_scenarios_ship() -> None:
    assert set(QUICK) <= set(shipped())
