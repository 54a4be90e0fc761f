"""Judge the health of each part from two measurements, a period apart."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, NamedTuple

from auv_mcm.shell.check.host import NEEDED_BYTES, PLENTY_BYTES
from auv_mcm.shell.health.record import Part
from auv_mcm.source import SourceHealth

_NO_VEHICLE_S: Final = 10.0  # s after the start in which a vehicle may be silent: the slowest wire's 5 s twice
_NO_PING_S: Final = 10.0  # s without a ping: sound takes 7 s to 5 km and back, beyond every side scan


class Process(NamedTuple):
    """Measure a process. busy_s: processor time it took so far, s."""

    busy_s: float
    memory_bytes: float


class Computer(NamedTuple):
    """Measure the computer; what is not known is NaN. hot_c: from which on the kernel slows the processor down."""

    free_bytes: float
    temperature_c: float
    hot_c: float


class Vehicle(NamedTuple):
    """Describe the vehicle. words: who has control and what was refused. is_silent: it says nothing understood."""

    words: str
    is_silent: bool = False


class Measured(NamedTuple):
    """Hold what the service measures of itself at one moment, monotonic time `now_s`.

    late_s: how late the event loop woke up at most since the last measurement. pings_in_flight: of the messages in
    flight. counters: of the service and of its recorder. waits_on_purpose: the source waits for perception. source:
    None for one without ports. vehicle: None without one. service, perception: their processes.
    """

    now_s: float
    uptime_s: float
    is_ready: bool
    has_kernels: bool
    late_s: float
    pings: int
    queue_pings: int
    queue_limit: int
    in_flight: int
    pings_in_flight: int
    waits_on_purpose: bool
    contacts: int
    clutter: int
    counters: Counter[str]
    source: SourceHealth | None
    is_recording: bool
    vehicle: Vehicle | None
    service: Process | None
    perception: Process | None
    computer: Computer


def judge(now: Measured, before: Measured) -> tuple[Part, ...]:
    """Judge every part. `before` is the last measurement, or `now` itself at the first."""
    span_s = now.now_s - before.now_s
    return (
        _service(now, before, span_s),
        _perception(now, before, span_s),
        *_ports(now, before, span_s),
        *_navigation(now),
        *_recording(now, before),
        *_vehicle(now),
        *_computer(now.computer),
    )


def _service(now: Measured, before: Measured, span_s: float) -> Part:
    failed = now.counters["service.journal_failed"] + now.counters["service.early_journal_failed"]
    failed_before = before.counters["service.journal_failed"] + before.counters["service.early_journal_failed"]
    reasons = []
    if failed > failed_before:
        reasons.append("journal_failed")
    if not now.is_ready:
        reasons.append("starting")
    return Part(
        name="service",
        state="fault" if "journal_failed" in reasons else "boot" if reasons else "normal",
        reasons=tuple(reasons),
        values=_known(
            uptime_s=now.uptime_s,
            event_loop_late_s=now.late_s,
            contacts=now.contacts,
            clutter=now.clutter,
            **_process(now.service, before.service, span_s),
        ),
    )


def _perception(now: Measured, before: Measured, span_s: float) -> Part:
    dropped, shed, restarted = "service.ping_dropped", "service.work_shed", "perception.restarted"
    faults, flaws = [], []
    # A lossless source, such as a recorded mission, waits on purpose while perception works.
    if not now.waits_on_purpose:
        if now.counters[dropped] > before.counters[dropped] or 2 * now.queue_pings > now.queue_limit:
            faults.append("perception_behind")
        if span_s > 0.0 and now.pings == before.pings and now.in_flight and now.queue_pings:
            faults.append("perception_stalled")
    if now.counters[shed] > before.counters[shed]:
        flaws.append("work_shed")
    if now.counters[restarted] > before.counters[restarted]:
        flaws.append("perception_restarted")
    if not now.has_kernels:
        flaws.append("no_kernels")
    # Perception that becomes ready brings the pings of the runs before.
    rate_hz = (now.pings - before.pings) / span_s if span_s > 0.0 and before.is_ready else math.nan
    waiting = now.queue_pings + now.pings_in_flight
    return Part(
        name="perception",
        state="boot" if not now.is_ready else "fault" if faults else "degraded" if flaws else "normal",
        reasons=(*faults, *flaws),
        values=_known(
            pings_total=now.pings,
            pings_hz=rate_hz,
            pings_dropped_total=now.counters[dropped],
            pings_with_less_work_total=now.counters[shed],
            queue_pings=now.queue_pings,
            queue_pings_limit=now.queue_limit,
            messages_in_flight=now.in_flight,
            delay_s=waiting / rate_hz if rate_hz > 0.0 else math.nan,
            **_process(now.perception, before.perception, span_s),
        ),
    )


def _ports(now: Measured, before: Measured, span_s: float) -> list[Part]:
    if now.source is None:
        return []
    earlier = {} if before.source is None else {port.name: port for port in before.source.ports}
    parts = []
    for port in now.source.ports:
        last = earlier.get(port.name, port)
        faults = [] if port.state == "up" else [f"port_{port.state}"]
        if port.state == "up" and min(port.ping_age_s, now.uptime_s) > _NO_PING_S:
            faults.append("no_pings")
        flaws = ["port_discards"] if port.discarded_bytes > last.discarded_bytes else []
        parts.append(
            Part(
                name=f"port.{port.name}",
                state="fault" if faults else "degraded" if flaws else "normal",
                reasons=(*faults, *flaws),
                values=_known(
                    received_bytes_total=port.received_bytes,
                    received_bytes_hz=(port.received_bytes - last.received_bytes) / span_s if span_s > 0 else math.nan,
                    age_s=port.age_s,
                    ping_age_s=port.ping_age_s,
                ),
            )
        )
    return parts


def _navigation(now: Measured) -> list[Part]:
    if now.source is None:
        return []
    parts = []
    for quantity in now.source.quantities:
        is_lost = not quantity.served_by
        is_position = quantity.name == "position"
        reason = "position_lost" if is_position else "quantity_lost"
        parts.append(
            Part(
                name=f"navigation.{quantity.name}",
                state="normal" if not is_lost else "fault" if is_position else "degraded",
                reasons=(reason,) if is_lost else (),
                words=quantity.served_by,
                values=_known(age_s=quantity.age_s),
            )
        )
    return parts


def _recording(now: Measured, before: Measured) -> list[Part]:
    if not now.is_recording:
        return []
    lost = now.counters["session.bytes_lost"]
    is_losing = lost > before.counters["session.bytes_lost"]
    return [
        Part(
            name="recording",
            state="degraded" if is_losing else "normal",
            reasons=("recording_incomplete",) if is_losing else (),
            values=_known(recorded_bytes_total=now.counters["session.bytes_recorded"], lost_bytes_total=lost),
        )
    ]


def _vehicle(now: Measured) -> list[Part]:
    """Show the state of control, and whether the vehicle speaks; the wire itself is judged as a port."""
    if now.vehicle is None:
        return []
    reasons = ("vehicle_silent",) if now.vehicle.is_silent and now.uptime_s > _NO_VEHICLE_S else ()
    return [Part(name="vehicle", state="degraded" if reasons else "normal", reasons=reasons, words=now.vehicle.words)]


def _computer(computer: Computer) -> list[Part]:
    free = computer.free_bytes
    low = "disk_full" if free < NEEDED_BYTES else "disk_low" if free < PLENTY_BYTES else ""
    is_hot = computer.temperature_c >= computer.hot_c
    return [
        Part(
            name="disk",
            state="fault" if low == "disk_full" else "degraded" if low else "normal",
            reasons=(low,) if low else (),
            values=_known(free_bytes=free),
        ),
        Part(
            name="computer",
            state="degraded" if is_hot else "normal",
            reasons=("hot",) if is_hot else (),
            values=_known(temperature_c=computer.temperature_c),
        ),
    ]


def _process(now: Process | None, before: Process | None, span_s: float) -> dict[str, float]:
    if now is None:
        return {}
    # A process that was started anew has taken less than the one before.
    busy_s = math.nan if before is None or now.busy_s < before.busy_s else now.busy_s - before.busy_s
    return {"processor_share": busy_s / span_s if span_s > 0.0 else math.nan, "memory_bytes": now.memory_bytes}


def _known(**values: float) -> dict[str, float]:
    """Keep the values that are known, rounded to what anyone reads."""
    return {name: round(value, 3) for name, value in values.items() if math.isfinite(value)}
