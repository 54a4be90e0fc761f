"""Record the output of processes during a run, with its time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple


class Line(NamedTuple):
    """Hold a line of the service's output, and its time, seconds after the run's start."""

    at_s: float
    text: str


class Restart(NamedTuple):
    """Hold when the service was killed by intent, and when it was ready again, seconds after the run's start.

    mono_s: of the kill, by the monotonic clock.
    """

    killed_s: float
    ready_s: float
    mono_s: float = math.nan


class Report(NamedTuple):
    """Hold a fake device's report: see sim_replay.fakes.device and sim_replay.fakes.vehicle_device."""

    at_s: float
    what: str
    details: Mapping[str, Any]
