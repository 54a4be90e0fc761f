"""Check a computer whose UTC is set while the service runs."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from auv_mcm.errors import UsageError
from sim_replay.hil.scenario import HostClockStep, parse_scenario
from sim_replay.hil.stepping_service import SteppingClock, follow, main
from tests.hil.test_hil_scenario import SOUND
from tests.manual_clock import ManualClock


@pytest.mark.parametrize("by_s", [3600.0, -12.5])
def test_utc_steps_at_the_given_instant_and_monotonic_time_does_not(by_s: float) -> None:
    under = ManualClock(1000.0)
    clock = SteppingClock(under, by_s)
    under.advance_to(1005.0)
    assert clock.utc_s() == 1005.0
    follow(clock, io.StringIO("noise\nstart 4.5\n"), 2.0)
    for utc_s, steps in ((1006.0, False), (1006.5, True), (1100.0, True)):
        under.advance_to(utc_s)
        assert clock.utc_s() == utc_s + by_s * steps
        assert clock.monotonic_s() == utc_s - 1000.0


def test_what_the_service_refuses_is_refused_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    path = tmp_path / "vehicle.yaml"
    path.write_text("service: {source: nowhere}\n", "utf-8")
    with pytest.raises(UsageError, match=r"service.source 'nowhere'"):
        main(str(path), "1.0", "2.0")


def test_a_scenario_sets_when_the_clock_steps() -> None:
    text = SOUND + "host_clock_step: {at_s: 3.5, by_s: -7}\n"
    assert parse_scenario(text, "s.yaml").host_clock_step == HostClockStep(at_s=3.5, by_s=-7.0)
    with pytest.raises(UsageError, match=r"host_clock_step\.at_s"):
        parse_scenario(text.replace("3.5", "-3.5"), "s.yaml")
