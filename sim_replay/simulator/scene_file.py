"""Read scenes from YAML files and reject contradictory ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.errors import UsageError
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from sim_replay.simulator.echo import absorption_db_per_km
from sim_replay.simulator.objects import BY_WIDTH, USUAL
from sim_replay.simulator.plan import Leg, place_in_plane, planned_legs, swath_m
from sim_replay.simulator.recording import largest_sample
from sim_replay.simulator.scene import ObjectKind, Scene, SceneObject
from sim_replay.simulator.speckle import WIDEST
from sim_replay.simulator.vehicle import STRONGEST_CURRENT

FIERCEST_TEXTURE: Final = 0.1  # a Gamma law of smaller shape is all zeros and spikes
HIGHEST_SHARE: Final = 0.8  # of the altitude that an object may be high
_MOST_ABSORBED_DB: Final = 200.0  # dB to midway and back: beyond the span of any converter, and of 32-bit floats
_STEEPEST_PITCH_DEG: Final = 80.0  # degrees: beyond, what looks abeam soon looks at no floor at all
_CORNERED: Final = frozenset({"rock", "slab", "box", "wedge", "truncated_cone", "boulder_cluster", "debris"})
"""Kinds whose hull needs a size; of a cone where it is tilted."""
_SHIPPED: Final = resources.files("sim_replay") / "scenes"


def named_scenes() -> tuple[str, ...]:
    """Return the names of the scenes that ship with the package, in alphabetical order."""
    return tuple(sorted(path.name.removesuffix(".yaml") for path in _SHIPPED.iterdir() if path.name.endswith(".yaml")))


def read_scene(name_or_path: str) -> Scene:
    """Read a scene from a file, or one of the named ones.

    Raises UsageError if there is no such scene, or as parse_scene does.
    """
    path = Path(name_or_path)
    if name_or_path in named_scenes() and not path.is_file():
        return parse_scene((_SHIPPED / f"{name_or_path}.yaml").read_text("utf-8"), f"scene {name_or_path}")
    if not path.exists():
        raise UsageError(f"{path}: no such scene file, and the scenes with names are {', '.join(named_scenes())}")
    return parse_scene(read_text(path, "scene"), str(path))


def parse_scene(text: str, place: str) -> Scene:
    """Parse a scene from YAML text; `place` names it in messages.

    Raises UsageError with the key's path for unknown and repeated keys, wrong types, values out of range, and scenes
    that cannot be.
    """
    data = load_mapping(text, place, "expected keys such as 'track:'")
    try:
        scene = msgspec.convert(data, Scene)
    except msgspec.ValidationError as error:
        raise UsageError(
            f"{place}: {explain_validation_error(error, Scene, data)}. See the scenes shipped with the package"
        ) from error
    check_scene(scene, place)
    return scene


def check_scene(scene: Scene, place: str = "scene") -> None:
    """Reject a scene that contradicts itself. Raises UsageError naming the first offending key, and why."""
    for reason in _contradictions(scene):
        raise UsageError(f"{place}: {reason}")


def _contradictions(scene: Scene) -> Iterator[str]:
    sonar, track, world = scene.sonar, scene.track, scene.world
    if track.altitude_m >= sonar.range_m:
        yield (
            f"`track.altitude_m` is {track.altitude_m:g} m: a `sonar.range_m` of {sonar.range_m:g} does not reach the "
            "floor"
        )
    if track.altitude_m >= world.depth_m:
        yield (
            f"`track.altitude_m` is {track.altitude_m:g} m: above the surface, where `world.depth_m` is "
            f"{world.depth_m:g}"
        )
    current, strongest = track.motion.current_mps, STRONGEST_CURRENT * track.speed_mps
    if current > strongest:
        yield (
            f"`track.motion.current_mps` is {current:g}: the vehicle, at `track.speed_mps`, stays on track in "
            f"{strongest:g}"
        )
    tipped_deg = abs(track.motion.pitch_offset_deg) + 4.0 * track.motion.pitch_sigma_deg
    if tipped_deg > _STEEPEST_PITCH_DEG:
        yield (
            f"`track.motion.pitch_sigma_deg` is {track.motion.pitch_sigma_deg:g}: four of them and `pitch_offset_deg` "
            f"make {tipped_deg:g} degrees, of {_STEEPEST_PITCH_DEG:g} at most"
        )
    yield from _sonar_contradictions(scene)
    for index, seabed in enumerate(world.seabeds):
        if seabed.texture_shape is not None and 0.0 < seabed.texture_shape < FIERCEST_TEXTURE:
            yield (
                f"`world.seabeds[{index}].texture_shape` is {seabed.texture_shape:g}; give 0 for none, or at least "
                f"{FIERCEST_TEXTURE:g}"
            )
    legs = planned_legs(track.plan)
    for index, leg in enumerate(legs):
        if leg.length_m < 1.0:
            yield f"`track.plan`: leg {index} is {leg.length_m:.2f} m long; at least 1 m is needed"
    yield from _slope_contradictions(scene, legs)
    for index, scene_object in enumerate(scene.objects):
        for reason in _object_contradictions(scene, scene_object, legs):
            yield f"`objects[{index}]` ({scene_object.kind}): {reason}"
    yield from _scatter_contradictions(scene)


def _sonar_contradictions(scene: Scene) -> Iterator[str]:
    sonar, recorder = scene.sonar, scene.sonar.recorder
    travel_s = 2.0 * sonar.range_m / sonar.sound_speed_mps
    if sonar.synthetic_aperture is None and sonar.ping_rate_hz * travel_s > 1.0 + 1e-9:
        yield (
            f"`sonar.ping_rate_hz` is {sonar.ping_rate_hz:g}: an echo from `sonar.range_m` of {sonar.range_m:g} m "
            f"takes {travel_s:.3f} s, so at most {1.0 / travel_s:.1f} Hz"
        )
    largest = largest_sample(recorder)
    if recorder.full_scale is not None and largest is not None and recorder.full_scale > largest:
        yield f"`sonar.recorder.full_scale` is {recorder.full_scale}: `{recorder.samples}` holds at most {largest}"
    absorbed_db = 1e-3 * absorption_db_per_km(sonar, scene.world.depth_m) * (scene.track.altitude_m + sonar.range_m)
    if absorbed_db > _MOST_ABSORBED_DB:
        yield (
            f"`sonar.range_m` is {sonar.range_m:g}: at `sonar.frequency_khz` {sonar.frequency_khz:g} the water takes "
            f"{absorbed_db:.0f} dB of an echo from midway, of {_MOST_ABSORBED_DB:g} at most; give less of either, or "
            "`sonar.absorption_db_per_km`"
        )
    aperture = sonar.synthetic_aperture
    if aperture is None:
        wide = {
            "range_resolution_m": sonar.range_m / sonar.n_samples,
            "speckle_along_track_m": scene.track.speed_mps / sonar.ping_rate_hz,
        }
        for name, step_m in wide.items():
            if getattr(sonar, name) > WIDEST * step_m:
                yield (
                    f"`sonar.{name}` is {getattr(sonar, name):g}: more than {WIDEST} steps of {step_m:.3g} m; give at "
                    f"most {math.floor(1e3 * WIDEST * step_m) / 1e3:g}"
                )
    if aperture is not None and aperture.view != "full" and aperture.view >= aperture.sub_apertures:
        yield (
            f"`sonar.synthetic_aperture.view` is {aperture.view}: there are {aperture.sub_apertures} sub-apertures, "
            "the first is 0"
        )


def _scatter_contradictions(scene: Scene) -> Iterator[str]:
    reach = swath_m(scene)
    for index, group in enumerate(scene.scatter):
        where = f"scatter[{index}]"
        farthest = group.ground_range_m[1] if group.ground_range_m else 0.0
        if farthest > reach:
            yield (
                f"`{where}.ground_range_m` ends at {farthest:g} m; from `track.altitude_m` the sonar reaches "
                f"{reach:.1f} m"
            )
        ranges = {
            name: getattr(group, name)
            for name in ("ground_range_m", "length_m", "width_m", "height_m", "burial_m", "scour_m")
        }
        ranges |= {"tilt_deg": group.tilt_deg, "strength_db": group.strength_db}
        for name, limits in ranges.items():
            if limits is not None and limits[0] > limits[1]:
                yield f"`{where}.{name}` is [{limits[0]:g}, {limits[1]:g}]; the lowest comes first"
        for name in ("length_m", "width_m", "height_m"):
            if ranges[name] is not None and ranges[name][0] <= 0.0 and group.kind in _CORNERED:
                yield f"`{where}.{name}` starts at 0; a {group.kind} needs a smallest size above 0"
        if group.natural_sizes and group.length_m is not None and group.length_m[0] <= 0.0:
            yield f"`{where}.length_m` starts at 0; natural sizes need a smallest one above 0"
        if group.natural_sizes and USUAL[group.kind].length_m == 0.0:
            yield f"`{where}.natural_sizes`: a {group.kind} has no size"
        key = _height_key(group.kind)
        highest_m = (ranges.get(key) or (0.0, 0.0))[1]
        if highest_m > HIGHEST_SHARE * scene.track.altitude_m:
            yield _too_high(f"{where}.{key}", highest_m, scene.track.altitude_m)


def _slope_contradictions(scene: Scene, legs: Sequence[Leg]) -> Iterator[str]:
    world, track = scene.world, scene.track
    rise = math.tan(math.radians(world.slope_deg))
    towards = math.radians(world.slope_towards_deg)
    for index, leg in enumerate(legs):
        for east, north in ((leg.east_m, leg.north_m), leg.end):
            depth = world.depth_m - rise * (east * math.sin(towards) + north * math.cos(towards))
            if depth < track.altitude_m + 0.5 and world.slope_deg == 0.0:
                yield (
                    f"`world.depth_m` is {depth:g}; a `track.altitude_m` of {track.altitude_m:g} needs 0.5 m more "
                    "than that at least"
                )
            elif depth < track.altitude_m + 0.5:
                yield (
                    f"`world.slope_deg` {world.slope_deg:g} leaves {depth:.1f} m of water at leg {index} of "
                    f"`track.plan`; `track.altitude_m` {track.altitude_m:g} needs more: give a larger `world.depth_m` "
                    "or a gentler slope"
                )


def _object_contradictions(scene: Scene, scene_object: SceneObject, legs: Sequence[Leg]) -> Iterator[str]:
    ways = (
        (scene_object.east_m, scene_object.north_m),
        (scene_object.latitude_deg, scene_object.longitude_deg),
        (scene_object.leg, scene_object.along_m, scene_object.across_m),
    )
    if sum(any(value is not None for value in way) for way in ways) != 1 or not any(
        all(v is not None for v in way) for way in ways
    ):
        yield (
            "give its place once: `east_m` and `north_m`, or `latitude_deg` and `longitude_deg`, or `leg`, `along_m` "
            "and `across_m`"
        )
        return
    if scene_object.leg is not None and scene_object.leg >= len(legs):
        yield f"`leg` is {scene_object.leg}: the plan has {len(legs)} legs, the first is 0"
        return
    for name in ("length_m", "width_m", "height_m"):
        if getattr(scene_object, name) == 0.0 and scene_object.kind in _CORNERED:
            yield f"`{name}` is 0: give a size above 0, or leave it out for the usual one"
    altitude, key = scene.track.altitude_m, _height_key(scene_object.kind)
    height_m = getattr(scene_object, key, None) or 0.0
    if height_m > HIGHEST_SHARE * altitude:
        yield _too_high(key, height_m, altitude)
    if scene_object.above_m + height_m > HIGHEST_SHARE * altitude:
        yield _too_high("above_m", scene_object.above_m + height_m, altitude)
    width_m = USUAL[scene_object.kind].width_m if scene_object.width_m is None else scene_object.width_m
    if scene_object.top_m is not None and scene_object.top_m > width_m:
        yield f"`top_m` is {scene_object.top_m:g} m, wider than its base of {width_m:g} m"
    east, north = place_in_plane(scene, scene_object)
    nearest = min(leg.distance_m(east, north) for leg in legs)
    reach = swath_m(scene)
    if nearest > reach:
        yield f"lies {nearest:.1f} m from the nearest leg; the sonar reaches {reach:.1f} m there"


def _height_key(kind: ObjectKind) -> str:
    """Return the key of the height that a kind rises to; none for what is dug."""
    if kind == "anchor_scar":
        return ""
    return "width_m" if "height_m" in BY_WIDTH.get(kind, ()) else "height_m"


def _too_high(key: str, height_m: float, altitude_m: float) -> str:
    return (
        f"`{key}` is {height_m:g} m; at most {HIGHEST_SHARE:g} of `track.altitude_m` ({altitude_m:g} m), or shadows "
        "mean nothing"
    )
