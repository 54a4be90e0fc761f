"""What processes said during a run, and when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class Line(NamedTuple):
    """A line of the service's output, and when it came, seconds after the run's start."""

    at_s: float
    text: str


class Report(NamedTuple):
    """What a fake device said: see sim_replay.fakes.device and sim_replay.fakes.vehicle_device."""

    at_s: float
    what: str
    details: Mapping[str, Any]
