"""The whole loop over virtual wires: what is found is told, looked at again and clearer then, and the vehicle is the vehicle's again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, TypeAlias

import pytest

Verdicts: TypeAlias = list[dict[str, Any]]

ATTEMPTS = 2
PATIENCE_S = 300.0


def failures(folder: Path, names: tuple[str, ...]) -> dict[str, Verdicts]:
    """What was not met in scenarios that run at once, by those where there is something."""
    command = [sys.executable, "-m", "auv_mcm", "hil", "--out", str(folder)]
    processes = [subprocess.Popen([*command, name], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for name in names]
    for process in processes:
        process.wait(PATIENCE_S)
    failed = {}
    for name in names:
        verdicts: Verdicts = json.loads((folder / name / "verdict.json").read_bytes())
        failed[name] = [verdict for verdict in verdicts if not verdict["passed"]]
    return {name: verdicts for name, verdicts in failed.items() if verdicts}


def was_too_slow(verdicts: Verdicts) -> bool:
    """Whether the computer could not keep up with a world in real time, so that the run shows nothing."""
    return any("kept up" in verdict["test"] for verdict in verdicts)


def is_left_to_chance(verdicts: Verdicts) -> bool:
    """Whether all that was not met is that the second look told more: where from it is had differs with the load of the computer, and a
    cylinder seen along its axis may look like two things."""
    return all("clearer" in verdict["test"] for verdict in verdicts)


@pytest.mark.parametrize("names", [("vehicle_imc", "vehicle_bluefin"), ("vehicle_can", "vehicle_service_killed")])
def test_a_contact_is_looked_at_again_and_the_vehicle_given_back(names: tuple[str, ...], tmp_path: Path) -> None:
    left = names
    for attempt in range(ATTEMPTS):
        failed = failures(tmp_path / str(attempt), left)
        again = attempt + 1 < ATTEMPTS
        assert all(was_too_slow(verdicts) or (again and is_left_to_chance(verdicts)) for verdicts in failed.values()), failed
        left = tuple(failed)
        if not left:
            return
    pytest.skip(f"this computer has too much else to do: {', '.join(left)} did not keep up")
