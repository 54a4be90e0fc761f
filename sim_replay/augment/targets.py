"""Read which targets to put into a log, and where: the YAML file of `auv-mcm augment`.

Directions are true, degrees clockwise from north; ranges are ground ranges across the track. A size left out is usual
for the kind, as in simulated scenes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from auv_mcm.errors import UsageError
from auv_mcm.records import SIDES, Side
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from sim_replay.augment.track import PingTrack
from sim_replay.simulator.objects import BY_WIDTH, USUAL, PlacedObject, rise_m, shape_seed, solid_sizes
from sim_replay.simulator.scene import TARGET_KINDS, Tilt
from sim_replay.simulator.scene_file import HIGHEST_SHARE

_STREAM: Final = 0x41554754  # keeps these random numbers apart from others of the same seed
_TRIES: Final = 400  # places drawn for one object before there is none left

EmbeddedKind: TypeAlias = Literal[
    "cylinder", "sphere", "truncated_cone", "wedge", "box", "rock", "tyre", "pipe", "boulder_cluster", "debris"
]
Azimuth = Annotated[float, Meta(ge=-360.0, le=720.0)]
Size = Annotated[float, Meta(gt=0.0, le=50.0)]
Range = Annotated[float, Meta(ge=0.0, le=1000.0)]
Depth = Annotated[float, Meta(ge=0.0, le=5.0)]
Contrast = Annotated[float, Meta(ge=-30.0, le=60.0)]
SideName: TypeAlias = Literal["port", "starboard"]

USUAL_CONTRAST_DB: Final = 14.0  # dB of a target's echo over the sea floor


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class EmbeddedTarget(_Section, frozen=True, kw_only=True):
    """Place one object at a place.

    Side, ground_range_m, and ping (its number in the log, from 0) or along_m (way from the first ping).

    contrast_db: backscattering strength of its surface at normal incidence over that of the sea floor around it, as
    seen from there; specular_db: of the specular lobe on top of it. burial_m: pushed into the floor; tilt_deg: its end
    towards the azimuth raised; scour_m: depth of the moat around it.
    """

    kind: EmbeddedKind
    side: SideName
    ground_range_m: Range
    ping: Annotated[int, Meta(ge=0)] | None = None
    along_m: Range | None = None
    azimuth_deg: Azimuth = 0.0
    length_m: Size | None = None
    width_m: Size | None = None
    height_m: Size | None = None
    burial_m: Depth = 0.0
    tilt_deg: Tilt = 0.0
    scour_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    contrast_db: Contrast = USUAL_CONTRAST_DB
    specular_db: Contrast | None = None
    is_target: bool | None = None


class ScatteredTargets(_Section, frozen=True, kw_only=True):
    """Scatter `count` objects of the kinds.

    Even over the sea floor seen, in azimuth, and within each range of [lowest, highest].

    contrast_db: [mean, standard deviation] of a normal distribution. apart_m: from each other, other objects and
    `keep_clear` places.
    """

    kinds: Annotated[tuple[EmbeddedKind, ...], Meta(min_length=1)]
    count: Annotated[int, Meta(ge=1, le=100_000)]
    sides: Annotated[tuple[SideName, ...], Meta(min_length=1, max_length=2)] = SIDES
    ground_range_m: tuple[Range, Range] | None = None
    length_m: tuple[Size, Size] | None = None
    width_m: tuple[Size, Size] | None = None
    height_m: tuple[Size, Size] | None = None
    burial_m: tuple[Depth, Depth] = (0.0, 0.0)
    tilt_deg: tuple[Tilt, Tilt] = (0.0, 0.0)
    scour_m: tuple[Depth, Depth] = (0.0, 0.0)
    contrast_db: tuple[Contrast, Annotated[float, Meta(ge=0.0, le=20.0)]] = (USUAL_CONTRAST_DB, 4.0)
    apart_m: Annotated[float, Meta(ge=0.0, le=200.0)] = 8.0
    is_target: bool | None = None


class ClearPlace(_Section, frozen=True, kw_only=True):
    """Keep scattered objects at least radius_m away from a place."""

    side: SideName
    ground_range_m: Range
    ping: Annotated[int, Meta(ge=0)] | None = None
    along_m: Range | None = None
    radius_m: Annotated[float, Meta(gt=0.0, le=500.0)] = 5.0


class TargetSpec(_Section, frozen=True, kw_only=True):
    """Specify all objects to put into a log. seed: of places, sizes and speckle."""

    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 1
    targets: tuple[EmbeddedTarget, ...] = ()
    scatter: tuple[ScatteredTargets, ...] = ()
    keep_clear: tuple[ClearPlace, ...] = ()


def read_target_spec(path: Path) -> TargetSpec:
    """Read the spec in a YAML file. Raises UsageError if it cannot be read, and as parse_spec does."""
    return parse_target_spec(read_text(path, "target spec"), str(path))


def parse_target_spec(text: str, place: str) -> TargetSpec:
    """Parse the spec from YAML text; `place` names it in messages.

    Raises UsageError with the key's path for unknown and repeated keys, wrong types, values out of range, and what
    contradicts itself.
    """
    data = load_mapping(text, place, "expected keys such as 'targets:' or 'scatter:'")
    try:
        spec = msgspec.convert(data, TargetSpec)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {explain_validation_error(error, TargetSpec)}") from error
    for reason in _contradictions(spec):
        raise UsageError(f"{place}: {reason}")
    return spec


def _contradictions(spec: TargetSpec) -> Iterator[str]:
    placed: list[tuple[str, EmbeddedTarget | ClearPlace]] = [
        (f"targets[{k}]", target) for k, target in enumerate(spec.targets)
    ]
    placed += [(f"keep_clear[{k}]", clear) for k, clear in enumerate(spec.keep_clear)]
    for where, scene_object in placed:
        if (scene_object.ping is None) == (scene_object.along_m is None):
            yield f"`{where}`: give its place along the track once, as `ping` or as `along_m`"
    for index, group in enumerate(spec.scatter):
        for name in ("ground_range_m", "length_m", "width_m", "height_m", "burial_m", "tilt_deg", "scour_m"):
            limits = getattr(group, name)
            if limits is not None and limits[0] > limits[1]:
                yield f"`scatter[{index}].{name}` is [{limits[0]:g}, {limits[1]:g}]; the lowest comes first"
    groups: list[tuple[str, EmbeddedTarget | ScatteredTargets, tuple[EmbeddedKind, ...]]] = [
        *((f"targets[{k}]", target, (target.kind,)) for k, target in enumerate(spec.targets)),
        *((f"scatter[{k}]", group, group.kinds) for k, group in enumerate(spec.scatter)),
    ]
    for where, sized, kinds in groups:
        for name in ("length_m", "height_m"):
            if getattr(sized, name) is not None and all(name in BY_WIDTH.get(kind, ()) for kind in kinds):
                yield f"`{where}.{name}` changes nothing: it goes by the diameter. Give that as `width_m`"


# --- places ---


class Placement(NamedTuple):
    """Place one object on the sea floor, and name the ping, by its index along the track, that looks straight at it.

    scene_object: with azimuth from true north, east and north in the track's plane, and the contrast as its strength.
    """

    scene_object: PlacedObject
    ping: int
    side: Side
    ground_range_m: float


def place_targets(spec: TargetSpec, track: PingTrack) -> tuple[Placement, ...]:
    """Place all objects of a spec, those named first.

    Raises UsageError for a place that the log does not show well, with the reason, for a spec without objects, and
    where there is no room.
    """
    if not spec.targets and not spec.scatter:
        raise UsageError("the target spec names no object: give `targets:` or `scatter:` (examples: docs/augmented.md)")
    placed = [_named(track, target, index) for index, target in enumerate(spec.targets)]
    taken = [(one.scene_object.east_m, one.scene_object.north_m, one.scene_object.reach_m) for one in placed]
    for index, clear in enumerate(spec.keep_clear):
        ping = _ping_of(track, clear, f"keep_clear[{index}]")
        taken.append((*track.plane_place(ping, clear.side, clear.ground_range_m), clear.radius_m))
    for index, group in enumerate(spec.scatter):
        placed += _scattered(track, group, index, spec.seed, taken)
    return tuple(placed)


def _ping_of(track: PingTrack, scene_object: EmbeddedTarget | ClearPlace, where: str) -> int:
    if scene_object.ping is not None:
        found = np.flatnonzero(track.number == scene_object.ping)
        if not found.size:
            raise UsageError(
                f"`{where}.ping` is {scene_object.ping}: the log has usable pings {track.number[0]} to "
                f"{track.number[-1]}"
            )
        return int(found[0])
    along_m = float(track.along_m[0]) + (scene_object.along_m or 0.0)
    if along_m > track.along_m[-1]:
        way_m = float(track.along_m[-1] - track.along_m[0])
        raise UsageError(f"`{where}.along_m` is {scene_object.along_m:g}: the log's track is {way_m:.1f} m long")
    return int(np.abs(track.along_m - along_m).argmin())


def _named(track: PingTrack, target: EmbeddedTarget, index: int) -> Placement:
    where = f"targets[{index}]"
    ping = _ping_of(track, target, where)
    reason = track.refusal(ping, target.side, target.ground_range_m)
    if reason:
        raise UsageError(
            f"`{where}` ({target.kind}), ping {track.number[ping]}, {target.side}, {target.ground_range_m:g} m: "
            f"{reason}. Choose another place"
        )
    usual = USUAL[target.kind]
    sizes = solid_sizes(target.kind, target.length_m, target.width_m, target.height_m)
    return _placement(
        track,
        ping,
        target.side,
        target.ground_range_m,
        target.kind,
        sizes,
        azimuth_rad=math.radians(target.azimuth_deg),
        tilt_rad=math.radians(target.tilt_deg),
        burial_m=target.burial_m,
        scour_m=target.scour_m,
        contrast_db=target.contrast_db,
        specular_db=usual.specular_db if target.specular_db is None else target.specular_db,
        is_target=target.kind in TARGET_KINDS if target.is_target is None else target.is_target,
        seed=index,
        where=where,
    )


def _placement(
    track: PingTrack,
    ping: int,
    side: Side,
    ground_range_m: float,
    kind: EmbeddedKind,
    sizes: dict[str, float],
    *,
    azimuth_rad: float,
    tilt_rad: float,
    burial_m: float,
    scour_m: float,
    contrast_db: float,
    specular_db: float,
    is_target: bool,
    seed: int,
    where: str,
) -> Placement:
    usual = USUAL[kind]
    east_m, north_m = track.plane_place(ping, side, ground_range_m)
    scene_object = PlacedObject(
        kind=kind,
        east_m=east_m,
        north_m=north_m,
        azimuth_rad=azimuth_rad,
        tilt_rad=tilt_rad,
        **sizes,
        top_m=usual.top_m * sizes["width_m"] / max(usual.width_m, 1e-9),
        burial_m=burial_m,
        scour_m=scour_m,
        above_m=0.0,
        n_members=usual.n_members,
        strength_db=contrast_db,
        specular_db=specular_db,
        is_target=is_target,
        seed=seed,
    )
    above_m, below_sonar_m = rise_m(scene_object), float(track.first_return_m[ping])
    if above_m > HIGHEST_SHARE * below_sonar_m:
        raise UsageError(
            f"`{where}` ({kind}) rises {above_m:.2f} m, more than {HIGHEST_SHARE:g} of the sonar's {below_sonar_m:.2f} "
            f"m above the floor at ping {track.number[ping]}: take a lower one or a ping from higher up"
        )
    return Placement(scene_object, ping, side, ground_range_m)


def _scattered(
    track: PingTrack, group: ScatteredTargets, index: int, seed: int, taken: list[tuple[float, float, float]]
) -> list[Placement]:
    """Draw the group's objects; their places are added to `taken`: east, north and reach."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, _STREAM, index])))
    where = f"scatter[{index}]"
    low, high = group.ground_range_m or (0.0, math.inf)
    placed: list[Placement] = []

    def drawn(limits: tuple[float, float] | None) -> float | None:
        return None if limits is None else float(random.uniform(*limits))

    refused: Counter[str] = Counter()
    for number in range(group.count):
        kind = group.kinds[int(random.integers(len(group.kinds)))]
        sizes = solid_sizes(kind, drawn(group.length_m), drawn(group.width_m), drawn(group.height_m))
        burial, tilt, scour = (drawn(limits) or 0.0 for limits in (group.burial_m, group.tilt_deg, group.scour_m))
        contrast = float(random.normal(*group.contrast_db))
        azimuth = float(random.uniform(0.0, 2.0 * math.pi))
        reach = 0.5 * math.hypot(sizes["length_m"], sizes["width_m"])
        for _ in range(_TRIES):
            ping, side, ground_range = track.draw(random, group.sides, low, high)
            reason = track.refusal(ping, side, ground_range)
            if not reason:
                east, north = track.plane_place(ping, side, ground_range)
                if all(math.hypot(east - e, north - n) >= group.apart_m + reach + r for e, n, r in taken):
                    break
                reason = "another object or a place to keep clear is too close"
            refused[reason] += 1
        else:
            raise UsageError(
                f"`{where}`: no room for number {number + 1} of {group.count}; mostly because: "
                f"{refused.most_common(1)[0][0]}. Take fewer, a smaller `apart_m`, or another `ground_range_m`"
            )
        placed.append(
            _placement(
                track,
                ping,
                side,
                ground_range,
                kind,
                sizes,
                azimuth_rad=azimuth,
                tilt_rad=math.radians(tilt),
                burial_m=min(burial, 0.8 * sizes["height_m"]),
                scour_m=scour,
                contrast_db=contrast,
                specular_db=USUAL[kind].specular_db,
                is_target=kind in TARGET_KINDS if group.is_target is None else group.is_target,
                seed=shape_seed(seed, index, number),
                where=where,
            )
        )
        taken.append((east, north, reach))
    return placed
