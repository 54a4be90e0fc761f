"""Compute the vertical slices of round solids that single pings see.

Coordinates within a slice: y is ground range from the sonar, z height over the floor, the sonar is at (0, H). All
solids are convex, and so are their slices and what the floor z = 0 leaves of them. Two facts then replace all
searching: the elevation (z - H) / y of points along the upper boundary has one maximum, and so has their nearness to
the sonar; where the boundary is cut (end planes, rims, floor), the best point moves to the cut.

All arguments are float64 arrays that broadcast against each other, lengths in metres.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TINY: Final = 1e-300  # avoids 0 / 0 where the quotient is clipped anyway
_STEPS: Final = 6  # of Newton's method; the starts are chosen so that it never overshoots, and gets by with four
_CHORD: Final = 0.2928  # just under 1 - sqrt(1/2): (1 + v)^(-1/2) <= 1 - 0.2928 v for v from 0 to 1
_LEVEL: Final = 1e-15  # sine or cosine that rounding alone makes
_UPRIGHT: Final = 1e-9  # taper below which the sides of a cone count as upright, which moves them by nanometres


class Slice(NamedTuple):
    """Hold near end, front and tangent of slices, arrays of one shape; NaN where a slice misses the solid.

    near_m: minimum ground range. front_slant_range_m: of the point nearest to the sonar. tangent_m, tangent_height_m:
    ground range and height of the point that the ray along the far edge of the shadow touches.
    """

    near_m: Array
    front_slant_range_m: Array
    tangent_m: Array
    tangent_height_m: Array


def sphere_slice(radius: Array, centre_height: Array, offset: Array, ground_range: Array, altitude: Array) -> Slice:
    """Slice a sphere: the slice is a circle."""
    circle = np.sqrt(np.maximum((radius - offset) * (radius + offset), 0.0))
    hit = np.abs(offset) < radius
    zero, one = np.zeros(()), np.ones(())
    return _arch_slice(
        circle, centre_height, zero, one, (np.where(hit, -np.inf, np.inf), np.inf + zero), ground_range, altitude
    )


def cylinder_slice(
    radius: Array,
    length: Array,
    azimuth: Array,
    centre_height: Array,
    offset: Array,
    ground_range: Array,
    altitude: Array,
) -> Slice:
    """Slice a lying cylinder with flat ends: the slice is an ellipse cut by two verticals.

    Everything is done in the lateral coordinate l of the cylinder, in which it is a circle, because the ellipse's long
    semi-axis radius / |cos azimuth| has no bound.
    """
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    sine, cosine = np.where(cosine < 0.0, -sine, sine), np.abs(cosine)  # the axis has no sign
    ends = _interval(offset * cosine, sine, 0.5 * length)
    return _arch_slice(radius, centre_height, -offset * sine, cosine, ends, ground_range, altitude)


def cone_slice(
    base_radius: Array, top_radius: Array, height: Array, offset: Array, ground_range: Array, altitude: Array
) -> Slice:
    """Slice an upright truncated cone on the floor, top_radius <= base_radius.

    The slice is bounded by a hyperbola and the flat top.

    With ρ² = y'² + u² (y' from the axis, u the offset) the lateral height is (R - ρ) / k, and the ray from the sonar
    touches it where u² - y_c y' = (R - kH) ρ, which is a sine in the polar angle of (y', u).
    """
    hit = (np.abs(offset) <= base_radius) & (height > 0.0)
    base_radius = np.where(hit, base_radius, 1.0)
    u = np.where(hit, np.abs(offset), 0.0)
    k = (base_radius - top_radius) / np.where(hit, height, 1.0)
    # Dividing by a smaller taper would make heights of rounding.
    top_radius, k = np.where(k < _UPRIGHT, base_radius, top_radius), np.where(k < _UPRIGHT, 0.0, k)
    apex = base_radius - k * altitude  # radius of the cone continued to the sonar's height; negative above its apex
    base = np.sqrt(np.maximum((base_radius - u) * (base_radius + u), 0.0))
    rim = np.sqrt(np.maximum((top_radius - u) * (top_radius + u), 0.0))
    flat = u <= top_radius

    def lateral_height(across: Array) -> Array:
        sloping = np.clip(
            (base_radius - np.hypot(across, u)) / np.where(k > 0.0, k, 1.0), 0.0, np.where(hit, height, 0.0)
        )
        return np.where(flat & (np.abs(across) <= rim), height, np.where(np.abs(across) >= base, 0.0, sloping))

    angle = np.arctan2(ground_range, u) + np.arcsin(
        np.clip(apex / np.maximum(np.hypot(u, ground_range), _TINY), -1.0, 1.0)
    )
    lit_down_to_the_floor = angle <= 0.0
    touch = np.where(lit_down_to_the_floor, np.inf, u / np.tan(np.where(lit_down_to_the_floor, 1.0, angle)))
    # Seen from above its rim the flat top hides behind its far end, from below behind the near one.
    below_rim = flat & (altitude < height)
    across = np.clip(touch, np.where(flat & ~below_rim, rim, -base), np.where(below_rim, -rim, base))
    front = -np.clip(
        _cone_front(base_radius, np.maximum(k, _UPRIGHT), u, ground_range, altitude), np.where(flat, rim, 0.0), base
    )
    return _masked(
        hit,
        near=ground_range - base,
        front=np.hypot(ground_range + front, np.maximum(altitude - lateral_height(front), 0.0)),
        tangent=ground_range + across,
        tangent_height=lateral_height(across),
    )


def _cone_front(base_radius: Array, k: Array, u: Array, ground_range: Array, altitude: Array) -> Array:
    """Compute how far before the axis the sloping side is nearest to the sonar, if it had neither top nor base.

    With x the inverse of that distance and m = R - kH: s x + m S(x) = T, where s = k² y_c, T = 1 + k² and S(x) = x /
    sqrt(1 + u²x²). The left side is concave for m >= 0 and convex for m < 0, so Newton's method from below, or from
    above, closes in from one side. It starts from the best of the bounds S <= x, S <= 1/u, and S <= x (1 - e u²x²) for
    ux <= 1, S <= (1 - e / (ux)²) / u for ux >= 1 with e = 1 - sqrt(1/2).
    """
    u = np.maximum(u, 1e-12 * base_radius)  # through the axis the side has a corner
    m = base_radius - k * altitude
    slope = k * k * np.maximum(ground_range, 1e-6)
    target = 1.0 + k * k
    at_corner, at_end = slope + m, target - m / u
    through_origin = np.where(at_corner > 0.0, target / np.maximum(at_corner, _TINY), np.inf)
    saturated = at_end / slope
    x_below = np.maximum(through_origin, saturated)
    x_above = np.minimum(through_origin, saturated)
    tail = _CHORD * np.maximum(m, 0.0) / u**3
    bent = np.minimum(np.sqrt(0.5 * tail / np.maximum(np.abs(at_end), 1e-200)), np.cbrt(0.5 * tail / slope))
    bent = np.where(at_end >= 0.0, np.cbrt(tail / slope), bent)
    x_below = np.where(bent * u >= 1.0, np.maximum(x_below, bent), x_below)
    cubic = np.maximum(_CHORD * np.maximum(-m, 0.0) * u**2, _TINY)
    bent = np.maximum(np.sqrt(2.0 * np.abs(at_corner) / cubic), np.cbrt(2.0 * target / cubic))
    bent = np.where(at_corner >= 0.0, np.cbrt(target / cubic), bent)
    x_above = np.where(bent * u <= 1.0, np.minimum(x_above, bent), x_above)
    x = np.where(m < 0.0, x_above, x_below)
    for _ in range(_STEPS):
        shrink = 1.0 / np.hypot(1.0, u * x)
        x = x - (slope * x + m * x * shrink - target) / (slope + m * shrink**3)
    return np.asarray(1.0 / x, dtype=np.float64)


def _arch_slice(
    radius: Array,
    centre_height: Array,
    lateral: Array,
    cosine: Array,
    ends: tuple[Array, Array],
    ground_range: Array,
    altitude: Array,
) -> Slice:
    """Slice an arch, y' from y_c.

    {(y', z): l² + (z - centre)² <= radius², l = lateral + cosine y', ends[0] <= y' <= ends[1], z >= 0}.

    cosine >= 0. In (l, z) the boundary is a circle and straight rays stay straight, so tangents are a circle's.
    """
    sunk = np.minimum(centre_height, 0.0)
    at_floor = np.sqrt(np.maximum((radius - sunk) * (radius + sunk), 0.0))
    sides = _interval(lateral, cosine, np.where(radius > -sunk, at_floor, -1.0))
    low, high = np.maximum(sides[0], ends[0]), np.minimum(sides[1], ends[1])
    hit = low <= high
    low, high = np.where(hit, low, 0.0), np.where(hit, high, 0.0)

    sonar = lateral - cosine * ground_range  # lateral coordinate of the sonar
    rise = altitude - centre_height
    square = np.maximum(sonar * sonar + rise * rise, _TINY)
    power = np.maximum(square - radius * radius, 0.0)
    touch = (radius * radius * sonar + radius * np.sqrt(power) * rise) / square
    across = np.clip(np.where(power > 0.0, (touch - lateral) / np.maximum(cosine, _LEVEL), -np.inf), low, high)
    front = np.clip(_arch_front(radius, lateral, cosine, sonar, rise, ground_range), low, high)
    half = _half_chord(radius, lateral + cosine * front)
    front_height = np.clip(altitude, np.maximum(centre_height - half, 0.0), np.maximum(centre_height + half, 0.0))
    return _masked(
        hit,
        near=ground_range + low,
        front=np.hypot(ground_range + front, altitude - front_height),
        tangent=ground_range + across,
        tangent_height=np.maximum(centre_height + _half_chord(radius, lateral + cosine * across), 0.0),
    )


def _arch_front(radius: Array, lateral: Array, cosine: Array, sonar: Array, rise: Array, ground_range: Array) -> Array:
    """Compute where, from y_c, the nearest point to the sonar is if the ellipse had neither ends nor floor.

    The multiplier t >= 0 of the ellipse's equation solves F(t) = (A / (c²t + 1))² + (B / (t + 1))² = 1 with A, B the
    sonar's lateral coordinate and rise over the radius. F^(-1/2) is concave, so Newton's method on it closes in from
    below (J. J. Moré and D. C. Sorensen, "Computing a trust region step", SIAM J. Sci. Stat. Comput. 4, 1983). It
    starts from the best of the bounds c = 1, B = 0, and (1 + c²t)^-2 >= 1 - 2 c²t; the last one counts where the sonar
    is all but above the ellipse's long end.
    """
    size = np.where(radius > 0.0, radius, 1.0)
    first, second = sonar / size, rise / size
    squeeze = cosine * cosine
    outside = first * first + second * second > 1.0
    first, second = np.where(outside, first, 2.0), np.where(outside, second, 0.0)
    excess = (np.abs(first) - 1.0) * (np.abs(first) + 1.0)
    falling, second_square = np.maximum(2.0 * first * first * squeeze, 1e-60), second * second
    bent = np.minimum(
        np.sqrt(0.5 * second_square / np.maximum(np.abs(excess), 1e-30)), np.cbrt(0.5 * second_square / falling)
    )
    bent = np.where(excess >= 0.0, np.cbrt(second_square / falling), bent) - 1.0
    along_axis = np.where(squeeze > 1e-30, (np.abs(first) - 1.0) / np.maximum(squeeze, 1e-30), 0.0)
    t = np.maximum(np.maximum(np.hypot(first, second) - 1.0, along_axis), bent)
    for _ in range(_STEPS):
        wide, high = 1.0 / (squeeze * t + 1.0), 1.0 / (t + 1.0)
        first_square, second_square = (first * wide) ** 2, (second * high) ** 2
        value = first_square + second_square
        t = np.maximum(t + value * (np.sqrt(value) - 1.0) / (first_square * squeeze * wide + second_square * high), 0.0)
    return np.where(outside, -(ground_range + lateral * cosine * t) / (squeeze * t + 1.0), -np.inf)


def _half_chord(radius: Array, lateral: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum((radius - lateral) * (radius + lateral), 0.0)), dtype=np.float64)


def _interval(offset: Array, slope: Array, half_width: Array) -> tuple[Array, Array]:
    """Compute the interval of y' in which |offset + slope y'| <= half_width; from inf to -inf if there is none."""
    level = np.abs(slope) < _LEVEL
    steep = np.where(level, 1.0, np.abs(slope))
    offset = np.where(slope < 0.0, -offset, offset)
    everywhere = np.where(np.abs(offset) <= half_width, np.inf, -np.inf)
    return (
        np.where(level, -everywhere, (-half_width - offset) / steep),
        np.where(level, everywhere, (half_width - offset) / steep),
    )


def _masked(hit: NDArray[np.bool_], *, near: Array, front: Array, tangent: Array, tangent_height: Array) -> Slice:
    results = np.broadcast_arrays(hit, near, front, tangent, tangent_height)
    return Slice(*(np.where(results[0], result, np.nan) for result in results[1:]))
