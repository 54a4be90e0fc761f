"""Configure two ports, and make the traffic of a sonar and a navigation unit."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.clock import Stamp
from auv_mcm.errors import HardwareError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config, parse_config
from drivers.navigation.nmea0183 import sentence
from drivers.navigation.sentences import Gga, Hdt, Vtg, body_of
from drivers.sonar.ping_messages import OsMonoProfile, encode

MONO_S: Final = 5000.0
UTC_S: Final = 1_700_000_000.0
POWER_UP_S: Final = 77.0  # what the sonar's counter shows at the beginning
INTERVAL_S: Final = 0.1
RANGE_M: Final = 30.0
SOUND_SPEED_MPS: Final = 1500.0
PORTS: Final = """
ports:
  - {name: sonar, link: "tcp://192.168.2.92:51200", device: ping_protocol, sonar: {range_m: 30}}
  - {name: gnss, link: "serial:///dev/ttyS0?baud=115200", device: nmea0183}
"""


def config_of(text: str = PORTS) -> Config:
    return parse_config(text, "vehicle.yaml")


class Collected:
    """Collect everything in a sink without bounds."""

    def __init__(self) -> None:
        self.events: list[SourceEvent] = []

    async def put(self, event: SourceEvent) -> None:
        self.events.append(event)

    def push(self, event: SourceEvent) -> None:
        self.events.append(event)


class Chunk(NamedTuple):
    port: str
    data: bytes
    stamp: Stamp


def stamp(time_s: float) -> Stamp:
    """time_s: since the beginning."""
    return Stamp(round((MONO_S + time_s) * 1e9), round((UTC_S + time_s) * 1e9))


def profile(
    number: int, channel: int, time_s: float, results: Any = (0, 21845, 43690, 65535), range_m: float = RANGE_M
) -> bytes:
    """Encode one side of one ping. results: (n,) uint16, 80 dB to full scale."""
    samples = np.asarray(results, dtype=np.uint16)
    millimetres = round(1e3 * range_m)
    clock_ms = round(1e3 * (POWER_UP_S + time_s)) % 2**32
    speed = round(10.0 * SOUND_SPEED_MPS)
    return encode(
        OsMonoProfile(
            number, 0, millimetres, clock_ms, 450_000, 3, speed, channel, 1e-4, 12.5, 80.0, 0.0, 0.0, 0.0, samples
        )
    )


def fix(
    time_s: float, latitude_deg: float, longitude_deg: float, heading_rad: float = 0.0, speed_mps: float = 2.0
) -> bytes:
    """Return the sentences of one fix."""
    clock_s = (UTC_S + time_s) % 86_400.0
    records = (Gga(clock_s, latitude_deg, longitude_deg, 1), Hdt(heading_rad), Vtg(heading_rad, speed_mps))
    return b"".join(sentence(body_of(record)) for record in records)


def traffic(n_pings: int, seed: int = 1) -> Iterator[Chunk]:
    """Northward at 2 m/s. Profiles arrive when the echoes are in, late by 0 to 3 ms."""
    random = np.random.Generator(np.random.PCG64(seed))
    frame = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
    for number in range(n_pings):
        time_s = number * INTERVAL_S
        latitude_deg, longitude_deg, _ = frame.to_geodetic([0.0, 2.0 * time_s, 0.0])
        yield Chunk("gnss", fix(time_s, float(latitude_deg), float(longitude_deg)), stamp(time_s + 1e-3))
        arrival_s = time_s + 2.0 * RANGE_M / SOUND_SPEED_MPS + random.uniform(0.0, 3e-3)
        for channel in (0, 1):
            arrival_s += 1e-4
            yield Chunk("sonar", profile(number, channel, time_s), stamp(arrival_s))


def time_of(number: int) -> float:
    """Return the UTC of the transmission of a ping."""
    return UTC_S + number * INTERVAL_S


def is_close(one_s: float, other_s: float, within_s: float) -> bool:
    return math.isclose(one_s, other_s, rel_tol=0.0, abs_tol=within_s)


class MemoryWire:
    """A wire in memory: what waits is read at once, and nothing while it is pulled. Children say what is written."""

    def __init__(self) -> None:
        self.note = ""
        self.has_unsent = False
        self.pause_s = 0.0
        self.plugged = True
        self.waiting: deque[Any] = deque()

    def fileno(self) -> int:
        return -1

    def read(self) -> list[Any]:
        if not self.plugged:
            raise HardwareError("the wire was pulled; plug it in again")
        items = list(self.waiting)
        self.waiting.clear()
        return items

    def flush(self) -> None: ...

    def on_silence(self) -> str:
        return "Look at the wire."

    def close(self) -> None: ...
