"""The load bench: every floor goes through the chain, and a ledger on disk loses no contact."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.records import NavSample, Ping
from sim_replay.benches.load import FLOORS, floor_cost, floor_events, ledger_steps


@pytest.mark.parametrize("floor", FLOORS)
def test_every_floor_goes_through_the_chain_without_a_defect(floor: str) -> None:
    cost = floor_cost(floor, 160, 0.05)
    assert len(cost.ping_ms) == 160
    assert not [code for code in cost.notices if "defect" in code or "failed" in code]


def test_a_floor_is_a_straight_line_of_pings_with_navigation() -> None:
    events = list(floor_events("bare", 3))
    assert [type(event) for event in events] == [NavSample, Ping] * 3


def test_every_contact_of_a_ledger_on_disk_is_in_the_results(tmp_path: Path) -> None:
    steps, _, n_bytes = ledger_steps(400, tmp_path)
    assert [step.n_contacts for step in steps] == [40, 400]
    assert steps[0].disk_bytes < steps[1].disk_bytes
    assert n_bytes > 100_000
