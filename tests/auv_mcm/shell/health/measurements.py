"""A payload that is well, to be made worse one measurement at a time."""

from __future__ import annotations

import math
from collections import Counter

from auv_mcm.shell.health.judge import Computer, Measured, Process, Vehicle, judge
from auv_mcm.shell.health.record import Health, Part
from auv_mcm.source import PortState, QuantityState, SourceHealth

PORT = PortState("sonar", "up", received_bytes=1000, discarded_bytes=0, age_s=0.2, ping_age_s=0.3)
POSITION = QuantityState("position", served_by="gps", age_s=0.1)
COMPUTER = Computer(free_bytes=5e9, temperature_c=50.0, hot_c=90.0)

WELL = Measured(
    now_s=10.0,
    uptime_s=10.0,
    is_ready=True,
    has_kernels=True,
    late_s=0.001,
    pings=100,
    queue_pings=2,
    queue_limit=512,
    in_flight=40,
    pings_in_flight=3,
    waits_on_purpose=False,
    contacts=4,
    clutter=7,
    counters=Counter(),
    source=SourceHealth((PORT,), (POSITION,)),
    is_recording=True,
    vehicle=Vehicle("vehicle=granted (by IMC)"),
    service=Process(busy_s=1.0, memory_bytes=1e8),
    perception=Process(busy_s=2.0, memory_bytes=2e8),
    computer=COMPUTER,
)
LATER = WELL._replace(
    now_s=15.0,
    uptime_s=15.0,
    pings=150,
    source=SourceHealth((PORT._replace(received_bytes=6000),), (POSITION,)),
    service=Process(busy_s=1.5, memory_bytes=1e8),
    perception=Process(busy_s=4.5, memory_bytes=2e8),
)


def part(name: str, now: Measured = LATER, before: Measured = WELL) -> Part:
    """Judge, and give one part."""
    return next(part for part in judge(now, before) if part.name == name)


def record(now: Measured = LATER, before: Measured = WELL, utc_s: float = 1.8e9) -> Health:
    """A record of health of these measurements."""
    return Health(version="1.2.3", session="results/session-1", utc_s=utc_s, period_s=5.0, parts=judge(now, before))


NEVER = math.inf
