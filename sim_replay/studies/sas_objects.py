"""Segment, outline and classify mines in simulated synthetic aperture images of 1.5 to 10 cm.

Objects lie by themselves on sand, rendered with the blur that the aperture gives to shadows, and with single-look
speckle. The first table repeats figures 3 to 5 of the source paper: its Markov field, ours, and contours, on cylinders
and spheres, as intersection over union with the truth. Its highlight is all that a solid shows the sonar, bright or
not, and its shadow what lies behind it and gets less than half of the floor's sound.

The second table asks what highlight and shadow are worth for the class, by resolution: every class is fitted by the
likelihood of the highlight alone, of the shadow alone, and of both. The third asks what it costs that the solids of the
chain cast sharp shadows: the same objects with the blur of a wide aperture, and with hardly any. The fourth asks what
the solids' likelihood would gain by the number of looks averaged, which the chain takes to be 1.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from auv_mcm.classify.fit import SOLIDS, fit_shapes, hypotheses_of
from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Contours, converge_on, survey
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.kernels.shape import Array, ImageRowSums, Solid, intervals, up_to
from sim_replay.benches.every_stage.paper_mrf import segment_as_paper
from sim_replay.benches.every_stage.rendered_solids import SIZES, best_class
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.overlap import overlap
from sim_replay.simulator.aperture import Aperture
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import (
    STEADY,
    Lawnmower,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    SyntheticAperture,
    Track,
    World,
)
from sim_replay.simulator.sea import Sea
from sim_replay.text_tables import markdown, share_cell

Labels: TypeAlias = NDArray[np.uint8]

RESOLUTIONS_M: Final = (0.015, 0.025, 0.05, 0.10)  # m, those that the source paper speaks of
PARTS: Final = ("highlight", "shadow", "both")
_KHZ: Final = 300.0  # of the first two tables: apertures of 9.6 to 1.4 degrees
_WIDE_KHZ: Final = 100.0  # three times as wide
_SHARP_KHZ: Final = 1200.0  # a twelfth of that
_WIDE_M: Final = (0.025, 0.05)  # m: resolutions whose blur is compared, over 17.2 and 8.6 degrees
_LOOKS: Final = (1, 4)
_LOOKS_M: Final = 0.05  # m: resolution at which looks are compared
MORE: Final = 4
"""Times the objects of the other tables, for looks: their fits are quick."""
_ALTITUDE_M: Final = 9.0  # m above the floor
_RANGE_M: Final = 28.0  # m, slant: beyond the longest shadow
_LEG_M: Final = 5.0  # m of track: object, shadow and floor on both sides
_NEAREST_M, _FARTHEST_M = 12.0, 21.0  # m, ground range of objects
_BEFORE_M, _BEHIND_M = 2.0, 1.5  # m of floor before an object, and behind its shadow
_HIGHEST_M: Final = 0.9  # m: of any object here
_PIXELS: Final = 1.2  # per resolution
_SPREAD: Final = 0.5  # of the point-spread function, 1-sigma per resolution
_HALF: Final = 0.5  # of the floor's sound: below it lies the shadow
_EDGE: Final = 0.12  # of the rows at either end: floor alone
_N_STARTS, _N_ROUNDS, _N_TRIES, _N_KEPT = 1000, 4, 250, 25  # of the search, chosen for the run time
_AT_ONCE: Final = 250  # hypotheses: bounds memory
_LOWEST: Final[dict[Solid, tuple[float, ...]]] = {
    # m, ratios, rad and shares in the order of `classify.fit`: the usual sizes, not buried
    "sphere": (0.3, 0.0),
    "cylinder": (0.2, 1.5, -0.5 * math.pi, 0.0),
    "truncated_cone": (0.4, 0.4, 0.38),
    "wedge": (0.8, -math.pi, 0.0),
}
_HIGHEST: Final[dict[Solid, tuple[float, ...]]] = {
    "sphere": (0.5, 0.0),
    "cylinder": (0.32, 2.6, 0.5 * math.pi, 0.0),
    "truncated_cone": (0.6, 0.7, 0.58),
    "wedge": (1.25, math.pi, 0.0),
}
_PLACE_M: Final = (0.5, 0.5)  # m about the true place along and across the track within which solids are tried
_BRIGHT, _DARK = 1.3, 0.6  # of the floor, as `kernels.shape` has it: highlight and shadow must be


class Drawn(NamedTuple):
    """Hold an object in its region, the true labels of its pixels, and its place and sizes."""

    solid: Solid
    region: Region
    truth: Labels
    along_m: float
    ground_range_m: float
    sizes_m: Array


class Rendered(NamedTuple):
    """Hold what a lone object on sand shows a synthetic aperture before speckle.

    mean: intensity without noise, (n_lines, n_bins) over slant range. floor: (n_bins,), that of the floor alone; 0 in
    the water column. noise: of both, where there is any. edges: of the region's columns, in bins. region: its geometry,
    without sound. hypothesis: place along and across the track, m, and the fields of the solid.
    """

    solid: Solid
    mean: Array
    floor: Array
    noise: float
    edges: Array
    region: Region
    hypothesis: Array


def draw(solid: Solid, resolution_m: float, frequency_khz: float, seed: int, n_looks: int = 1) -> Drawn:
    """Draw an object of usual size, with n_looks averaged; seed alone decides on size, place and direction."""
    random = np.random.Generator(np.random.PCG64(seed))
    rendered = render(solid, resolution_m, frequency_khz, seed, random)
    energy = (rendered.mean + rendered.noise) / (rendered.floor + rendered.noise)
    intensity = np.mean([speckled(energy, random) for _ in range(n_looks)], axis=0)
    return drawn_from(rendered, over_ground(rendered, intensity), over_ground(rendered, energy))


def render(solid: Solid, resolution_m: float, frequency_khz: float, seed: int, random: np.random.Generator) -> Rendered:
    """Render an object whose size, place and direction `random` gives."""
    range_m, azimuth_rad = float(random.uniform(_NEAREST_M, _FARTHEST_M)), float(random.uniform(-math.pi, math.pi))
    size, fields = _sized(solid, float(random.uniform(0.9, 1.1)), float(random.uniform(0.8, 1.2)), azimuth_rad)
    step_m = resolution_m / _PIXELS
    along_m = 0.5 * _LEG_M + float(random.uniform(-0.5, 0.5)) * step_m
    scene = Scene(
        seed=seed,
        world=World(depth_m=30.0, relief_rms_m=0.02, seabeds=(Seabed(type="sand", relief_rms_m=0.005),), cell_m=0.02),
        objects=(
            SceneObject(kind=solid, east_m=range_m, north_m=along_m, azimuth_deg=math.degrees(azimuth_rad), **size),
        ),
        sonar=Sonar(
            frequency_khz=frequency_khz,
            range_m=_RANGE_M,
            n_samples=round(_RANGE_M / step_m),
            absorption_db_per_km=70.0,  # of 300 kHz, whatever the frequency: it must not decide on the noise
            noise_db=-15.0,
            synthetic_aperture=SyntheticAperture(
                along_track_resolution_m=resolution_m, range_resolution_m=resolution_m, pixels_per_resolution=_PIXELS
            ),
        ),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=_LEG_M), altitude_m=_ALTITUDE_M, motion=STEADY),
    )
    sea = Sea(scene)
    aperture = Aperture(sea)
    strip = aperture.strip(planned_legs(scene.track.plan)[0], 0)
    mean = aperture.mean_intensity(strip, 0, strip.n_lines, "full")[:, 1]
    edge = round(_EDGE * strip.n_lines)
    floor = np.concatenate((mean[:edge], mean[-edge:])).mean(axis=0)
    floor_m = scene.world.depth_m - strip.depth_m - sea.world.floor_m(range_m, along_m)
    first_m = range_m - _BEFORE_M
    last_m = range_m * floor_m / (floor_m - _HIGHEST_M) + _BEHIND_M
    edges = np.hypot(np.arange(first_m, last_m, step_m), floor_m) / aperture.bin_m
    shape = len(mean), len(edges) - 1
    region = Region(
        intensity=np.ones(shape),
        valid=np.ones(shape, dtype=np.bool_),
        row_spacing_m=aperture.line_m,
        column_spacing_m=step_m,
        first_ground_range_m=first_m,
        altitude_m=floor_m,
        row=along_m / aperture.line_m + 0.5,
        column=(range_m - 0.2 - first_m) / step_m,
        beam_width_rad=0.0,
    )
    place_m = along_m + 0.5 * aperture.line_m
    hypothesis = np.concatenate([[place_m, range_m, 1.0], fields, np.zeros(5 - len(fields))])
    return Rendered(solid, mean, floor, sea.noise, edges, region, hypothesis)


def over_ground(rendered: Rendered, plane: Array) -> Array:
    """Average slant bins of a plane over the columns of the region."""
    sums = np.concatenate((np.zeros((len(plane), 1)), np.cumsum(plane, axis=1)), axis=1)
    ends = np.tile(rendered.edges, (len(plane), 1))
    return np.asarray(np.diff(up_to(sums, ends), axis=1) / np.diff(rendered.edges))


def drawn_from(rendered: Rendered, intensity: Array, energy: Array) -> Drawn:
    """Give the region its sound, and label its pixels by the energy, both over the ground."""
    region = msgspec.structs.replace(rendered.region, intensity=intensity)
    fields = rendered.hypothesis[3:]
    solid = rendered.solid
    truth = _true_labels(solid, rendered.hypothesis, region, energy)
    sizes_m = fields[: len(SIZES[solid])] if solid in ("sphere", "cylinder") else fields[[0, 2]]
    return Drawn(solid, region, truth, float(rendered.hypothesis[0]), float(rendered.hypothesis[1]), sizes_m)


def _sized(solid: Solid, scale: float, long: float, azimuth_rad: float) -> tuple[dict[str, Any], list[float]]:
    """Give the sizes of an object of the scene, and the fields of the solid that it is."""
    match solid:
        case "sphere":
            return {"width_m": 0.8 * scale}, [0.4 * scale, 0.0]
        case "cylinder":
            return {"width_m": 0.53 * scale, "length_m": 2.0 * long}, [0.265 * scale, 2.0 * long, azimuth_rad, 0.0]
        case "truncated_cone":
            return (
                {"width_m": 0.98 * scale, "top_m": 0.5 * scale, "height_m": 0.47 * scale},
                [0.49 * scale, 0.25 * scale, 0.47 * scale, 0.0],
            )
        case "wedge":
            sides = [1.02 * scale, 0.8 * scale, 0.385 * scale]
            return {"length_m": sides[0], "width_m": sides[1], "height_m": sides[2]}, [*sides, azimuth_rad, 0.0]


def speckled(energy: Array, random: np.random.Generator) -> Array:
    """Detect a smeared complex Gaussian field with this mean, of mean 1 where the energy is 1."""
    total = np.zeros(energy.shape)
    for _ in range(2):
        field = random.standard_normal(energy.shape) * np.sqrt(energy)
        total += gaussian_filter(field, _SPREAD * _PIXELS) ** 2
    edge = round(_EDGE * len(energy))
    return np.asarray(total / np.concatenate((total[:edge], total[-edge:])).mean())


def _true_labels(solid: Solid, hypothesis: Array, region: Region, energy: Array) -> Labels:
    image = image_row_sums(region, 1.0)
    assert image is not None
    ends = intervals(solid, hypothesis[np.newaxis], image)[0, :, 0]
    column, row = np.arange(energy.shape[1]) + 0.5, np.arange(len(energy)) + 0.5
    near_m = np.abs(row * region.row_spacing_m - hypothesis[0])[:, np.newaxis]
    labels = np.full(energy.shape, BACKGROUND, dtype=np.uint8)
    behind_m = region.first_ground_range_m + column * region.column_spacing_m > hypothesis[1] - 0.5
    dark = ((energy < _HALF) & behind_m & (near_m < 0.5 * _LEG_M - 0.5)).astype(np.uint8)
    # Without the specks that the relief leaves in the dark.
    n_parts, parts, measured, _ = cv2.connectedComponentsWithStats(dark, connectivity=4)
    if n_parts > 1:
        labels[parts == 1 + int(measured[1:, cv2.CC_STAT_AREA].argmax())] = SHADOW
    labels[(column >= ends[:, :1]) & (column < ends[:, 1:2])] = HIGHLIGHT
    return labels


# --- figures 3 to 5 ---


def contour_labels(region: Region) -> Labels:
    """Label what the contours of the chain enclose, started at the detection."""
    ground = survey(region, grain_area(region.intensity, region.valid))
    found = ground if isinstance(ground, Contours) else converge_on(ground, ground.boxes)
    labels = np.full(region.intensity.shape, BACKGROUND, dtype=np.uint8)
    for nodes, label in ((found.shadow, SHADOW), (found.highlight, HIGHLIGHT)):
        if len(nodes):
            labels[contour_mask(nodes, labels.shape)] = label
    return labels


METHODS: Final[dict[str, Callable[[Region], Labels]]] = {
    "field of the paper": lambda region: segment_as_paper(region).labels,
    "field of the chain": lambda region: segment(region).labels,
    "contours of the chain": contour_labels,
}


def outline_rows(drawn: Sequence[Drawn], resolution_m: float) -> list[list[str]]:
    """Return a row per method and solid: median and lower quartile of the overlap, of shadow and of highlight."""
    rows = []
    for solid in ("cylinder", "sphere"):
        some = [one for one in drawn if one.solid == solid]
        for name, method in METHODS.items():
            labels = [method(one.region) for one in some]
            cells = []
            for label in (SHADOW, HIGHLIGHT):
                shares = [overlap(each == label, one.truth == label) for each, one in zip(labels, some, strict=True)]
                cells.append(f"{statistics.median(shares):.2f} ({float(np.quantile(shares, 0.25)):.2f})")
            rows.append([f"{100.0 * resolution_m:g}", solid, name, *cells])
    return rows


# --- classes by part ---


def classes_by_part(drawn: Drawn) -> dict[str, Solid]:
    """Choose the likeliest class by the highlight alone, by the shadow alone, and by both."""
    image = image_row_sums(drawn.region, grain_area(drawn.region.intensity, drawn.region.valid))
    assert image is not None
    costs = {solid: _lowest_costs(solid, drawn, image) for solid in SOLIDS}
    return {part: min(costs, key=lambda solid: costs[solid][k]) for k, part in enumerate(PARTS)}


def _lowest_costs(solid: Solid, drawn: Drawn, image: ImageRowSums) -> Array:
    """Search a class by each part, from the same starts; costs (3,) in nats against bare floor, by PARTS."""
    random = np.random.Generator(np.random.PCG64(len(solid)))
    centre = np.array([drawn.along_m, drawn.ground_range_m])
    low = np.concatenate([centre - _PLACE_M, _LOWEST[solid]])
    high = np.concatenate([centre + _PLACE_M, _HIGHEST[solid]])
    starts = random.uniform(low, high, (_N_STARTS, len(low)))
    first = part_costs(solid, starts, image)
    lowest: Array = first.min(axis=0)
    for k in range(len(PARTS)):
        order = np.argsort(first[:, k])[:_N_KEPT]
        kept, cost, stride = starts[order], first[order, k], 0.15 * (high - low)
        for _ in range(_N_ROUNDS):
            parents = kept[random.integers(len(kept), size=_N_TRIES)]
            tried = np.clip(parents + stride * random.standard_normal(parents.shape), low, high)
            points = np.concatenate([kept, tried])
            cost = np.concatenate([cost, part_costs(solid, tried, image)[:, k]])
            order = np.argsort(cost)[:_N_KEPT]
            kept, cost, stride = points[order], cost[order], 0.5 * stride
        lowest[k] = min(lowest[k], cost[0])
    return lowest


def part_costs(solid: Solid, points: Array, image: ImageRowSums) -> Array:
    """Weigh solids by their highlight, by their shadow, and by both, (n, 3) nats against bare floor.

    Echoes of a part that are Gamma distributed about their own mean mu, the floor's being 1, are likelier than floor by
    N (mu - 1 - ln mu) samples; a highlight that is not bright, or a shadow that is not dark, explains nothing.
    """
    edge = round(_EDGE * len(image.echoes))
    rows = np.r_[0:edge, len(image.echoes) - edge : len(image.echoes)]
    floor = float(image.echoes[rows, -1].sum() / image.counts[rows, -1].sum())
    n_rows, costs = len(image.echoes), []
    for first in range(0, len(points), _AT_ONCE):
        ends = intervals(solid, hypotheses_of(solid, points[first : first + _AT_ONCE]), image)[:, :, 0]
        n = len(ends)
        row = np.tile(np.arange(n_rows), n)
        counted, total = (
            np.diff(up_to(sums, ends.reshape(-1, 3), row), axis=1).reshape(n, n_rows, 2).sum(axis=1)
            for sums in (image.counts, image.echoes)
        )
        mean = np.maximum(total / np.maximum(counted, 1e-9) / floor, 1e-6)
        clear = np.column_stack([mean[:, 0] > _BRIGHT, mean[:, 1] < _DARK])
        parts = np.where(clear, counted * (np.log(mean) + 1.0 - mean), 0.0)
        costs.append(np.column_stack([parts, parts.sum(axis=1)]))
    return np.asarray(image.samples_per_pixel * np.concatenate(costs), dtype=np.float64)


# --- sharp shadows ---


def fitted(drawn: Sequence[Drawn], looks: float = 1.0) -> tuple[int, float, float]:
    """Fit the solids of the chain under a number of looks: classes right, median size error and margin in nats."""
    right, errors, margins = 0, [], []
    for one in drawn:
        fits = fit_shapes(one.region, None, grain_area(one.region.intensity, one.region.valid), looks=looks)
        right += best_class([fits]) == one.solid
        own = next((fit for fit in fits.fits if fit.solid == one.solid), None)
        if own is not None:
            found = np.array([getattr(own.best.shape, name) for name in SIZES[one.solid]])
            errors += np.abs(found / one.sizes_m - 1.0).tolist()
            others = [fit.best.cost for fit in fits.fits if fit.solid != one.solid]
            margins.append(min(others, default=math.inf) - own.best.cost)
    return right, statistics.median(errors), statistics.median(margins)


# --- tables ---


def outlines_and_classes(n: int) -> str:
    """Write the first two tables, of n objects per class and resolution."""
    by_resolution = {
        resolution_m: [
            draw(solid, resolution_m, _KHZ, 4 * number + k) for number in range(n) for k, solid in enumerate(SOLIDS)
        ]
        for resolution_m in RESOLUTIONS_M
    }
    return tables_of(by_resolution, "resolution, cm")


def tables_of(by_size: Mapping[float, Sequence[Drawn]], size: str) -> str:
    """Write the overlaps of outlines and the classes found by each part, for objects by resolution or pixel, m."""
    outlines, classes = [], []
    for size_m, drawn in by_size.items():
        outlines += outline_rows(drawn, size_m)
        chosen = [classes_by_part(one) for one in drawn]
        right = [sum(each[part] == one.solid for each, one in zip(chosen, drawn, strict=True)) for part in PARTS]
        classes.append([f"{100.0 * size_m:g}", *(share_cell(proportion(some, len(drawn))) for some in right)])
    return (
        "Intersection over union, median (lower quartile):\n\n"
        + markdown([size, "object", "method", "shadow", "highlight"], outlines)
        + "\n\nClass found:\n\n"
        + markdown([size, *PARTS], classes)
    )


def shadows_compared(n: int) -> str:
    """Write the third table, of n objects per class."""
    rows = []
    for resolution_m in _WIDE_M:
        for khz in (_SHARP_KHZ, _WIDE_KHZ):
            drawn = [
                draw(solid, resolution_m, khz, 4 * number + k) for number in range(n) for k, solid in enumerate(SOLIDS)
            ]
            right, error, margin = fitted(drawn)
            blur_deg = math.degrees(1.5 / khz / (2.0 * resolution_m))
            rows.append(
                [
                    f"{100.0 * resolution_m:g}",
                    f"{blur_deg:.1f}",
                    share_cell(proportion(right, len(drawn))),
                    f"{error:.3f}",
                    f"{margin:.0f}",
                ]
            )
    header = ["resolution, cm", "integration, degrees", "class found", "median size error", "margin, nats"]
    return "Solids with sharp shadows:\n\n" + markdown(header, rows)


def looks_compared(n: int) -> str:
    """Write the fourth table, of n objects per class."""
    rows = []
    for n_looks in _LOOKS:
        drawn = [
            draw(solid, _LOOKS_M, _KHZ, 4 * number + k, n_looks)
            for number in range(n)
            for k, solid in enumerate(SOLIDS)
        ]
        for taken in sorted({1, n_looks}):
            right, error, margin = fitted(drawn, taken)
            share = share_cell(proportion(right, len(drawn)))
            rows.append([str(n_looks), str(taken), share, f"{error:.3f}", f"{margin:.0f}"])
    header = ["looks averaged", "looks taken", "class found", "median size error", "margin, nats"]
    return "Solids by number of looks:\n\n" + markdown(header, rows)
