"""Highlights on real side-scan tiles with a known object, and false confirmations on real images without one.

auv-mcm bench images --data FOLDER [--sheets FOLDER]

FOLDER holds `sdvd_20240429`, side-scan tiles with masks of an effigy's highlight (Jaszcz et al. 2024), and `sas`, synthetic-aperture
snippets of bare sea floor (NSWC PCD). Both are 8-bit pictures without scale or geometry: what the chain needs to know of them is assumed
here, and varied where it could matter.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import MineOdds, shipped_odds
from auv_mcm.classify.stage import labels_near, look_closely, region_of
from auv_mcm.config import Config
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import HIGHLIGHT, Region
from auv_mcm.confirm.snake import FINE, Nodes, converge, start_from_detection, start_from_labels
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.detect.measure import ROWS_M
from auv_mcm.detect.stage import detect_tile
from auv_mcm.detect.suppress import Suppressor
from auv_mcm.errors import BadInputError
from auv_mcm.geodesy import LocalFrame
from auv_mcm.records import SATURATED, VALID, Detection, EchoTrace, PoseTrack, Tile
from auv_mcm.waterfall.radiometry import AngleCurve, local_mean
from auv_mcm.waterfall.transfer import SpeckleEvidence, speckle_evidence
from sim_replay.benches.snakes import mask_of, overlap

Mask = NDArray[np.bool_]
Plane = NDArray[np.float64]
Counts = NDArray[np.uint8]

EFFIGY_M: Final = 1.8
CALLED: Final = (0.5, 0.2)
"""p_mine from which a detection counts as a call."""
FALSE_CALLS: Final = (0.1, 0.2, 0.5, 1.0)
"""Per picture without the object, at which the share of objects called is compared."""
OTHER_SCALES_M: Final = (0.024, 0.042)
SAS_SCALES_M: Final = (0.025, 0.05)

_BRIGHTEST: Final = 255
_INVERTED_SKEWNESS: Final = -0.2
_INVERTED_SPREAD: Final = 0.2
_LEAST_FILL_PX: Final = 600
_TICK_PX: Final = 8
_LABEL_PX: Final = (66, 10)  # rows above a tick's end, columns beside it
_DARK_M: Final = 1.0
_DARK: Final = 0.04  # of the median: the water column
_NEAR_M: Final = 0.5  # from the mask, for a detection to be of the object
_SNAKE_NODES: Final = max(nodes for nodes, _, _ in FINE)
_CONTRASTS_DB: Final = (-math.inf, 3.0, 5.0, 7.0, math.inf)
_AROUND_PX: Final = 41
_ACROSS_M: Final = (3.0, 8.0)  # before and behind the place looked at
_SMOOTHED_PX: Final = 3
_AROUND_M: Final = 0.3
_SPEED_MPS: Final = 1.5


class Geometry(NamedTuple):
    """What is assumed of a picture: pixel size, slant range of the first bottom return, ground range of the near edge."""

    pixel_m: float
    first_return_m: float
    first_ground_range_m: float
    beam_width_deg: float

    @property
    def n_columns_before(self) -> int:
        """Columns of the ground-range grid before the picture."""
        return round(self.first_ground_range_m / self.pixel_m)


SIDE_SCAN: Final = Geometry(pixel_m=0.032, first_return_m=4.0, first_ground_range_m=5.0, beam_width_deg=0.3)
SAS: Final = Geometry(pixel_m=0.025, first_return_m=8.0, first_ground_range_m=30.0, beam_width_deg=0.01)


class Picture(NamedTuple):
    """A recorded picture, range growing to the right.

    amplitude: (n_rows, n_columns) float64. measured: same shape bool, False under marks, fill and water column. clipped: bool. mask: of
    the object's highlight, None without an object. inverted: recorded with bright and dark exchanged.
    """

    name: str
    counts: Counts
    amplitude: Plane
    measured: Mask
    clipped: Mask
    mask: Mask | None
    inverted: bool

    @property
    def cut(self) -> bool:
        """Whether the object leaves the picture."""
        assert self.mask is not None
        return bool(self.mask[[0, -1]].any() or self.mask[:, [0, -1]].any())


class Overlaps(NamedTuple):
    """Intersection over union with the mask: of all highlight labels of a region, of the connected ones at the place looked at, of the
    snake started at that place, of the one started from those labels, and of whichever of the two has the lower criterion."""

    labels: float
    own_labels: float
    snake: float
    snake_from_labels: float
    best_start: float


class Placed(NamedTuple):
    """A region and its first row and column in the tile."""

    region: Region
    corner: tuple[int, int]


class Outlined(NamedTuple):
    """Highlight of a region. labels: same shape bool, the object's own. contour: (n, 2) float64 nodes of the best snake."""

    placed: Placed
    labels: Mask
    contour: Nodes
    iou: Overlaps


class Judged(NamedTuple):
    """One picture of the object.

    detected: some detection is near the mask. first: that is the one of highest p_mine. given, found: with the mask's centre and with
    the best detection near the mask as the place to look; found is None if there is none. looked_at: that detection before and after the
    close look. best_threshold: of any threshold on smoothed
    intensity with the mask. one_pixel: of the mask with itself grown by a pixel. few_nodes: with its outline by 16 nodes. contrast_db:
    mean intensity inside the mask over that around it.
    """

    picture: Picture
    geometry: Geometry
    detected: bool
    first: bool
    given: Outlined
    found: Outlined | None
    looked_at: tuple[Detection, Detection] | None
    best_threshold: float
    one_pixel: float
    few_nodes: float
    contrast_db: float


class Called(NamedTuple):
    """One picture without the object: calls per threshold of CALLED, by the detector alone and after the close look."""

    picture: Picture
    geometry: Geometry
    detections: tuple[Detection, ...]
    looked_at: tuple[Detection, ...]

    def n_detector(self, threshold: float) -> int:
        return sum(d.p_mine >= threshold for d in self.detections)

    def n_confirmed(self, threshold: float) -> int:
        return sum(is_call(d, threshold) for d in self.looked_at)


def is_call(detection: Detection, threshold: float) -> bool:
    """Whether a detection that was looked at is called mine-like and its contours do not speak against it."""
    return detection.p_mine >= threshold and not (detection.confirmation is not None and detection.confirmation.rejected)


def read_picture(path: Path, *, mask_path: Path | None = None, mirrored: bool = False) -> Picture:
    """Read an 8-bit picture; mirrored for one whose range grows to the left. Raises BadInputError naming the file."""
    counts, mask = _gray(path), None
    if mask_path is not None:
        mask = _gray(mask_path) > _BRIGHTEST // 2
        if mask.shape != counts.shape:
            raise BadInputError(f"{mask_path}: the mask is {mask.shape}, the picture {counts.shape}; they must be alike")
    if mirrored:
        counts = np.ascontiguousarray(counts[:, ::-1])
        mask = None if mask is None else np.ascontiguousarray(mask[:, ::-1])
    measured = ~(_fill(counts) | _range_marks(counts))
    evidence = evidence_of(counts)
    inverted = evidence.skewness < _INVERTED_SKEWNESS and evidence.relative_std < _INVERTED_SPREAD
    amplitude = (_BRIGHTEST - counts if inverted else counts).astype(np.float64)
    return Picture(path.stem, counts, amplitude, measured, amplitude >= _BRIGHTEST, mask, inverted)


def evidence_of(counts: NDArray[np.generic]) -> SpeckleEvidence:
    """Speckle statistics of a picture (n_rows, n_columns), each row as a trace."""
    return speckle_evidence([EchoTrace(samples=row, first_range_m=0.0, spacing_m=1.0) for row in counts])


def _gray(path: Path) -> Counts:
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if picture is None:
        raise BadInputError(f"{path}: no picture that can be read; give the folder with sdvd_20240429 and sas as --data")
    return np.asarray(picture, dtype=np.uint8)


def _fill(counts: Counts) -> Mask:
    """Large areas of zeros: where the tile goes beyond the recording."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats((counts == 0).astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_FILL_PX
    large[0] = False
    return np.asarray(large[parts])


def _range_marks(counts: Counts) -> Mask:
    """Ticks of the range scale, white between black, with the black label above them; and the transmit pulse, which looks like one."""
    wide = np.pad(counts.astype(np.int64), ((0, 0), (2, 2)), mode="edge")
    tick = (wide[:, 2:-2] > 180) & (wide[:, :-4] < 70) & (wide[:, 4:] < 70)
    long = cv2.erode(tick.astype(np.uint8), np.ones((_TICK_PX, 1), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    above, beside = _LABEL_PX
    marked = np.zeros(counts.shape, dtype=np.bool_)
    for row, column in np.argwhere(long).tolist():
        marked[max(row - above, 0) : row + _TICK_PX, max(column - beside, 0) : column + beside + 1] = True
    return marked


def tile_of(picture: Picture, geometry: Geometry) -> Tile:
    """The picture as the chain would hand it to the detector: the angle response and the local mean taken off, in ground range.

    Columns before the picture's near edge are not valid. The track runs north at constant speed.
    """
    n_rows, n_columns = picture.counts.shape
    offset = geometry.n_columns_before
    intensity = np.maximum(picture.amplitude, 0.5) ** 2
    measured = picture.measured & ~_dark_stretches(intensity, picture.measured, geometry.pixel_m)
    ground_m = geometry.first_ground_range_m + (np.arange(n_columns) + 0.5) * geometry.pixel_m
    tangent = np.broadcast_to(geometry.first_return_m / ground_m, intensity.shape)
    log_intensity = np.log(intensity)
    log_intensity -= AngleCurve().learn(log_intensity, measured, tangent)
    levelled = np.where(measured, np.exp(log_intensity), 0.0).astype(np.float32)
    mean, known = local_mean(levelled, measured, geometry.pixel_m, geometry.pixel_m)
    valid = measured & known
    shape = n_rows, offset + n_columns
    plane, bits = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.uint8)
    plane[:, offset:] = np.where(valid, levelled / np.maximum(mean, 1e-9), 0.0)
    bits[:, offset:] = np.where(valid, VALID, 0) | np.where(valid & picture.clipped, SATURATED, 0)
    return Tile(
        side="starboard",
        index=0,
        first_row=0,
        core_start=0,
        core_stop=n_rows,
        row_spacing_m=geometry.pixel_m,
        column_spacing_m=geometry.pixel_m,
        intensity=plane,
        mask=bits,
        pose=_northward(n_rows, geometry),
        first_return_m=np.full(n_rows, geometry.first_return_m),
        first_return_sigma_m=np.full(n_rows, 0.05 * geometry.first_return_m),
        ping_number=np.arange(n_rows, dtype=np.int64),
    )


def _dark_stretches(intensity: Plane, measured: Mask, pixel_m: float) -> Mask:
    """The water column: metres without echo. Shadows of wrecks go with it."""
    side = 2 * round(0.5 * _DARK_M / pixel_m) + 1
    total = cv2.boxFilter(np.where(measured, intensity, 0.0), -1, (side, side), normalize=True, borderType=cv2.BORDER_REFLECT)
    share = cv2.boxFilter(measured.astype(np.float64), -1, (side, side), normalize=True, borderType=cv2.BORDER_REFLECT)
    level = float(np.median(intensity[measured])) if measured.any() else 1.0
    bright = float(np.quantile(intensity[measured], 0.75)) if measured.any() else 1.0
    return np.asarray(total < _DARK * max(level, 0.5 * bright) * np.maximum(share, 1e-6))


def _northward(n_rows: int, geometry: Geometry) -> PoseTrack:
    along_m: Plane = (np.arange(n_rows, dtype=np.float64) + 0.5) * geometry.pixel_m
    none, even = np.zeros(n_rows), np.ones(n_rows)
    latitude, longitude, _ = LocalFrame(latitude_deg=45.0, longitude_deg=5.0).to_geodetic(np.stack((none, along_m, none), axis=-1))
    return PoseTrack(
        time_s=np.asarray(along_m / _SPEED_MPS, dtype=np.float64),
        latitude_deg=latitude,
        longitude_deg=longitude,
        depth_m=none,
        heading_rad=none,
        pitch_rad=none,
        roll_rad=none,
        speed_mps=_SPEED_MPS * even,
        altitude_m=geometry.first_return_m * even,
        stale=np.zeros(n_rows, dtype=np.bool_),
    )


def config_of(geometry: Geometry) -> Config:
    """The default configuration with the beam of the sonar that made the picture."""
    config = Config()
    return msgspec.structs.replace(config, sonar=msgspec.structs.replace(config.sonar, beam_width_deg=geometry.beam_width_deg))


def detections_of(tile: Tile, config: Config) -> list[Detection]:
    """What the detector and suppression leave of one tile."""
    suppressor = Suppressor(config.detect, Counter())
    settled = suppressor.add(detect_tile(tile, config).detections, math.inf)
    return [*settled, *suppressor.flush()]


def judge(picture: Picture, geometry: Geometry, odds: MineOdds) -> Judged:
    """Find and outline the object in a picture that has a mask."""
    assert picture.mask is not None
    tile, config = tile_of(picture, geometry), config_of(geometry)
    beam_width_rad = math.radians(geometry.beam_width_deg)
    mask = np.pad(picture.mask, ((0, 0), (geometry.n_columns_before, 0)))
    rows, columns = np.nonzero(mask)
    given = outline(cut_around(tile, float(rows.mean()) + 0.5, float(columns.mean()) + 0.5, beam_width_rad), mask)
    detections = sorted(detections_of(tile, config), key=lambda d: -d.p_mine)
    near = [d for d in detections if float(np.hypot(rows + 0.5 - d.row, columns + 0.5 - d.column).min()) * geometry.pixel_m <= _NEAR_M]
    found, looked_at = None, None
    if near and (surroundings := near[0].surroundings) is not None:
        corner = round(near[0].row - surroundings.row), round(near[0].column - surroundings.column)
        found = outline(Placed(region_of(near[0], surroundings, beam_width_rad), corner), mask)
        looked_at = near[0], look_closely(near[0], beam_width_rad, odds, config.confirm)
    valid = (tile.mask & VALID) != 0
    intensity = tile.intensity.astype(np.float64)
    grown, around = (cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0 for side in (3, _AROUND_PX))
    inside, outside = (float(intensity[part & valid].mean()) for part in (mask, around & ~grown))
    return Judged(
        picture=picture,
        geometry=geometry,
        detected=found is not None,
        first=bool(near) and near[0] is detections[0],
        given=given,
        found=found,
        looked_at=looked_at,
        best_threshold=best_threshold(intensity, mask, geometry.pixel_m),
        one_pixel=overlap(mask, grown),
        few_nodes=overlap(mask, with_few_nodes(mask)),
        contrast_db=10.0 * math.log10(inside / outside),
    )


def cut_around(tile: Tile, row: float, column: float, beam_width_rad: float) -> Placed:
    """What a detection at a place of the tile would be looked at in."""
    n_rows, n_columns = tile.mask.shape
    (before, after), reach = (round(away_m / tile.column_spacing_m) for away_m in _ACROSS_M), round(ROWS_M / tile.row_spacing_m)
    top, near = max(0, int(row) - reach), max(0, int(column) - before)
    part = slice(top, min(n_rows, int(row) + reach + 1)), slice(near, min(n_columns, int(column) + after + 1))
    region = Region(
        intensity=tile.intensity[part].astype(np.float64),
        valid=(tile.mask[part] & VALID) != 0,
        row_spacing_m=tile.row_spacing_m,
        column_spacing_m=tile.column_spacing_m,
        first_ground_range_m=near * tile.column_spacing_m,
        altitude_m=float(tile.first_return_m[int(row)]),
        row=row - top,
        column=column - near,
        beam_width_rad=beam_width_rad,
    )
    return Placed(region, (top, near))


def outline(placed: Placed, mask: Mask) -> Outlined:
    """Labels and contours of a region's object, as the close look makes them, beside a mask (n_rows, n_columns) of the whole tile."""
    region = placed.region
    area = grain_area(region.intensity, region.valid)
    labels = segment(region).labels
    own = labels_near(labels, region)
    snake = converge(region, start_from_detection(region), correlation_px=area)
    again = snake if own is None else converge(region, start_from_labels(region, own), correlation_px=area)
    best = again if again.criterion < snake.criterion else snake
    part = tuple(slice(corner, corner + size) for corner, size in zip(placed.corner, region.intensity.shape, strict=True))
    inside, n_mask = mask[part], int(mask.sum())

    def share(found: Mask) -> float:
        both = int((found & inside).sum())
        return both / (int(found.sum()) + n_mask - both)

    nothing = np.zeros(inside.shape, dtype=np.bool_)
    contours = [mask_of(c.highlight, inside.shape) if len(c.highlight) else nothing for c in (snake, again, best)]
    own_highlight = nothing if own is None else own == HIGHLIGHT
    return Outlined(
        placed=placed,
        labels=own_highlight,
        contour=best.highlight,
        iou=Overlaps(share(labels == HIGHLIGHT), share(own_highlight), *map(share, contours)),
    )


def best_threshold(intensity: Plane, mask: Mask, pixel_m: float) -> float:
    """Intersection over union of the mask with the best of all thresholds on the 3 x 3 mean, within a third of a metre of its box."""
    smooth = cv2.blur(intensity, (_SMOOTHED_PX, _SMOOTHED_PX))
    rows, columns = np.nonzero(mask)
    reach = round(_AROUND_M / pixel_m)
    part = slice(max(rows.min() - reach, 0), rows.max() + reach + 1), slice(max(columns.min() - reach, 0), columns.max() + reach + 1)
    levels = np.quantile(smooth[part], np.linspace(0.0, 1.0, 101))
    return max(overlap(smooth[part] >= level, mask[part]) for level in levels)


def with_few_nodes(mask: Mask) -> Mask:
    """The mask's largest part inside an outline of as many nodes as a snake has at most."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(outlines, key=len)
    coarse, tolerance_px = largest, 0.0
    while len(coarse) > _SNAKE_NODES:
        tolerance_px += 0.25
        coarse = cv2.approxPolyDP(largest, tolerance_px, closed=True)
    return cv2.fillPoly(np.zeros(mask.shape, dtype=np.uint8), [coarse], 1) > 0


def n_kept(of_object: Sequence[float], of_none: Sequence[float], n_false: int) -> int:
    """How many of the object's probabilities are above all but `n_false` of those of anything else."""
    ordered = sorted(of_none, reverse=True)
    least = ordered[n_false] if n_false < len(ordered) else -math.inf
    return sum(p > least for p in of_object)


def call(picture: Picture, geometry: Geometry, odds: MineOdds) -> Called:
    """What is called mine-like in a picture without the object."""
    tile, config = tile_of(picture, geometry), config_of(geometry)
    detections = detections_of(tile, config)
    beam_width_rad = math.radians(geometry.beam_width_deg)
    looked_at = tuple(look_closely(detection, beam_width_rad, odds, config.confirm) for detection in detections)
    return Called(picture, geometry, tuple(detections), looked_at)


def effigies(folder: Path) -> list[Picture]:
    """The side-scan tiles with a mask, range growing to the right. Raises BadInputError if there are none."""
    images = folder / "sdvd_20240429" / "images"
    return [
        read_picture(path, mask_path=images.parent / "masks" / path.name, mirrored=path.name.startswith("left_"))
        for path in _listed(images, ("left_*", "right_*"))
    ]


def clutter(folder: Path) -> list[Picture]:
    """The side-scan tiles without the object, each as recorded and mirrored: which side they are of is not told."""
    paths = _listed(folder / "sdvd_20240429" / "images", ("clutter_*",))
    return [read_picture(path, mirrored=mirrored) for path in paths for mirrored in (False, True)]


def snippets(folder: Path) -> list[Picture]:
    """The synthetic-aperture snippets."""
    return [read_picture(path) for path in _listed(folder / "sas", ("image_*",))]


def _listed(folder: Path, patterns: Sequence[str]) -> list[Path]:
    paths = sorted(path for pattern in patterns for path in folder.glob(pattern))
    if not paths:
        raise BadInputError(f"{folder} holds no {patterns[0]}: give the folder with sdvd_20240429 and sas as --data")
    return paths


def length_px(mask: Mask) -> float:
    """Greatest distance between two points of a mask."""
    hull = cv2.convexHull(np.argwhere(mask).astype(np.int32)).reshape(-1, 2).astype(np.float64)
    return float(np.linalg.norm(hull[:, None] - hull[None], axis=2).max()) + 1.0


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median, upper quartile."""
    lower, middle, upper = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    return lower, middle, upper


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `auv-mcm bench images`."""
    parser.add_argument("--data", type=Path, required=True, metavar="FOLDER", help="folder with sdvd_20240429 and sas")
    parser.add_argument("--sheets", type=Path, metavar="FOLDER", help="draw contact sheets there, too")


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code."""
    odds = shipped_odds()
    pictures = effigies(chosen.data)
    _print_pictures(pictures)
    judged = [judge(picture, SIDE_SCAN, odds) for picture in pictures]
    _print_overlaps(judged)
    _print_scales([picture for picture in pictures if not picture.cut], odds)
    by_tile = [call(picture, SIDE_SCAN, odds) for picture in clutter(chosen.data)]
    print("\nside-scan tiles without the object, each looked at from either side")
    _print_calls(by_tile)
    _print_kept(judged, by_tile)
    by_scale = []
    for pixel_m in SAS_SCALES_M:
        called = [call(picture, SAS._replace(pixel_m=pixel_m), odds) for picture in snippets(chosen.data)]
        print(f"\nsynthetic-aperture snippets, {100.0 * pixel_m:g} cm a pixel")
        _print_calls(called)
        by_scale.append(called)
    if chosen.sheets is not None:
        from sim_replay.benches.real_sheets import write_sheets

        for path in write_sheets(chosen.sheets, judged, by_scale[0]):
            print(f"written: {path}")
    return 0


def _print_pictures(pictures: Sequence[Picture]) -> None:
    whole = [length_px(picture.mask) for picture in pictures if picture.mask is not None and not picture.cut]
    lower, middle, upper = quartiles(whole)
    print(f"{len(pictures)} tiles with the object, {len(whole)} of them whole; {sum(p.inverted for p in pictures)} recorded inverted")
    print(f"whole masks are {lower:.0f}, {middle:.0f}, {upper:.0f} pixels long (quartiles): {100.0 * EFFIGY_M / middle:.1f} cm a pixel")
    evidence = [evidence_of(picture.amplitude) for picture in pictures]
    for name, part in (("skewness", [e.skewness for e in evidence]), ("deviation over mean", [e.relative_std for e in evidence])):
        print(f"speckle's {name} (quartiles): " + ", ".join(f"{value:.2f}" for value in quartiles(part)))


def _print_overlaps(judged: Sequence[Judged]) -> None:
    names = [name.replace("_", " ") for name in Overlaps._fields]
    heading = "".join(f"{name:>18}" for name in names)
    print(f"\n{'tile':<42}{'cut':>4}{'dB':>6}{'+1 px':>7}{'nodes':>7}{'thresh.':>9}{heading}{'found':>7}{'IoU':>6}")
    for one in sorted(judged, key=lambda j: -j.given.iou.best_start):
        found = "no" if one.found is None else "first" if one.first else "later"
        of_found = "-" if one.found is None else f"{one.found.iou.best_start:.2f}"
        limits = f"{one.contrast_db:>6.1f}{one.one_pixel:>7.2f}{one.few_nodes:>7.2f}{one.best_threshold:>9.2f}"
        values = "".join(f"{value:>18.2f}" for value in one.given.iou)
        print(f"{one.picture.name:<42}{'cut' if one.picture.cut else '':>4}{limits}{values}{found:>7}{of_found:>6}")
    _print_quartiles("whole", [j for j in judged if not j.picture.cut])
    _print_quartiles("cut off", [j for j in judged if j.picture.cut])
    print(f"\n{'contrast, dB':<18}{'tiles':>6}{'thresh.':>9}{heading}   medians, place given, whole and cut off")
    for low, high in pairwise(_CONTRASTS_DB):
        part = [j for j in judged if low <= j.contrast_db < high]
        values = "".join(f"{statistics.median(j.given.iou[k] for j in part):>18.2f}" for k in range(len(names)))
        print(f"{f'{low:g} to {high:g}':<18}{len(part):>6}{statistics.median(j.best_threshold for j in part):>9.2f}{values}")


def _print_quartiles(title: str, part: Sequence[Judged]) -> None:
    print(f"\n{title}: {len(part)} tiles, {sum(j.detected for j in part)} detected, {sum(j.first for j in part)} as the most mine-like")
    looked_at = [j.looked_at for j in part if j.looked_at is not None]
    for threshold in CALLED:
        alone, after = sum(one.p_mine >= threshold for one, _ in looked_at), sum(is_call(one, threshold) for _, one in looked_at)
        print(f"  called at {threshold:g}: {alone} by the detector alone, {after} after the close look")
    rejected = sum(one.confirmation is not None and one.confirmation.rejected for _, one in looked_at)
    print(f"  {sum(one.confirmation is not None for _, one in looked_at)} looked at closely, contours of {rejected} rejected")
    rows = [
        ("mask and a pixel more", [j.one_pixel for j in part]),
        ("mask by 16 nodes", [j.few_nodes for j in part]),
        ("best threshold", [j.best_threshold for j in part]),
    ]
    for k, name in enumerate(Overlaps._fields):
        rows.append((f"{name}, place given", [j.given.iou[k] for j in part]))
        rows.append((f"{name}, as detected", [j.found.iou[k] for j in part if j.found is not None]))
    for name, values in rows:
        print(f"  {name.replace('_', ' '):<36}" + "".join(f"{value:>7.2f}" for value in quartiles(values)))


def _print_scales(whole: Sequence[Picture], odds: MineOdds) -> None:
    print("\nmedians over whole tiles, place given, for other sizes of a pixel")
    for pixel_m in OTHER_SCALES_M:
        part = [judge(picture, SIDE_SCAN._replace(pixel_m=pixel_m), odds) for picture in whole]
        iou = [statistics.median(j.given.iou[k] for j in part) for k in range(len(Overlaps._fields))]
        told = ", ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in zip(Overlaps._fields, iou, strict=True))
        print(f"  {100.0 * pixel_m:.1f} cm: {told}; {sum(j.detected for j in part)} of {len(part)} detected")


def _print_kept(judged: Sequence[Judged], called: Sequence[Called]) -> None:
    looked_at = [j.looked_at for j in judged if j.looked_at is not None]
    scores: dict[str, tuple[list[float], list[float]]] = {
        "detector alone": ([one.p_mine for one, _ in looked_at], [d.p_mine for c in called for d in c.detections]),
        "close look": ([one.p_mine for _, one in looked_at], [d.p_mine for c in called for d in c.looked_at]),
        "close look, rejected left out": (
            [_unless_rejected(one) for _, one in looked_at],
            [_unless_rejected(d) for c in called for d in c.looked_at],
        ),
    }
    print(f"\nobjects called of {len(judged)}, by false calls per tile without one" + "".join(f"{rate:>8g}" for rate in FALSE_CALLS))
    for name, (of_object, of_none) in scores.items():
        kept = "".join(f"{n_kept(of_object, of_none, round(rate * len(called))):>8}" for rate in FALSE_CALLS)
        print(f"  {name:<58}{kept}")


def _unless_rejected(detection: Detection) -> float:
    return detection.p_mine if is_call(detection, 0.0) else 0.0


def _print_calls(called: Sequence[Called]) -> None:
    heading = "".join(f"{f'alone {p:g}':>12}{f'looked {p:g}':>12}" for p in CALLED)
    print(f"{'picture':<22}{'detections':>11}{heading}")
    for one in called:
        counts = "".join(f"{one.n_detector(p):>12}{one.n_confirmed(p):>12}" for p in CALLED)
        print(f"{one.picture.name:<22}{len(one.detections):>11}{counts}")
    means = "".join(
        f"{statistics.fmean(count(c, p) for c in called):>12.2f}" for p in CALLED for count in (Called.n_detector, Called.n_confirmed)
    )
    print(f"{'mean per picture':<22}{statistics.fmean(len(c.detections) for c in called):>11.1f}{means}")
