"""Run the quick scenarios that ship: the real service between fake devices meets every expectation. All of them:
auv-mcm hil --all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from auv_mcm.cli import main
from sim_replay.hil.scenario import shipped
from tests.golden.answers import read_stored

# The longest first, for several at a time: kills, a mission without faults, live JSF whose cable is pulled, a
# vehicle, and one of each kind of fault, 30 s of processor time or less each. A survey, a kill under a vehicle and
# vehicles on other wires fail where several run at once on two cores: they are in `auv-mcm hil --all`. Further kills
# are in test_hil_kill.py, protocols in tests/drivers/vehicle.
QUICK = (
    "cut_off",
    "vehicle_imc",
    "vehicle_iver_no_floor",
    "vehicle_flood",
    "clean",
    "jsf_tcp",
    "garbage",
    "nav_lost",
    "damage",
    "full_disk",
)


@pytest.mark.parametrize("name", QUICK)
def test_the_service_meets_every_expectation(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In this process, so that the bench is loaded once; service and devices are processes of their own."""
    code = main(["hil", "--out", str(tmp_path), name])
    said = capsys.readouterr()
    assert (tmp_path / name / "verdict.json").exists(), said.err
    verdicts = json.loads((tmp_path / name / "verdict.json").read_bytes())
    assert [verdict for verdict in verdicts if not verdict["passed"]] == [], said.out
    stored = read_stored("scenarios")
    assert stored is not None
    assert [verdict["test"] for verdict in verdicts] == [each["test"] for each in stored[name]]
    assert code == 0
    assert not [path for path in (tmp_path / name).iterdir() if path.is_symlink()], "a port is left behind"


def test_quick_scenarios_ship() -> None:
    assert set(QUICK) <= set(shipped())
