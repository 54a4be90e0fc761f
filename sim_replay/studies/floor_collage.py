"""Repeat the source paper's figure 10: targets on a collage of recorded sea floor, learned from flat sea floor alone.

auv-mcm bench collage --log LINE.xtf [--log LINE.xtf ...]                 judge many collages
auv-mcm bench collage --log LINE.xtf --draw FILE.jpg                      draw one of them instead

Each collage has an object of type A, three of type B and one that is not a target, a box, as the paper's has. Objects
are embedded in recorded side-scan lines; a piece of waterfall is cut around each, as wide as the swath, and five pieces
are laid one behind the other along the track, so that ranges and altitudes stay those of the recording. All that is
learned from is simulated flat sea floor. What lies on the recorded floor besides is not known: it counts as false
alarms.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import count, new_file
from sim_replay.augment.augment_log import augment
from sim_replay.augment.targets import EmbeddedKind, ScatteredTargets, TargetSpec
from sim_replay.fitting.cascade.classical.classical_model import ClassicalModel
from sim_replay.fitting.cascade.classical.train_classical import merged
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.place import cropped
from sim_replay.fitting.cascade.spec import AugmentedLine
from sim_replay.fitting.cascade.tiles import LabelledTile
from sim_replay.fitting.cascade.training_images import augmented_tiles
from sim_replay.missions import FIRST_SEED
from sim_replay.scoring.intervals import density, poisson_interval, proportion
from sim_replay.studies.families import judge_by, models_of, odds_of_share, samples_of
from sim_replay.studies.paper_candidates import (
    Array,
    ImageCandidates,
    Judge,
    Sighting,
    TileCandidates,
    kept_places,
    sightings,
    tile_candidates,
)
from sim_replay.studies.paper_scenes import TYPES, in_one_tile, training_lines
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

NOT_A_TARGET: Final[EmbeddedKind] = "box"
COLLAGE: Final[Mapping[EmbeddedKind, int]] = {"truncated_cone": 1, "wedge": 3, NOT_A_TARGET: 1}
"""Objects of a collage, by kind."""
DETECTOR: Final = "contrasts alone"
SHARES: Final = (0.5, 0.75, 0.9)
"""Shares of A and B at whose thresholds false alarms are counted."""
_HALF_M: Final = 6.0  # m of track before and after an object that its piece holds
_APART_M: Final = 8.0  # m between embedded objects, minimum
_SETS_PER_LINE: Final = 1  # collages' worth of objects in a line at once: the shortest has room for no more
_DRAWN_BY: Final = "all six"
_PIXEL_M: Final = 0.08  # m of a drawing's pixel
_QUALITY: Final = 72  # of the JPEG
_BRIGHTEST: Final = 4.0  # times the mean sea floor, in a drawing
_RING_PX: Final = 13  # radius of a detection's mark
_MARK: Final = {True: (80, 220, 80), False: (60, 60, 255)}  # blue, green, red: on a target, and a false alarm
_NOT_FOUND: Final = (0, 200, 255)


class Piece(NamedTuple):
    """Hold a piece of a recorded line around one embedded object. line: the log's name."""

    line: str
    kind: str
    tile: LabelledTile


class PieceTask(NamedTuple):
    """Name a line to embed objects in, by a seed."""

    log: Path
    seed: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench collage`."""
    parser.add_argument(
        "--log", type=Path, action="append", required=True, metavar="FILE", help="a recorded line, XTF; repeatable"
    )
    parser.add_argument("--seeds", type=count, default=24, help=f"draws per line, seeds {FIRST_SEED} on (default 24)")
    parser.add_argument("--missions", type=count, default=4, help="flat missions to learn from (default 4)")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument(
        "--draw", type=new_file, metavar="FILE", help="draw the first collage as a JPEG instead of tables"
    )
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Embed, learn, judge and print, or draw; return the exit code.

    Raises BadInputError or UsageError for a line that nothing can be embedded in, UsageError where pieces for a collage
    are missing and for a picture that cannot be written.
    """
    farm = Farm(arguments.workers)
    samples = merged(list(run_tasks(samples_of, training_lines(arguments.missions, ("flat",)), farm)))
    models = models_of(samples, tuple(TYPES))
    seeds = range(FIRST_SEED, FIRST_SEED + (1 if arguments.draw else arguments.seeds))
    tasks = [PieceTask(log, seed) for seed in seeds for log in arguments.log]
    pieces = [piece for some in run_tasks(pieces_of, tasks, farm) for piece in some]
    collages = collages_of(pieces)
    if not collages:
        raise UsageError("the lines have no room for the objects of a collage. Give longer ones, or more of them")
    config = in_one_tile(Config())
    if arguments.draw:
        _write(arguments.draw, draw(collages[0], models[_DRAWN_BY], config))
        return 0
    images = [ImageCandidates("collage", (tile_candidates(joined(some), config),)) for some in collages]
    alone = _by_line(pieces, config)
    laid_out = markdown if arguments.markdown else columns
    print(f"{len(collages)} collages, {sum(image.area_km2() for image in images):.4f} km² in all")
    print(f"learned from {models[_DRAWN_BY].trained_on}\n")
    print(laid_out(*table(images, models)))
    print(f"\nAll pieces by line, {_DRAWN_BY}\n")
    print(laid_out(*lines_table(alone, models[_DRAWN_BY])))
    return 0


def pieces_of(task: PieceTask) -> list[Piece]:
    """Embed objects in a line and cut a piece around each that is alone there."""
    with TemporaryDirectory() as folder:
        augment(task.log, spec_of(task.seed), Path(folder), Config())
        line = AugmentedLine(Path(folder), in_one_tile(Config()), "test")
        return [piece for tile in augmented_tiles(line) for piece in cut(tile)]


def spec_of(seed: int) -> TargetSpec:
    """Draw the objects of some collages over a line."""
    return TargetSpec(
        seed=seed,
        scatter=tuple(
            ScatteredTargets(kinds=(kind,), count=_SETS_PER_LINE * n, apart_m=_APART_M, is_target=kind != NOT_A_TARGET)
            for kind, n in COLLAGE.items()
        ),
    )


def cut(tile: LabelledTile) -> Iterator[Piece]:
    """Yield the pieces around objects, without those that reach beyond the tile or hold another object."""
    half = math.ceil(_HALF_M / tile.row_spacing_m)
    for one in tile.objects:
        start, stop = math.floor(one.row) - half, math.floor(one.row) + half
        if start < tile.core_start or stop > tile.core_stop:
            continue
        inside = cropped(tile.objects, start, stop)
        if len(inside) == 1:
            rows = slice(start, stop)
            yield Piece(
                Path(tile.background).stem,
                one.kind,
                msgspec.structs.replace(
                    tile,
                    codes=tile.codes[rows],
                    valid=tile.valid[rows],
                    usable=tile.usable[rows],
                    core_start=0,
                    core_stop=stop - start,
                    first_return_m=tile.first_return_m[rows],
                    objects=inside,
                ),
            )


def collages_of(pieces: Sequence[Piece]) -> list[list[Piece]]:
    """Deal pieces into collages with the objects of COLLAGE, lines in turn, as long as there are pieces."""
    waiting = {kind: _in_turn([piece for piece in pieces if piece.kind == kind]) for kind in COLLAGE}
    n_collages = min(len(waiting[kind]) // n for kind, n in COLLAGE.items())
    return [
        [piece for kind, n in COLLAGE.items() for piece in waiting[kind][index * n : (index + 1) * n]]
        for index in range(n_collages)
    ]


def _in_turn(pieces: Sequence[Piece]) -> list[Piece]:
    by_line: dict[str, list[Piece]] = {}
    for piece in pieces:
        by_line.setdefault(piece.line, []).append(piece)
    longest = max(map(len, by_line.values()), default=0)
    return [some[index] for index in range(longest) for some in by_line.values() if index < len(some)]


def joined(pieces: Sequence[Piece]) -> LabelledTile:
    """Lay pieces one behind the other; where one is narrower than the widest, nothing is recorded."""
    width = max(piece.tile.codes.shape[1] for piece in pieces)
    starts = np.cumsum([0, *(len(piece.tile.first_return_m) for piece in pieces)]).tolist()
    planes = {
        name: np.concatenate(
            [
                np.pad(plane, ((0, 0), (0, width - plane.shape[1])), constant_values=fill)
                for piece in pieces
                for plane in (getattr(piece.tile, name),)
            ]
        )
        for name, fill in (("codes", 1024), ("valid", False), ("usable", False))
    }
    return msgspec.structs.replace(
        pieces[0].tile,
        **planes,
        core_stop=starts[-1],
        first_return_m=np.concatenate([piece.tile.first_return_m for piece in pieces]),
        objects=tuple(
            msgspec.structs.replace(one, row=one.row + start)
            for piece, start in zip(pieces, starts[:-1], strict=True)
            for one in piece.tile.objects
        ),
        background="collage",
    )


def table(images: Sequence[ImageCandidates], models: Mapping[str, ClassicalModel]) -> tuple[list[str], list[list[str]]]:
    """Lay out what every feature set finds on the collages, as header and rows.

    At even odds, and false alarms where given shares of A and B are found; the detector's candidates last.
    """
    judges: dict[str, Judge] = {name: partial(judge_by, model) for name, model in models.items()}
    judges[DETECTOR] = _detector
    rows = []
    for name, judge in judges.items():
        seen = [one for image in images for one in sightings(image.tiles, judge)]
        wanted = sum(image.count(kind) for image in images for kind in COLLAGE if kind != NOT_A_TARGET)
        falling = sorted((one.log_odds for one in seen if one.is_target), reverse=True)
        cells = [name, *_found_cells(images, seen_from(seen, 0.0))]
        for share in SHARES:
            threshold = odds_of_share(falling, wanted, share)
            cells.append(
                _per_image(seen_from(seen, threshold), len(images)) if math.isfinite(threshold) else "not at any"
            )
        rows.append(cells)
    header = ["features", "A at even odds", "B", NOT_A_TARGET, "FA per collage", "FA/km²"]
    return [*header, *(f"FA per collage, {share:.0%} of A and B found" for share in SHARES)], rows


def lines_table(
    by_line: Mapping[str, Sequence[ImageCandidates]], model: ClassicalModel
) -> tuple[list[str], list[list[str]]]:
    """Lay out what a model finds at even odds on the pieces of each line, as header and rows."""
    rows = []
    for line, images in by_line.items():
        seen = [one for image in images for one in sightings(image.tiles, partial(judge_by, model))]
        offered = [one for image in images for one in sightings(image.tiles, _detector)]
        n_targets = sum(image.count(kind) for image in images for kind in COLLAGE if kind != NOT_A_TARGET)
        rows.append(
            [
                line,
                str(len(images)),
                share_cell(proportion(sum(one.is_target for one in offered), n_targets)),
                *_found_cells(images, seen_from(seen, 0.0)),
            ]
        )
    header = ["line", "pieces", "A and B among the candidates", "A at even odds", "B", NOT_A_TARGET]
    return [*header, "FA per piece", "FA/km²"], rows


def seen_from(seen: Sequence[Sighting], threshold: float) -> Counter[str]:
    """Count what is sighted at a threshold or above it, by kind."""
    return Counter(one.what for one in seen if one.log_odds >= threshold)


def draw(pieces: Sequence[Piece], model: ClassicalModel, config: Config) -> NDArray[np.uint8]:
    """Draw a collage, and below it again with what the model calls at even odds; (rows, columns, 3) blue, green, red.

    Along the track to the right, range downwards. Green rings are on targets, red ones are false alarms, yellow squares
    are targets that were missed.
    """
    tile = joined(pieces)
    found = tile_candidates(tile, config)
    odds = judge_by(model, found)
    size = (
        round(tile.codes.shape[0] * tile.row_spacing_m / _PIXEL_M),
        round(tile.codes.shape[1] * tile.column_spacing_m / _PIXEL_M),
    )
    level = np.sqrt(np.clip(tile.codes / 1024.0 / _BRIGHTEST, 0.0, 1.0)) * tile.valid
    grey = cv2.resize((255.0 * level).astype(np.uint8).T, size, interpolation=cv2.INTER_AREA)
    before = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    after = before.copy()

    def at(row: float, column: float) -> tuple[int, int]:
        return round(row * tile.row_spacing_m / _PIXEL_M), round(column * tile.column_spacing_m / _PIXEL_M)

    for index, one in enumerate(tile.objects):
        best = odds[found.object_index == index].max(initial=-math.inf)
        place = at(one.row, one.column)
        if best >= 0.0:
            cv2.circle(after, place, _RING_PX, _MARK[one.is_target], 2, cv2.LINE_AA)
        elif one.is_target:
            corner = np.array(place) - _RING_PX
            cv2.rectangle(after, corner.tolist(), (corner + 2 * _RING_PX).tolist(), _NOT_FOUND, 2)
    for k in kept_places(found, odds):
        if odds[k] >= 0.0:
            cv2.circle(after, at(found.rows[k] + 0.5, found.columns[k] + 0.5), _RING_PX, _MARK[False], 2, cv2.LINE_AA)
    panels = []
    for title, panel in (("(a)", before), ("(b)", after)):
        cv2.putText(panel, title, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        panels.append(np.pad(panel, ((0, 6), (0, 0), (0, 0)), constant_values=110))
    return np.concatenate(panels)


def _detector(tile: TileCandidates) -> Array:
    return tile.detector_odds


def _by_line(pieces: Sequence[Piece], config: Config) -> dict[str, list[ImageCandidates]]:
    found: dict[str, list[ImageCandidates]] = {}
    for piece in pieces:
        found.setdefault(piece.line, []).append(ImageCandidates(piece.line, (tile_candidates(piece.tile, config),)))
    return found


def _found_cells(images: Sequence[ImageCandidates], called: Counter[str]) -> list[str]:
    shares = [share_cell(proportion(called[kind], sum(image.count(kind) for image in images))) for kind in COLLAGE]
    area_km2 = sum(image.area_km2() for image in images)
    return [*shares, _per_image(called, len(images)), density_cell(density(_n_false(called), area_km2))]


def _per_image(called: Counter[str], n_images: int) -> str:
    n_false = _n_false(called)
    low, high = poisson_interval(n_false)
    return f"{n_false / n_images:.1f} ({float(low) / n_images:.1f}-{float(high) / n_images:.1f})"


def _n_false(called: Counter[str]) -> int:
    return sum(n for what, n in called.items() if what not in TYPES.values())


def _write(path: Path, picture: NDArray[np.uint8]) -> None:
    _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    try:
        write_file(path, coded.tobytes())
    except OSError as error:
        raise UsageError(f"--draw {path} cannot be written: {error.strerror}. Name another file") from error
