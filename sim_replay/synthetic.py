"""Synthetic side-scan missions with known truth: straight legs over a flat, textured sea floor with simple objects on it.

python -m sim_replay.synthetic --out mission.xtf --seed 1
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import structs

from auv_mcm.errors import AuvMcmError, UsageError
from auv_mcm.geodesy import LocalFrame, local_to_ecef_rotation
from auv_mcm.records import NavSample, Ping
from sim_replay.synthetic_echo import Pose, Solid, mean_intensity, recorded, seabed_texture, speckled
from sim_replay.synthetic_scene import Leg, SceneObject, SyntheticScene, check_scene
from sim_replay.xtf_writer import write_xtf

__all__ = ["Leg", "SceneObject", "SyntheticScene", "demo_scene", "lawnmower", "synthetic_mission", "truth"]

_GAP_BETWEEN_LEGS_S: Final = 10.0


class _Segment(NamedTuple):
    """Part of the track in the plane of the scene: direction clockwise from its north, curvature positive to starboard."""

    start_s: float
    start_m: float
    length_m: float
    east_m: float
    north_m: float
    direction_rad: float
    curvature: float


def synthetic_mission(scene: SyntheticScene) -> Iterator[NavSample | Ping]:
    """The mission's events, each ping after its navigation sample. Byte-identical for equal scenes; a ping does not depend on others.

    Raises UsageError naming the field for a scene that cannot be.
    """
    check_scene(scene)
    frame = _frame(scene)
    solids = _solids(scene, frame)
    texture = seabed_texture(scene)
    for number, pose in _poses(scene, frame):
        latitude, longitude, heading = _true_pose(frame, pose)
        yield NavSample(
            time_s=pose.time_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=heading,
            pitch_rad=math.radians(scene.pitch_deg),
            roll_rad=0.0,
            depth_m=scene.seabed_depth_m - pose.altitude_m,
            altitude_m=pose.altitude_m,
            speed_mps=scene.speed_mps,
        )
        random = np.random.Generator(np.random.Philox(key=np.array([scene.seed, number], dtype=np.uint64)))
        sides = [recorded(scene, speckled(scene, mean_intensity(scene, solids, texture, pose, sign), random)) for sign in (-1.0, 1.0)]
        yield Ping(
            number=number,
            time_s=pose.time_s,
            port=sides[0],
            starboard=sides[1],
            sound_speed_mps=scene.sound_speed_mps,
            altitude_m=pose.altitude_m,
            place=f"synthetic mission, ping {number}",
        )


def truth(scene: SyntheticScene) -> dict[str, Any]:
    """`area_km2` swept by the legs, turns left out, and all `objects`, as in truth.json."""
    check_scene(scene)
    frame = _frame(scene)
    objects = []
    for thing, solid in zip(scene.objects, _solids(scene, frame), strict=True):
        latitude, longitude, _ = frame.to_geodetic([solid.east_m, solid.north_m, 0.0])
        objects.append(
            {
                "kind": thing.kind,
                "lat": float(latitude),
                "lon": float(longitude),
                "is_target": thing.is_target,
                "azimuth_deg": thing.azimuth_deg,
                "length_m": solid.length_m,
                "width_m": solid.width_m,
                "height_m": solid.height_m,
            }
        )
    return {"area_km2": _swept_area_m2(scene, frame) / 1e6, "objects": objects}


def lawnmower(
    latitude_deg: float, longitude_deg: float, heading_deg: float, *, n_legs: int, length_m: float, spacing_m: float
) -> tuple[Leg, ...]:
    """Parallel legs to starboard of the first, flown back and forth; leg ends lie abeam of each other."""
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    direction = math.radians(heading_deg)
    legs = []
    for index in range(n_legs):
        along = length_m if index % 2 else 0.0
        across = index * spacing_m
        east = along * math.sin(direction) + across * math.cos(direction)
        north = along * math.cos(direction) - across * math.sin(direction)
        way = direction + (math.pi if index % 2 else 0.0)
        latitude, longitude, heading = _true_pose(frame, Pose(0.0, east, north, way, 0.0))
        legs.append(Leg(latitude_deg=latitude, longitude_deg=longitude, heading_deg=math.degrees(heading), length_m=length_m))
    return tuple(legs)


def demo_scene(seed: int = 1, n_legs: int = 2) -> SyntheticScene:
    """Some minutes over sand with six targets and four rocks, for a first look."""
    legs = lawnmower(43.0931, 5.8872, 35.0, n_legs=n_legs, length_m=120.0, spacing_m=26.0)
    cylinder = SceneObject(kind="cylinder", length_m=1.8, height_m=0.5)
    rock = SceneObject(kind="rock", is_target=False)
    things = [
        structs.replace(cylinder, leg=0, along_m=22.0, across_m=13.0, azimuth_deg=40.0),
        SceneObject(kind="sphere", leg=0, along_m=40.0, across_m=-11.0, height_m=0.8),
        structs.replace(cylinder, leg=0, along_m=61.0, across_m=-17.0, azimuth_deg=95.0),
        SceneObject(kind="box", leg=0, along_m=78.0, across_m=9.0, azimuth_deg=20.0, length_m=1.1, width_m=0.9, height_m=0.45),
        SceneObject(kind="sphere", leg=0, along_m=97.0, across_m=16.0, height_m=0.7),
        structs.replace(cylinder, leg=1, along_m=45.0, across_m=-15.0, azimuth_deg=120.0),
        structs.replace(rock, leg=0, along_m=31.0, across_m=19.0, azimuth_deg=70.0, length_m=5.5, width_m=3.0, height_m=0.7),
        structs.replace(rock, leg=0, along_m=88.0, across_m=-14.0, length_m=0.6, width_m=0.5, height_m=0.12),
        structs.replace(rock, leg=1, along_m=25.0, across_m=-8.0, length_m=0.4, width_m=0.4, height_m=0.1),
        structs.replace(rock, leg=1, along_m=85.0, across_m=-19.0, azimuth_deg=10.0, length_m=7.0, width_m=1.5, height_m=0.5),
    ]
    objects = tuple(thing for thing in things if thing.leg < n_legs)
    return SyntheticScene(
        legs=legs, objects=objects, seed=seed, turns=True, altitude_wave_m=0.4, altitude_wavelength_m=70.0, texture_nu=12.0, pitch_deg=1.5
    )


def _frame(scene: SyntheticScene) -> LocalFrame:
    return LocalFrame(latitude_deg=scene.legs[0].latitude_deg, longitude_deg=scene.legs[0].longitude_deg)


def _plane_direction(frame: LocalFrame, latitude_deg: float, longitude_deg: float, true_deg: float) -> float:
    """Direction in the plane of `frame`, clockwise from its north, of a true direction at another place (meridians converge)."""
    angle = math.radians(true_deg)
    ecef = local_to_ecef_rotation(latitude_deg, longitude_deg) @ np.array([math.sin(angle), math.cos(angle), 0.0])
    east, north, _ = ecef @ frame.rotation()
    return math.atan2(east, north)


def _true_pose(frame: LocalFrame, pose: Pose) -> tuple[float, float, float]:
    """Latitude, longitude, and true heading in [0, 2 pi) there."""
    latitude, longitude, _ = frame.to_geodetic([pose.east_m, pose.north_m, 0.0])
    direction = np.array([math.sin(pose.direction_rad), math.cos(pose.direction_rad), 0.0])
    east, north, _ = frame.rotation() @ direction @ local_to_ecef_rotation(latitude, longitude)
    return float(latitude), float(longitude), math.atan2(east, north) % (2.0 * math.pi)


def _segments(scene: SyntheticScene, frame: LocalFrame) -> list[_Segment]:
    segments: list[_Segment] = []
    start_s = start_m = 0.0
    for index, leg in enumerate(scene.legs):
        east, north, _ = frame.to_enu(leg.latitude_deg, leg.longitude_deg, 0.0)
        direction = _plane_direction(frame, leg.latitude_deg, leg.longitude_deg, leg.heading_deg)
        if segments and scene.turns:
            turn = _half_circle(segments[-1], float(east), float(north), direction, f"scene.legs[{index}]")
            turn = turn._replace(start_s=start_s, start_m=start_m)
            segments.append(turn)
            start_s += turn.length_m / scene.speed_mps
            start_m += turn.length_m
        elif segments:
            start_s += _GAP_BETWEEN_LEGS_S
        segments.append(_Segment(start_s, start_m, leg.length_m, float(east), float(north), direction, 0.0))
        start_s += leg.length_m / scene.speed_mps
        start_m += leg.length_m
    return segments


def _half_circle(before: _Segment, east_m: float, north_m: float, direction_rad: float, where: str) -> _Segment:
    end_east, end_north, _ = _along(before, before.length_m)
    ahead = math.sin(before.direction_rad), math.cos(before.direction_rad)
    along = (east_m - end_east) * ahead[0] + (north_m - end_north) * ahead[1]
    across = (east_m - end_east) * ahead[1] - (north_m - end_north) * ahead[0]
    opposite = math.cos(direction_rad - before.direction_rad) < -math.cos(math.radians(1.0))
    if not opposite or abs(across) < 1.0 or abs(along) > 0.01 * abs(across):
        raise UsageError(f"{where}: with turns it must start abeam of the end of the leg before, on the opposite heading. See lawnmower().")
    return _Segment(0.0, 0.0, 0.5 * math.pi * abs(across), end_east, end_north, before.direction_rad, 2.0 / across)


def _along(segment: _Segment, distance_m: float) -> tuple[float, float, float]:
    """East, north and direction at a distance from the segment's start."""
    turned = segment.direction_rad + segment.curvature * distance_m
    if segment.curvature == 0.0:
        chord, mean = distance_m, segment.direction_rad
    else:
        chord = 2.0 / segment.curvature * math.sin(0.5 * segment.curvature * distance_m)
        mean = 0.5 * (segment.direction_rad + turned)
    return segment.east_m + chord * math.sin(mean), segment.north_m + chord * math.cos(mean), turned


def _poses(scene: SyntheticScene, frame: LocalFrame) -> Iterator[tuple[int, Pose]]:
    segments = _segments(scene, frame)
    number = 0
    for segment in segments:
        duration = segment.length_m / scene.speed_mps
        first = math.ceil((segment.start_s - 1e-9) * scene.ping_rate_hz)
        stop = math.ceil((segment.start_s + duration - 1e-9) * scene.ping_rate_hz)
        for tick in range(first, stop):
            time_s = tick / scene.ping_rate_hz
            distance = (time_s - segment.start_s) * scene.speed_mps
            east, north, direction = _along(segment, distance)
            way = segment.start_m + distance
            altitude = scene.altitude_m + scene.altitude_wave_m * math.sin(2.0 * math.pi * way / scene.altitude_wavelength_m)
            yield number, Pose(scene.start_time_s + time_s, east, north, direction, altitude)
            number += 1


def _solids(scene: SyntheticScene, frame: LocalFrame) -> list[Solid]:
    legs = [segment for segment in _segments(scene, frame) if segment.curvature == 0.0]
    solids = []
    for thing in scene.objects:
        if thing.leg >= 0:
            east, north, direction = _along(legs[thing.leg], thing.along_m)
            east += thing.across_m * math.cos(direction)
            north -= thing.across_m * math.sin(direction)
        else:
            enu = frame.to_enu(thing.latitude_deg, thing.longitude_deg, 0.0)
            east, north = float(enu[0]), float(enu[1])
        latitude, longitude, _ = frame.to_geodetic([east, north, 0.0])
        direction = _plane_direction(frame, float(latitude), float(longitude), thing.azimuth_deg)
        length, width = thing.length_m, thing.width_m
        if thing.kind == "sphere":
            length = width = thing.height_m
        elif thing.kind == "cylinder":
            width = thing.height_m
        elif thing.kind == "point":
            length = width = 0.0
        height = 0.0 if thing.kind == "point" else thing.height_m
        solids.append(Solid(thing.kind, east, north, direction, length, width, height, 10.0 ** (thing.highlight_db / 10.0)))
    return solids


def _swept_area_m2(scene: SyntheticScene, frame: LocalFrame) -> float:
    """Union of the legs' swaths on a grid of 0.5 m."""
    legs = [segment for segment in _segments(scene, frame) if segment.curvature == 0.0]
    swath = math.sqrt(scene.range_m**2 - scene.altitude_m**2)
    ends = np.array([point for leg in legs for point in ((leg.east_m, leg.north_m), _along(leg, leg.length_m)[:2])])
    cell = 0.5
    low = ends.min(axis=0) - swath
    n_east, n_north = np.ceil((ends.max(axis=0) + swath - low) / cell).astype(int)
    east = (low[0] + (np.arange(n_east) + 0.5) * cell)[:, None]
    area = 0.0
    for start in range(0, int(n_north), 256):  # in strips: legs may lie far apart
        north = (low[1] + (np.arange(start, min(start + 256, int(n_north))) + 0.5) * cell)[None, :]
        seen = np.zeros((int(n_east), north.shape[1]), dtype=np.bool_)
        for leg in legs:
            sine, cosine = math.sin(leg.direction_rad), math.cos(leg.direction_rad)
            along = (east - leg.east_m) * sine + (north - leg.north_m) * cosine
            across = (east - leg.east_m) * cosine - (north - leg.north_m) * sine
            seen |= (along >= 0.0) & (along < leg.length_m) & (np.abs(across) <= swath)
        area += float(np.count_nonzero(seen)) * cell * cell
    return area


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a demonstration mission and its truth beside it."""
    parser = argparse.ArgumentParser(
        prog="python -m sim_replay.synthetic", description="Write a synthetic side-scan mission (XTF) and its truth (JSON, same name)."
    )
    parser.add_argument("--out", type=Path, required=True, help="XTF file to write; the truth goes beside it as NAME.truth.json")
    parser.add_argument("--seed", type=int, default=1, help="other seeds give other speckle and texture (default: 1)")
    parser.add_argument("--legs", type=int, default=2, help="legs of 120 m (default: 2)")
    options = parser.parse_args(arguments)
    try:
        scene = demo_scene(options.seed, options.legs)
        facts = truth(scene)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        n_pings = write_xtf(options.out, synthetic_mission(scene), sample_type=scene.sample_type)
        truth_path = options.out.with_suffix(".truth.json")
        truth_path.write_bytes(msgspec.json.format(msgspec.json.encode(facts), indent=2) + b"\n")
    except AuvMcmError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"error: {error.filename or options.out} cannot be written: {error.strerror}", file=sys.stderr)
        return UsageError.exit_code
    targets = sum(thing.is_target for thing in scene.objects)
    print(f"{options.out}: {n_pings} pings, {len(scene.objects)} objects, {targets} of them targets")
    print(f"{truth_path}: where they are")
    return 0


if __name__ == "__main__":
    sys.exit(main())
