"""Find shortest paths of a vehicle that moves forward and turns no tighter than a given radius.

L. E. Dubins, "On curves of minimal length with a constraint on average curvature", American Journal of Mathematics 79
(1957):
the shortest path is two arcs with a straight between (LSL, RSR, LSR, RSL) or three arcs (LRL, RLR). Here each word
comes from the triangle of its circles' centres, with the straight's (or middle arc's) length and direction taken from
the same triangle, so that the end pose is met to rounding even where the length itself is ill-conditioned (circles that
just touch).

Plane coordinates are east and north in metres; headings are radians clockwise from north.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Turn: TypeAlias = Literal["left", "straight", "right"]
Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]

_TURN: Final[dict[int, Turn]] = {-1: "left", 0: "straight", 1: "right"}
# Sign of each part's turn: right turns add heading. Equal lengths are settled by this order.
_WORDS: Final = ((-1, 0, -1), (1, 0, 1), (-1, 0, 1), (1, 0, -1), (-1, 1, -1), (1, -1, 1))
_N_STRAIGHT: Final = 4  # that have a straight, first in order
_ROUNDING: Final = 1e-12  # radians, and lengths over the radius, that rounding alone makes


class PlanePose(NamedTuple):
    """Hold a place in the plane and a direction of travel."""

    east_m: float
    north_m: float
    heading_rad: float


class Segment(NamedTuple):
    """Hold a piece of path with constant curvature."""

    turn: Turn
    length_m: float


class DubinsPath(NamedTuple):
    """Hold the shortest path from `start`.

    `segments` are its three parts, some possibly of zero length.
    """

    start: PlanePose
    turn_radius_m: float
    length_m: float
    segments: tuple[Segment, Segment, Segment]


def dubins_path(start: PlanePose, end: PlanePose, turn_radius_m: float) -> DubinsPath:
    """Find the shortest path; of equally short ones always the same.

    Raises ValueError if the radius is not positive or a pose is not finite.
    """
    if not (turn_radius_m > 0.0 and all(map(math.isfinite, (*start, *end, turn_radius_m)))):
        raise ValueError(
            f"no path from {start} to {end} with turn radius {turn_radius_m} m: needs finite poses and a positive "
            "radius"
        )
    (path,) = dubins_paths(np.array([[start, end]]), turn_radius_m)
    assert path is not None  # where every turn is allowed there is one
    return path


def dubins_paths(
    ends: Array, turn_radius_m: float, leave: Flags | None = None, arrive: Flags | None = None
) -> list[DubinsPath | None]:
    """Apply `dubins_path` to each of (n, 2, 3) starts and ends, all finite.

    None where no allowed path exists.

    Parameters
    ----------
    leave, arrive
        As for `dubins_lengths`, (n, 2).
    """
    parts = _allowed_parts(ends[:, 0], ends[:, 1], turn_radius_m, leave, arrive)
    word = np.argmin(parts.sum(axis=-1), axis=0)
    length_m = parts[word, np.arange(len(ends))] * turn_radius_m
    paths: list[DubinsPath | None] = []
    for number, (start, lengths) in enumerate(zip(ends[:, 0].tolist(), length_m.tolist(), strict=True)):
        if not math.isfinite(sum(lengths)):
            paths.append(None)
            continue
        first, second, third = (
            Segment(_TURN[turn], length) for turn, length in zip(_WORDS[word[number]], lengths, strict=True)
        )
        total_m = first.length_m + second.length_m + third.length_m
        paths.append(DubinsPath(PlanePose(*start), turn_radius_m, total_m, (first, second, third)))
    return paths


def dubins_lengths(
    starts: ArrayLike, ends: ArrayLike, turn_radius_m: float, leave: Flags | None = None, arrive: Flags | None = None
) -> Array:
    """Compute lengths in metres of shortest paths between (..., 3) poses [east, north, heading] that broadcast.

    With limits only two arcs with a straight between come into question, for they stay in the hull of the two circles;
    infinite where there is none.

    Parameters
    ----------
    leave, arrive
        (..., 2), whether the circles to the left and right of the starts and of the ends may be sailed; None for no
        limits.
    """
    parts = _allowed_parts(
        np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64), turn_radius_m, leave, arrive
    )
    return np.asarray(parts.sum(axis=-1).min(axis=0) * turn_radius_m, dtype=np.float64)


def sample_path(path: DubinsPath, arc_step_rad: float) -> Array:
    """Sample a path as (n, 3) poses [east, north, heading].

    Samples are the start, the end of every part, and points within arcs at most `arc_step_rad` apart.
    """
    east, north, heading = path.start
    poses = [path.start]
    for turn, length in path.segments:
        sign = {"left": -1.0, "straight": 0.0, "right": 1.0}[turn]
        angle = length / path.turn_radius_m
        steps = max(1, math.ceil(angle / arc_step_rad)) if sign else 1
        for step in range(1, steps + 1):
            part = step / steps
            if sign:
                chord = 2.0 * path.turn_radius_m * math.sin(angle * part / 2.0)
                direction = heading + sign * angle * part / 2.0
            else:
                chord, direction = length * part, heading
            turned = heading + sign * angle * part
            poses.append(PlanePose(east + chord * math.sin(direction), north + chord * math.cos(direction), turned))
        east, north, heading = poses[-1]
    return np.array(poses, dtype=np.float64)


def _word_parts(start: Array, end: Array, radius: float, n_words: int) -> Array:
    """Compute the lengths of the parts of the first words, over the radius: (n_words, ..., 3).

    Infinite where a word does not exist.
    """
    offset = (end[..., :2] - start[..., :2]) / radius
    heading_out, heading_in = start[..., 2], end[..., 2]
    cosine_out, sine_out, cosine_in, sine_in = (
        np.cos(heading_out),
        np.sin(heading_out),
        np.cos(heading_in),
        np.sin(heading_in),
    )
    words = []
    for first, middle, last in _WORDS[:n_words]:
        # Centre of a turn: one radius to the right (first = 1) or left of the pose. right(h) = (cos h, -sin h) in east,
        # north.
        east = offset[..., 0] + last * cosine_in - first * cosine_out
        north = offset[..., 1] - last * sine_in + first * sine_out
        distance = np.hypot(east, north)
        bearing = np.where(distance > _ROUNDING, np.arctan2(east, north), heading_out)
        if middle:  # three arcs: the outer circles touch a middle one whose arc is longer than half a turn
            exists = distance <= 4.0 * (1.0 + _ROUNDING)
            along = 2.0 * (np.pi - np.arcsin(np.minimum(distance / 4.0, 1.0)))
            leave, arrive = bearing + first * along / 2.0, bearing - first * along / 2.0
        elif first == last:
            exists = np.ones(distance.shape, dtype=np.bool_)
            along = np.where(distance > _ROUNDING, distance, 0.0)
            leave = arrive = bearing
        else:  # the straight crosses between the circles
            exists = distance >= 2.0 * (1.0 - _ROUNDING)
            along = np.sqrt(np.maximum(distance - 2.0, 0.0) * (distance + 2.0))
            leave = arrive = bearing + first * np.arctan2(2.0, along)
        # Between close centres the bearing is only as good as rounding over distance. The last arc makes good what the
        # first one drops.
        out = _positive(first * (leave - heading_out), np.maximum(_ROUNDING, 1e-15 / np.maximum(distance, _ROUNDING)))
        dropped = np.where(out == 0.0, heading_out - leave, 0.0)
        back = _positive(last * (heading_in - arrive - dropped), _ROUNDING)
        words.append(
            np.where(exists[..., np.newaxis], np.stack(np.broadcast_arrays(out, along, back), axis=-1), np.inf)
        )
    return np.stack(words)


def _allowed_parts(start: Array, end: Array, radius: float, leave: Flags | None, arrive: Flags | None) -> Array:
    """Compute the lengths of the parts of the allowed words, (n_words, ..., 3).

    Infinite also where a circle may not be sailed; with limits only two arcs with a straight are considered.
    """
    if leave is None or arrive is None:
        return _word_parts(start, end, radius, len(_WORDS))
    parts = _word_parts(start, end, radius, _N_STRAIGHT)
    circle = {-1: 0, 1: 1}
    for word, (first, _, last) in enumerate(_WORDS[:_N_STRAIGHT]):
        parts[word][~np.broadcast_to(leave[..., circle[first]] & arrive[..., circle[last]], parts.shape[1:-1])] = np.inf
    return parts


def _positive(angle: Array, tolerance: Array | float) -> Array:
    """Wrap an angle to [0, 2 pi); a rounding error below zero gives zero instead of a full circle."""
    turned = np.mod(angle, 2.0 * np.pi)
    return np.asarray(np.where(turned > 2.0 * np.pi - tolerance, 0.0, turned), dtype=np.float64)
