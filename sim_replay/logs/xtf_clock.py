"""Time the pings of an XTF log whose clock was never set, or is not to be believed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain, islice
from typing import Final

import numpy as np
from msgspec.structs import replace

from drivers.navigation.corrections import offset_m
from sim_replay.logs.xtf_fields import KNOT_MPS
from sim_replay.logs.xtf_layout import PROBE_PINGS
from sim_replay.logs.xtf_pings import RawPing
from sim_replay.logs.xtf_report import LogReport

_DAY_S: Final = 86_400.0  # seconds per day
_FIRST_YEAR: Final = 1980  # before it there was no recorder of this format: a clock that was never set
_MAX_INTERVAL_S: Final = 2.0  # s between pings: at 750 m of range a second passes
_BACK_S: Final = 1.0  # s: recorders keep the order of pings within a second
_NOMINAL_SOUND_SPEED_MPS: Final = 1500.0  # m/s, for the time between pings of which nothing else is known
_CLOCK_NOT_SET: Final = "the recorder's clock was never set: the date is unknown and times count from 1970"


def timed(raw_pings: Iterator[RawPing], report: LogReport) -> Iterator[RawPing]:
    """Leave out pings without a time, or whose time alone is before all around; of a clock never set, count from 1970.

    Parameters
    ----------
    raw_pings
        In the order of the file.
    report
        Takes counters and notices.
    """
    probe = list(islice(raw_pings, PROBE_PINGS))
    if not probe:
        return
    place = report.place(probe[0].offset)
    pings = chain(probe, raw_pings)
    if all(math.isnan(raw.time_s) for raw in probe):
        yield from _counted(probe, pings, report)
        return
    year = probe[0].year
    if 0 < year < 100:
        text = f"years have two digits ({year:02d}) and are taken as 1980 to 2079; check the dates of contacts"
        report.notify_once("reader.time_two_digits", text, place)
    elif year < _FIRST_YEAR:
        report.notify_once("reader.time_unknown", f"{_CLOCK_NOT_SET} (year {year})", place)
    last_s, doubted = -math.inf, None  # of the pings given; the one that steps back, until the next confirms it
    for raw in pings:
        if not math.isnan(raw.time_s):
            if doubted is not None and raw.time_s < last_s:
                yield doubted
                last_s = doubted.time_s
            elif doubted is not None:
                report.counters["reader.time_outlier"] += 1
            doubted = raw if raw.time_s < last_s - _BACK_S else None
            if doubted is None:
                yield raw
                last_s = raw.time_s
            continue
        report.counters["reader.time_invalid"] += 1
        report.notify_once(
            "reader.time_invalid",
            f"a ping's date or time is impossible (year {raw.year}); such pings are skipped and counted: set the "
            "recorder's clock",
            report.place(raw.offset),
        )
    if doubted is not None:
        yield doubted


def _counted(probe: list[RawPing], pings: Iterator[RawPing], report: LogReport) -> Iterator[RawPing]:
    """Time pings without a date, by the time of day if it goes on, else by their interval."""
    runs = len({raw.day_s for raw in probe}) > 1
    interval_s = _interval_s(probe)
    how = "the time of day" if runs else f"{interval_s:.3g} s from ping to ping"
    report.notify_once("reader.time_unknown", f"{_CLOCK_NOT_SET}, by {how}", report.place(probe[0].offset))
    midnights, last_s = 0, -math.inf
    for number, raw in enumerate(pings):
        midnights += runs and raw.day_s < last_s - 0.5 * _DAY_S
        last_s = raw.day_s
        yield replace(raw, time_s=midnights * _DAY_S + raw.day_s if runs else number * interval_s)


def _interval_s(probe: list[RawPing]) -> float:
    """Find the time between pings without a clock: as logged, else by way and speed, else by the range."""
    logged = [raw.interval_s for raw in probe if 0.0 < raw.interval_s <= _MAX_INTERVAL_S]
    if logged:
        return float(np.median(logged))
    first, last = probe[0].header, probe[-1].header
    speed_mps = KNOT_MPS * float(np.median([raw.header.SensorSpeed or raw.header.ShipSpeed for raw in probe]))
    ends = ((first.SensorYcoordinate, first.SensorXcoordinate), (last.SensorYcoordinate, last.SensorXcoordinate))
    way_m = math.hypot(*offset_m(*ends)) if all(abs(y) <= 90.0 and abs(x) <= 360.0 for y, x in ends) else 0.0
    if len(probe) > 1 and speed_mps > 0.0 and 0.0 < way_m / speed_mps / (len(probe) - 1) <= _MAX_INTERVAL_S:
        return way_m / speed_mps / (len(probe) - 1)
    ranges_m = [trace.range_m for raw in probe for trace in (raw.port, raw.starboard) if trace is not None]
    return 2.0 * max(ranges_m) / _NOMINAL_SOUND_SPEED_MPS
