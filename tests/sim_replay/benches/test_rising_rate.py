"""A run at one ping rate is summed up by what gave first and by what reported it."""

from __future__ import annotations

import pytest

from auv_mcm.shell.health.record import Health, Part
from sim_replay.benches.rising_rate import outcome_of
from sim_replay.hil.evidence import Line, Report
from sim_replay.hil.verdict import Evidence

SHED = "notice service.work_shed: perception is behind, 138 pings wait"


def evidence(counters: dict[str, int], *lines: str, n_taken: int = 100, n_left_out: int = 0) -> Evidence:
    return Evidence(
        exit_code=0,
        lines=[Line(0.0, line) for line in lines],
        reports={"sonar": [Report(0.0, "counters", {"device.events": 100, "device.skipped": n_left_out})]},
        summary={"counters": counters, "pings": n_taken},
        contacts=(),
        targets=(),
        replayed=None,
    )


def health(n_waiting: int, *reasons: str) -> Health:
    perception = Part(name="perception", state="normal", reasons=reasons, values={"queue_pings": n_waiting})
    return Health(version="0", session="s", utc_s=0.0, period_s=0.5, parts=(perception,))


@pytest.mark.parametrize(
    ("run", "gave"),
    [
        (evidence({}), ""),
        (evidence({"service.work_shed": 5}, SHED), "perception: work was shed"),
        (evidence({"service.ping_dropped": 2, "service.work_shed": 5}, n_taken=98), "perception: pings were dropped"),
        (evidence({}, n_taken=90, n_left_out=10), "the fake device: it left pings out"),
        (evidence({}, n_taken=99), "pings were lost without a count"),
    ],
)
def test_the_worst_that_gave_is_named(run: Evidence, gave: str) -> None:
    assert outcome_of(640.0, run, []).gave == gave


def test_reports_are_codes_of_notices_and_reasons_of_health_and_the_longest_queue_counts() -> None:
    run = outcome_of(
        640.0, evidence({"service.work_shed": 5}, SHED), [health(3), health(40, "perception_behind"), health(7)]
    )
    assert run.reported == ("perception_behind", "work_shed")
    assert run.n_waiting == 40
