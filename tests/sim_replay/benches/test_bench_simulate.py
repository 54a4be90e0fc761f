"""The bench of the simulator runs to its end and finds shadows where they are."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_figures_come_for_every_step() -> None:
    command = [sys.executable, "-m", "auv_mcm", "bench", "simulate", "--repeat", "1", "--minutes", "0.05"]
    printed = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True).stdout
    for step in (
        "numpy: rays",
        "numpy: rays, speckle, 16-bit recorder",
        "numpy: 5 rays per ping",
        "sea floor from scratch",
    ):
        (cost_ms,) = re.findall(rf"^ +{re.escape(step)} +([\d.]+)", printed, re.MULTILINE)
        assert float(cost_ms) > 0.0
    errors = re.findall(r"^ +([\d.]+) cm +([\d.]+) +([\d.]+)", printed, re.MULTILINE)
    assert [cell for cell, *_ in errors] == ["10.0", "5.0", "2.5"]
    assert all(float(in_cells) < 0.6 for *_, in_cells in errors)
    assert re.search(r"mission of .* 36 pings .* x real time, peak memory \d+ MB", printed)
