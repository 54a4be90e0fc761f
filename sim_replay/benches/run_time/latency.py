"""Measure how long after the last ping that saw a target it is announced.

The last ping that saw a target is the one after which half the beam's footprint and half the target are passed. A view
counts where the finished mission has it in a contact on a target, itself with a p_mine of CALLED_P or more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detection, EarlyContact, NavSample, Ping, Side
from sim_replay.benches.run_time.lines import BenchMission
from sim_replay.benches.run_time.measure import CALLED_P
from sim_replay.logs.open_log import open_log
from sim_replay.scoring.inputs import TruthObject

WITHIN_M: Final = 20.0  # m of track: see below
WITHIN_S: Final = 10.0
"""Target: an announcement within these metres of track or seconds, whichever is later."""
_GATE_M: Final = 3.0  # between a contact and its target
_SAME_M: Final = 2.5  # between an early view and the final one, along and across


class Wait(NamedTuple):
    """Track and mission time between the last ping that saw a target and its announcement."""

    track_m: float
    time_s: float

    @property
    def is_in_time(self) -> bool:
        """Find whether the announcement is within the target."""
        return self.track_m <= WITHIN_M or self.time_s <= WITHIN_S


class _Track:
    """Measure the distance sailed at any time, from positions as the payload got them."""

    def __init__(self, samples: Sequence[NavSample]) -> None:
        fixes = [s for s in samples if math.isfinite(s.latitude_deg) and math.isfinite(s.longitude_deg)]
        frame = LocalFrame(latitude_deg=fixes[0].latitude_deg, longitude_deg=fixes[0].longitude_deg)
        places = frame.to_enu(
            np.array([s.latitude_deg for s in fixes]), np.array([s.longitude_deg for s in fixes]), 0.0
        )[..., :2]
        self._time_s = np.array([s.time_s for s in fixes])
        self._along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])

    def along_m(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.interp(time_s, self._time_s, self._along_m), dtype=np.float64)


class _Announced(NamedTuple):
    n_pings: int  # fed by then
    view: Detection


def first_waits(line: BenchMission) -> list[Wait]:
    """Run the chain with early contacts over a mission; measure the wait for the first word on each target view."""
    pipeline = Pipeline(line.config, early=True)
    ping_s: list[float] = []
    navigation: list[NavSample] = []
    early: list[_Announced] = []
    finished: dict[tuple[Side, float], int] = {}
    for event in open_log(line.log, line.config):
        if isinstance(event, Ping):
            ping_s.append(event.time_s)
        elif isinstance(event, NavSample):
            navigation.append(event)
        for out in pipeline.feed(event):
            if isinstance(out, EarlyContact) and out.state == "found":
                early.append(_Announced(len(ping_s), out.contact.views[0]))
            elif isinstance(out, Contact):
                for view in out.views:
                    finished.setdefault((view.side, view.time_s), len(ping_s))
    pipeline.finish()
    times_s, track = np.array(ping_s), _Track(navigation)
    along_m = track.along_m(times_s)
    waits = []
    for view, target in _target_views(pipeline.contacts, line.truth.objects):
        beam_m = view.slant_range_m * line.config.sonar.beam_width_rad
        seen_to_m = float(track.along_m(np.array([view.time_s]))[0]) + 0.5 * (
            beam_m + max(target.length_m or 0.0, target.width_m or 0.0)
        )
        last = max(int(np.searchsorted(along_m, seen_to_m, side="right")) - 1, 0)
        done = finished.get((view.side, view.time_s), len(times_s))
        first = min((each.n_pings for each in early if _are_same(each.view, view)), default=done)
        word = min(first, done) - 1
        waits.append(Wait(float(along_m[word] - along_m[last]), float(times_s[word] - times_s[last])))
    return waits


def _target_views(contacts: Sequence[Contact], objects: Sequence[TruthObject]) -> list[tuple[Detection, TruthObject]]:
    """Pair every view of a contact on a target with the target."""
    targets = [each for each in objects if each.is_target]
    pairs = []
    for contact in contacts:
        if contact.p_mine < CALLED_P:
            continue
        frame = LocalFrame(latitude_deg=contact.latitude_deg, longitude_deg=contact.longitude_deg)
        away_m = [float(np.hypot(*frame.to_enu(each.latitude_deg, each.longitude_deg, 0.0)[:2])) for each in targets]
        if targets and min(away_m) <= _GATE_M:
            target = targets[int(np.argmin(away_m))]
            pairs += [(view, target) for view in contact.views if view.p_mine >= CALLED_P]
    return pairs


def _are_same(a: Detection, b: Detection) -> bool:
    along_m, across_m = (a.row - b.row) * a.row_spacing_m, (a.column - b.column) * a.column_spacing_m
    return a.side == b.side and math.hypot(along_m, across_m) <= _SAME_M
