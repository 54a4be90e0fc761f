"""Place the objects of a scene and build the bodies and points that echo in their stead."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from auv_mcm.errors import UsageError
from sim_replay.simulator.bodies import CONE, CYLINDER, ELLIPSOID, MOAT, POLYHEDRON, SCAR, TORUS, Body, Planes
from sim_replay.simulator.plan import Leg, place_in_plane, planned_legs, swath_m
from sim_replay.simulator.scene import TARGET_KINDS, ObjectKind, Scatter, Scene, SceneObject

_STREAM: Final = 0x4F424A45  # keeps these random numbers apart from others of the same seed
_TRIES: Final = 400  # places drawn for one object before there is none left
_SIZE_EXPONENT: Final = 2.5  # stones longer than d are as many as d^-2.5
_CONE_SIDES: Final = 24  # of a tilted cone: its radius is within 1 %
_MOAT_WIDTH: Final = 0.6  # half width of a scour moat, in parts of the object's half sizes

HeightOfFloor: TypeAlias = Callable[[float, float], float]  # m above the datum, of east and north
Floats: TypeAlias = NDArray[np.float64]


class Usual(NamedTuple):
    """Hold the usual sizes and strengths of a kind, m and dB; see SceneObject."""

    length_m: float
    width_m: float
    height_m: float
    top_m: float = 0.0
    n_members: int = 1
    strength_db: float = -12.0
    specular_db: float = 10.0


USUAL: Final[dict[ObjectKind, Usual]] = {
    "cylinder": Usual(2.0, 0.53, 0.53),
    "sphere": Usual(0.8, 0.8, 0.8, specular_db=6.0),
    "truncated_cone": Usual(0.98, 0.98, 0.47, top_m=0.5, specular_db=6.0),
    "wedge": Usual(1.02, 0.8, 0.385),
    "box": Usual(1.1, 0.9, 0.45),
    "rock": Usual(0.9, 0.7, 0.4, strength_db=-14.0, specular_db=0.0),
    "slab": Usual(1.4, 0.9, 0.3, strength_db=-14.0, specular_db=5.0),
    "boulder_cluster": Usual(4.0, 3.0, 0.5, n_members=9, strength_db=-14.0, specular_db=0.0),
    "debris": Usual(2.2, 1.4, 0.4, n_members=6, strength_db=-12.0, specular_db=8.0),
    "tyre": Usual(0.9, 0.9, 0.25, strength_db=-18.0, specular_db=3.0),
    "pipe": Usual(4.5, 0.4, 0.4),
    "anchor_scar": Usual(25.0, 2.4, 0.25),
    "fish_school": Usual(4.0, 2.5, 1.2, n_members=150, strength_db=-42.0),
    "point": Usual(0.0, 0.0, 0.0, strength_db=-15.0),
}
BY_WIDTH: Final[dict[ObjectKind, tuple[str, ...]]] = {
    "cylinder": ("height_m",),
    "pipe": ("height_m",),
    "sphere": ("length_m", "height_m"),
    "truncated_cone": ("length_m",),
    "tyre": ("length_m",),
}
"""Sizes of a kind that equal its width, the diameter."""
_SPECULAR_EXPONENT: Final = 40.0  # of the cosine: how narrow the glint of a smooth surface is


class PlacedObject(NamedTuple):
    """Describe one object completely. azimuth_rad clockwise from the plane's north; sizes as in SceneObject."""

    kind: ObjectKind
    east_m: float
    north_m: float
    azimuth_rad: float
    tilt_rad: float
    length_m: float
    width_m: float
    height_m: float
    top_m: float
    burial_m: float
    scour_m: float
    above_m: float
    n_members: int
    strength_db: float
    specular_db: float
    is_target: bool
    seed: int

    @property
    def reach_m(self) -> float:
        """Return the maximum of half its horizontal extent."""
        return 0.5 * math.hypot(self.length_m, self.width_m) + self.height_m * abs(math.sin(self.tilt_rad))


class Material(NamedTuple):
    """Describe how a body scatters; see backscatter.target_table."""

    strength_db: float
    specular_db: float
    specular_exponent: float


def place_objects(scene: Scene) -> tuple[PlacedObject, ...]:
    """Place all objects of a scene: those it names, then those it scatters.

    Raises UsageError if there is not enough room for the scattered objects.
    """
    legs = planned_legs(scene.track.plan)
    placed = [_named(scene, scene_object, index) for index, scene_object in enumerate(scene.objects)]
    for index, group in enumerate(scene.scatter):
        placed += _scattered(scene, group, index, legs, placed)
    return tuple(placed)


def _named(scene: Scene, scene_object: SceneObject, index: int) -> PlacedObject:
    usual = USUAL[scene_object.kind]
    east, north = place_in_plane(scene, scene_object)
    width = usual.width_m if scene_object.width_m is None else scene_object.width_m
    return PlacedObject(
        kind=scene_object.kind,
        east_m=east,
        north_m=north,
        azimuth_rad=math.radians(scene_object.azimuth_deg),
        tilt_rad=math.radians(scene_object.tilt_deg),
        **solid_sizes(scene_object.kind, scene_object.length_m, width, scene_object.height_m),
        top_m=min(usual.top_m * width / max(usual.width_m, 1e-9), width)
        if scene_object.top_m is None
        else scene_object.top_m,
        burial_m=scene_object.burial_m,
        scour_m=scene_object.scour_m,
        above_m=scene_object.above_m,
        n_members=scene_object.count or usual.n_members,
        strength_db=usual.strength_db if scene_object.strength_db is None else scene_object.strength_db,
        specular_db=usual.specular_db if scene_object.specular_db is None else scene_object.specular_db,
        is_target=scene_object.kind in TARGET_KINDS if scene_object.is_target is None else scene_object.is_target,
        seed=index,
    )


def solid_sizes(
    kind: ObjectKind, length_m: float | None, width_m: float | None, height_m: float | None
) -> dict[str, float]:
    """Return length, width and height of a kind; missing ones are usual, those that its shape couples are equal."""
    usual = USUAL[kind]
    width = usual.width_m if width_m is None else width_m
    sizes = {
        "length_m": usual.length_m if length_m is None else length_m,
        "width_m": width,
        "height_m": usual.height_m if height_m is None else height_m,
    }
    return sizes | dict.fromkeys(BY_WIDTH.get(kind, ()), width)


def _scattered(
    scene: Scene, group: Scatter, index: int, legs: Sequence[Leg], others: Sequence[PlacedObject]
) -> list[PlacedObject]:
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([scene.seed, _STREAM, index])))
    limits_m = group.ground_range_m or (0.0, swath_m(scene))
    usual = USUAL[group.kind]
    taken = np.empty((3, len(others) + group.count), dtype=np.float64)  # east, north, reach
    for number, other in enumerate(others):
        taken[:, number] = other.east_m, other.north_m, other.reach_m
    placed: list[PlacedObject] = []

    def drawn(limits: tuple[float, float] | None) -> float | None:
        return None if limits is None else float(random.uniform(*limits))

    for number in range(group.count):
        length, width, height = drawn(group.length_m), drawn(group.width_m), drawn(group.height_m)
        if group.natural_sizes:
            smallest, largest = group.length_m or (0.3 * usual.length_m, 3.0 * usual.length_m)
            natural = _power_law(float(random.uniform()), smallest, largest)
            scale = natural / (usual.length_m or 1.0)
            length = natural
            width = usual.width_m * scale * float(random.uniform(0.8, 1.2)) if width is None else width
            height = usual.height_m * scale * float(random.uniform(0.7, 1.3)) if height is None else height
        sizes = solid_sizes(group.kind, length, width, height)
        burial, tilt, scour = drawn(group.burial_m) or 0.0, drawn(group.tilt_deg) or 0.0, drawn(group.scour_m) or 0.0
        strength = drawn(group.strength_db)
        reach = 0.5 * math.hypot(sizes["length_m"], sizes["width_m"])
        n_taken = len(others) + number
        for east, north in _tries(random, legs, limits_m):
            gaps_m = np.hypot(east - taken[0, :n_taken], north - taken[1, :n_taken]) - taken[2, :n_taken]
            if (gaps_m >= group.apart_m + reach).all():
                break
        else:
            raise UsageError(
                f"`scatter[{index}]` ({group.kind}): no room for number {number + 1} of {group.count} after {_TRIES} "
                "tries; take fewer, a smaller `apart_m`, or a longer track"
            )
        taken[:, n_taken] = east, north, reach
        placed.append(
            PlacedObject(
                kind=group.kind,
                east_m=east,
                north_m=north,
                azimuth_rad=float(random.uniform(0.0, 2.0 * math.pi)),
                tilt_rad=math.radians(tilt),
                **sizes,
                top_m=usual.top_m * sizes["width_m"] / max(usual.width_m, 1e-9),
                burial_m=burial,
                scour_m=scour,
                above_m=1.0 if group.kind == "fish_school" else 0.0,
                n_members=usual.n_members,
                strength_db=usual.strength_db if strength is None else strength,
                specular_db=usual.specular_db,
                is_target=group.kind in TARGET_KINDS if group.is_target is None else group.is_target,
                seed=shape_seed(scene.seed, index, number),
            )
        )
    return placed


def shape_seed(seed: int, group: int, number: int) -> int:
    """Return what draws the shape of a scattered object, by seed, group and number; from 0 to 2^32 - 1."""
    return int(np.random.SeedSequence([seed, _STREAM, group, number]).generate_state(1)[0])


def _tries(
    random: np.random.Generator, legs: Sequence[Leg], limits_m: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """Draw places, east and north, m, whose nearest leg passes them within the limits of ground range."""
    low, high = limits_m
    ends = np.cumsum([leg.length_m for leg in legs])
    ends /= ends[-1]
    for _ in range(_TRIES):
        leg = legs[int(ends.searchsorted(random.random(), side="right"))]
        across = float(random.uniform(low, high)) * (1.0 if random.uniform() < 0.5 else -1.0)
        east, north = leg.at(float(random.uniform(0.0, leg.length_m)), across)
        closest = min(abs(other.along_across(east, north)[1]) for other in legs if _abeam(other, east, north))
        if low <= closest <= high:
            yield east, north


def _abeam(leg: Leg, east_m: float, north_m: float) -> bool:
    return 0.0 <= leg.along_across(east_m, north_m)[0] <= leg.length_m


def _power_law(uniform: float, smallest: float, largest: float) -> float:
    """Draw a size whose numbers above d fall as d^-2.5 between the limits, by inversion."""
    share = 1.0 - (smallest / largest) ** _SIZE_EXPONENT
    return float(smallest * (1.0 - uniform * share) ** (-1.0 / _SIZE_EXPONENT))


def material_of(scene_object: PlacedObject) -> Material:
    """Return the material of the object's bodies."""
    return Material(scene_object.strength_db, scene_object.specular_db, _SPECULAR_EXPONENT)


def bodies_of(scene_object: PlacedObject, floor_m: HeightOfFloor, material: int) -> list[Body]:
    """Build the bodies of an object on a floor of the given height above the datum; none for point echoes."""
    if scene_object.kind in ("point", "fish_school"):
        return []
    base = floor_m(scene_object.east_m, scene_object.north_m)
    if scene_object.kind == "anchor_scar":
        sizes = (0.5 * scene_object.length_m, 0.5 * scene_object.width_m, scene_object.height_m)
        return [_body(scene_object, SCAR, base, sizes, material, scene_object.reach_m)]
    bodies = []
    if scene_object.scour_m > 0.0:
        half = 0.5 * scene_object.length_m, 0.5 * scene_object.width_m
        bodies.append(
            _body(
                scene_object,
                MOAT,
                base,
                (*half, scene_object.scour_m, _MOAT_WIDTH),
                material,
                (1.0 + _MOAT_WIDTH) * max(half),
            )
        )
    if scene_object.kind in ("boulder_cluster", "debris"):
        return bodies + _group(scene_object, floor_m, material)
    return [*bodies, _single(scene_object, base, material)]


def _single(scene_object: PlacedObject, base_m: float, material: int) -> Body:
    half_length, half_width, buried = 0.5 * scene_object.length_m, 0.5 * scene_object.width_m, scene_object.burial_m
    if scene_object.kind == "sphere":
        return _body(
            scene_object,
            ELLIPSOID,
            base_m,
            (half_width, half_width, half_width, half_width - buried),
            material,
            half_width,
        )
    if scene_object.kind in ("cylinder", "pipe"):
        raised = (
            scene_object
            if scene_object.tilt_rad >= 0.0
            else scene_object._replace(azimuth_rad=scene_object.azimuth_rad + math.pi, tilt_rad=-scene_object.tilt_rad)
        )
        sine, cosine = math.sin(raised.tilt_rad), math.cos(raised.tilt_rad)
        centre = half_width * cosine + half_length * sine - buried
        reach = math.hypot(half_length, half_width) * 1.01
        return _body(raised, CYLINDER, base_m, (half_width, half_length, centre, sine, cosine), material, reach)
    if scene_object.kind == "truncated_cone" and scene_object.tilt_rad == 0.0:
        return _body(
            scene_object,
            CONE,
            base_m,
            (half_width, 0.5 * scene_object.top_m, scene_object.height_m, buried),
            material,
            half_width,
        )
    if scene_object.kind == "tyre":
        tread = 0.5 * scene_object.height_m
        return _body(
            scene_object,
            TORUS,
            base_m,
            (half_width - 0.8 * tread, 0.8 * tread, tread, tread - buried),
            material,
            half_width,
        )
    return _polyhedron(scene_object, base_m, material)


def _polyhedron(scene_object: PlacedObject, base_m: float, material: int) -> Body:
    """Build a wedge, box, rock, slab or tilted cone: the hull of its corners."""
    corners = _corners(scene_object)
    planes, n_sides = hull_planes(corners)
    reach = float(np.hypot(corners[:, 0], corners[:, 1]).max()) + 1e-6
    return _body(scene_object, POLYHEDRON, base_m, (), material, reach, planes, n_sides)


def _corners(scene_object: PlacedObject) -> Floats:
    """Return (n, 3) corners of a solid with plane sides, tilted and pushed into the floor."""
    half_length, half_width, height = 0.5 * scene_object.length_m, 0.5 * scene_object.width_m, scene_object.height_m
    if scene_object.kind in _STONES:
        corners = _STONES[scene_object.kind](half_length, half_width, height, scene_object.seed)
    elif scene_object.kind == "truncated_cone":
        turn = np.arange(_CONE_SIDES) * (2.0 * math.pi / _CONE_SIDES)
        rings = [(half_width, 0.0), (0.5 * scene_object.top_m, height)]
        corners = np.concatenate(
            [np.stack([r * np.cos(turn), r * np.sin(turn), np.full_like(turn, z)], axis=1) for r, z in rings]
        )
    else:
        corners = np.array(
            [(u * half_length, v * half_width, top * height) for u in (-1, 1) for v in (-1, 1) for top in (0, 1)]
        )
        if scene_object.kind == "wedge":
            corners = corners[(corners[:, 0] > 0.0) | (corners[:, 2] == 0.0)]
    sine, cosine = math.sin(scene_object.tilt_rad), math.cos(scene_object.tilt_rad)
    along, up = corners[:, 0] * cosine - corners[:, 2] * sine, corners[:, 0] * sine + corners[:, 2] * cosine
    lowest = 0.0 if scene_object.kind in _STONES else float(up.min())  # a stone is bedded in the floor as it is
    return np.stack([along, corners[:, 1], up - lowest - scene_object.burial_m], axis=1)


def rise_m(scene_object: PlacedObject) -> float:
    """Return how far an object rises above the floor that it lies on."""
    kind, tilt = scene_object.kind, abs(scene_object.tilt_rad)
    if tilt > 0.0 and kind in _TILTED:
        return float(_corners(scene_object)[:, 2].max())
    if kind in ("cylinder", "pipe"):
        upright_m = scene_object.width_m * math.cos(tilt) + scene_object.length_m * math.sin(tilt)
        return upright_m - scene_object.burial_m
    return scene_object.height_m - scene_object.burial_m


def hull_planes(corners_m: Floats) -> tuple[Planes, int]:
    """Return sides and tops of the convex hull of (n, 3) corners, as seen from above, and the number of sides.

    A side (a, b, d) bounds the outline: a u + b v <= d. A top (a, b, c) bounds the height: z <= a u + b v + c.
    """
    outline = ConvexHull(corners_m[:, :2])
    sides = {(float(a), float(b), float(-d)) for a, b, d in outline.equations}
    tops = {
        (float(-a / c), float(-b / c), float(-d / c))
        for a, b, c, d in ConvexHull(corners_m, qhull_options="Qt").equations
        if c > 1e-9
    }
    return tuple(sorted(sides)) + tuple(sorted(tops)), len(sides)


def _rock_corners(half_length: float, half_width: float, height: float, seed: int) -> Floats:
    """Draw corners of an angular rock that fills its sizes: points on a half-buried superellipsoid, flattened at
    random."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([_STREAM, seed])))
    n = int(random.integers(14, 26))
    turn = random.uniform(0.0, 2.0 * math.pi, n)
    rise = random.uniform(-0.3, 1.0, n)
    level = np.sqrt(np.maximum(0.0, 1.0 - rise**2)) * random.uniform(0.75, 1.0, n)
    corners = np.stack([level * np.cos(turn), level * np.sin(turn), rise * random.uniform(0.85, 1.0, n)], axis=1)
    span = np.maximum(np.abs(corners).max(axis=0), 1e-6)
    corners[:, 0] *= half_length / span[0]
    corners[:, 1] *= half_width / span[1]
    corners[:, 2] *= height / max(float(corners[:, 2].max()), 1e-6)
    return corners


def _slab_corners(half_length: float, half_width: float, height: float, seed: int) -> Floats:
    """Draw corners of a slab of bedrock that reaches its sizes: four or five steep sides, a flat top that may slope."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([_STREAM, 2, seed])))
    outline = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * random.uniform(0.7, 1.0, (4, 2))
    if random.random() < 0.4:  # a corner is broken off
        shares = random.uniform(0.2, 0.6, 2)[:, None]
        outline = np.concatenate([outline[1:], outline[:1] + shares * (outline[[1, 3]] - outline[:1])])
    outline /= np.abs(outline).max(axis=0)
    outline *= (half_length, half_width)
    top = outline * random.uniform(0.8, 1.0)
    slope_u, slope_v = random.uniform(-0.2, 0.2, 2)
    rise = 1.0 + slope_u * top[:, 0] / half_length + slope_v * top[:, 1] / half_width
    return np.concatenate(
        [np.pad(outline, ((0, 0), (0, 1))), np.column_stack([top, height * rise / max(float(rise.max()), 1e-6)])]
    )


_STONES: Final = {"rock": _rock_corners, "slab": _slab_corners}
_TILTED: Final = ("truncated_cone", "wedge", "box", *_STONES)  # solids with plane sides once they tilt


def _group(scene_object: PlacedObject, floor_m: HeightOfFloor, material: int) -> list[Body]:
    """Build a boulder cluster, or debris: plates, blocks and rods, strewn over the group's extent."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([_STREAM, 1, scene_object.seed])))
    sine, cosine = math.sin(scene_object.azimuth_rad), math.cos(scene_object.azimuth_rad)
    bodies = []
    for member in range(scene_object.n_members):
        radius, turn = math.sqrt(float(random.uniform())), float(random.uniform(0.0, 2.0 * math.pi))
        u, v = (
            0.5 * scene_object.length_m * radius * math.cos(turn),
            0.5 * scene_object.width_m * radius * math.sin(turn),
        )
        size = _power_law(float(random.uniform()), 0.35, 1.0) if member else 1.0
        height = scene_object.height_m * size
        long, wide = (float(value) for value in random.uniform(1.2, 2.4, 2) * height)
        kind: ObjectKind = "rock"
        if scene_object.kind == "debris":
            kind = ("box", "cylinder", "box")[member % 3] if member else "box"
            long, wide, height = (
                (1.5 * long, 0.3 * height, 0.3 * height) if kind == "cylinder" else (long, wide, 0.6 * height)
            )
        one = scene_object._replace(
            kind=kind,
            east_m=scene_object.east_m + u * sine + v * cosine,
            north_m=scene_object.north_m + u * cosine - v * sine,
            azimuth_rad=float(random.uniform(0.0, 2.0 * math.pi)),
            tilt_rad=float(random.uniform(-0.3, 0.3)) if scene_object.kind == "debris" else 0.0,
            length_m=long,
            width_m=wide,
            height_m=height,
            burial_m=min(scene_object.burial_m, 0.5 * height),
            seed=scene_object.seed * 100 + member,
        )
        bodies.append(_single(one, floor_m(one.east_m, one.north_m), material))
    return bodies


def _body(
    scene_object: PlacedObject,
    kind: int,
    base_m: float,
    sizes: tuple[float, ...],
    material: int,
    reach_m: float,
    planes: Planes = (),
    n_sides: int = 0,
) -> Body:
    return Body(
        kind,
        scene_object.east_m,
        scene_object.north_m,
        base_m,
        scene_object.azimuth_rad,
        reach_m,
        sizes,
        material,
        planes,
        n_sides,
    )


def points_of(scene_object: PlacedObject, floor_m: HeightOfFloor) -> list[tuple[float, float, float, float]]:
    """Return east, north, height above the datum (m) and target strength (linear, m2) of echoes without a body."""
    if scene_object.kind not in ("point", "fish_school"):
        return []
    base, strength = (
        floor_m(scene_object.east_m, scene_object.north_m) + scene_object.above_m,
        10.0 ** (0.1 * scene_object.strength_db),
    )
    if scene_object.kind == "point":
        return [(scene_object.east_m, scene_object.north_m, base, strength)]
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([_STREAM, 2, scene_object.seed])))
    sine, cosine = math.sin(scene_object.azimuth_rad), math.cos(scene_object.azimuth_rad)
    points = []
    for a, b, c in random.normal(size=(scene_object.n_members, 3)) * 0.25:
        u, v, w = (
            scene_object.length_m * float(a),
            scene_object.width_m * float(b),
            scene_object.height_m * (0.5 + float(c)),
        )
        points.append(
            (
                scene_object.east_m + u * sine + v * cosine,
                scene_object.north_m + u * cosine - v * sine,
                base + max(w, 0.0),
                strength,
            )
        )
    return points
