"""Find the candidates of an image once, with their chips, so that any number of classifiers can judge them.

What a candidate lies on does not depend on who judges it. An object counts once, at the best odds among the candidates
on it or in its shadow; so does a place without any, at the best odds among candidates within a metre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import odds_of
from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.classical.chips import cut_chips, picture_of, reference_shadow_m
from sim_replay.fitting.cascade.classical.classical_candidates import Candidates, pixels_of, unlabelled
from sim_replay.fitting.cascade.spec import SimulatedLine
from sim_replay.fitting.cascade.tiles import LabelledTile
from sim_replay.fitting.cascade.training_images import simulated_tiles
from sim_replay.fitting.left_out import Scored
from sim_replay.studies.paper_scenes import surface_range_m

Array: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

NORMALISED: Final = "shares of the reference shadow"
"""The cut of chips that classifiers are given elsewhere."""
EVERYWHERE: Final = (0.0, math.inf)
"""Band of ground ranges, m, that holds all of them."""
FLOOR: Final = "floor"
SURFACE: Final = "surface"
_ON_OBJECT_M: Final = 1.5
_SAME_M: Final = 1.0
_SURFACE_M: Final = 1.5  # of slant range about the surface's first echo
_ANY_CUT: Final[Mapping[str, float | None]] = {NORMALISED: None}


class CutChips(NamedTuple):
    """Hold contrast (n, N_ROWS, N_COLUMNS) float32 of chips, and known (n,) bool, whether they can be judged."""

    contrast: NDArray[np.float32]
    known: Bools


class TileCandidates(NamedTuple):
    """Hold all candidates of one tile, n, and the objects in its core.

    rows, columns: (n,) int32, their pixels. chips: by cut. detector_odds: (n,) float64, log-odds that the training-free
    detector gives them. ground_range_m: (n,). object_index: (n,) intp of kinds, of the object that the candidate lies
    on, -1 for none, -2 for an object of the next tile. covers: (n, n) bool, whether the second of two candidates lies
    on the first or in its shadow. on_surface: (n,) bool, on the sea surface's echo. kinds, is_target,
    object_range_m: of the objects. usable_m2: (n_columns,) of each column of the tile, column_m wide.
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    chips: dict[str, CutChips]
    detector_odds: Array
    ground_range_m: Array
    object_index: NDArray[np.intp]
    covers: Bools
    on_surface: Bools
    kinds: tuple[str, ...]
    is_target: tuple[bool, ...]
    object_range_m: tuple[float, ...]
    usable_m2: Array
    column_m: float

    def area_km2(self, band_m: tuple[float, float] = EVERYWHERE) -> float:
        """Return the area that candidates were looked for in."""
        middle_m = (np.arange(len(self.usable_m2)) + 0.5) * self.column_m
        return float(self.usable_m2[(middle_m >= band_m[0]) & (middle_m < band_m[1])].sum()) / 1e6


class ImageCandidates(NamedTuple):
    """Hold the tiles of one image. floor: "flat/9100", the scene and seed, or the recorded line that it shows."""

    floor: str
    tiles: tuple[TileCandidates, ...]

    def count(self, kind: str) -> int:
        """Count the objects of a kind."""
        return sum(tile.kinds.count(kind) for tile in self.tiles)

    def area_km2(self) -> float:
        """Return the area that candidates were looked for in."""
        return sum(tile.area_km2() for tile in self.tiles)


Judge: TypeAlias = Callable[[TileCandidates], Array]
"""Returns (n,) log-odds of all candidates of a tile, -inf for those it cannot judge."""


class Sighting(NamedTuple):
    """Hold the best odds in an image of one object, or of one place without any. what: its kind, SURFACE or FLOOR."""

    what: str
    is_target: bool
    log_odds: float


def detected(tile: LabelledTile, config: Config) -> tuple[Candidates, Array]:
    """Find candidates as `find_candidates` does, and the log-odds (n,) that the training-free detector gives them."""
    plain = unlabelled(tile)
    detections = detect_tile(plain, config).detections
    return Candidates(*pixels_of(detections, plain)), np.array([odds_of(one.p_mine) for one in detections])


def tile_candidates(
    tile: LabelledTile,
    config: Config,
    surface_m: float = math.nan,
    cuts: Mapping[str, float | None] = _ANY_CUT,
) -> TileCandidates:
    """Find the candidates of a tile and cut their chips.

    Parameters
    ----------
    surface_m
        Slant range, m, of the sea surface's first echo, NaN if there is none.
    cuts
        Ways of cutting chips by name, each the `shadow_m` of `cut_chips`.
    """
    found, odds = detected(tile, config)
    rows, columns = found.rows.astype(np.float64) + 0.5, found.columns.astype(np.float64) + 0.5
    range_m, altitude_m = columns * tile.column_spacing_m, tile.first_return_m[found.rows]
    picture = picture_of(tile)
    chips = {}
    for name, shadow_m in cuts.items():
        cut = cut_chips(picture, found.rows, found.columns, shadow_m)
        chips[name] = CutChips(cut.contrast.astype(np.float32), cut.known)
    own = [k for k, one in enumerate(tile.objects) if tile.core_start <= one.row < tile.core_stop]
    return TileCandidates(
        rows=found.rows,
        columns=found.columns,
        chips=chips,
        detector_odds=odds,
        ground_range_m=range_m,
        object_index=_lies_on(tile, own, rows, columns),
        covers=np.array(
            [_covered(tile, *place, rows, columns, _SAME_M) for place in zip(rows, columns, strict=True)],
            dtype=np.bool_,
        ).reshape(len(rows), len(rows)),
        on_surface=np.abs(np.hypot(range_m, altitude_m) - surface_m) < _SURFACE_M,
        kinds=tuple(tile.objects[k].kind for k in own),
        is_target=tuple(tile.objects[k].is_target for k in own),
        object_range_m=tuple(tile.objects[k].ground_range_m for k in own),
        usable_m2=np.count_nonzero(tile.usable, axis=0) * tile.row_spacing_m * tile.column_spacing_m,
        column_m=tile.column_spacing_m,
    )


def fly_image(line: SimulatedLine, cuts: Mapping[str, float | None] = _ANY_CUT) -> ImageCandidates:
    """Fly a mission and find its candidates. cuts: as in tile_candidates."""
    surface_m = math.nan if line.scene.sonar.surface_echo_db is None else surface_range_m(line.scene)
    return ImageCandidates(
        line.background, tuple(tile_candidates(tile, line.config, surface_m, cuts) for tile in simulated_tiles(line))
    )


def sightings(
    tiles: Iterable[TileCandidates], judge: Judge, band_m: tuple[float, float] = EVERYWHERE
) -> list[Sighting]:
    """List every object that candidates lie on, at its best odds, then the places without one, best first.

    band_m: of ground ranges, from and below, m; objects and places elsewhere are left out.
    """
    found = []
    for tile in tiles:
        odds = judge(tile)
        for index, (kind, is_target, range_m) in enumerate(
            zip(tile.kinds, tile.is_target, tile.object_range_m, strict=True)
        ):
            best = odds[tile.object_index == index].max(initial=-math.inf)
            if math.isfinite(best) and band_m[0] <= range_m < band_m[1]:
                found.append(Sighting(kind, is_target, float(best)))
        found += [
            Sighting(SURFACE if tile.on_surface[k] else FLOOR, False, float(odds[k]))
            for k in kept_places(tile, odds)
            if band_m[0] <= tile.ground_range_m[k] < band_m[1]
        ]
    return found


def remembered(judge: Judge) -> Judge:
    """Judge every tile once, however often it is asked for; tiles must stay in memory."""
    answers: dict[int, Array] = {}

    def answer(tile: TileCandidates) -> Array:
        if id(tile) not in answers:
            answers[id(tile)] = judge(tile)
        return answers[id(tile)]

    return answer


def kept_places(tile: TileCandidates, odds: Array) -> list[int]:
    """List the candidates on no object, best first, without those that lie on a better one or in its shadow."""
    left = (tile.object_index == -1) & np.isfinite(odds)
    kept = []
    for k in np.argsort(-odds, kind="stable").tolist():
        if left[k]:
            kept.append(k)
            left &= ~tile.covers[k]
    return kept


def scored_image(image: ImageCandidates, judge: Judge, band_m: tuple[float, float] = EVERYWHERE) -> Scored:
    """Return what is sighted in an image as benches of Pd take it; objects that are no targets are false alarms."""
    seen = sightings(image.tiles, judge, band_m)
    return Scored(
        domain=image.floor,
        log_odds=np.array([one.log_odds for one in seen]),
        is_target=np.array([one.is_target for one in seen], dtype=np.bool_),
        weight=np.ones(len(seen)),
        n_targets=sum(
            is_target and band_m[0] <= range_m < band_m[1]
            for tile in image.tiles
            for is_target, range_m in zip(tile.is_target, tile.object_range_m, strict=True)
        ),
        area_km2=sum(tile.area_km2(band_m) for tile in image.tiles),
    )


def _lies_on(tile: LabelledTile, own: list[int], rows: Array, columns: Array) -> NDArray[np.intp]:
    """Return what each candidate lies on, the first object where there are several."""
    index = np.full(len(rows), -1, dtype=np.intp)
    for k, one in enumerate(tile.objects):
        here = _covered(tile, one.row, one.column, rows, columns, _ON_OBJECT_M)
        index[here & (index == -1)] = own.index(k) if k in own else -2
    return index


def _covered(tile: LabelledTile, row: float, column: float, rows: Array, columns: Array, reach_m: float) -> Bools:
    """Report which places (n,) are within reach of a highlight at (row, column), or in the shadow behind it."""
    along_m = np.abs(rows - row) * tile.row_spacing_m
    across_m = (columns - column) * tile.column_spacing_m
    altitude_m = tile.first_return_m[min(max(math.floor(row), 0), len(tile.first_return_m) - 1)]
    shadow_m = float(reference_shadow_m(np.array(column * tile.column_spacing_m), np.array(altitude_m)))
    return np.asarray((along_m < reach_m) & (across_m > -reach_m) & (across_m < reach_m + shadow_m))
