"""Find what a run did not do although its scenario says so: without its fault, a run without harm proves nothing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from sim_replay.hil.evidence import Report
from sim_replay.hil.scenario import Scenario

# Faults of what a device sends, which is nothing more once its mission is over.
_OF_MESSAGES: Final = ("damage", "clock_step", "freeze", "offset", "nonsense", "misreport")


def undone(
    scenario: Scenario, reports: Mapping[str, Sequence[Report]], dead: Sequence[str], n_restarts: int, ended_s: float
) -> tuple[str, ...]:
    """List what the scenario says and the run did not do, in words.

    Parameters
    ----------
    scenario
        What was to be done.
    reports
        Of the fake devices, by name.
    dead
        Names of devices that ended before the run did.
    n_restarts
        How often the service was started again.
    ended_s
        When it had ended, s after the run's start.
    """
    problems = [*_not_begun(scenario, reports), *(f"{name} ended on the way" for name in dead)]
    if (n_planned := len(scenario.restarts_s)) > n_restarts:
        problems.append(f"the service was started again {n_restarts} of {n_planned} times")
    step = scenario.host_clock_step
    if step is not None and step.at_s > ended_s:
        problems.append(f"the host's clock did not step: the service had ended after {ended_s:.1f} s")
    return tuple(problems)


def _not_begun(scenario: Scenario, reports: Mapping[str, Sequence[Report]]) -> Iterator[str]:
    for name, device in scenario.devices.items():
        planned = Counter(str(fault.__struct_config__.tag) for fault in device.faults)
        done_s = next((report.at_s for report in reports[name] if report.what == "done"), math.inf)
        faults = [(report.details["do"], report.at_s) for report in reports[name] if report.what == "fault"]
        begun = Counter(do for do, at_s in faults if do not in _OF_MESSAGES or at_s <= done_s)
        for do, n in (planned - begun).items():
            when = " before its last message" if do in _OF_MESSAGES else ""
            yield f"{n} of {planned[do]} faults '{do}' of '{name}' did not begin{when}"
