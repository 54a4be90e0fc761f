"""Find contacts as the plain baseline does: a script of an afternoon, on the same pings.

On the recorded numbers as they are, side by side, leg by leg: divide every range bin by its running median along-track,
blur, take what is bright and has something dark close behind, join neighbours, report one contact each. Positions by
the reported pose over a flat floor at the reported altitude. What it lacks is what it is there to show: no calibration
of what a stored number means, no statistics of speckle, no bottom of its own, no shape.

Its constants were chosen on missions with seeds below 100.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SIDES, NavSample, Ping, Side, SourceEvent
from sim_replay.scoring import ReportedContact

_STRAIGHT_DEG_S: Final = 3.0  # turning faster than this a ping is left out
_TURN_OVER_S: Final = 1.0  # s on either side, over which the turn rate is taken
_SHORTEST_PINGS: Final = 50  # of a straight line that is searched
_MEDIAN_PINGS: Final = 151  # over which each range's level is taken
_MEDIAN_STEP: Final = 25  # pings between levels; linear in between

_BLUR_ALONG_M: Final = 0.6  # m along the track, averaged
_BLUR_ACROSS_M: Final = 0.2  # m across the track, averaged
_BRIGHT: Final = 1.9  # times the level: a highlight
_DARK: Final = 0.6  # times the level: a shadow
_SHADOW_M: Final = 0.8  # of the stretch that must be dark,
_SHADOW_BEHIND_M: Final = 0.8  # and how far behind the highlight its middle is
_LONGEST_M: Final = 4.0  # m: longer ones are no mines
_SMALLEST_M2: Final = 0.04  # m²: smaller ones are speckle
_WATER_COLUMN: Final = 1.1  # altitudes; nearer than this is no floor
_FAR_END_M: Final = 1.5  # m left out at the end of the range
_ONE_OBJECT_M: Final = 2.0  # m between calls that count as one
_EVEN_RATIO: Final = 7.0  # of highlight to shadow, at which the score is 0.5

Floats = NDArray[np.float32]


class _Line(NamedTuple):
    """Hold pings of a straight run: (n,) float64 poses in the plane, samples per side (n, n_samples) float32."""

    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    altitude_m: NDArray[np.float64]
    samples: dict[Side, Floats]
    first_range_m: float
    spacing_m: float


class _Call(NamedTuple):
    score: float
    east_m: float
    north_m: float
    ground_range_m: float
    length_m: float
    width_m: float


def baseline_contacts(events: Iterable[SourceEvent]) -> list[ReportedContact]:
    """Find the contacts of a mission with p_mine from 0 to 1, strongest first.

    Pings whose format differs from the first one's are dropped.

    Pings whose format differs from the first one's are left out.
    """
    navigation, pings = _usable(events)
    if len(navigation) < 2 or len(pings) < _SHORTEST_PINGS:
        return []
    frame = LocalFrame(latitude_deg=navigation[0].latitude_deg, longitude_deg=navigation[0].longitude_deg)
    calls = [call for line in _lines(navigation, pings, frame) for side in SIDES for call in _calls(line, side)]
    contacts = []
    for call in _one_per_object(calls):
        latitude, longitude, _ = frame.to_geodetic([call.east_m, call.north_m, 0.0])
        contacts.append(
            ReportedContact(
                latitude_deg=float(latitude),
                longitude_deg=float(longitude),
                p_mine=round(call.score, 3),
                length_m=call.length_m,
                width_m=call.width_m,
                ground_range_m=call.ground_range_m,
            )
        )
    return contacts


def _usable(events: Iterable[SourceEvent]) -> tuple[list[NavSample], list[Ping]]:
    """Select navigation with a whole pose, in order of time, and pings of both sides in one format."""
    navigation: list[NavSample] = []
    pings: list[Ping] = []
    layout: tuple[object, ...] | None = None
    for event in events:
        if isinstance(event, NavSample):
            pose = event.latitude_deg, event.longitude_deg, event.heading_rad, event.altitude_m
            if all(math.isfinite(value) for value in pose):
                navigation.append(event)
        elif isinstance(event, Ping) and event.port is not None and event.starboard is not None:
            own = tuple(
                (trace.samples.shape, trace.first_range_m, trace.spacing_m) for trace in (event.port, event.starboard)
            )
            layout = layout or (own if own[0] == own[1] else None)
            if own == layout:
                pings.append(event)
    return sorted(navigation, key=lambda sample: sample.time_s), pings


def _lines(navigation: Sequence[NavSample], pings: Sequence[Ping], frame: LocalFrame) -> list[_Line]:
    """Split a mission into its straight runs."""
    navigation_s = np.array([sample.time_s for sample in navigation])
    place = frame.to_enu(
        [sample.latitude_deg for sample in navigation], [sample.longitude_deg for sample in navigation], 0.0
    )
    heading = np.unwrap([sample.heading_rad for sample in navigation])
    time_s = np.array([ping.time_s for ping in pings])

    def at(moments_s: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.interp(moments_s, navigation_s, values), dtype=np.float64)

    turned = at(time_s + _TURN_OVER_S, heading) - at(time_s - _TURN_OVER_S, heading)
    straight = np.abs(turned) < 2.0 * _TURN_OVER_S * math.radians(_STRAIGHT_DEG_S)
    edges = np.flatnonzero(np.diff(straight.astype(np.int8), prepend=0, append=0))
    altitude = np.array([sample.altitude_m for sample in navigation])
    lines = []
    for first, stop in edges.reshape(-1, 2).tolist():
        if stop - first < _SHORTEST_PINGS:
            continue
        own, moments_s = pings[first:stop], time_s[first:stop]
        traces: dict[Side, list[Floats]] = {side: [] for side in SIDES}
        for ping in own:
            for side, trace in zip(SIDES, (ping.port, ping.starboard), strict=True):
                assert trace is not None
                traces[side].append(trace.samples.astype(np.float32))
                first_range_m, spacing_m = trace.first_range_m, trace.spacing_m
        lines.append(
            _Line(
                east_m=at(moments_s, place[:, 0]),
                north_m=at(moments_s, place[:, 1]),
                heading_rad=at(moments_s, heading),
                altitude_m=at(moments_s, altitude),
                samples={side: np.stack(rows) for side, rows in traces.items()},
                first_range_m=first_range_m,
                spacing_m=spacing_m,
            )
        )
    return lines


def _calls(line: _Line, side: Side) -> list[_Call]:
    """Find what looks like an object on one side of a line."""
    level = _levelled(line.samples[side])
    n_samples = level.shape[1]
    row_m = max(float(np.median(np.hypot(np.diff(line.east_m), np.diff(line.north_m)))), 1e-3)
    blurred = ndimage.uniform_filter(level, (_odd(_BLUR_ALONG_M / row_m), _odd(_BLUR_ACROSS_M / line.spacing_m)))
    dark = ndimage.uniform_filter(level, (_odd(_BLUR_ALONG_M / row_m), _odd(_SHADOW_M / line.spacing_m)))
    shift = min(round(_SHADOW_BEHIND_M / line.spacing_m), n_samples)
    behind = np.full_like(dark, np.inf)
    behind[:, : n_samples - shift] = dark[:, shift:]
    slant_m = line.first_range_m + line.spacing_m * np.arange(n_samples)
    on_floor = (slant_m > _WATER_COLUMN * line.altitude_m[:, None]) & (slant_m < slant_m[-1] - _FAR_END_M)
    bright = (blurred > _BRIGHT) & on_floor
    labels, _ = ndimage.label(bright)
    has_shadow = np.unique(labels[bright & (behind < _DARK)])
    boxes = ndimage.find_objects(labels)
    calls = []
    for label in has_shadow.tolist():
        box = boxes[label - 1]
        inside = labels[box] == label
        length_m, width_m = inside.shape[0] * row_m, inside.shape[1] * line.spacing_m
        if max(length_m, width_m) > _LONGEST_M or np.count_nonzero(inside) * row_m * line.spacing_m < _SMALLEST_M2:
            continue
        weight = np.where(inside, blurred[box], 0.0)
        rows, columns = np.indices(inside.shape)
        row = box[0].start + float((weight * rows).sum() / weight.sum())
        column = box[1].start + float((weight * columns).sum() / weight.sum())
        ratio = float(weight.max()) / max(float(behind[box][inside].min()), 1e-3)
        calls.append(_placed(line, side, row, column, ratio / (ratio + _EVEN_RATIO), length_m, width_m))
    return calls


def _placed(line: _Line, side: Side, row: float, column: float, score: float, length_m: float, width_m: float) -> _Call:
    rows = np.arange(len(line.east_m))
    east, north, heading, altitude = (
        float(np.interp(row, rows, values)) for values in (line.east_m, line.north_m, line.heading_rad, line.altitude_m)
    )
    slant_m = line.first_range_m + line.spacing_m * column
    ground_m = math.sqrt(max(0.0, (slant_m - altitude) * (slant_m + altitude)))
    across_m = ground_m if side == "starboard" else -ground_m
    return _Call(
        score=score,
        east_m=east + across_m * math.cos(heading),
        north_m=north - across_m * math.sin(heading),
        ground_range_m=ground_m,
        length_m=max(length_m, width_m),
        width_m=min(length_m, width_m),
    )


def _levelled(samples: Floats) -> Floats:
    """Divide samples by the running median of their range bin; 1 where that is 0.

    The median is taken every few pings and interpolated linearly between them.
    """
    n_pings = len(samples)
    centres = np.unique(np.append(np.arange(0, n_pings, _MEDIAN_STEP), n_pings - 1))
    half = _MEDIAN_PINGS // 2
    medians = np.stack([np.median(samples[max(0, centre - half) : centre + half + 1], axis=0) for centre in centres])
    place = np.interp(np.arange(n_pings), centres, np.arange(len(centres)))
    lower = np.minimum(place.astype(np.int64), max(len(centres) - 2, 0))
    part = (place - lower).astype(np.float32)[:, None]
    median = medians[lower] * (1.0 - part) + medians[np.minimum(lower + 1, len(centres) - 1)] * part
    level: Floats = np.divide(samples, median, out=np.ones_like(samples), where=median > 0.0)
    return level


def _one_per_object(calls: Sequence[_Call]) -> list[_Call]:
    """Keep the strongest of calls close together, whatever the pass."""
    kept: list[_Call] = []
    for call in sorted(calls, reverse=True):
        if all(math.hypot(call.east_m - other.east_m, call.north_m - other.north_m) > _ONE_OBJECT_M for other in kept):
            kept.append(call)
    return kept


def _odd(size: float) -> int:
    """Round to the nearest odd number of samples, 1 at the minimum."""
    return max(1, 2 * round(0.5 * (size - 1.0)) + 1)
