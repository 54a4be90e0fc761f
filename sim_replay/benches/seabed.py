"""Compare the live map of the sea floor with the truth of the named scenes, all cells, and measure its cost.

auv-mcm bench seabed                              flies, scores and prints
auv-mcm bench seabed --model FILE                 scores a model of 'auv-mcm calibrate seabed'
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, CoveragePatch, SeabedCells, Tile
from auv_mcm.safe_files import read_regular
from auv_mcm.seabed.seabed_cells import seabed_cells
from auv_mcm.seabed.seabed_model import SeabedModel, parse_seabed_model, shipped_seabed_model
from sim_replay.benches.experiment import Cell, Column, Experiment, Task, mission_source, number
from sim_replay.fitting.seabed.seabed_score import Shares, confusion_m2, shares
from sim_replay.flights import Flight, fly_through
from sim_replay.missions import SCENES
from sim_replay.scoring.inputs import parse_truth
from sim_replay.text_tables import NOTHING, columns

Array = NDArray[np.float64]

MAP: Final = "live map"


class Scored(NamedTuple):
    """Hold the score of one mission: confusion (n_types, n_types) in m², truth down.

    stage_s: median processor time per tile.
    """

    confusion_m2: Array
    stage_s: float


def fly(task: Task) -> dict[str, Scored]:
    """Fly a mission over a named scene and compare its map with the truth."""
    with mission_source(task) as source:
        return {MAP: scored(source, _model(task.options["model"]))}


def scored(source: Flight, model: SeabedModel) -> Scored:
    """Fly a mission, without a detector, and compare its map with the truth."""
    stage_s: list[float] = []

    def timed(tile: Tile) -> SeabedCells:
        start_s = time.process_time()
        cells = seabed_cells(tile, model)
        stage_s.append(time.process_time() - start_s)
        return cells

    pipeline = Pipeline(source.config, detect=lambda tile: TileDetections((), 0, 0), seabed=timed)
    searched = ClearanceMap(shipped_performance())
    fly_through(
        source.events, {MAP: pipeline}, lambda one: searched.add(one) if isinstance(one, CoveragePatch) else None
    )
    clearance, truth = searched.snapshot(), parse_truth(source.truth(), "truth").seabed_map
    area_m2 = np.zeros((len(SEABED_TYPES), len(SEABED_TYPES)))
    if clearance is not None and truth is not None:
        area_m2 = confusion_m2(clearance, truth)
    return Scored(area_m2, float(np.median(stage_s)))


def _model(path: Path | None) -> SeabedModel:
    if path is None:
        return shipped_seabed_model()
    try:
        return parse_seabed_model(read_regular(path), str(path))
    except OSError as error:
        raise BadInputError(f"--model {path} cannot be read: {error.strerror}. Check the path") from error


def _add_model(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", type=Path, metavar="FILE", help="model to score (default: the one that ships)")


def _pooled(missions: Sequence[Scored]) -> Array:
    return np.asarray(np.sum([one.confusion_m2 for one in missions], axis=0))


def _share(missions: Sequence[Scored], part: str) -> Cell:
    found: Shares = shares(_pooled(missions))
    value: float = getattr(found, part)
    return Cell(NOTHING) if np.isnan(value) else number(value, 2)


def _words(flown: Sequence[Mapping[str, Scored]]) -> str:
    """Lay out the areas of each true kind by what it was taken for, and state the cost."""
    missions = [one[MAP] for one in flown]
    pooled = _pooled(missions)
    kinds = [
        [
            name,
            *(f"{part / 1e6:.3f}" for part in pooled[index].tolist()),
            f"{pooled[index, index] / pooled[index].sum():.2f}",
        ]
        for index, name in enumerate(SEABED_TYPES)
        if pooled[index].sum() > 0.0
    ]
    middle_ms = 1e3 * float(np.median([one.stage_s for one in missions]))
    return (
        columns(("truth, km²", *SEABED_TYPES, "right"), kinds)
        + f"\n\nper tile, processor time: {middle_ms:.1f} ms in the median"
    )


EXPERIMENT: Final = Experiment(
    name="seabed",
    scenes=SCENES,
    first_seed=91001,  # nothing of the sea floor was ever fitted or tried on seeds from here on
    n_seeds=2,
    variant_title="map",
    variants=(MAP,),
    fly=fly,
    columns=(
        Column("km²", lambda missions: number(float(_pooled(missions).sum()) / 1e6, 3)),
        Column("right", partial(_share, part="right")),
        Column("unknown", partial(_share, part="unknown")),
        Column("right where a kind is given", partial(_share, part="right_of_known")),
    ),
    add_options=_add_model,
    own_options=("model",),
    words=_words,
)
