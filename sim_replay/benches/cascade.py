"""Measure what a trained cascade costs on three kinds of tile.

Where there is little to see, where there is much, and where nothing is rejected.

auv-mcm bench cascade [--model FILE] [--repeat N]

One thread, CPU time, medians of interleaved repetitions; tiles of 1024 by 1024 pixels of 0.12 by 0.05 m seen from 6 m.
Without a model a drawn one serves: random comparisons of what lies in an object's place with what lies around, and
thresholds that let 4 of 10 windows of plain sea floor pass each time. Beside every time stands whether numpy finds the
same windows with the same scores.

Contrasts, which run beside a cascade, have a table of their own: scored at all pixels and weighed only where they can
reach the default threshold, and whether both find the same. Below it stands what cascade and contrasts together cost on
the quiet tile over the busy one.

OpenCV runs the same stumps on the same pixels, for the one band of shadow lengths that a file of its own can hold. It
visits every other row, every other column, and every fourth where its first stage rejects: windows per second are those
it really visits.
"""

from __future__ import annotations

import argparse
import functools
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.detect.candidates import STEP_M
from auv_mcm.detect.cascade.bands import N_BANDS, WINDOW, FeatureBox, band_edges, margins_px
from auv_mcm.detect.cascade.codes import CodePlane, codes_of, make_plane
from auv_mcm.detect.cascade.model import (
    MAX_LEAF,
    MAX_STUMPS,
    Calibration,
    CascadeModel,
    Stump,
    check_model,
    parse_model,
)
from auv_mcm.detect.cascade.run import CascadeResult, opening_groups, run_plane, tables_of
from auv_mcm.detect.cascade.speed import measure_speed
from auv_mcm.detect.contrasts import Contrasts, contrasts
from auv_mcm.detect.prescreen import Peak, ScoreMaps, find_peaks, score_tile
from auv_mcm.errors import BadInputError
from auv_mcm.kernels.cascade import (
    CODE_OF_MEAN,
    Opened,
    WindowField,
    encode,
    encode_numpy,
    integral,
    integral_numpy,
    integral_shape,
    open_windows,
    open_windows_numpy,
)
from auv_mcm.records import VALID, PoseTrack, Tile
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import DetectConfig
from sim_replay.arguments import count
from sim_replay.fitting.cascade.opencv_xml import opencv_cascade

ROW_M: Final = 0.12  # m along the track, of the tiles that are timed
COLUMN_M: Final = 0.05  # m across
SHAPE: Final = (1024, 1024)  # rows and columns

_FIRST_RETURN_M: Final = 6.0  # m
_BAND: Final = 12  # of the model that OpenCV runs, one in the middle
_SIZES: Final = (3, 4, 6, 10, 15, 20, 30, 40, 50)  # stumps per group of the drawn model
_SHARE: Final = 0.4  # of windows that each group of the drawn model lets pass, maximum
_ANY_SCORE: Final = -MAX_STUMPS * MAX_LEAF
_FINISHED: Final = 32  # one in so many windows can be finished where none is rejected
_PERIOD_S: Final = 15.0  # s between tiles at a usual speed
_CODES_PER_GREY: Final = 64  # codes per level of OpenCV's 8 bits

Image = NDArray[np.float32]


class TileRow(NamedTuple):
    """Hold the costs on one kind of tile.

    budget: None for none. plane_ms: codes and integral images; run_ms: the cascade.

    same: numpy finds the same.
    """

    name: str
    result: CascadeResult
    budget: int | None
    plane_ms: float
    run_ms: float
    same: bool


class ContrastRow(NamedTuple):
    """Hold the costs of contrasts on one kind of tile. everywhere_ms: all pixels scored; ms: only where it matters.

    same: scores, floor and peaks alike.
    """

    name: str
    n_peaks: int
    everywhere_ms: float
    ms: float
    same: bool


class AgainstOpenCv(NamedTuple):
    """Hold speed and agreement with OpenCV.

    Million windows per second, and how many windows one finds and the other does not, of those that both visit.
    """

    ours: float
    opencv: float
    n_visited: int
    n_found: int
    n_different: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench cascade`."""
    parser.add_argument("--model", type=Path, metavar="FILE", help="a trained cascade (default: a drawn one)")
    parser.add_argument("--repeat", type=count, default=9, help="repetitions of each step (default 9)")


def run(arguments: argparse.Namespace) -> int:
    """Print every table of this bench; returns the exit code. Raises BadInputError for a file that is no model."""
    model = drawn_model("soft") if arguments.model is None else _read(arguments.model)
    cv2.setNumThreads(1)
    print(
        f"CPU time of one thread, kernels: {kernels.loaded().reason}, median of {arguments.repeat} interleaved "
        "repetitions\n"
    )
    print("\n".join(_step_lines(arguments.repeat)) + "\n")
    tiles = tile_rows(model, SHAPE, arguments.repeat)
    print("\n".join(_tile_lines(tiles)) + "\n")
    print("\n".join(_contrast_lines(contrast_rows(SHAPE, arguments.repeat), tiles)) + "\n")
    stages = drawn_model("stages")
    against = {name: against_opencv(stages, image, arguments.repeat) for name, image in drawn_tiles(SHAPE).items()}
    print("\n".join(_opencv_lines(against)) + "\n")
    speed = measure_speed(model, ROW_M, COLUMN_M)
    budget = math.floor(0.1 * _PERIOD_S * speed)
    print(f"{speed / 1e6:.0f} million evaluations per second where nothing is rejected")
    if (worst := tiles[-1]).budget:
        share = (worst.plane_ms + worst.run_ms) * 1e-3 * speed / worst.budget
        print(f"the {worst.name} tile takes {share:.2f} times as long as its budget at that speed")
    print(
        f"a tenth of one core with a tile every {_PERIOD_S:g} s is a budget of {budget / 1e6:.0f} million evaluations "
        "per tile"
    )
    return 0


def drawn_tiles(shape: tuple[int, int]) -> dict[str, Image]:
    """Draw single-look speckle on plain sea floor, on ripples of 1.2 m, and on a field of boulders.

    One boulder on every 2.5 square metres.
    """
    random = np.random.Generator(np.random.PCG64(21))
    speckle = random.exponential(size=shape)
    across_m, along_m = np.arange(shape[1]) * COLUMN_M, np.arange(shape[0])[:, np.newaxis] * ROW_M
    ripples = 1.0 + 0.8 * np.sin(2.0 * np.pi * (across_m + 0.3 * along_m) / 1.2)
    busy = np.ones(shape)
    for _ in range(round(shape[0] * shape[1] * ROW_M * COLUMN_M / 2.5)):
        row, column = int(random.integers(shape[0])), int(random.integers(shape[1]))
        shadow = round(max(0.4, 0.35 * column * COLUMN_M / (_FIRST_RETURN_M - 0.35)) / COLUMN_M)
        rows = slice(max(row - 3, 0), row + 4)
        busy[rows, column + 4 : column + 4 + shadow] = 0.15
        busy[rows, max(column - 4, 0) : column + 4] = 5.0
    return {
        "quiet": speckle.astype(np.float32),
        "rippled": (speckle * ripples).astype(np.float32),
        "busy": (speckle * busy).astype(np.float32),
    }


def code_plane_of(image: Image) -> CodePlane:
    """Make the code plane of a drawn tile, all of it valid."""
    everywhere = np.ones(image.shape, dtype=np.bool_)
    first_return_m = np.full(image.shape[0], _FIRST_RETURN_M)
    return make_plane(codes_of(image, everywhere), everywhere, everywhere, first_return_m, ROW_M, COLUMN_M)


def drawn_model(kind: str) -> CascadeModel:
    """Draw comparisons of highlight, shadow and surroundings at random, "soft" or "stages", for the drawn tiles."""
    random = np.random.Generator(np.random.PCG64(22))
    groups = tuple(tuple(_drawn_stump(random) for _ in range(size)) for size in _SIZES)
    model = CascadeModel(
        kind="stages" if kind == "stages" else "soft",
        trained_on="nothing: drawn at random",
        training_sha256="",
        row_spacing_m=(ROW_M, ROW_M),
        column_spacing_m=(COLUMN_M, COLUMN_M),
        calibration=Calibration(score=(-1, 1), log_odds=(-1.0, 1.0)),
        reject=(_ANY_SCORE,) * len(groups),
        groups=groups,
    )
    plane = code_plane_of(drawn_tiles((192, SHAPE[1]))["quiet"])
    reject: list[int] = []
    for group in range(len(groups)):
        part = msgspec.structs.replace(model, groups=groups[: group + 1], reject=(*reject, _ANY_SCORE))
        # Few stumps make few different scores: the lowest threshold above which no more than the share lies.
        values, times = np.unique(run_plane(plane, part, None).scores, return_counts=True)
        rejected = np.cumsum(times) >= (1.0 - _SHARE) * times.sum()
        reject.append(int(values[rejected][0]) + 1 if values.size else 0)
    model = msgspec.structs.replace(model, reject=tuple(reject))
    check_model(model, "drawn model")
    return model


def tile_rows(model: CascadeModel, shape: tuple[int, int], n_repeats: int) -> list[TileRow]:
    """Measure every drawn tile, and the quiet one with thresholds that reject nothing.

    The latter has a budget for the opening and some windows more.
    """
    images = drawn_tiles(shape)
    sizes, first, n_pixels = [len(group) for group in model.groups], opening_groups(model), shape[0] * shape[1]
    endless = msgspec.structs.replace(model, reject=(_ANY_SCORE,) * len(sizes))
    budget = sum(sizes[:first]) * n_pixels + sum(sizes[first:]) * (n_pixels // _FINISHED)
    jobs = [_Job(name, code_plane_of(image), image, model, None) for name, image in images.items()]
    jobs.append(_Job("adversarial", code_plane_of(images["quiet"]), images["quiet"], endless, budget))
    times_ms = cpu_ms([step for job in jobs for step in (job.prepare, job.run)], n_repeats)
    rows = []
    for k, job in enumerate(jobs):
        result = job.run()
        rows.append(
            TileRow(
                job.name,
                result,
                job.budget,
                times_ms[2 * k],
                times_ms[2 * k + 1],
                same_in_numpy(job.plane, job.model, result),
            )
        )
    return rows


def contrast_rows(shape: tuple[int, int], n_repeats: int) -> list[ContrastRow]:
    """Measure contrasts on every drawn tile at the default threshold."""
    p_false_alarm = DetectConfig().p_false_alarm

    def everywhere(tile: Tile) -> tuple[ScoreMaps, list[Peak]]:
        maps = score_tile(tile)
        return maps, find_peaks(tile, maps, p_false_alarm, STEP_M)

    def where_it_matters(tile: Tile) -> tuple[Contrasts, list[Peak]]:
        found = contrasts(tile, p_false_alarm)
        return found, found.peaks(STEP_M)

    tiles = {name: tile_of(image) for name, image in drawn_tiles(shape).items()}
    steps = [functools.partial(step, tile) for tile in tiles.values() for step in (everywhere, where_it_matters)]
    times_ms = cpu_ms(steps, n_repeats)
    threshold = np.float32(-statistics.NormalDist().inv_cdf(p_false_alarm))
    rows = []
    for k, (name, tile) in enumerate(tiles.items()):
        (maps, all_peaks), (found, peaks) = everywhere(tile), where_it_matters(tile)
        high = np.where(maps.score >= threshold, maps.score, np.float32(-np.inf))
        alike = ((high, found.score), (maps.background, found.background), (maps.small_box_variance, found.small))
        same = peaks == all_peaks and all(np.array_equal(one, other) for one, other in alike)
        rows.append(ContrastRow(name, len(peaks), times_ms[2 * k], times_ms[2 * k + 1], same))
    return rows


def tile_of(image: Image) -> Tile:
    """Make a tile of an image, all of it valid and of the core."""
    unknown = np.full(len(image), np.nan)
    pose = PoseTrack(
        time_s=unknown,
        latitude_deg=unknown,
        longitude_deg=unknown,
        depth_m=unknown,
        heading_rad=unknown,
        pitch_rad=unknown,
        roll_rad=unknown,
        speed_mps=unknown,
        altitude_m=unknown,
        stale=np.zeros(len(image), dtype=np.bool_),
    )
    return Tile(
        side="starboard",
        index=0,
        first_row=0,
        core_start=0,
        core_stop=len(image),
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        intensity=image,
        mask=np.full(image.shape, VALID, dtype=np.uint8),
        pose=pose,
        first_return_m=np.full(len(image), _FIRST_RETURN_M),
        first_return_sigma_m=np.zeros(len(image)),
        ping_number=np.arange(len(image)),
    )


def same_in_numpy(plane: CodePlane, model: CascadeModel, result: CascadeResult) -> bool:
    """Check that numpy alone gives every window of a result its score.

    And passes no other window if the budget did not cut.
    """
    usable = plane.usable
    if result.n_cut:
        usable = np.zeros_like(usable)
        usable[result.rows, result.columns] = True
    edges = band_edges(plane.first_return_m, plane.n_columns, plane.column_spacing_m, model.reference_height_m)
    stride = plane.sums.shape[1]
    corner = plane.margin_rows * stride + plane.margin_near
    tables = tables_of(model, plane.row_spacing_m, plane.column_spacing_m, stride)
    windows = open_windows_numpy(
        WindowField(plane.sums, plane.counts, corner, usable, edges), tables, len(model.groups)
    ).windows
    order = np.argsort(windows.place)
    expected = corner + result.rows * stride + result.columns
    return np.array_equal(windows.place[order], expected) and np.array_equal(windows.score[order], result.scores)


def against_opencv(model: CascadeModel, image: Image, n_repeats: int) -> AgainstOpenCv:
    """Run a model of stages and OpenCV on an image in whole greys, all of it in one band."""
    greys = np.minimum(np.rint(image * (CODE_OF_MEAN / _CODES_PER_GREY)), 255.0).astype(np.uint8)
    exported = opencv_cascade(model, _BAND, ROW_M, COLUMN_M)
    size = (exported.n_columns, exported.n_rows)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cascade.xml"
        path.write_text(exported.xml, encoding="ascii")
        classifier = cv2.CascadeClassifier(str(path))
    n_rows, n_columns = greys.shape[0] - exported.n_rows, greys.shape[1] - exported.n_columns
    inside = (
        slice(exported.centre_row, exported.centre_row + n_rows),
        slice(exported.centre_column, exported.centre_column + n_columns),
    )

    codes = greys.astype(np.uint16) * np.uint16(_CODES_PER_GREY)

    def ours(n_groups: int = len(model.groups)) -> tuple[CodePlane, Opened]:
        return _in_one_band(codes, inside, model, n_groups)

    def theirs() -> Sequence[Sequence[int]]:
        return classifier.detectMultiScale(greys, scaleFactor=2.0, minNeighbors=0, minSize=size, maxSize=size)

    ours_ms, theirs_ms = cpu_ms((ours, theirs), n_repeats)
    found, begun = (_map_of(*ours(n_groups))[inside] for n_groups in (len(model.groups), 1))
    visited = visited_by_opencv(begun)
    found_by_opencv = np.zeros_like(found)
    for column, row, _, _ in theirs():
        found_by_opencv[row, column] = True
    return AgainstOpenCv(
        ours=n_rows * n_columns / ours_ms * 1e-3,
        opencv=int(visited.sum()) / theirs_ms * 1e-3,
        n_visited=int(visited.sum()),
        n_found=int((found & visited).sum()),
        n_different=int((found_by_opencv != (found & visited)).sum()),
    )


def visited_by_opencv(begun: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Select the windows that OpenCV visits, given which pass the first stage.

    Every other one, and after one that does not pass the next but one.
    """
    visited = np.zeros_like(begun)
    for row in range(0, begun.shape[0], 2):
        column = 0
        while column < begun.shape[1]:
            visited[row, column] = True
            column += 2 if begun[row, column] else 4
    return visited


def cpu_ms(steps: Sequence[Callable[[], object]], n_repeats: int) -> list[float]:
    """Measure the median CPU time of this thread in each step, ms.

    Repetitions are interleaved so that whatever else runs disturbs all alike.

    Before each measured step runs the same one unmeasured, as tiles follow upon tiles: memory is where the step before
    has left it.
    """
    times_ms: list[list[float]] = [[] for _ in steps]
    for _ in range(n_repeats):
        for step, taken in zip(steps, times_ms, strict=True):
            step()
            began_s = time.thread_time()
            step()
            taken.append(1e3 * (time.thread_time() - began_s))
    return [statistics.median(taken) for taken in times_ms]


class _Job(NamedTuple):
    name: str
    plane: CodePlane
    image: Image
    model: CascadeModel
    budget: int | None

    def prepare(self) -> CodePlane:
        return code_plane_of(self.image)

    def run(self) -> CascadeResult:
        return run_plane(self.plane, self.model, self.budget)


def _in_one_band(
    codes: NDArray[np.uint16], inside: tuple[slice, slice], model: CascadeModel, n_groups: int
) -> tuple[CodePlane, Opened]:
    """Run the first groups on windows centred `inside`, as if all of the tile were in one band.

    Windows count however much of them is valid.
    """
    everywhere, usable = np.ones(codes.shape, dtype=np.bool_), np.zeros(codes.shape, dtype=np.bool_)
    usable[inside] = True
    plane = make_plane(codes, everywhere, usable, np.full(len(codes), _FIRST_RETURN_M), ROW_M, COLUMN_M)
    edges = np.zeros((len(codes), N_BANDS + 1), dtype=np.int32)
    edges[:, _BAND + 1 :] = codes.shape[1]
    stride = plane.sums.shape[1]
    tables = tables_of(model, ROW_M, COLUMN_M, stride)._replace(least=np.zeros(N_BANDS, dtype=np.int32))
    corner = plane.margin_rows * stride + plane.margin_near
    return plane, open_windows(WindowField(plane.sums, plane.counts, corner, usable, edges), tables, n_groups)


def _map_of(plane: CodePlane, opened: Opened) -> NDArray[np.bool_]:
    rows, columns = np.divmod(opened.windows.place, plane.sums.shape[1])
    passed = np.zeros(plane.usable.shape, dtype=np.bool_)
    passed[rows - plane.margin_rows, columns - plane.margin_near] = True
    return passed


def _drawn_stump(random: np.random.Generator) -> Stump:
    """Draw a comparison of highlight or shadow in an object's place with a box beside it.

    Most of those drawn separate objects.
    """
    low, high = sorted(random.uniform(-0.45, 0.45, 2).tolist())
    beside = (
        WINDOW
        if random.random() < 0.5
        else FeatureBox(*((0.5, 1.0) if random.random() < 0.5 else (-1.0, -0.5)), -0.8, 0.0, 0.8, 0.8)
    )
    sure = int(random.integers(100, 500))
    if random.random() < 0.5:
        inner = FeatureBox(low, high + 0.1, -0.3, 0.0, float(random.uniform(-0.1, 0.3)), 0.0)
        threshold, below, above = float(random.uniform(1.1, 1.8)), -sure, sure
    else:
        inner = FeatureBox(low, high + 0.1, 0.2, 0.0, float(random.uniform(0.3, 0.6)), float(random.uniform(0.3, 0.9)))
        threshold, below, above = float(random.uniform(0.5, 0.9)), sure, -sure
    if random.random() < 0.7:
        return Stump(kind="ratio", a=inner, b=beside, threshold=threshold, below=below, above=above)
    return Stump(kind="contrast", a=inner, b=beside, w=WINDOW, threshold=threshold - 1.0, below=below, above=above)


def _read(path: Path) -> CascadeModel:
    try:
        return parse_model(read_regular(path), str(path))
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}. Name a model file, or none to take the drawn one") from error


def _step_lines(n_repeats: int) -> list[str]:
    """Measure codes and integral images, with their twins in numpy and OpenCV's image of bytes."""
    image = drawn_tiles(SHAPE)["quiet"]
    mask = np.ones(SHAPE, dtype=np.uint8)
    codes = encode(image, mask)[0]
    greys = (codes // _CODES_PER_GREY).astype(np.uint8)
    margins, plain = margins_px(ROW_M, COLUMN_M), (0, 0, 0)
    bare, padded, signed = (np.empty(integral_shape(codes, m), dtype=np.uint32) for m in (plain, margins, plain))
    steps: dict[str, tuple[Callable[[], object], Callable[[], object] | None]] = {
        "codes of intensities": (lambda: encode(image, mask), lambda: encode_numpy(image, mask)),
        "integral image, no margins": (
            lambda: integral(codes, plain, 0, bare),
            lambda: integral_numpy(codes, plain, 0, bare),
        ),
        "integral image with margins": (
            lambda: integral(codes, margins, CODE_OF_MEAN, padded),
            lambda: integral_numpy(codes, margins, CODE_OF_MEAN, padded),
        ),
        "OpenCV's, of bytes": (lambda: cv2.integral(greys, signed.view(np.int32)), None),
    }
    ours = cpu_ms([step for step, _ in steps.values()], n_repeats)
    lines = [f"{'per tile of 1024 x 1024':<30}{'ms':>8}{'numpy ms':>10}{'equal':>8}"]
    for (name, (step, twin)), ms in zip(steps.items(), ours, strict=True):
        if twin is None:
            lines.append(f"{name:<30}{ms:>8.2f}")
        else:
            lines.append(f"{name:<30}{ms:>8.2f}{cpu_ms([twin], 1)[0]:>10.1f}{_yes(_equal(step(), twin())):>8}")
    return lines


def _equal(one: object, other: object) -> bool:
    if isinstance(one, tuple) and isinstance(other, tuple):
        return all(_equal(a, b) for a, b in zip(one, other, strict=True))
    return np.array_equal(np.array(one), np.array(other))


def _tile_lines(rows: list[TileRow]) -> list[str]:
    heads = ("windows", "each", "plane ms", "run ms", "M windows/s", "M eval./s", "passed", "cut", "of budget", "equal")
    lines = [f"{'tile':<12}" + "".join(f"{head:>12}" for head in heads)]
    for row in rows:
        result = row.result
        cells = (
            f"{result.n_windows}",
            f"{result.n_evaluations / max(result.n_windows, 1):.2f}",
            f"{row.plane_ms:.2f}",
            f"{row.run_ms:.2f}",
            f"{result.n_windows / (row.plane_ms + row.run_ms) * 1e-3:.1f}",
            f"{result.n_evaluations / row.run_ms * 1e-3:.0f}",
            f"{len(result.rows)}",
            f"{result.n_cut}",
            "" if row.budget is None else f"{100.0 * result.n_evaluations / row.budget:.1f} %",
            _yes(row.same),
        )
        lines.append(f"{row.name:<12}" + "".join(f"{cell:>12}" for cell in cells))
    by_name = {row.name: row for row in rows}
    quiet, busy = by_name["quiet"], by_name["busy"]
    of_time = (quiet.plane_ms + quiet.run_ms) / (busy.plane_ms + busy.run_ms)
    of_evaluations = quiet.result.n_evaluations / busy.result.n_evaluations
    return [
        *lines,
        (
            f"each: evaluations per window. Quiet over busy: {of_evaluations:.2f} of the evaluations, {of_time:.2f} of "
            "the time"
        ),
    ]


def _contrast_lines(rows: list[ContrastRow], tiles: list[TileRow]) -> list[str]:
    heads = ("peaks", "all ms", "ms", "ratio", "equal")
    lines = [f"{'contrasts':<12}" + "".join(f"{head:>12}" for head in heads)]
    for row in rows:
        cells = (
            f"{row.n_peaks}",
            f"{row.everywhere_ms:.1f}",
            f"{row.ms:.1f}",
            f"{row.everywhere_ms / row.ms:.1f}",
            _yes(row.same),
        )
        lines.append(f"{row.name:<12}" + "".join(f"{cell:>12}" for cell in cells))
    cascade_ms = {tile.name: tile.plane_ms + tile.run_ms for tile in tiles}
    before = {row.name: cascade_ms[row.name] + row.everywhere_ms for row in rows}
    now = {row.name: cascade_ms[row.name] + row.ms for row in rows}
    shares = [
        f"{both['quiet']:.0f} of {both['busy']:.0f} ms ({both['quiet'] / both['busy']:.2f})" for both in (before, now)
    ]
    return [
        *lines,
        f"quiet over busy, cascade and contrasts: {shares[0]} with all pixels scored, {shares[1]} as it runs",
    ]


def _opencv_lines(against: dict[str, AgainstOpenCv]) -> list[str]:
    heads = ("ours, M/s", "OpenCV, M/s", "ratio", "visited", "found", "different")
    lines = [f"{'one band':<12}" + "".join(f"{head:>12}" for head in heads)]
    for name, row in against.items():
        cells = (
            f"{row.ours:.1f}",
            f"{row.opencv:.1f}",
            f"{row.ours / row.opencv:.1f}",
            row.n_visited,
            row.n_found,
            row.n_different,
        )
        lines.append(f"{name:<12}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


def _yes(equal: bool) -> str:
    return "yes" if equal else "NO"
