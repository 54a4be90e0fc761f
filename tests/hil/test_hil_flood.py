"""A live flood of the bytes that cost most, from the vehicle's own address: `auv-mcm hil vehicle_flood` shows the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

PATIENCE_S = 400.0


def test_a_flooded_wire_stops_neither_the_mission_nor_its_end(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "auv_mcm", "hil", "--out", str(tmp_path), "vehicle_flood"]
    run = subprocess.run(command, timeout=PATIENCE_S, capture_output=True, text=True, check=False)
    verdicts = json.loads((tmp_path / "vehicle_flood" / "verdict.json").read_bytes())
    assert [verdict for verdict in verdicts if not verdict["passed"]] == [], run.stdout
    assert run.returncode == 0
    assert "and says so at once" in {verdict["test"] for verdict in verdicts}
