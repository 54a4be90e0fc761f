"""Render a training set, for `auv-mcm train`.

Missions, simulated or recorded with targets put into them, go through the pipeline up to its tiles. What lies in each
tile follows from the truth of the mission. Every mission is a task of its own, on the cores of this computer or on a
dask cluster.
"""

from __future__ import annotations

import gc
import hashlib
import math
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any, Final, cast

import msgspec
import numpy as np
from msgspec import Meta

from auv_mcm.detect.cascade.codes import codes_of
from auv_mcm.detect.detect_tile import TileDetections, worth_looking
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import LOW_RESOLUTION, NAN, VALID, SourceEvent, Tile
from auv_mcm.safe_files import open_regular, read_regular
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.shell.whole_files import make_directory
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.place import PlacedTarget, cropped, objects_in
from sim_replay.fitting.cascade.spec import USUAL_SONAR, AugmentedLine, SimulatedLine, lines_of, read_training_spec
from sim_replay.fitting.cascade.store import Manifest, Packed, pack, write_set
from sim_replay.fitting.cascade.tiles import LabelledTile, Origin
from sim_replay.logs.recorded import RecordedMission
from sim_replay.simulate import TRUTH_NAME
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.objects import place_objects

OVERLAP_M: Final = 2.0
"""Rows kept beyond a tile's core: what windows of core pixels reach, and objects so near that they are in those
windows."""


class _AugmentedObject(msgspec.Struct, frozen=True, kw_only=True):
    kind: str
    lat: float
    lon: float
    is_target: bool
    seabed: str | None = None
    azimuth_deg: float | None = None
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    burial_m: float = 0.0


class _AugmentedTruth(msgspec.Struct, frozen=True, kw_only=True):
    background: Annotated[str, Meta(pattern=r"^[^/]+$")]  # also the name of the log
    objects: tuple[_AugmentedObject, ...]


def render_line(line: SimulatedLine | AugmentedLine) -> Packed:
    """Render the shard of one mission. Raises BadInputError for a folder that holds no augmented log."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    if isinstance(line, SimulatedLine):
        return pack(simulated_tiles(line), line.split, line.background, "simulated")
    background, targets = augmented_truth(line.folder / TRUTH_NAME)
    return pack(_augmented(line, background, targets), line.split, background, "augmented")


def simulated_tiles(line: SimulatedLine) -> Iterator[LabelledTile]:
    """Fly a mission and yield its tiles, as they become final."""
    mission = Mission(line.scene)
    return _labelled(mission.events(), targets_of(mission), line.config, line.background, "simulated")


def targets_of(mission: Mission) -> tuple[PlacedTarget, ...]:
    """Return the objects of a simulated mission."""
    sea = mission.sea
    return tuple(
        PlacedTarget(
            latitude_deg=entry["lat"],
            longitude_deg=entry["lon"],
            floor_depth_m=sea.scene.world.depth_m - sea.world.floor_m(placed.east_m, placed.north_m),
            kind=entry["kind"],
            is_target=entry["is_target"],
            seabed=entry["seabed"],
            azimuth_rad=placed.azimuth_rad,
            length_m=placed.length_m,
            width_m=placed.width_m,
            height_m=placed.height_m,
            burial_m=placed.burial_m,
        )
        for entry, placed in zip(mission.truth()["objects"], sea.objects, strict=True)
    )


def labelled(
    tile: Tile, targets: Sequence[PlacedTarget], config: Config, background: str, origin: Origin
) -> LabelledTile:
    """Return the core of a tile with OVERLAP_M on both sides, and which of `targets` lie in it."""
    reach = math.ceil(OVERLAP_M / tile.row_spacing_m)
    start, stop = max(tile.core_start - reach, 0), min(tile.core_stop + reach, tile.mask.shape[0])
    mask = tile.mask[start:stop]
    valid = ((mask & VALID) != 0) & np.isfinite(tile.intensity[start:stop])
    usable = valid & ((mask & LOW_RESOLUTION) == 0)
    usable[: tile.core_start - start] = False
    usable[tile.core_stop - start :] = False
    return LabelledTile(
        codes=codes_of(tile.intensity[start:stop], valid),
        valid=valid,
        usable=usable,
        core_start=tile.core_start - start,
        core_stop=tile.core_stop - start,
        first_return_m=tile.first_return_m[start:stop],
        row_spacing_m=tile.row_spacing_m,
        column_spacing_m=tile.column_spacing_m,
        side=tile.side,
        objects=cropped(objects_in(tile, targets, config.sonar), start, stop),
        background=background,
        origin=origin,
    )


def made_from(spec_path: Path | None, sonar: SonarConfig = USUAL_SONAR) -> dict[str, Any]:
    """Describe what a set is rendered from: the spec, the sonar of its augmented logs, and digests of its files."""
    spec, base = read_training_spec(spec_path)
    named = [beside if (beside := base / name).is_file() else Path(name) for name in spec.scenes]
    for log in spec.augmented:
        truth = base / log.folder / TRUTH_NAME
        named += [truth, truth.with_name(augmented_truth(truth)[0])]
    files = [_digest(file) for file in named if file.is_file()]
    return dict(msgspec.to_builtins(spec), files=files, recorded_by=msgspec.to_builtins(sonar))


def _digest(file: Path) -> str:
    with open_regular(file) as opened:
        return hashlib.file_digest(cast(BufferedReader, opened), "sha256").hexdigest()


def render_set(spec_path: Path | None, folder: Path, farm: Farm, sonar: SonarConfig = USUAL_SONAR) -> Manifest:
    """Render all missions of a spec (None: the one that ships) into a folder, and report progress on stderr.

    sonar: that recorded the augmented logs, mounted as where targets were put into them.

    Raises UsageError for a spec that cannot be, objects that find no room, and a sea floor that comes twice;
    BadInputError for augmented logs that are not there; and as run_tasks does.
    """
    spec, base = read_training_spec(spec_path)
    lines = lines_of(spec, base, sonar)
    for line in lines:
        if isinstance(line, SimulatedLine):
            _check_room(line)
    check_once(lines)
    make_directory(folder)
    started_s = time.monotonic()

    def show_progress(done: int) -> None:
        print(
            f"\r{done} of {len(lines)} missions rendered, {time.monotonic() - started_s:.0f} s",
            end="",
            file=sys.stderr,
            flush=True,
        )

    try:
        return write_set(folder, run_tasks(render_line, lines, farm, show_progress), made_from(spec_path, sonar))
    except OSError as error:
        raise UsageError(f"{folder}: {error.strerror}. Name another folder, or make room") from error
    finally:
        print(file=sys.stderr)


def tile_set_words(manifest: Manifest) -> str:
    """Describe a training set, a line per split."""
    lines = []
    for split in dict.fromkeys(shard.split for shard in manifest.shards):
        shards = [shard for shard in manifest.shards if shard.split == split]
        by_seabed: Counter[str] = Counter()
        for shard in shards:
            by_seabed.update(shard.by_seabed)
        lines.append(
            f"{split}: {len(shards)} missions, {sum(shard.n_tiles for shard in shards)} tiles, "
            f"{sum(shard.usable_m2 for shard in shards) / 1e6:.2f} km², {by_seabed.total()} looks at targets "
            f"({', '.join(f'{name} {n}' for name, n in sorted(by_seabed.items()))}), "
            f"{sum(shard.n_others for shard in shards)} at other objects"
        )
    return "\n".join([*lines, f"sha256 {manifest.sha256}"])


def _check_room(line: SimulatedLine) -> None:
    """Check that the scatter fits, before many missions are rendered."""
    try:
        place_objects(line.scene)
    except UsageError as error:
        raise UsageError(f"mission {line.background}: {error}") from error


def _augmented(line: AugmentedLine, background: str, targets: Sequence[PlacedTarget]) -> Iterator[LabelledTile]:
    events = RecordedMission([line.folder / background], line.config).events()
    return _labelled(events, targets, line.config, background, "augmented")


def _labelled(
    events: Iterable[SourceEvent], targets: Sequence[PlacedTarget], config: Config, background: str, origin: Origin
) -> Iterator[LabelledTile]:
    for tile in _tiles(events, config):
        if worth_looking(tile):
            yield labelled(tile, targets, config, background, origin)


def _tiles(events: Iterable[SourceEvent], config: Config) -> Iterator[Tile]:
    """Yield tiles as they become final."""
    pipeline = Pipeline(config, detect=_nothing)
    for event in events:
        yield from (entry for entry in pipeline.feed(event) if isinstance(entry, Tile))
    yield from (entry for entry in pipeline.finish() if isinstance(entry, Tile))


def _nothing(tile: Tile) -> TileDetections:
    """Detect nothing: the objects are known already."""
    return TileDetections((), 0, 0)


def augmented_truth(path: Path) -> tuple[str, tuple[PlacedTarget, ...]]:
    """Read the log's name and its targets from a truth of `auv-mcm augment`. Raises BadInputError if it is none."""
    try:
        truth = msgspec.json.decode(read_regular(path), type=_AugmentedTruth)
    except OSError as error:
        raise BadInputError(
            f"{path} cannot be read: {error.strerror}. Name a folder that `auv-mcm augment` wrote"
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}. Name a folder that `auv-mcm augment` wrote") from error
    return truth.background, tuple(
        PlacedTarget(
            latitude_deg=target.lat,
            longitude_deg=target.lon,
            floor_depth_m=NAN,
            kind=target.kind,
            is_target=target.is_target,
            seabed=target.seabed or "unknown",
            azimuth_rad=NAN if target.azimuth_deg is None else math.radians(target.azimuth_deg),
            length_m=NAN if target.length_m is None else target.length_m,
            width_m=NAN if target.width_m is None else target.width_m,
            height_m=NAN if target.height_m is None else target.height_m,
            burial_m=target.burial_m,
        )
        for target in truth.objects
    )


def check_once(lines: Iterable[SimulatedLine | AugmentedLine]) -> None:
    """Reject augmented logs that are not there, and a background that comes again, before missions are rendered."""
    splits: dict[str, str] = {}
    for line in lines:
        if isinstance(line, SimulatedLine):
            background = line.background
        else:
            background, _ = augmented_truth(line.folder / TRUTH_NAME)
            if not (line.folder / background).is_file():
                raise BadInputError(f"{line.folder / background} does not exist. Check the path.")
        if background in splits:
            raise UsageError(
                f"sea floor '{background}' is in the set twice, for {splits[background]} and for {line.split}. Give "
                "each recorded line once; if two logs have one name, rename one and augment it again"
            )
        splits[background] = line.split
