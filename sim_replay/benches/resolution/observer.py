"""Find what the best observer can do at each pixel size: find a mine, distinguish it from all rocks, and name it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.benches.resolution.distances import DISTINCT_NATS, FOUND_NATS, coarser, distance_nats
from sim_replay.benches.resolution.pictures import FINE_M, MINES, Floor, Pictured
from sim_replay.scoring.intervals import proportion
from sim_replay.text_tables import share_cell

Floats = NDArray[np.float64]

COARSER: Final = (1, 2, 4, 8, 16, 24, 32)
"""Fine pixels that make a pixel: 1.5 to 48 cm."""

_SHIFT_PIXELS: Final = 8  # fine ones, 12 cm: steps in which a rock is moved below a mine
_N_SHIFTS: Final = 3  # steps to either side: 36 cm
_LEAST_NATS: Final = 1e-9  # nats, whose logarithm is taken for none
_N_RESAMPLES: Final = 300  # of mines, for intervals; chosen for the run time
_FIRST_ROCK: Final = 1000  # seed of the first rock: no mine has it


class Distances(NamedTuple):
    """Hold distances of one mine, nats for one look, (views, pixel sizes), views being one and two.

    floor: from bare floor. rocks, others: from the rock, and from the mine of another kind, that looks most like it.
    """

    kind: str
    floor: Floats
    rocks: Floats
    others: Floats


def observed(n_mines: int, n_rocks: int, strength_db: float) -> list[Distances]:
    """Draw n_mines of each kind and n_rocks rocks of one strength, and compare them all.

    A rock, or another mine, may lie up to 36 cm from where it looks most like the mine.
    """
    floor = Floor()
    bare = floor.bare()
    mines = [floor.pictured(kind, strength_db, seed) for kind in MINES for seed in range(n_mines)]
    rocks = [floor.pictured("rock", strength_db, _FIRST_ROCK + seed) for seed in range(n_rocks)]
    return [_distances(mine, mines, rocks, bare) for mine in mines]


def _distances(mine: Pictured, mines: Sequence[Pictured], rocks: Sequence[Pictured], bare: Floats) -> Distances:
    others = [other for other in mines if other.kind != mine.kind]
    return Distances(
        mine.kind,
        _one_and_two(_by_size(mine.means, np.broadcast_to(bare, mine.means.shape))[np.newaxis]),
        _one_and_two(np.stack([_by_size(mine.means, _moved(rock, mine, bare)) for rock in rocks])),
        _one_and_two(np.stack([_by_size(mine.means, _moved(other, mine, bare)) for other in others])),
    )


def _by_size(means: Floats, others: Floats) -> Floats:
    """Compute the distances of two sets of pictures, (views, pixel sizes) nats."""
    return np.stack([distance_nats(coarser(means, n), coarser(others, n)) for n in COARSER], axis=-1)


def _one_and_two(distances: Floats) -> Floats:
    """Take the nearest of several, (n, 2 views, pixel sizes): by the first view, and by the sum of both."""
    return np.stack([distances[:, 0].min(axis=0), distances.sum(axis=1).min(axis=0)])


def _moved(one: Pictured, below: Pictured, bare: Floats) -> Floats:
    """Move an object over the floor to where it looks most like another, in each view, (2, rows, columns)."""
    moved = []
    steps = range(-_N_SHIFTS, _N_SHIFTS + 1)
    for means, wanted in zip(one.means, below.means, strict=True):
        change, seen = coarser(means / bare, _SHIFT_PIXELS), coarser(wanted, _SHIFT_PIXELS)
        under = coarser(bare, _SHIFT_PIXELS)
        tried = {
            (down, right): float(distance_nats(np.roll(change, (down, right), (0, 1)) * under, seen))
            for down in steps
            for right in steps
        }
        down, right = min(tried, key=lambda step: tried[step])
        moved.append(np.roll(means / bare, (down * _SHIFT_PIXELS, right * _SHIFT_PIXELS), (0, 1)) * bare)
    return np.stack(moved)


def share_rows(compared: Sequence[Distances], looks: int, *, views: int) -> Iterator[list[str]]:
    """Yield per kind and question the share of mines for which the answer is yes, by pixel size."""
    questions = (
        ("found", "floor", FOUND_NATS),
        ("distinct from rocks", "rocks", DISTINCT_NATS),
        ("named", "others", DISTINCT_NATS),
    )
    for kind in MINES:
        some = [one for one in compared if one.kind == kind]
        for words, name, least_nats in questions:
            nats = looks * np.stack([getattr(one, name)[views - 1] for one in some])
            cells = (share_cell(proportion(int(k), len(some))) for k in (nats >= least_nats).sum(axis=0))
            yield [kind, words, *cells]


def nats_of(compared: Sequence[Distances], name: str, *, views: int, looks: int) -> Floats:
    """List the distances of mines from `floor`, `rocks` or `others`, (n, pixel sizes) nats."""
    return looks * np.stack([getattr(one, name)[views - 1] for one in compared])


def drawn_anew(nats: Floats) -> Floats:
    """Draw as many mines from these, (n, pixel sizes), again and again, (draws, n, pixel sizes), for intervals."""
    random = np.random.Generator(np.random.PCG64(len(nats)))
    return nats[random.integers(len(nats), size=(_N_RESAMPLES, len(nats)))]


def pixel_for(nats: Floats, least_nats: float, *, share: float) -> Floats:
    """Find the largest pixel, m, with which a share of mines is beyond a distance, by interpolation; NaN for none.

    nats: (..., n, pixel sizes); returns (...). Between pixel sizes the logarithm of a distance goes with that of the
    pixel.
    """
    pixels = np.log([FINE_M * n for n in COARSER])
    margin = np.log(np.maximum(np.quantile(nats, 1.0 - share, axis=-2), _LEAST_NATS) / least_nats)
    is_below = margin < 0.0
    k = np.clip(is_below.argmax(axis=-1), 1, None)[..., np.newaxis]
    before, after = (np.take_along_axis(margin, at, axis=-1)[..., 0] for at in (k - 1, k))
    step = np.where(before > after, before - after, 1.0)
    found = pixels[k[..., 0] - 1] + before / step * (pixels[k[..., 0]] - pixels[k[..., 0] - 1])
    found = np.where(is_below.any(axis=-1), found, pixels[-1])
    return np.asarray(np.where(is_below[..., 0], np.nan, np.exp(found)))
