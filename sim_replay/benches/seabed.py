"""Compare the live map of the sea floor with the truth of the named scenes, all cells, and measure its cost.

auv-mcm bench seabed                              flies, scores and prints
auv-mcm bench seabed --model FILE                 scores a model of 'auv-mcm calibrate seabed'
auv-mcm bench seabed --picture FILE --log LOG ... draws recorded lines and what their floor is taken for
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.contacts.contact_picture import encoded
from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, CoveragePatch, SeabedCells, Tile
from auv_mcm.safe_files import read_regular
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import SeabedModel, parse_seabed_model, shipped_seabed_model
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import count
from sim_replay.benches.mission_options import add_scene_options, chosen_scenes, chosen_seeds
from sim_replay.benches.progress import counted
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.seabed.seabed_picture import seabed_picture
from sim_replay.fitting.seabed.seabed_score import Shares, confusion_m2, shares
from sim_replay.missions import config_for
from sim_replay.scoring.seabed_map import SeabedMap
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import NOTHING, columns, markdown

Array = NDArray[np.float64]

FIRST_SEED: Final = 91001  # nothing of the sea floor was ever fitted or tried on seeds from here on
_QUALITY: Final = 62  # of JPEG, per cent


class SeabedTask(NamedTuple):
    """Name a mission over a named scene. model: JSON of the model that serves it."""

    scene: str
    seed: int
    model: bytes


class Scored(NamedTuple):
    """Hold the score of one mission: confusion (n_types, n_types) in m², truth down.

    stage_s: median processor time per tile.
    """

    confusion_m2: Array
    stage_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench seabed`."""
    add_scene_options(parser, FIRST_SEED)
    parser.add_argument("--model", type=Path, metavar="FILE", help="model to score (default: the one that ships)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the areas to FILE")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help="draw recorded lines into FILE, .png or .jpg, and score nothing"
    )
    parser.add_argument("--log", type=Path, action="append", metavar="LOG", help="log to draw, repeatable")
    parser.add_argument(
        "--tiles", type=count, default=6, help="tiles drawn of each log, from its beginning (default 6)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Score and print, or draw; returns the exit code.

    Raises UsageError for unknown scenes and files that cannot be written.
    """
    if (arguments.picture is None) != (arguments.log is None):
        raise UsageError("--picture draws what --log names: give both, or neither to score")
    data = _model_bytes(arguments.model)
    if arguments.picture is not None:
        return _draw(arguments.log, arguments.tiles, arguments.picture, parse_seabed_model(data, str(arguments.model)))
    names = chosen_scenes(arguments.scenes)
    seeds = chosen_seeds(arguments)
    tasks = [SeabedTask(name, seed, data) for name in names for seed in seeds]
    missions = list(run_tasks(scored, tasks, Farm(arguments.workers), counted(len(tasks), "missions scored")))
    by_scene = {
        name: np.sum(
            [each.confusion_m2 for task, each in zip(tasks, missions, strict=True) if task.scene == name], axis=0
        )
        for name in names
    }
    print(
        f"{len(seeds)} missions per scene, seeds {seeds[0]} to {seeds[-1]}; "
        f"{parse_seabed_model(data, 'model').fitted_on}\n"
    )
    print(report(by_scene, arguments.markdown))
    print(
        f"\nper tile, processor time: {1e3 * float(np.median([each.stage_s for each in missions])):.1f} ms in the "
        "median"
    )
    if arguments.json is not None:
        areas = {name: area_m2.tolist() for name, area_m2 in by_scene.items()}
        try:
            write_file(arguments.json, msgspec.json.format(msgspec.json.encode({"kinds": SEABED_TYPES, "m2": areas})))
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    return 0


def scored(task: SeabedTask) -> Scored:
    """Fly a mission over a named scene and compare its map with the truth."""
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    return scored_scene(scene, parse_seabed_model(task.model, "model"))


def scored_scene(scene: Scene, model: SeabedModel) -> Scored:
    """Fly a mission over a scene, without a detector, and compare its map with the truth."""
    stage_s: list[float] = []

    def timed(tile: Tile) -> SeabedCells:
        start_s = time.process_time()
        cells = seabed_cells(tile, model)
        stage_s.append(time.process_time() - start_s)
        return cells

    mission = Mission(scene)
    pipeline = Pipeline(config_for(scene), detect=lambda tile: TileDetections((), 0, 0), seabed=timed)
    searched = ClearanceMap(shipped_performance())
    for event in mission.events():
        for result in pipeline.feed(event):
            if isinstance(result, CoveragePatch):
                searched.add(result)
    for result in pipeline.finish():
        if isinstance(result, CoveragePatch):
            searched.add(result)
    clearance = searched.snapshot()
    n = len(SEABED_TYPES)
    truth = msgspec.convert(mission.truth()["seabed_map"], SeabedMap)
    return Scored(np.zeros((n, n)) if clearance is None else confusion_m2(clearance, truth), float(np.median(stage_s)))


def report(by_scene: dict[str, Array], in_markdown: bool = False) -> str:
    """Lay out shares by scene and of all together, and the areas of each true kind by what it was taken for."""
    laid_out = markdown if in_markdown else columns
    pooled = np.sum(list(by_scene.values()), axis=0)
    rows = [_row(name, area_m2) for name, area_m2 in {**by_scene, "all": pooled}.items()]
    header = ("scene", "km²", "right", "unknown", "right where a kind is given")
    kinds = [
        [
            name,
            *(f"{part / 1e6:.3f}" for part in pooled[index].tolist()),
            f"{pooled[index, index] / pooled[index].sum():.2f}",
        ]
        for index, name in enumerate(SEABED_TYPES)
        if pooled[index].sum() > 0.0
    ]
    return laid_out(header, rows) + "\n\n" + laid_out(("truth, km²", *SEABED_TYPES, "right"), kinds)


def _row(name: str, area_m2: Array) -> list[str]:
    row: Shares = shares(area_m2)
    return [name, f"{area_m2.sum() / 1e6:.3f}", *(NOTHING if np.isnan(share) else f"{share:.2f}" for share in row)]


def _model_bytes(path: Path | None) -> bytes:
    if path is None:
        return msgspec.json.encode(shipped_seabed_model())
    try:
        data = read_regular(path)
    except OSError as error:
        raise BadInputError(f"--model {path} cannot be read: {error.strerror}. Check the path") from error
    parse_seabed_model(data, str(path))
    return data


def _draw(logs: Sequence[Path], n_tiles: int, out: Path, model: SeabedModel) -> int:
    options = {".png": [cv2.IMWRITE_PNG_COMPRESSION, 9], ".jpg": [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]}.get(
        out.suffix.lower()
    )
    if options is None:
        raise UsageError(f"--picture {out}: name a file that ends in .png or .jpg")
    picture = encoded(seabed_picture(logs, n_tiles, model), out.suffix.lower(), options)
    try:
        write_file(out, picture)
    except OSError as error:
        raise UsageError(f"--picture {out} cannot be written: {error.strerror}") from error
    return 0
