"""Fixes of several units along a survey, and what merging makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from auv_mcm.records import NavSample, Notice
from auv_mcm.settings.port_settings import NavUnitSettings
from drivers.navigation.corrections import moved, offset_m
from drivers.navigation.merge import Event, NavMerge
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from tests.drivers.navigation.nav_damage import T0, at

HOME = (54.0, 10.0)


def place(east_m: float, north_m: float) -> dict[str, float]:
    latitude_deg, longitude_deg = moved(*HOME, east_m, north_m)
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}


def fix(source: str, seconds: float, **reported: Any) -> NavFix:
    return NavFix(source=source, received=at(seconds), **reported)


def merge(recover_s: float = 5.0, **units: NavUnitSettings) -> NavMerge:
    return NavMerge(NavMergeSettings(units=units, recover_s=recover_s))


def run(merged: NavMerge, fixes: Iterable[NavFix]) -> tuple[list[NavSample], list[Notice]]:
    """Everything that comes out, the fixes put in the order of their arrival."""
    events: list[Event] = []
    for one in sorted(fixes, key=lambda one: one.received.mono_ns):
        events += merged.feed(one)
    events += merged.finish()
    return [event for event in events if isinstance(event, NavSample)], [
        event for event in events if isinstance(event, Notice)
    ]


def seconds(sample: NavSample) -> float:
    return sample.time_s - T0.utc_ns * 1e-9


def track(samples: Sequence[NavSample]) -> list[tuple[float, float, float]]:
    """Seconds, east and north of every position."""
    return [
        (seconds(sample), *offset_m(HOME, (sample.latitude_deg, sample.longitude_deg)))
        for sample in samples
        if not math.isnan(sample.latitude_deg)
    ]


def survey(n_s: int, circle: bool = True) -> list[tuple[float, float, float, float]]:
    """Seconds, east, north and heading at 10 Hz: 1.5 m/s, straight or on a circle of 40 m radius."""
    poses = []
    for step in range(n_s * 10):
        t = step * 0.1
        heading = (1.5 / 40.0 * t) % (2 * math.pi) if circle else 0.0
        east, north = (
            (40.0 * (1 - math.cos(1.5 / 40.0 * t)), 40.0 * math.sin(1.5 / 40.0 * t)) if circle else (0.0, 1.5 * t)
        )
        poses.append((t, east, north, heading))
    return poses


def dvl_and_compass(n_s: int, circle: bool = True) -> list[NavFix]:
    return [
        fix("dvl", t, heading_rad=heading, speed_mps=1.5, drift_rad=0.0) for t, _, _, heading in survey(n_s, circle)
    ]


GPS = NavUnitSettings(delivers=("position",), surface_only=True)
DVL = NavUnitSettings(delivers=("heading", "speed", "depth"))
