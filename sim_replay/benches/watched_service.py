"""Run the real service between a fake sonar and a fake unit of navigation, and look at it while it runs."""

from __future__ import annotations

import contextlib
import math
import os
import re
import threading
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from sim_replay.fakes.job import Device
from sim_replay.hil.run import SERVICE_LOG
from sim_replay.hil.scenario import ExitCode, Expectation, Read, Scenario
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import read_scene

FLOWN_MPS: Final = 12.0  # at a multiple of real time; faster, no navigation unit could report it
LONGEST_LEG_M: Final = 300.0
"""m of a leg."""
PING_RATE_HZ: Final = 10.0
"""Pings in a second of mission."""
TURN_M: Final = 81.0
"""m of a turn between two legs 70 m apart."""
POLL_S: Final = 0.02
"""s between looks at the service's output."""
HEALTH: Final = re.compile(
    r"^(\S+)Z INFO health pings=(\d+) .*contacts=(\d+) clutter=(\d+) .*ports=(\S+)", re.MULTILINE
)
"""A health line: time, pings, contacts, clutter, ports."""
STOPPING: Final = " INFO stopping: "
"""In the line with which the service answers a request to stop."""
SERVICE: Final[dict[str, Any]] = {
    "service": {"source": "ports"},
    "ports": [
        {"name": "sonar", "link": "{sonar}", "device": "ping_protocol", "sonar": {"range_m": 30, "n_samples": 400}},
        {"name": "nav", "link": "{nav}", "device": "nmea2000"},
    ],
}
"""A configuration of the service."""
SONAR_AND_CAN: Final = {
    "sonar": Device(device="ping_protocol", link="serial", baud=4_000_000),
    "nav": Device(device="nmea2000", link="slcan", baud=4_000_000, bus_bitrate=1_000_000),
}
"""A sonar at a serial port, and navigation on a CAN bus."""
_TARGET_EVERY_M: Final = 15.0  # m of a leg between targets


def said(folder: Path, text: str, over: threading.Event) -> bool:
    """Wait until a line of the service's output contains a text; False if the run was over before."""
    while not over.wait(POLL_S):
        with contextlib.suppress(FileNotFoundError):
            if text in console(folder):
                return True
    return False


def console(folder: Path) -> str:
    """Read what the service has printed so far. Raises FileNotFoundError before it has begun."""
    return (folder / SERVICE_LOG).read_text("utf-8", "replace")


def service_pid(folder: Path) -> int | None:
    """Find the process that serves the configuration in the folder."""
    configuration = os.fsencode(folder / "service.yaml")
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if configuration in path.read_bytes().split(b"\0"):
                return int(path.parent.name)
    return None


def health(console_lines: Sequence[str]) -> Iterator[tuple[float, int]]:
    """Read UTC and pings taken of each health line."""
    for line in console_lines:
        if (match := HEALTH.match(line)) is not None:
            yield datetime.fromisoformat(match[1]).replace(tzinfo=UTC).timestamp(), int(match[2])


def simulate_mission(folder: Path, duration_s: float, vehicle_mps: float) -> tuple[Path, float]:
    """Simulate a log of flat sand with targets on either side all along, about so long; return its real duration, s."""
    way_m = duration_s * vehicle_mps
    n_legs = math.ceil(way_m / LONGEST_LEG_M)
    leg_m = way_m / n_legs
    scene = {
        "name": "soak",
        "world": {"depth_m": 18, "relief_rms_m": 0.02, "patch_m": 40, "seabeds": [{"type": "sand"}]},
        "sonar": {"frequency_khz": 450, "range_m": 30, "n_samples": 400, "ping_rate_hz": PING_RATE_HZ},
        "track": {
            "altitude_m": 5,
            "speed_mps": vehicle_mps,
            "plan": {"pattern": "lawnmower", "heading_deg": 35, "n_legs": n_legs, "leg_m": leg_m, "spacing_m": 70},
        },
        "objects": [
            {"kind": "cylinder", "leg": leg, "along_m": along_m, "across_m": 14 * (-1) ** index, "azimuth_deg": 35}
            for leg in range(n_legs)
            for index, along_m in enumerate(np.arange(5.0, leg_m, _TARGET_EVERY_M).tolist())
        ],
    }
    path = folder / "soak.yaml"
    path.write_bytes(msgspec.yaml.encode(scene))
    simulated = simulate(read_scene(str(path)), folder)
    return simulated.log, simulated.duration_s


def read_mission(
    log: Path,
    duration_s: float,
    speed: float,
    service: dict[str, Any],
    patience_s: float,
    restarts_s: tuple[float, ...] = (),
    *,
    waits: bool = False,
    devices: dict[str, Device] | None = None,
) -> Read:
    """Follow the run of a mission to its end, and patience_s more; see `Scenario` for the rest.

    devices: `SONAR_AND_CAN` unless others are given.
    """
    scenario = Scenario(
        about="a long run",
        log=str(log.resolve()),
        speed=speed,
        run_s=duration_s / speed + patience_s,
        devices=devices or SONAR_AND_CAN,
        service=service,
        restarts_s=restarts_s,
        waits=waits,
        expectations=(Expectation(test="ends when stopped", expected=ExitCode()),),
    )
    return Read("soak", log.parent, scenario)
