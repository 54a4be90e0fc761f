"""Draw the mission's map as shapes for an inline SVG, true to scale.

Track, coverage, contacts with error ellipses and proposed legs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.contact import error_ellipse_ring_m, is_mine_like
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Contact, CoveragePatch, Waypoint
from sim_replay.mosaic import Box
from sim_replay.report.report_words import degrees_minutes
from sim_replay.verdicts import Verdict

Points: TypeAlias = NDArray[np.float64]  # (n, 2) east, north in metres, or right, down in drawing units

WIDTH: Final = 1100.0  # units of the drawing
_MIN_HEIGHT: Final = 380.0  # units
_MAX_HEIGHT: Final = 900.0  # units
_MARGIN: Final = 46.0  # units around the mission
_MIN_SPAN_M: Final = 60.0  # m shown, of the shortest mission
_MINUTE_STEPS: Final = [factor * 10.0**power for power in range(-4, 2) for factor in (1.0, 2.0, 5.0)] + [
    60.0,
    120.0,
    300.0,
    600.0,
]


class Marker(NamedTuple):
    """Place a contact on the map."""

    contact: Contact
    right: float
    down: float
    ellipse: str
    label: tuple[float, float, str] | None  # right and down of the marker, text-anchor


class LegLine(NamedTuple):
    """Place a proposed leg on the map."""

    number: int
    contact_id: str
    why: str
    turn: str
    run: str
    right: float
    down: float
    turn_deg: float


class Label(NamedTuple):
    """Place a text on the map."""

    text: str
    right: float
    down: float


class Chart(NamedTuple):
    """Hold the shapes of the map, in drawing units; paths are SVG path data."""

    height: float
    track: str
    ends: tuple[tuple[float, float], ...]
    coverage: str
    markers: tuple[Marker, ...]
    missed: tuple[Label, ...]
    legs: tuple[LegLine, ...]
    graticule: str
    latitude_labels: tuple[Label, ...]
    longitude_labels: tuple[Label, ...]
    scale_m: float
    scale_units: float
    picture: tuple[float, float, float, float] | None  # left, top, width, height of the sonar picture
    corners_deg: tuple[tuple[float, float], ...]  # latitude, longitude at the left top, right top and left bottom


class _Projection(NamedTuple):
    """Project places on a plane tangent at the middle of the mission, and from there on the drawing."""

    frame: LocalFrame
    west_m: float
    north_m: float
    units_per_m: float
    height: float

    def drawn(self, east_north_m: Points) -> Points:
        return (
            np.column_stack([(east_north_m[:, 0] - self.west_m), (self.north_m - east_north_m[:, 1])])
            * self.units_per_m
        )


def draw_chart(
    track_deg: Points,
    contacts: Sequence[Contact],
    patches: Iterable[CoveragePatch],
    waypoints: Sequence[Waypoint],
    box: Box | None = None,
    missed: Sequence[Verdict] = (),
) -> Chart | None:
    """Draw the map of a mission; None if it has no position at all.

    Parameters
    ----------
    track_deg
        (n, 2) latitude, longitude, NaN where the track breaks.
    box
        Outline of the sonar picture under the map.
    missed
        Objects that people saw and no contact stands for.
    """
    located = [
        contact for contact in contacts if math.isfinite(contact.latitude_deg) and math.isfinite(contact.longitude_deg)
    ]
    contacts_deg = np.array([(contact.latitude_deg, contact.longitude_deg) for contact in located]).reshape(-1, 2)
    rings_deg = [ring[:, ::-1] for patch in patches for ring in patch.rings_deg if np.isfinite(ring).all()]
    way_deg = np.array([(point.latitude_deg, point.longitude_deg) for point in waypoints]).reshape(-1, 2)
    missed_deg = np.array([(one.latitude_deg, one.longitude_deg) for one in missed]).reshape(-1, 2)
    everything = np.vstack([track_deg.reshape(-1, 2), contacts_deg, missed_deg, way_deg, *rings_deg])
    everything = everything[np.isfinite(everything).all(axis=1)]
    if not len(everything):
        return None
    rough = LocalFrame(latitude_deg=float(everything[0, 0]), longitude_deg=float(everything[0, 1]))
    spread = _plane(rough, everything)
    latitude, longitude, _ = rough.to_geodetic([*((spread.min(axis=0) + spread.max(axis=0)) / 2.0), 0.0])
    frame = LocalFrame(latitude_deg=float(latitude), longitude_deg=float(longitude))
    projection = _fitted(frame, _plane(frame, everything))

    def drawn(places_deg: Points) -> Points:
        return projection.drawn(_plane(frame, places_deg))

    track = drawn(track_deg.reshape(-1, 2))
    known = track[np.isfinite(track).all(axis=1)]
    return Chart(
        height=projection.height,
        track="".join(svg_path(piece) for piece in _unbroken(track)),
        ends=tuple((float(right), float(down)) for right, down in (known[[0, -1]] if len(known) else known)),
        coverage="".join(svg_path(drawn(ring)) + "Z" for ring in rings_deg),
        markers=_markers(located, drawn(contacts_deg), projection),
        missed=tuple(Label(one.object, *place) for one, place in zip(missed, drawn(missed_deg).tolist(), strict=True)),
        legs=_legs(waypoints, drawn(way_deg)),
        **_graticule(projection),
        **_scale_bar(projection.units_per_m),
        picture=None if box is None else _frame(drawn(_corners_deg(box))),
        corners_deg=_chart_corners(projection),
    )


def _corners_deg(box: Box) -> Points:
    return np.array([(lat, lon) for lat in (box.north, box.south) for lon in (box.west, box.east)])


def _frame(corners: Points) -> tuple[float, float, float, float]:
    """Fit a rectangle to corners, which meridians that converge turn by less than a unit."""
    left, right = corners[[0, 2], 0].mean(), corners[[1, 3], 0].mean()
    top, bottom = corners[[0, 1], 1].mean(), corners[[2, 3], 1].mean()
    return float(left), float(top), float(right - left), float(bottom - top)


def _chart_corners(projection: _Projection) -> tuple[tuple[float, float], ...]:
    right_m, down_m = WIDTH / projection.units_per_m, projection.height / projection.units_per_m
    places_m = [(0.0, 0.0), (right_m, 0.0), (0.0, -down_m)]
    enu = np.array([(projection.west_m + east, projection.north_m + north, 0.0) for east, north in places_m])
    latitude, longitude, _ = projection.frame.to_geodetic(enu)
    return tuple(zip(latitude.tolist(), longitude.tolist(), strict=True))


def _plane(frame: LocalFrame, places_deg: Points) -> Points:
    return np.asarray(
        frame.to_enu(places_deg[:, 0], places_deg[:, 1], np.zeros(len(places_deg)))[:, :2], dtype=np.float64
    )


def _fitted(frame: LocalFrame, plane: Points) -> _Projection:
    low, high = plane.min(axis=0), plane.max(axis=0)
    span = np.maximum(high - low, _MIN_SPAN_M)
    middle = (low + high) / 2.0
    scale = min((WIDTH - 2.0 * _MARGIN) / span[0], (_MAX_HEIGHT - 2.0 * _MARGIN) / span[1])
    height = max(_MIN_HEIGHT, span[1] * scale + 2.0 * _MARGIN)
    return _Projection(
        frame, middle[0] - WIDTH / 2.0 / scale, middle[1] + height / 2.0 / scale, float(scale), float(height)
    )


def svg_path(points: Points) -> str:
    """Write SVG path data to a tenth of a unit, without points that fall together."""
    tenths = np.round(points * 10.0)
    if len(tenths) > 1:
        tenths = tenths[np.concatenate([[True], (np.diff(tenths, axis=0) != 0.0).any(axis=1)])]
    return "M" + "L".join(f"{right / 10.0:g} {down / 10.0:g}" for right, down in tenths.tolist()) if len(tenths) else ""


def _unbroken(points: Points) -> list[Points]:
    known = np.isfinite(points).all(axis=1)
    return [
        piece
        for piece in np.split(points, np.flatnonzero(np.diff(known)) + 1)
        if len(piece) > 1 and np.isfinite(piece).all()
    ]


def _markers(contacts: Sequence[Contact], places: Points, projection: _Projection) -> tuple[Marker, ...]:
    """Draw contacts, the least likely first, so that mines are on top.

    Labels only where they do not cover each other, the most likely first.
    """
    order = sorted(range(len(contacts)), key=lambda number: (-contacts[number].p_mine, contacts[number].id))
    likely = [places[number].tolist() for number in order if is_mine_like(contacts[number])]
    taken: list[tuple[float, float, float, float]] = [
        (right - 5, down - 5, right + 5, down + 5) for right, down in likely
    ]
    markers = []
    for number in order:
        contact, (right, down) = contacts[number], places[number].tolist()
        label = None
        if is_mine_like(contact):
            wide = 7.6 * len(contact.id)
            for shift, drop, anchor in ((10, 4, "start"), (-10, 4, "end"), (0, -10, "middle"), (0, 20, "middle")):
                left = right + shift - {"start": 0.0, "end": wide, "middle": wide / 2.0}[anchor]
                box = left, down + drop - 11.0, left + wide, down + drop + 2.0
                inside = box[0] > 0.0 and box[2] < WIDTH
                if inside and not any(
                    box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken
                ):
                    taken.append(box)
                    label = shift, drop, anchor
                    break
        ring_m = error_ellipse_ring_m(contact)
        ellipse = ""
        if np.isfinite(ring_m).all():
            ellipse = svg_path(ring_m * [1.0, -1.0] * projection.units_per_m + places[number]) + "Z"
        markers.append(Marker(contact, right, down, ellipse, label))
    return tuple(reversed(markers))


def _legs(waypoints: Sequence[Waypoint], places: Points) -> tuple[LegLine, ...]:
    legs = []
    for number in dict.fromkeys(point.leg for point in waypoints):
        members = [index for index, point in enumerate(waypoints) if point.leg == number]
        run = [index for index in members if waypoints[index].kind in ("leg_entry", "leg_exit")]
        if len(run) != 2:
            continue
        entry, leave = places[run[0]], places[run[1]]
        arrow = (entry + 3.0 * leave) / 4.0
        legs.append(
            LegLine(
                number=number,
                contact_id=waypoints[run[1]].contact_id,
                why=waypoints[run[1]].why,
                turn=svg_path(places[max(members[0] - 1, 0) : run[0] + 1]),
                run=svg_path(places[run]),
                right=float(arrow[0]),
                down=float(arrow[1]),
                turn_deg=math.degrees(math.atan2(leave[0] - entry[0], entry[1] - leave[1])),
            )
        )
    return tuple(legs)


class _Graticule(TypedDict):
    graticule: str
    latitude_labels: tuple[Label, ...]
    longitude_labels: tuple[Label, ...]


class _ScaleBar(TypedDict):
    scale_m: float
    scale_units: float


def _scale_bar(units_per_m: float) -> _ScaleBar:
    max_m = 200.0 / units_per_m
    power = 10.0 ** math.floor(math.log10(max_m))
    metres = max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= max_m)
    return {"scale_m": metres, "scale_units": metres * units_per_m}


def _graticule(projection: _Projection) -> _Graticule:
    """Draw parallels and meridians across the drawing, labelled where they enter at the left and at the bottom."""
    frame, scale = projection.frame, projection.units_per_m
    edge = np.linspace(0.0, 1.0, 17)
    across, along = WIDTH / scale * edge, projection.height / scale * edge
    east_m, north_m = projection.west_m + across, projection.north_m - along
    border = np.vstack(
        [
            *(np.column_stack([east_m, np.full(17, side_m)]) for side_m in north_m[[0, -1]]),
            *(np.column_stack([np.full(17, side_m), north_m]) for side_m in east_m[[0, -1]]),
        ]
    )
    latitudes, longitudes, _ = frame.to_geodetic(np.column_stack([border, np.zeros(len(border))]))
    relative = (longitudes - frame.longitude_deg + 180.0) % 360.0 - 180.0
    south, north, west, east = (
        float(latitudes.min()),
        float(latitudes.max()),
        float(relative.min()),
        float(relative.max()),
    )
    lines: list[str] = []
    labels: tuple[list[Label], list[Label]] = [], []
    if east - west > 90.0:  # too near a pole for meridians to mean much
        return {"graticule": "", "latitude_labels": (), "longitude_labels": ()}
    for axis, (low, high) in enumerate(((south, north), (west + frame.longitude_deg, east + frame.longitude_deg))):
        step_deg = next((step for step in _MINUTE_STEPS if (high - low) * 60.0 / step <= 6.0), 600.0) / 60.0
        for number in range(math.ceil(low / step_deg), math.floor(high / step_deg) + 1):
            value = number * step_deg
            if axis == 0:
                places = np.column_stack([np.full(97, value), frame.longitude_deg + np.linspace(west, east, 97)])
            else:
                places = np.column_stack([np.linspace(south, north, 97), np.full(97, value)])
            points = projection.drawn(_plane(frame, places))
            inside = ((points >= 0.0) & (points <= [WIDTH, projection.height])).all(axis=1)
            if inside.sum() < 2:
                continue
            lines.append(svg_path(points))
            digits = max(0, -math.floor(math.log10(step_deg * 60.0) + 1e-9))
            right, down = points[inside][0].tolist()
            wrapped = (value + 180.0) % 360.0 - 180.0
            text = degrees_minutes(value, "N", "S", digits) if axis == 0 else degrees_minutes(wrapped, "E", "W", digits)
            labels[axis].append(Label(text, right, down))
    return {"graticule": "".join(lines), "latitude_labels": tuple(labels[0]), "longitude_labels": tuple(labels[1])}
