"""Raise the ping rate of a live service until pings are lost: what gave first, and how it was reported.

The same track is flown at twice the ping rate each time, by fake devices on loopback; a mission at X times real time
sends X times as many pings and navigation samples over the same sea floor. Service, perception and devices share this
computer, so that a device may give first; then the row says so.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.shell.health.files import HEALTH, read_health
from auv_mcm.shell.health.record import Health
from sim_replay.benches.watched_service import FLOWN_MPS, PING_RATE_HZ, SERVICE, read_mission, simulate_mission
from sim_replay.fakes.job import Device
from sim_replay.hil.run import RESULTS, run_scenario
from sim_replay.hil.verdict import Evidence

RATES_HZ: Final = (20.0, 40.0, 80.0, 160.0, 320.0, 640.0)
"""Pings a second. A sonar of 30 m range can send 25 at most."""
_RUN_S: Final = 20.0  # s of each rate: four tiles of sea floor
_LOOK_S: Final = 0.1  # s between looks at the record of health
_HEALTH_PERIOD_S: Final = 0.5  # s between records
_PATIENCE_S: Final = 60.0  # s for a service that is behind to work off what waits
_NOTICE: Final = re.compile(r"^notice (?:\w+\.)*(\w+):")
_RATE_SERVICE: Final[dict[str, Any]] = {
    "service": {"source": "ports", "health_period_s": _HEALTH_PERIOD_S},
    "ports": [
        {**SERVICE["ports"][0]},
        {"name": "nav", "link": "{nav}", "device": "nmea0183"},
    ],
    "waterfall": {"tile_rows": 128},
}


class AtRate(NamedTuple):
    """Hold what one ping rate came to.

    n_sent: pings that the device sent; n_left_out: that it could not send in time. n_taken: by perception; n_dropped:
    by the queue before it; n_less_work: with less work done on them. n_waiting: pings in that queue, maximum; late_s:
    longest that the service's own loop was late. shares: of one processor, the maximum of service and of
    perception. reported: codes of notices and reasons of health, in the order of their first report.
    """

    rate_hz: float
    n_sent: int
    n_left_out: int
    n_taken: int
    n_dropped: int
    n_less_work: int
    n_waiting: int
    late_s: float
    shares: tuple[float, float]
    reported: tuple[str, ...]

    @property
    def gave(self) -> str:
        """Name what gave, the worst first; empty if nothing."""
        if self.n_dropped:
            return "perception: pings were dropped"
        if self.n_left_out:
            return "the fake device: it left pings out"
        if self.n_sent > self.n_taken:
            return "pings were lost without a count"
        if self.n_less_work:
            return "perception: work was shed"
        return ""


def at_rising_rates(rates_hz: Sequence[float], folder: Path) -> Iterator[AtRate]:
    """Fly at one rate after another; ends after the first that loses pings."""
    for rate_hz in rates_hz:
        place = folder / f"{rate_hz:g}-hz"
        place.mkdir()
        at_rate = _flown(rate_hz, place)
        yield at_rate
        if at_rate.n_dropped or at_rate.n_left_out:
            return


def outcome_of(rate_hz: float, evidence: Evidence, seen: Sequence[Health]) -> AtRate:
    """Sum up a run from its evidence and the records of health seen meanwhile."""
    sonar = next(
        (Counter(report.details) for report in evidence.reports.get("sonar", ()) if report.what == "counters"),
        Counter[str](),
    )
    counters = Counter(evidence.summary.get("counters", {}))
    values: dict[tuple[str, str], float] = {}
    reported: dict[str, None] = {}
    for health in seen:
        for part in health.parts:
            for name, value in part.values.items():
                values[part.name, name] = max(value, values.get((part.name, name), 0.0))
            if part.name == "perception":
                reported |= dict.fromkeys(part.reasons)
    for line in evidence.lines:
        reported |= dict.fromkeys(_NOTICE.findall(line.text))
    return AtRate(
        rate_hz=rate_hz,
        n_sent=sonar["device.events"],
        n_left_out=sonar["device.skipped"],
        n_taken=int(evidence.summary.get("pings", 0)),
        n_dropped=counters["service.ping_dropped"],
        n_less_work=counters["service.work_shed"],
        n_waiting=int(values.get(("perception", "queue_pings"), 0.0)),
        late_s=values.get(("service", "event_loop_late_s"), 0.0),
        shares=(
            values.get(("service", "processor_share"), 0.0),
            values.get(("perception", "processor_share"), 0.0),
        ),
        reported=tuple(reported),
    )


def _flown(rate_hz: float, folder: Path) -> AtRate:
    speed = rate_hz / PING_RATE_HZ
    log, duration_s = simulate_mission(folder, _RUN_S * speed, FLOWN_MPS / speed)
    devices = {
        "sonar": Device(device="ping_protocol", link="tcp"),
        "nav": Device(device="nmea0183", link="tcp"),
    }
    read = read_mission(log, duration_s, speed, _RATE_SERVICE, _PATIENCE_S, devices=devices)
    over = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        watching = pool.submit(_watched, folder / RESULTS / "latest" / HEALTH, over)
        try:
            evidence = run_scenario(read, folder, lambda line: None)
        finally:
            over.set()
        return outcome_of(rate_hz, evidence, watching.result())


def _watched(path: Path, over: threading.Event) -> list[Health]:
    """Keep each record of health until the run is over."""
    seen: list[Health] = []
    while not over.wait(_LOOK_S):
        with contextlib.suppress(BadInputError, UsageError, OSError):
            health = read_health(path)
            if not seen or health.utc_s != seen[-1].utc_s:
                seen.append(health)
    return seen
