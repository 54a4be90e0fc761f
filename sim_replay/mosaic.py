"""Blend the tiles of a mission into a mosaic in longitude and latitude, in bounded memory.

The mosaic is a plane of square blocks of pixels, made as tiles come. Each pixel keeps three sums: of weights, of
weighted intensity and of the weighted variance of its position. Sums make what comes after exact: blending does not
depend on the order of tiles but for rounding, and four pixels make one of half the resolution.
"""

from __future__ import annotations

import math
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import IO, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.contacts.contact_picture import CEILING_DB, FLOOR_DB
from auv_mcm.geometry.geodesy import SEMI_MAJOR_M, wrap_longitude_deg
from auv_mcm.geometry.georeference import locate, position_covariance, tile_echoes
from auv_mcm.records import LOW_RESOLUTION, TURN, VALID, Tile
from auv_mcm.settings.config import Config
from sim_replay.projections import Projection, projection

WGS84: Final = 4326  # EPSG code of longitude and latitude
BLOCK: Final = 256  # pixels along a side of a block, which is also a tile of the GeoTIFF
ECHO_STEP_DB: Final = (CEILING_DB - FLOOR_DB) / 254.0  # dB per step of the echo's byte; display only
SIGMA_STEP_M: Final = 0.1  # m per step of the byte of position error: up to 25.5 m

_LOW_RESOLUTION_WEIGHT: Final = 0.05  # of a pixel near nadir or at a flat angle, where another pass may see better
_TURN_WEIGHT: Final = 0.01  # of a pixel in a turn: shown where nothing else was seen
_FADED_WEIGHT: Final = 0.01  # of a pixel right below the vehicle where it is faded: any other pass hides it. Chosen
_FAR_WEIGHT: Final = 0.02  # at the swath's edge, falling from 1 below the vehicle: no step where swaths end
_SHARPNESS: Final = 2.0  # power of that fall: the nearer of two passes wins but for a border a few metres wide
_SAMPLES_PER_PIXEL: Final = 1.5  # samples per pixel of the mosaic, at which none stays empty between two pings
_MAX_REPEATS: Final = 8  # a row drawn more often than this belongs to a turn
_MAX_ROWS: Final = 64  # of the mosaic placed at once, which bounds memory: a tile has some 400 rows
_MAX_SPREAD: Final = 1 << 24  # pixels of an outline drawn at once; longer ones are divided along the track
_COVARIANCE_ROWS: Final = 16  # rows between those of which the error is computed: it changes with the attitude

Blend: TypeAlias = Literal["mean", "nearest", "max", "last"]
"""Which of several passes over a place is shown: all of them by weight, the one that sees best, the brightest, or the
last one. All but the first keep a shadow that another pass does not see."""
Key: TypeAlias = tuple[int, int]
Sums: TypeAlias = NDArray[np.float32]
"""(2 or 3, BLOCK, BLOCK): weight, weighted intensity and, with errors, weighted variance in m^2."""


class Box(NamedTuple):
    """Hold the outline of a picture, degrees. East may be beyond 180 where the mosaic crosses the antimeridian."""

    west: float
    south: float
    east: float
    north: float


class Blocks:
    """Keep the blocks of one resolution, of which no more than `max_in_memory` lie in memory.

    The others lie in an unnamed file. A key is column and row of a block; columns grow to the east, rows to the south.
    Iterating yields the keys of the blocks that hold anything.
    """

    def __init__(self, max_in_memory: int, n_sums: int = 3) -> None:
        self._max_in_memory = max_in_memory
        self._shape = n_sums, BLOCK, BLOCK
        self._cache: OrderedDict[Key, Sums] = OrderedDict()
        self._slots: dict[Key, int] = {}
        self._file: IO[bytes] | None = None

    def __iter__(self) -> Iterator[Key]:
        return iter(sorted({*self._cache, *self._slots}))

    def __len__(self) -> int:
        return len(self._cache.keys() | self._slots.keys())

    def get(self, key: Key) -> Sums | None:
        """Return the sums of a block, None where nothing was drawn. Those of the last few calls may be changed."""
        found = self._cache.get(key)
        if found is not None:
            self._cache.move_to_end(key)
            return found
        slot = self._slots.get(key)
        if slot is None or self._file is None:
            return None
        self._file.seek(slot * self._n_bytes)
        sums = np.frombuffer(self._file.read(self._n_bytes), dtype=np.float32).reshape(self._shape).copy()
        self._keep(key, sums)
        return sums

    def made(self, key: Key) -> Sums:
        """Return the sums of a block, made if nothing was drawn there yet."""
        sums = self.get(key)
        if sums is None:
            sums = np.zeros(self._shape, dtype=np.float32)
            self._keep(key, sums)
        return sums

    def coarser(self) -> Blocks:
        """Add up four pixels to one, in blocks of half the resolution."""
        n_sums = self._shape[0]
        coarse = Blocks(self._max_in_memory, n_sums)
        for key in self:
            sums = self.get(key)
            assert sums is not None
            half = sums.reshape(n_sums, BLOCK // 2, 2, BLOCK // 2, 2).sum(axis=(2, 4))
            right, down = ((part & 1) * (BLOCK // 2) for part in key)
            into = coarse.made((key[0] >> 1, key[1] >> 1))
            into[:, down : down + BLOCK // 2, right : right + BLOCK // 2] = half
        return coarse

    def moved(self, columns: int, rows: int) -> Blocks:
        """Number the blocks anew, so that block (columns, rows) becomes (0, 0)."""
        self._cache = OrderedDict(((x - columns, y - rows), sums) for (x, y), sums in self._cache.items())
        self._slots = {(x - columns, y - rows): slot for (x, y), slot in self._slots.items()}
        return self

    def _keep(self, key: Key, sums: Sums) -> None:
        self._cache[key] = sums
        if len(self._cache) <= self._max_in_memory:
            return
        old, evicted = self._cache.popitem(last=False)
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115  # it lives as long as the blocks
            weakref.finalize(self, self._file.close)
        slot = self._slots.setdefault(old, len(self._slots))
        self._file.seek(slot * self._n_bytes)
        self._file.write(evicted.tobytes())

    @property
    def _n_bytes(self) -> int:
        return 4 * math.prod(self._shape)


class Mosaic:
    """Draw tiles into blocks of longitude and latitude; pixels are square in metres where the mission began.

    With `coarsen` the mosaic keeps to `max_blocks` by halving its resolution; else blocks beyond them lie in a file.

    resolution_m: of a pixel, at first. blend: of several passes. crs: "" for longitude and latitude, otherwise as of
    `sim_replay.projections`. nadir_share, fade_share: of the altitude, within which of the track nothing is drawn, and
    within which the picture fades into the level of the floor around and into other passes. errors: draw the errors of
    positions too, which take half of the time. Raises ValueError for a pixel that is not positive.
    """

    def __init__(
        self,
        config: Config,
        resolution_m: float,
        max_blocks: int = 64,
        *,
        coarsen: bool = False,
        blend: Blend = "mean",
        crs: str = "",
        nadir_share: float = 0.0,
        fade_share: float = 0.0,
        errors: bool = True,
    ) -> None:
        if not resolution_m > 0.0:
            raise ValueError(f"a pixel of {resolution_m} m is no size")
        self._config = config
        self._asked_m = self.resolution_m = resolution_m
        self._max_blocks = max_blocks
        self._coarsen, self._n_sums = coarsen, 3 if errors else 2
        self._blend, self._crs, self._nadir = blend, crs, (nadir_share, fade_share)
        self._projection: Projection | None = None
        self._blocks = Blocks(2 * max_blocks if coarsen else max_blocks, self._n_sums)
        self._origin_deg: tuple[float, float] | None = None  # longitude, latitude
        self._step_deg = (math.nan, math.nan)

    @property
    def is_empty(self) -> bool:
        """Check whether nothing was drawn."""
        return not len(self._blocks)

    @property
    def crs(self) -> str:
        """Name the reference system as asked for; its code as soon as anything is drawn."""
        return self._crs if self._projection is None else f"EPSG:{self._projection.epsg}"

    def add(self, tile: Tile) -> None:
        """Draw the core of a tile. Rows whose position is not known are left out."""
        known = np.flatnonzero(
            np.isfinite(tile.pose.latitude_deg) & np.isfinite(tile.pose.longitude_deg) & ~tile.pose.stale
        )
        known = known[(known >= tile.core_start) & (known < tile.core_stop)]
        if not len(known):
            return
        if self._origin_deg is None:
            self._begin(float(tile.pose.longitude_deg[known[0]]), float(tile.pose.latitude_deg[known[0]]))
        for first, stop in _stretches(known, _MAX_ROWS * _n_together(tile.row_spacing_m, self.resolution_m)):
            placed = _placed(tile, first, stop, self._config, self.resolution_m, self._nadir, self._n_sums > 2)
            if placed.weight.size:
                self._draw(placed)
        while self._coarsen and len(self._blocks) > self._max_blocks:
            self._blocks = self._blocks.coarser()
            self.resolution_m *= 2.0
            self._step_deg = self._step_deg[0] * 2.0, self._step_deg[1] * 2.0

    def levels(self, max_levels: int = 12) -> Iterator[Level]:
        """Give the mosaic and then, each half as fine as the one before, its overviews, until one is a block.

        The mosaic is used up.
        """
        blocks, step_deg = self._blocks, self._step_deg
        if self._origin_deg is None or not len(blocks):
            return
        keys = list(blocks)
        column, row = min(x for x, _ in keys), min(y for _, y in keys)
        n_columns, n_rows = max(x for x, _ in keys) - column + 1, max(y for _, y in keys) - row + 1
        west = self._origin_deg[0] + column * BLOCK * step_deg[0]
        north = self._origin_deg[1] - row * BLOCK * step_deg[1]
        blocks = blocks.moved(column, row)
        width, height = n_columns * BLOCK, n_rows * BLOCK
        for number in range(max_levels):
            epsg = WGS84 if self._projection is None else self._projection.epsg
            yield Level(blocks, width, height, west, north, step_deg, self.resolution_m * 2.0**number, epsg)
            if width <= BLOCK and height <= BLOCK:
                return
            blocks = blocks.coarser()
            width, height = -(-width // 2), -(-height // 2)
            step_deg = step_deg[0] * 2.0, step_deg[1] * 2.0

    def _begin(self, longitude_deg: float, latitude_deg: float) -> None:
        if self._crs:
            self._projection = projection(self._crs, longitude_deg, latitude_deg)
            east_m, north_m = self._projection.project(np.array([longitude_deg]), np.array([latitude_deg]))
            # On whole pixels, so that mosaics of several missions fit one another.
            east, north = (float(np.round(at_m[0] / self._asked_m)) * self._asked_m for at_m in (east_m, north_m))
            self._origin_deg = east, north
            self._step_deg = self._asked_m, self._asked_m
            return
        self._origin_deg = longitude_deg, latitude_deg
        degrees_per_m = 180.0 / (math.pi * SEMI_MAJOR_M)
        narrowing = max(math.cos(math.radians(latitude_deg)), 1e-3)  # a pixel at a pole is as wide as one near it
        self._step_deg = self._asked_m * degrees_per_m / narrowing, self._asked_m * degrees_per_m

    def _draw(self, placed: _Placed) -> None:
        """Add pixels to the blocks, piece by piece where the outline of all would be too large."""
        assert self._origin_deg is not None
        if self._projection is None:
            right = wrap_longitude_deg(placed.longitude_deg - self._origin_deg[0])
            down = self._origin_deg[1] - placed.latitude_deg
        else:
            east_m, north_m = self._projection.project(placed.longitude_deg, placed.latitude_deg)
            right, down = east_m - self._origin_deg[0], self._origin_deg[1] - north_m
        for pixels, step_deg in zip((right, down), self._step_deg, strict=True):  # in place: fresh memory is dear
            pixels /= step_deg
            np.floor(pixels, out=pixels)
        left, top = int(right.min()), int(down.min())
        width, height = int(right.max()) - left + 1, int(down.max()) - top + 1
        n_rows = len(right)
        if width * height > _MAX_SPREAD and n_rows > 1:
            self._draw(placed.part(slice(0, n_rows // 2)))
            self._draw(placed.part(slice(n_rows // 2, n_rows)))
            return
        down *= width
        down += right
        down -= top * width + left
        index = down.ravel().astype(np.intp)
        variance = [placed.weight * placed.variance_m2] if self._n_sums > 2 else []
        sums = np.zeros((self._n_sums, height, width), dtype=np.float32)
        for number, values in enumerate((placed.weight, placed.weighted, *variance)):
            sums[number] = np.bincount(index, values.ravel(), width * height).reshape(height, width)
        drawn = sums[0] > 0.0
        for block_row in range(top // BLOCK, (top + height - 1) // BLOCK + 1):
            for block_column in range(left // BLOCK, (left + width - 1) // BLOCK + 1):
                of_sums = (
                    slice(max(block_row * BLOCK - top, 0), (block_row + 1) * BLOCK - top),
                    slice(max(block_column * BLOCK - left, 0), (block_column + 1) * BLOCK - left),
                )
                if not drawn[of_sums].any():
                    continue
                part = sums[:, *of_sums]
                at = top + of_sums[0].start - block_row * BLOCK, left + of_sums[1].start - block_column * BLOCK
                block = self._blocks.made((block_column, block_row))
                _blend_in(block[:, at[0] : at[0] + part.shape[1], at[1] : at[1] + part.shape[2]], part, self._blend)


def _blend_in(held: Sums, part: Sums, blend: Blend) -> None:
    """Put what one stretch of a pass saw into what is held already, in place. Both (2 or 3, n, m)."""
    if blend == "mean":
        held += part
        return
    wins = part[0] > 0.0
    if blend == "nearest":
        wins &= part[0] > held[0]
    elif blend == "max":
        level, before = (sums[1] / np.maximum(sums[0], np.float32(1e-30)) for sums in (part, held))
        wins &= (held[0] == 0.0) | (level > before)
    held[:, wins] = part[:, wins]


class Level(NamedTuple):
    """Hold the mosaic at one resolution. Pixel (0, 0) is at the north-western corner; sizes are in pixels.

    epsg: code of the reference system; of a projected one, what is called degrees here is metres.
    """

    blocks: Blocks
    width: int
    height: int
    west_deg: float
    north_deg: float
    step_deg: tuple[float, float]
    resolution_m: float
    epsg: int = WGS84

    def bytes_of(self, key: Key, max_sigma_m: float = math.inf) -> NDArray[np.uint8] | None:
        """Draw a block: (BLOCK, BLOCK, 2) uint8 of echo and position error, 0 where nothing was seen.

        None for an empty block. max_sigma_m: what is placed worse than this is left out.
        """
        sums = self.blocks.get(key)
        return None if sums is None else _as_bytes(sums, max_sigma_m)

    def picture(self, max_sigma_m: float = math.inf) -> tuple[NDArray[np.uint8], Box]:
        """Draw all at once, without empty margins: (height, width, 2) uint8 as of `bytes_of`, and its outline."""
        whole = np.zeros((self.height, self.width, 2), dtype=np.uint8)
        for column, row in self.blocks:
            drawn = self.bytes_of((column, row), max_sigma_m)
            top, left = row * BLOCK, column * BLOCK
            if drawn is not None and top < self.height and left < self.width:
                part = whole[top : top + BLOCK, left : left + BLOCK]
                part[:] = drawn[: part.shape[0], : part.shape[1]]
        seen = whole[:, :, 0] > 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            return whole[:0, :0], self.box(0, 0, 0, 0)
        top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
        return whole[top:bottom, left:right], self.box(left, top, right, bottom)

    def box(self, left: float, top: float, right: float, bottom: float) -> Box:
        """Give the outline of a rectangle of pixels."""
        return Box(
            west=self.west_deg + left * self.step_deg[0],
            south=self.north_deg - bottom * self.step_deg[1],
            east=self.west_deg + right * self.step_deg[0],
            north=self.north_deg - top * self.step_deg[1],
        )


class _Placed(NamedTuple):
    """Hold pixels of a stretch of rows with their places; every array (n_rows, n_columns) float64."""

    longitude_deg: NDArray[np.float64]
    latitude_deg: NDArray[np.float64]
    weight: NDArray[np.float64]
    weighted: NDArray[np.float64]
    variance_m2: NDArray[np.float64]

    def part(self, rows: slice) -> _Placed:
        return _Placed(*(values[rows] for values in self))


def _stretches(numbers: NDArray[np.intp], n_most: int) -> list[tuple[int, int]]:
    """Find stretches [first, stop) of at most n_most numbers that follow one another."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    pieces = [run[first : first + n_most] for run in runs for first in range(0, len(run), n_most)]
    return [(int(piece[0]), int(piece[-1]) + 1) for piece in pieces]


def _n_together(spacing_m: float, resolution_m: float) -> int:
    """Count the samples that become one where they are much finer than the mosaic."""
    return max(1, int(resolution_m / spacing_m / _SAMPLES_PER_PIXEL))


def _placed(
    tile: Tile, first: int, stop: int, config: Config, resolution_m: float, nadir: tuple[float, float], errors: bool
) -> _Placed:
    """Weigh the pixels of some rows and place them; several become one where they are much finer than the mosaic."""
    n_together = [_n_together(spacing_m, resolution_m) for spacing_m in (tile.row_spacing_m, tile.column_spacing_m)]
    weight, weighted = _weighed(tile, first, stop, n_together)
    n_rows, n_columns = weight.shape
    ground_m = (np.arange(n_columns, dtype=np.float64) + 0.5) * n_together[1] * tile.column_spacing_m
    centre = first + (np.arange(n_rows, dtype=np.float64) + 0.5) * n_together[0] - 0.5
    far_m = tile.intensity.shape[1] * tile.column_spacing_m
    spread_m = _row_distance_m(tile, centre, far_m, config)
    repeats = [
        min(_MAX_REPEATS, max(1, math.ceil(_SAMPLES_PER_PIXEL * spacing_m / resolution_m)))
        for spacing_m in (spread_m, n_together[1] * tile.column_spacing_m)
    ]
    if repeats[0] > 1:
        within = (np.arange(repeats[0], dtype=np.float64) + 0.5) / repeats[0] - 0.5
        centre = (centre[:, np.newaxis] + n_together[0] * within).ravel()
        weight, weighted = (np.repeat(values / repeats[0], repeats[0], axis=0) for values in (weight, weighted))
    if repeats[1] > 1:
        within_m = (
            ((np.arange(repeats[1], dtype=np.float64) + 0.5) / repeats[1] - 0.5) * n_together[1] * tile.column_spacing_m
        )
        ground_m = (ground_m[:, np.newaxis] + within_m).ravel()
        weight, weighted = (np.repeat(values / repeats[1], repeats[1], axis=1) for values in (weight, weighted))
    if any(nadir):
        weight, weighted = _without_nadir(tile, centre, ground_m, nadir, weight, weighted)
    nearest = tile_echoes(tile, centre, 0.0)
    farthest = structs.replace(nearest, slant_range_m=np.hypot(far_m, nearest.first_return_m))
    near, far = (locate(echoes, config.sonar)[:2] for echoes in (nearest, farthest))
    share = ground_m / far_m  # over a flat bottom places lie evenly along a ping
    longitude_deg = np.multiply.outer(wrap_longitude_deg(far[1] - near[1]), share)
    longitude_deg += near[1][:, np.newaxis]
    latitude_deg = np.multiply.outer(far[0] - near[0], share)
    latitude_deg += near[0][:, np.newaxis]
    variance_m2 = _variance_m2(tile, centre, ground_m, config) if errors else np.broadcast_to(0.0, weight.shape)
    placed = _Placed(longitude_deg, latitude_deg, weight, weighted, variance_m2)
    known = np.isfinite([*near, *far]).all(axis=0)
    return placed if known.all() else _Placed(*(values[known] for values in placed))


def _without_nadir(
    tile: Tile,
    centre: NDArray[np.float64],
    ground_m: NDArray[np.float64],
    nadir: tuple[float, float],
    weight: NDArray[np.float64],
    weighted: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mask pixels nearer to the track than the first share of the altitude; fade those nearer than the second."""
    altitude_m = np.interp(np.clip(centre, 0.0, len(tile.pose) - 1.0), np.arange(len(tile.pose)), tile.first_return_m)
    share = ground_m / np.maximum(altitude_m, 1e-3)[:, np.newaxis]
    kept = np.minimum(share / nadir[1], 1.0) if nadir[1] else np.ones_like(share)
    seen = np.maximum(kept, _FADED_WEIGHT) * (share >= nadir[0])
    return weight * seen, (weighted * kept + weight * (1.0 - kept)) * seen  # the floor around is 1, by definition


def _weighed(
    tile: Tile, first: int, stop: int, n_together: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sum weights and weighted intensity over groups of pixels; the last groups may be cut short."""
    mask, intensity = tile.mask[first:stop], tile.intensity[first:stop]
    weight = ((mask & VALID) != 0).astype(np.float32)
    weight[(mask & LOW_RESOLUTION) != 0] *= np.float32(_LOW_RESOLUTION_WEIGHT)
    weight[(mask & TURN) != 0] *= np.float32(_TURN_WEIGHT)
    n_columns = mask.shape[1]
    fall = np.linspace(1.0, _FAR_WEIGHT ** (1.0 / _SHARPNESS), n_columns, dtype=np.float32) ** np.float32(_SHARPNESS)
    weight *= fall
    weighted = weight * intensity
    if tuple(n_together) != (1, 1):
        weight, weighted = (_summed(values, *n_together) for values in (weight, weighted))
    return weight.astype(np.float64), weighted.astype(np.float64)


def _summed(values: NDArray[np.float32], n_rows: int, n_columns: int) -> NDArray[np.float32]:
    """Sum groups of n_rows x n_columns values, across first; the last ones may be cut short."""
    padded = np.pad(values, ((0, -values.shape[0] % n_rows), (0, -values.shape[1] % n_columns)))
    across = reduce(np.add, (padded[:, first::n_columns] for first in range(n_columns)))
    return np.asarray(reduce(np.add, (across[first::n_rows] for first in range(n_rows))))


def _row_distance_m(tile: Tile, centre: NDArray[np.float64], far_m: float, config: Config) -> float:
    """Compute how far apart rows lie at the far end, m: more than their spacing where the vehicle turns."""
    spacing_m = tile.row_spacing_m * (centre[1] - centre[0] if len(centre) > 1 else 1.0)
    known = np.flatnonzero(np.isfinite(tile.pose.heading_rad))
    if not len(known):
        return spacing_m
    heading_rad = np.interp(centre, known, tile.pose.heading_rad[known])
    turned_m = far_m * np.abs(np.diff(heading_rad))
    return float(spacing_m + np.max(turned_m, initial=0.0))


def _variance_m2(
    tile: Tile, centre: NDArray[np.float64], ground_m: NDArray[np.float64], config: Config
) -> NDArray[np.float64]:
    """Compute the variance of places along the worst axis, m^2, between a few rows and ranges of which it is known."""
    rows = centre[:: max(1, len(centre) * _COVARIANCE_ROWS // max(int(centre[-1] - centre[0]), 1))]
    ranges_m = np.array([0.0, 0.5, 1.0]) * ground_m[-1]
    few = []
    for distance_m in ranges_m:
        echoes = tile_echoes(tile, rows, float(distance_m))
        sigma_m = np.interp(rows, np.arange(len(tile.pose)), tile.first_return_sigma_m)
        covariance = position_covariance(echoes, config.sonar, config.navigation, sigma_m)
        few.append(np.linalg.eigvalsh(covariance)[:, -1] + echoes.pose.position_sigma_m**2)
    known = np.isfinite(few).all(axis=0)
    if not known.any():
        return np.full((len(centre), len(ground_m)), np.nan)
    across = np.stack([np.interp(ground_m, ranges_m, row) for row in np.stack(few, axis=1)[known]])
    shares = np.stack([np.interp(centre, rows[known], one) for one in np.eye(len(across))], axis=1)
    return np.asarray(np.maximum(shares @ across, 0.0))


def _as_bytes(sums: Sums, max_sigma_m: float) -> NDArray[np.uint8]:
    weight, weighted, *variance = sums
    seen = weight > 0.0
    safe = np.where(seen, weight, np.float32(1.0))
    level_db = 10.0 * np.log10(np.maximum(weighted / safe, np.float32(1e-6)))
    echo = np.clip(np.round((level_db - FLOOR_DB) / ECHO_STEP_DB) + 1.0, 1.0, 255.0)
    sigma_m = np.sqrt(variance[0] / safe) if variance else np.zeros_like(safe)
    seen &= sigma_m <= max_sigma_m
    error = np.clip(np.round(sigma_m / SIGMA_STEP_M), 1.0, 255.0)
    return np.stack([np.where(seen, value, 0.0) for value in (echo, error)], axis=-1).astype(np.uint8)
