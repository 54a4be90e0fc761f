"""Fly drawn missions with dense mines and stones, and keep the sea floor around every detection, by the truth.

A mission is a file in a folder, written whole or not at all. Missions already there are not flown again.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.details import detection_details
from auv_mcm.classify.features import detector_features
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_odds import passages_of
from sim_replay.fitting.looks import DRAWN, LookTask, flight_of, place_of
from sim_replay.fitting.wide_world import wide_scene
from sim_replay.missions import config_for
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import Scatter, Scene, TargetKind

FIRST_SEED: Final = 40_000  # seeds of drawn missions that the odds were fitted and judged on lie below
FIRST_SHELLY: Final = 60_000
"""Seeds from here on have beds of bright shells, every second mission."""
FIRST_SLABS: Final = 70_000
"""Seeds from here on have slabs with straight edges in place of some of the stones, and more clutter."""
FIRST_PATCHES: Final = 80_000
"""Seeds from here on have pits, and dark and bright patches without a body, which count as sea floor."""
_STREAM: Final = 0x4D494C4C  # keeps these random numbers apart from others of the same seed
DENSE: Final = 9
"""Times as many mines and stones as the wide world has, where there is room."""
_CROWDS: Final = (DENSE, 7, 5, 3)  # times as many mines and stones, the first that finds room
_APART_M: Final = 5.0  # m between objects: chips of neighbours share little floor
_CROWDING: Final = frozenset({*get_args(TargetKind), "rock", "slab"})
_SHELLS: Final = (100.0, 1000.0)  # of a mission: one on 300 m² to one on 30 m²
_SHELL_DB: Final = (-40.0, -20.0)  # target strength: up to 25 dB above a resolution cell of sand
_CLUTTER: Final = frozenset({"boulder_cluster", "debris", "tyre", "pipe"})
_CLUTTERED: Final = 4  # times as much of it as in the wide world
_SLAB_M: Final = (0.6, 3.0)  # length
_THIN_M: Final = (0.01, 0.02)  # height of a patch: no shadow, no echo of its own
_PATCHES: Final = (
    Scatter(kind="rock", count=80, apart_m=0.5, length_m=(0.8, 8.0), width_m=(0.4, 2.0), strength_db=(-45.0, -26.0)),
    Scatter(kind="rock", count=20, apart_m=0.5, length_m=(0.5, 4.0), width_m=(0.4, 2.0), strength_db=(-14.0, -6.0)),
)
"""Patches of mud, weed or gravel of a mission: about a hundredth of its sea floor."""
_PITS: Final = Scatter(
    kind="anchor_scar", count=40, apart_m=0.5, length_m=(1.0, 5.0), width_m=(0.8, 2.5), height_m=(0.08, 0.35)
)
_SHELL: Final = "point"  # kind of an echo without a body: as much sea floor as a ripple's crest
_OPEN_P: Final = 0.01  # of the gate: what is less probable by its forecast is dropped unmeasured
_CELL_M: Final = 0.06  # m, of the floor, minimum: half a chip's pixel
_BEAM_LINES: Final = 3  # rays of a beam: two less than usual save a third of the simulator's time
_PLACE_SIGMA_M: Final = 0.05  # m: of reported positions, so that detections find their object
_HEADING_SIGMA_DEG: Final = 0.02  # degrees, likewise
_ON_M: Final = 1.0  # m beyond half an object's length that a detection on it lies from its middle, maximum
_CLEAR_M: Final = 3.0  # m around objects where a detection counts as neither
MINE: Final = 0
"""Label of detections on mines."""
OTHER: Final = 1
"""Label of detections on other objects."""
FLOOR: Final = 2
"""Label of detections far from all objects."""
BESIDE: Final = -1
"""Label of detections beside an object, which are not learnt from."""
GEOMETRY: Final = (
    *("row_spacing_m", "column_spacing_m", "first_ground_range_m", "first_return_m"),
    *("row", "column", "beam_width_rad", "squint_rad"),
)
"""Columns of `Catch.geometry`."""


class Catch(NamedTuple):
    """Hold n detections of a mission.

    codes: pixels of all surroundings, uint8 codes of `auv_mcm.snippet`, one region after the other, rows first. shapes:
    (n, 2) rows and columns. geometry: (n, len(GEOMETRY)). label: (n,) int8. kind: (n,) of the nearest object. nearest:
    (n,) its number, -1 for none. passage: (n,) of that object, by number. names, features: of the detector, (n, k).
    n_targets: passes that saw a target. area_km2: seen by the mission. law: how samples are stored.
    """

    codes: NDArray[np.uint8]
    shapes: NDArray[np.int32]
    geometry: NDArray[np.float64]
    label: NDArray[np.int8]
    kind: NDArray[np.str_]
    nearest: NDArray[np.int32]
    passage: NDArray[np.int64]
    distance_m: NDArray[np.float32]
    names: NDArray[np.str_]
    features: NDArray[np.float64]
    n_targets: NDArray[np.int64]
    area_km2: NDArray[np.float64]
    law: NDArray[np.str_]


def drawn_scene(seed: int, times: int) -> Scene:
    """Draw a mission of the wide world with mines and stones up to `times` as dense, as far as there is room.

    Every third has shadows filled by noise, every third speckle correlated over up to five samples, every third texture
    as fine as the speckle, every fourth an altitude that is up to a tenth off, every third faint mines. Seeds from
    FIRST_SHELLY, FIRST_SLABS and FIRST_PATCHES on have what these name; patches are left out where there is no room.
    """
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, _STREAM])))
    scene = _widened(wide_scene(seed), random)
    for n_times in (n for n in _CROWDS if 1 < n <= times):
        crowd = [
            msgspec.structs.replace(each, count=n_times * each.count, apart_m=_APART_M)
            if each.kind in _CROWDING and each.height_m != _THIN_M
            else each
            for each in scene.scatter
        ]
        crowded = msgspec.structs.replace(scene, name=f"dense-{seed}", scatter=tuple(crowd))
        if _has_room(crowded):
            return crowded
    bare = tuple(each for each in scene.scatter if each.height_m != _THIN_M)
    return scene if _has_room(scene) else msgspec.structs.replace(scene, scatter=bare)


def _has_room(scene: Scene) -> bool:
    """Check whether all objects of a scene can be placed."""
    try:
        place_objects(scene)
    except UsageError:
        return False
    return True


def _widened(scene: Scene, random: np.random.Generator) -> Scene:
    sonar, world, error = scene.sonar, scene.world, scene.navigation_error
    filled, smeared, textured, misjudged, faint = random.random(5) < (0.33, 0.33, 0.33, 0.25, 0.33)
    noise_db, width, shape, texture_m, bias_percent, fainter_db = (
        random.uniform(-13.0, -4.0),
        random.uniform(1.5, 5.0),
        np.exp(random.uniform(np.log(0.8), np.log(8.0))),
        random.uniform(0.1, 0.5),
        random.uniform(3.0, 10.0),
        random.uniform(4.0, 10.0),
    )
    sonar = msgspec.structs.replace(sonar, beam_lines=_BEAM_LINES)
    world = msgspec.structs.replace(world, cell_m=max(world.cell_m, _CELL_M))
    if filled:
        sonar = msgspec.structs.replace(sonar, noise_db=float(noise_db))
    if smeared:
        resolution_m = float(width) * sonar.range_m / sonar.n_samples
        sonar = msgspec.structs.replace(sonar, range_resolution_m=resolution_m)
    if textured:
        seabeds = tuple(
            msgspec.structs.replace(seabed, texture_shape=float(shape), texture_m=float(texture_m))
            for seabed in world.seabeds
        )
        world = msgspec.structs.replace(world, seabeds=seabeds)
    error = msgspec.structs.replace(
        error,
        position_sigma_m=_PLACE_SIGMA_M,
        heading_bias_sigma_deg=_HEADING_SIGMA_DEG,
        altitude_bias_percent=float(bias_percent) if misjudged else error.altitude_bias_percent,
    )
    scatter = tuple(
        msgspec.structs.replace(
            each, strength_db=(each.strength_db[0] - float(fainter_db), each.strength_db[1] - float(fainter_db))
        )
        if faint and each.strength_db is not None and each.kind in get_args(TargetKind)
        else each
        for each in scene.scatter
    )
    if scene.seed >= FIRST_SHELLY and random.random() < 0.5:
        n_shells = round(float(np.exp(random.uniform(*np.log(_SHELLS)))))
        low_db, high_db = sorted(random.uniform(*_SHELL_DB, size=2).tolist())
        scatter += (Scatter(kind=_SHELL, count=n_shells, apart_m=0.5, strength_db=(low_db, high_db)),)
    if scene.seed >= FIRST_SLABS:
        scatter = tuple(map(_slabs_and_clutter, scatter))
    if scene.seed >= FIRST_PATCHES:
        scatter += (_PITS, *(msgspec.structs.replace(each, height_m=_THIN_M) for each in _PATCHES))
    track = msgspec.structs.replace(scene.track, pings_in_turns=False)
    return msgspec.structs.replace(
        scene, sonar=sonar, world=world, navigation_error=error, scatter=scatter, track=track
    )


def _slabs_and_clutter(group: Scatter) -> Scatter:
    """Draw slabs for stones whose sizes do not follow the power law, and more of other clutter."""
    if group.kind == "rock" and not group.natural_sizes:
        return msgspec.structs.replace(group, kind="slab", length_m=_SLAB_M)
    return msgspec.structs.replace(group, count=_CLUTTERED * group.count) if group.kind in _CLUTTER else group


class MillTask(NamedTuple):
    """Name a mission and the folder that it is written to."""

    look: LookTask
    folder: Path


def fly_all(tasks: Sequence[LookTask], folder: Path, farm: Farm, show: Callable[[int, int], None]) -> list[Path]:
    """Fly the missions that are not in the folder; return the files of all. Raises UsageError as the folder does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror}") from error
    missing = [MillTask(task, folder) for task in tasks if not place_of(folder, task).exists()]
    for done, _ in enumerate(run_tasks(fly_one, missing, farm), 1):
        show(done, len(missing))
    return [place_of(folder, task) for task in tasks]


def fly_one(task: MillTask) -> int:
    """Fly a mission and write what was caught; returns the number of detections."""
    if task.look.source == DRAWN:
        scene = drawn_scene(task.look.seed, task.look.times)
        mission = Mission(scene)
        law = scene.sonar.recorder.samples
        caught = catch(config_for(scene), mission.events(), mission.truth, law)
    else:
        with flight_of(task.look) as flight:
            caught = catch(flight.config, flight.events, flight.truth, flight.law)
    place = place_of(task.folder, task.look)
    unfinished = place.with_suffix(f".{os.getpid()}.part")
    with unfinished.open("wb") as file:
        np.savez(file, **caught._asdict())
    os.replace(unfinished, place)
    return len(caught.label)


def read_catch(place: Path) -> Catch:
    """Read what a mission caught. Raises BadInputError for a file that is not one of fly_one."""
    try:
        with place.open("rb") as file, np.load(file) as stored:
            return Catch(**{name: stored[name] for name in Catch._fields})
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{place} holds no catch: {error}. Remove it, and it is flown again") from error


def catch(config: Config, events: Iterable[SourceEvent], truth: Callable[[], dict[str, Any]], law: str) -> Catch:
    """Collect every detection that the opened gate lets through, labelled by the truth."""
    found: list[Detection] = []

    def keep(detection: Detection) -> Detection:
        found.append(detection)
        return detection

    pipeline = Pipeline(_opened(config), look=keep, seabed=lambda tile: None)
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    known = truth()
    found = [one for one in found if one.surroundings is not None]
    objects = [one for one in known["objects"] if one["kind"] != _SHELL and one["height_m"] > _THIN_M[1]]
    label, nearest, distance_m = labels_of(found, objects)
    rows = [detector_features(one) | detection_details(one) for one in found]
    n_targets = sum(len(one["looks"]) for one in objects if one["is_target"])
    regions = [one.surroundings for one in found if one.surroundings is not None]
    width = config.sonar.beam_width_rad
    geometry = [
        (
            d.row_spacing_m,
            d.column_spacing_m,
            s.first_ground_range_m,
            s.first_return_m,
            s.row,
            s.column,
            width,
            d.squint_rad,
        )
        for d, s in zip(found, regions, strict=True)
    ]
    kinds = [objects[k]["kind"] if k >= 0 else "" for k in nearest]
    return Catch(
        codes=np.concatenate([s.codes.ravel() for s in regions]) if regions else np.empty(0, dtype=np.uint8),
        shapes=np.array([s.codes.shape for s in regions], dtype=np.int32).reshape(-1, 2),
        geometry=np.array(geometry).reshape(-1, len(GEOMETRY)),
        label=label,
        kind=np.array(kinds, dtype=np.str_),
        nearest=nearest,
        passage=passages_of(found, nearest, (label == MINE) | (label == OTHER)),
        distance_m=distance_m,
        names=np.array(list(rows[0]) if rows else [], dtype=np.str_),
        features=np.array([list(row.values()) for row in rows]),
        n_targets=np.array(n_targets),
        area_km2=np.array(float(known["area_km2"])),
        law=np.array(law),
    )


def labels_of(
    detections: Sequence[Detection], objects: Sequence[dict[str, Any]]
) -> tuple[NDArray[np.int8], NDArray[np.int32], NDArray[np.float32]]:
    """Label detections by the nearest object; returns labels, number of that object, and distance to it, (n,) each."""
    n = len(detections)
    if not n or not objects:
        return np.full(n, FLOOR, dtype=np.int8), np.full(n, -1, dtype=np.int32), np.full(n, np.inf, dtype=np.float32)
    frame = LocalFrame(latitude_deg=detections[0].latitude_deg, longitude_deg=detections[0].longitude_deg)
    places = np.array([frame.to_enu(d.latitude_deg, d.longitude_deg, 0.0)[:2] for d in detections])
    middles = np.array([frame.to_enu(one["lat"], one["lon"], 0.0)[:2] for one in objects])
    halves_m = 0.5 * np.array([max(one["length_m"], one["width_m"]) for one in objects])
    distance_m = np.hypot(*(places[:, np.newaxis] - middles).transpose(2, 0, 1))
    beyond_m = distance_m - halves_m
    nearest = distance_m.argmin(axis=1)
    rows = np.arange(n)
    is_target = np.array([bool(one["is_target"]) for one in objects])
    label = np.where(is_target[nearest], MINE, OTHER)
    label[beyond_m[rows, nearest] > _ON_M] = BESIDE
    label[(beyond_m > _CLEAR_M).all(axis=1)] = FLOOR
    return label.astype(np.int8), nearest.astype(np.int32), distance_m[rows, nearest].astype(np.float32)


def _opened(config: Config) -> Config:
    confirm = msgspec.structs.replace(config.confirm, min_p_mine=0.0, max_per_tile=100_000)
    contacts = msgspec.structs.replace(config.contacts, min_p_mine=_OPEN_P)
    return msgspec.structs.replace(config, confirm=confirm, contacts=contacts)
