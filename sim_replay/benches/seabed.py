"""How well kinds of sea floor are told apart on missions never fitted on, beside Haralick's textures, and what it costs.

auv-mcm bench seabed                              flies, scores and prints
auv-mcm bench seabed --picture FILE --log LOG ... draws recorded lines and what their floor is taken for
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.picture import encoded
from auv_mcm.errors import UsageError
from auv_mcm.records import SEABED_TYPES
from auv_mcm.seabed.seabed_cells import seabed_cells, smoothed
from auv_mcm.seabed.seabed_model import SeabedModel, kind_indices, odds_of, shipped_seabed_model
from auv_mcm.seabed.texture import measure_texture
from auv_mcm.shell.results import write_file
from sim_replay.arguments import count
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.seabed.fit_seabed import FIT_SEEDS, alike, regression
from sim_replay.fitting.seabed.haralick import haralick_features
from sim_replay.fitting.seabed.picture import seabed_picture
from sim_replay.fitting.seabed.samples import MIXED, TrueTile, kind_of_covers, true_tiles
from sim_replay.text_tables import columns, markdown

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
T = TypeVar("T")

FIRST_SEED: Final = 9320  # nothing of the sea floor was ever fitted or tried on seeds from here on
_QUALITY: Final = 62
_SYSTEMS: Final = ("ours", "ours, cell by cell", "Haralick's, smoothed alike")


class Told(NamedTuple):
    """Of one mission: confusion (len(_SYSTEMS), n_types, n_types), truth down; texture_s, stage_s: medians of processor time per tile."""

    confusion: Counts
    texture_s: float
    stage_s: float


class Rival(NamedTuple):
    """Haralick's features with the same regression: centre, scale (n,), weights (terms, n_kinds)."""

    centre: Array
    scale: Array
    weights: Array


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=count, default=24, help=f"missions to score on, from seed {FIRST_SEED} (default 24)")
    parser.add_argument(
        "--rival-seeds", type=count, default=len(FIT_SEEDS), help=f"missions to fit Haralick's on (default {len(FIT_SEEDS)})"
    )
    parser.add_argument("--workers", type=count, default=2, help="processes (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the counts to FILE")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw recorded lines into FILE, .png or .jpg, and score nothing")
    parser.add_argument("--log", type=Path, action="append", metavar="LOG", help="log to draw; may be given again")
    parser.add_argument("--tiles", type=count, default=6, help="tiles drawn of each log, from its beginning (default 6)")


def run(arguments: argparse.Namespace) -> int:
    """Fit the rival, score both and print, or draw; returns the exit code. Raises UsageError for a file that cannot be written."""
    if (arguments.picture is None) != (arguments.log is None):
        raise UsageError("--picture draws what --log names: give both, or neither to score")
    if arguments.picture is not None:
        return _draw(arguments.log, arguments.tiles, arguments.picture)
    farm = Farm(arguments.workers)
    rival_seeds = list(islice(FIT_SEEDS, arguments.rival_seeds))
    rival = _fitted(list(_counted(run_tasks(haralick_samples, rival_seeds, farm), len(rival_seeds), "fitted on")))
    seeds = list(range(FIRST_SEED, FIRST_SEED + arguments.seeds))
    told = list(_counted(run_tasks(partial(scored, rival=rival, model=shipped_seabed_model()), seeds, farm), len(seeds), "scored"))
    confusion = np.sum([each.confusion for each in told], axis=0)
    laid_out = markdown if arguments.markdown else columns
    print(f"{len(seeds)} missions, seeds {seeds[0]} to {seeds[-1]}: {confusion[0].sum()} cells whose windows show one kind alone\n")
    for name, counts in zip(_SYSTEMS, confusion, strict=True):
        print(f"{name}: {np.trace(counts) / counts.sum():.3f} right, {_balanced(counts):.3f} on average over kinds\n")
        print(laid_out(("truth", *SEABED_TYPES, "right"), list(_rows(counts))), end="\n\n")
    texture_ms, stage_ms = (1e3 * float(np.median([getattr(each, name) for each in told])) for name in ("texture_s", "stage_s"))
    print(f"per tile, processor time: {texture_ms:.1f} ms for textures, {stage_ms:.1f} ms in all")
    if arguments.json is not None:
        counted = {name: counts.tolist() for name, counts in zip(_SYSTEMS, confusion, strict=True)}
        try:
            write_file(arguments.json, msgspec.json.format(msgspec.json.encode({"kinds": SEABED_TYPES, **counted})))
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    return 0


def _draw(logs: Sequence[Path], n_tiles: int, out: Path) -> int:
    options = {".png": [cv2.IMWRITE_PNG_COMPRESSION, 9], ".jpg": [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]}.get(out.suffix.lower())
    if options is None:
        raise UsageError(f"--picture {out}: name a file that ends in .png or .jpg")
    picture = encoded(seabed_picture(logs, n_tiles, shipped_seabed_model()), out.suffix.lower(), options)
    try:
        write_file(out, picture)
    except OSError as error:
        raise UsageError(f"--picture {out} cannot be written: {error.strerror}") from error
    return 0


def haralick_samples(seed: int) -> tuple[Array, NDArray[np.uint8]]:
    """(n, n_features) of pure cells and (n,) their covers."""
    parts = []
    for tile, cover in true_tiles(seed):
        features = haralick_features(tile)
        pure = (cover != MIXED) & np.isfinite(features).all(axis=-1)
        parts.append((features[pure], cover[pure]))
    return np.concatenate([features for features, _ in parts]), np.concatenate([cover for _, cover in parts])


def scored(seed: int, rival: Rival, model: SeabedModel) -> Told:
    """Every system on one mission."""
    n = len(SEABED_TYPES)
    confusion = np.zeros((len(_SYSTEMS), n, n), dtype=np.int64)
    texture_s, stage_s = [], []
    for true in true_tiles(seed):
        texture, took_s = _timed(partial(measure_texture, true.tile))
        texture_s.append(took_s)
        cells, took_s = _timed(partial(seabed_cells, true.tile, model))
        stage_s.append(took_s)
        measured = np.isfinite(texture.features).all(axis=-1)
        odds = odds_of(np.nan_to_num(texture.features), np.broadcast_to(texture.cot_grazing, measured.shape), model)
        alone = kind_indices(model)[np.argmax(odds.log_p, axis=-1)]
        for system, kind in enumerate((cells.kind, alone, _by_rival(true, rival, kind_indices(model)))):
            pure = (true.cover != MIXED) & measured
            np.add.at(confusion[system], (kind_of_covers()[true.cover[pure]], kind[pure]), 1)
    return Told(confusion, float(np.median(texture_s)), float(np.median(stage_s)))


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    start_s = time.process_time()
    done = work()
    return done, time.process_time() - start_s


def _fitted(samples: list[tuple[Array, NDArray[np.uint8]]]) -> Rival:
    features, cover = (np.concatenate(part) for part in zip(*samples, strict=True))
    centre, scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-9)
    of_cover = kind_of_covers()
    known = np.array(list(dict.fromkeys(of_cover.tolist())))
    kind = np.searchsorted(np.sort(known), of_cover[cover])
    return Rival(centre, scale, regression(_terms((features - centre) / scale), kind, alike(cover, kind)))


def _by_rival(true: TrueTile, rival: Rival, kinds: NDArray[np.uint8]) -> NDArray[np.uint8]:
    features = haralick_features(true.tile)
    measured = np.asarray(np.isfinite(features).all(axis=-1))
    log_p = _terms((np.nan_to_num(features) - rival.centre) / rival.scale) @ rival.weights
    log_p -= np.logaddexp.reduce(log_p, axis=-1, keepdims=True)
    return np.asarray(np.sort(kinds)[np.argmax(smoothed(log_p * measured[..., np.newaxis], measured), axis=-1)], dtype=np.uint8)


def _terms(x: Array) -> Array:
    near = np.clip(x, -2.0, 2.0)
    return np.concatenate([np.ones((*near.shape[:-1], 1)), near, near**2], axis=-1)


def _rows(counts: Counts) -> Iterator[list[str]]:
    for index, name in enumerate(SEABED_TYPES):
        if total := int(counts[index].sum()):
            yield [name, *map(str, counts[index].tolist()), f"{counts[index, index] / total:.2f}"]


def _balanced(counts: Counts) -> float:
    present = counts.sum(axis=1) > 0
    return float(np.mean(np.diag(counts)[present] / counts.sum(axis=1)[present]))


def _counted(results: Iterator[T], total: int, word: str) -> Iterator[T]:
    for done, result in enumerate(results, 1):
        print(f"\r{done} of {total} missions {word}", end="" if done < total else "\n", file=sys.stderr, flush=True)
        yield result
