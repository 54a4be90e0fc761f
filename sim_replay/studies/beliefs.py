"""Measure the beliefs from views of single objects, beside what the source paper prints, and whether it holds as
probability.

auv-mcm bench beliefs [--objects N]

Mines are drawn as for the bench of shapes; clutter is rocks of a mine's size. Every object is described twice:

- By the likelihood: the free contour and the solids are all weighed by the echoes; clutter is what the free contour
  explains, less the code length of its nodes, and whatever solid is of implausible size.
- As the source paper does, after S. Reed, Y. Petillot, J. Bell, IEE Proc. Radar Sonar Navig. 151, 2004: the contour's
  shadow is compared with simulated shadows by their Hausdorff distance d; the membership exp(-d^2 / 2 s^2) and the
  plausibility of the sizes become masses by Appriou's first family. How the paper does either step is not published in
  detail; this is a derivation anew.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import EVERYTHING, FRAME, N_CLASSES, Array, ViewMass, belief, combine, pignistic, subset
from auv_mcm.classify.evidence import TEMPERATURE, ClassEvidence, appriou_mass, view_mass
from auv_mcm.classify.fit import SOLIDS, fit_shapes, hypotheses_of, plausibility
from auv_mcm.classify.likelihood import image_row_sums, labels_cost
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Nodes, converge, start_from_detection
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.kernels.shape import Solid
from auv_mcm.records import ContactClass
from auv_mcm.solids.box_search import SearchBox, look_around, walk
from sim_replay.arguments import count
from sim_replay.benches.every_stage.rendered_solids import CORRELATION_AREA, draw_object, rendered_region
from sim_replay.scoring.calibration import calibration_error
from sim_replay.simulator.scene import SceneObject
from sim_replay.studies.hausdorff import Mask, contour_distance_m, shadow_mask

# Bel of cylinder, sphere, cone and clutter for one view of each, as printed in the source paper's Table 1. It has no
# wedge.
PAPER: Final[dict[ContactClass, dict[ContactClass, float]]] = {
    "cylinder": {"cylinder": 0.71, "sphere": 0.0, "truncated_cone": 0.0, "clutter": 0.2},
    "sphere": {"cylinder": 0.0, "sphere": 0.833, "truncated_cone": 0.0, "clutter": 0.083},
    "truncated_cone": {"cylinder": 0.0, "sphere": 0.303, "truncated_cone": 0.45, "clutter": 0.045},
    "clutter": {"cylinder": 0.42, "sphere": 0.0, "truncated_cone": 0.0, "clutter": 0.46},
}
TEMPERATURES: Final = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
TRAINING_SEED, HELD_OUT_SEED = 3000, 7000

_QUALITY: Final = 0.95  # of every view: simulated regions are whole and in the middle of a straight leg
_PAIR: Final = subset("sphere", "truncated_cone")
_AMBIGUOUS: Final = 1.0 / 3.0
_BIN_EDGES: Final = (0.5, 0.7, 0.8, 0.9)
_HEADINGS: Final = ("cylinder", "sphere", "cone", "wedge", "clutter", "sum", "sph/cone", "any", "prob.", "right")

# Rocks that a detector would hand on: of a mine's size, higher or lower, more or less bedded in.
_ROCK_STREAM: Final = 0x524F434B  # keeps its random numbers apart from others of the same seed
_ROCK_LENGTH_M, _ROCK_HEIGHT_M = (0.7, 2.2), (0.25, 0.8)
_ROCK_SLIMNESS, _ROCK_FLATNESS = (0.6, 0.95), (0.35, 0.7)
_ROCK_TILT_DEG: Final = 35.0
_ALTITUDE_ERROR: Final = 0.1

# The source paper's route: membership and clutter's distance are those of the minimum log-loss on 60 objects of
# training seeds.
_MEMBERSHIP_SIGMA_M: Final = 0.07
_CLUTTER_M: Final = 0.2  # a shadow this far from every solid's is clutter's as much as any solid's
_QUANTILE: Final = 0.95  # of the gaps; their largest is set by one grain of speckle
_FAR_M: Final = 10.0
_N_STARTS, _N_WALKS, _N_STEPS, _N_TRIES = 48, 2, 8, 6
_PLACE_M, _PLACE_GRAIN_M = (
    (0.4, 0.6, 0.4),
    0.05,
)  # along track either way; nearer and farther than the shadow's near side
_TURN: Final = math.pi
_TOP_SHARE: Final = 0.51
_SIZES: Final[
    dict[Solid, tuple[tuple[float, float, float], ...]]
] = {  # from, to, grain: 30 % beyond the usual; azimuths all round
    "sphere": ((0.21, 0.65, 0.03),),
    "cylinder": ((0.14, 0.416, 0.03), (1.05, 3.38, 0.1), (-0.5 * _TURN, 0.5 * _TURN, 0.08)),
    "truncated_cone": ((0.28, 0.78, 0.03), (0.27, 0.75, 0.06)),
    "wedge": ((0.56, 1.625, 0.06), (-_TURN, _TURN, 0.08)),
}
_TURNS: Final[tuple[Solid, ...]] = ("cylinder", "wedge")

Evidence = dict[ContactClass, ClassEvidence]


class DrawnObject(NamedTuple):
    """Hold an object and its views 90 degrees apart."""

    name: ContactClass
    views: tuple[Region, Region]


class FreeContour(NamedTuple):
    """Hold labels: (n_rows, n_columns) uint8 of the region. cost: what they explain plus the code length of their
    nodes, nats.
    """

    labels: NDArray[np.uint8]
    cost: float


class LikelihoodView(NamedTuple):
    """Hold the evidence of one view by the likelihood. half_turn_symmetric: of the solid that fits best. shadow: of the
    free contour, (n_rows, n_columns).
    """

    evidence: Evidence
    half_turn_symmetric: bool
    shadow: Mask


Judged = tuple[ContactClass, tuple[LikelihoodView, LikelihoodView]]


class BeliefRow(NamedTuple):
    """Medians over the objects of one class. beliefs: of FRAME's classes, NaN where not known. total: their sum. pair,
    ignorance: mass on {sphere, truncated_cone} itself and on all classes. probability: pignistic, of the true class.
    correct: share of right decisions.
    """

    name: ContactClass
    beliefs: Array
    total: float
    pair: float
    ignorance: float
    probability: float
    correct: float


class Bin(NamedTuple):
    """Hold views of about one probability of the winning class: how many, its mean, and the share that was right."""

    n_views: int
    promised: float
    right: float


class Calibrated(NamedTuple):
    """At one temperature: mean log-loss of the pignistic probability of the true class, nats, and the expected
    calibration error of that of the winning class.
    """

    temperature: float
    log_loss: float
    error: float


def draw_labelled_objects(n_objects: int, seed: int) -> list[DrawnObject]:
    """Draw objects of all classes in turn."""
    return [draw_labelled(FRAME[index % N_CLASSES], seed + index) for index in range(n_objects)]


def draw_labelled(name: ContactClass, seed: int) -> DrawnObject:
    """Draw a mine as the bench of shapes does, or a rock at 10 to 45 m, rendered from two sides with altitudes up to 10
    % wrong.
    """
    for solid in SOLIDS:
        if solid == name:
            return DrawnObject(name, draw_object(solid, seed).views)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([_ROCK_STREAM, seed])))
    range_m, azimuth_deg, tilt_deg = (
        float(random.uniform(*limits)) for limits in ((10.0, 45.0), (0.0, 360.0), (-_ROCK_TILT_DEG, _ROCK_TILT_DEG))
    )
    length_m = float(random.uniform(*_ROCK_LENGTH_M))
    width_m = length_m * float(random.uniform(*_ROCK_SLIMNESS))
    height_m = float(np.clip(width_m * random.uniform(*_ROCK_FLATNESS), *_ROCK_HEIGHT_M))
    error = _ALTITUDE_ERROR * float(random.uniform(-1.0, 1.0))

    def view(turned_deg: float, number: int, altitude_error: float) -> Region:
        rock = SceneObject(
            kind="rock",
            east_m=range_m,
            north_m=0.0,
            azimuth_deg=azimuth_deg + turned_deg,
            tilt_deg=tilt_deg,
            length_m=length_m,
            width_m=width_m,
            height_m=height_m,
        )
        return rendered_region(rock, 2 * seed + number, altitude_error=altitude_error)

    return DrawnObject(name, (view(0.0, 0, error), view(90.0, 1, -error)))


def free_contour(region: Region) -> FreeContour:
    """Return the snakes' contour from the detector's place alone."""
    contours = converge(region, start_from_detection(region), correlation_px=CORRELATION_AREA)
    labels = np.full(region.intensity.shape, BACKGROUND, dtype=np.uint8)
    code = 0.0
    for nodes, label in ((contours.shadow, SHADOW), (contours.highlight, HIGHLIGHT)):
        if len(nodes):
            labels[contour_mask(nodes, labels.shape)] = label
            code += code_length(nodes, labels.size)
    return FreeContour(labels, labels_cost(region, labels, CORRELATION_AREA) + code)


def code_length(nodes: Nodes, n_pixels: int) -> float:
    """Return nats to encode a contour's nodes (n, 2) in a region of n_pixels, as in the snakes' criterion
    (`auv_mcm.kernels.snake`)."""
    n = len(nodes)
    steps = np.abs(np.roll(nodes, -1, axis=0) - nodes).mean(axis=0)
    each = 2.0 * math.log(2.0 * math.e) + math.log(max(float(steps.prod()) / CORRELATION_AREA, 0.25))
    return math.log(n_pixels / CORRELATION_AREA) + 2.0 * math.log(n) + n * each


def look(region: Region) -> LikelihoodView:
    """Evidence by the likelihood. Highlights enter as far as they are in the likelihood: their extent, measured row by
    row, is too rough a number to count again.
    """
    free = free_contour(region)
    found = fit_shapes(region, free.cost, CORRELATION_AREA)
    evidence: Evidence = {solid: ClassEvidence(nll=math.inf) for solid in SOLIDS}
    evidence |= {fit.solid: ClassEvidence(nll=fit.best.cost, plausibility=fit.plausibility) for fit in found.fits}
    evidence["clutter"] = ClassEvidence(nll=free.cost)
    return LikelihoodView(evidence, not (found.fits and found.fits[0].solid == "wedge"), free.labels == SHADOW)


def looks_at(scene_object: DrawnObject) -> tuple[LikelihoodView, LikelihoodView]:
    """Return both views of an object."""
    first, second = scene_object.views
    return look(first), look(second)


def shadow_evidence(region: Region, shadow: Mask) -> Evidence:
    """Weigh evidence by the distance of a shadow (n_rows, n_columns) from the nearest simulated shadow of every
    solid."""
    evidence: Evidence = {"clutter": ClassEvidence(nll=_membership_cost(_CLUTTER_M))}
    for solid in SOLIDS:
        distance_m, plausible = _nearest_shadow(solid, region, shadow) if shadow.any() else (math.inf, 0.0)
        evidence[solid] = ClassEvidence(nll=_membership_cost(distance_m), plausibility=plausible)
    return evidence


def _membership_cost(distance_m: float) -> float:
    return 0.5 * (distance_m / _MEMBERSHIP_SIGMA_M) ** 2


def _nearest_shadow(solid: Solid, region: Region, shadow: Mask) -> tuple[float, float]:
    """Return the distance of the nearest simulated shadow, m, and the plausibility of its solid's size."""
    image = image_row_sums(region, CORRELATION_AREA)
    assert image is not None
    rows, columns = np.nonzero(shadow)
    along_m = 0.5 * float(rows.min() + rows.max() + 1) * region.row_spacing_m
    near_m = region.first_ground_range_m + float(np.quantile(columns, 0.05)) * region.column_spacing_m
    aside_m, before_m, behind_m = _PLACE_M
    place = (
        (along_m - aside_m, along_m + aside_m, _PLACE_GRAIN_M),
        (near_m - before_m, near_m + behind_m, _PLACE_GRAIN_M),
    )
    low, high, grain = np.array(place + _SIZES[solid]).T
    box = SearchBox(low, high, (np.arange(low.size) == low.size - 1) & (solid in _TURNS), grain)

    def distances(points: Array) -> Array:
        found = np.empty(len(points))
        for k, hypothesis in enumerate(hypotheses_of(solid, _whole(solid, points))):
            observed, simulated = _around(shadow, shadow_mask(solid, hypothesis, image))
            gap_m = contour_distance_m(
                observed, simulated, region.row_spacing_m, region.column_spacing_m, quantile=_QUANTILE
            )
            found[k] = min(gap_m, _FAR_M)
        return found

    best = walk(distances, box, look_around(distances, box, _N_STARTS, _N_WALKS), _N_STEPS, _N_TRIES, first_stride=2.0)
    return float(best.cost[0]), plausibility(solid, _whole(solid, box.points(best.unit[:1]))[0, 2:])


def _whole(solid: Solid, points: Array) -> Array:
    """Complete points with all parameters of a class: cones of one slope, nothing buried."""
    if solid == "truncated_cone":
        return np.insert(points, 3, _TOP_SHARE, axis=1)
    return np.column_stack((points, np.zeros(len(points))))


def _around(one: Mask, other: Mask) -> tuple[Mask, Mask]:
    """Crop both by the rows and columns that neither reaches, which are in no distance."""
    either = one | other
    rows, columns = np.flatnonzero(either.any(axis=1)), np.flatnonzero(either.any(axis=0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return one[part], other[part]


def mass_as_paper(region: Region, shadow: Mask) -> Array:
    """Return (32,) mass of one view by the source paper's route."""
    return appriou_mass(shadow_evidence(region, shadow), _QUALITY, temperature=1.0)


def mass_of_one(seen: LikelihoodView, temperature: float = TEMPERATURE) -> Array:
    """Return (32,) mass of one view."""
    return view_mass(seen.evidence, _QUALITY, temperature)


def mass_of_two(looks: Sequence[LikelihoodView], temperature: float = TEMPERATURE) -> Array:
    """Return (32,) mass of two views at right angles."""
    views = [
        ViewMass(
            mass=mass_of_one(seen, temperature),
            aspect_rad=0.5 * math.pi * number,
            half_turn_symmetric=seen.half_turn_symmetric,
        )
        for number, seen in enumerate(looks)
    ]
    return combine(views).mass


def belief_rows(masses: Array, names: Sequence[ContactClass]) -> list[BeliefRow]:
    """Return a row per class present; masses: (n, 32), of objects with these true classes."""
    truth = np.array([FRAME.index(name) for name in names])
    beliefs, probability = belief(masses)[:, [subset(name) for name in FRAME]], pignistic(masses)
    right = decided(probability) == truth
    rows = []
    for index, name in enumerate(FRAME):
        of_class = truth == index
        if of_class.any():
            rows.append(
                BeliefRow(
                    name=name,
                    beliefs=np.median(beliefs[of_class], axis=0),
                    total=float(np.median(beliefs[of_class].sum(axis=1))),
                    pair=float(np.median(masses[of_class, _PAIR])),
                    ignorance=float(np.median(masses[of_class, EVERYTHING])),
                    probability=float(np.median(probability[of_class, index])),
                    correct=float(right[of_class].mean()),
                )
            )
    return rows


def decided(probability: Array) -> NDArray[np.intp]:
    """Return (n,) index of the most probable class of (n, 5), -1 for a tie, which decides nothing."""
    ordered = np.sort(probability, axis=1)
    return np.where(ordered[:, -1] > ordered[:, -2] + 1e-9, probability.argmax(axis=1), -1)


def reliability(masses: Array, names: Sequence[ContactClass]) -> list[Bin]:
    """Sort promises and outcomes of masses (n, 32) by the probability of the winning class.

    Bins without any are left out.
    """
    probability = pignistic(masses)
    promised, right = probability.max(axis=1), decided(probability) == np.array([FRAME.index(name) for name in names])
    bins = np.searchsorted(_BIN_EDGES, promised, side="right")
    return [
        Bin(int((bins == index).sum()), float(promised[bins == index].mean()), float(right[bins == index].mean()))
        for index in range(len(_BIN_EDGES) + 1)
        if (bins == index).any()
    ]


def contour_wins(seen: LikelihoodView) -> bool:
    """Report whether the free contour explains a view better than every solid."""
    return seen.evidence["clutter"].nll < min(seen.evidence[solid].nll for solid in SOLIDS)


def clutter_without_sizes(seen: LikelihoodView) -> bool:
    """Report whether a view is called clutter if every size is as plausible as any other."""
    unsized = {name: ClassEvidence(nll=item.nll) for name, item in seen.evidence.items()}
    return bool(decided(pignistic(view_mass(unsized, _QUALITY))[np.newaxis])[0] == FRAME.index("clutter"))


def paper_rows() -> list[BeliefRow]:
    """Return the figures that the source paper prints; the rest is not known."""
    nan = math.nan
    return [
        BeliefRow(
            name, np.array([printed.get(other, nan) for other in FRAME]), sum(printed.values()), nan, nan, nan, nan
        )
        for name, printed in PAPER.items()
    ]


def calibration_of(masses: Array, names: Sequence[ContactClass], temperature: float) -> Calibrated:
    """Measure how well the pignistic probabilities of masses (n, 32) hold."""
    truth = np.array([FRAME.index(name) for name in names])
    probability = pignistic(masses)
    log_loss = -float(np.log(probability[np.arange(len(truth)), truth]).mean())
    return Calibrated(temperature, log_loss, calibration_error(probability.max(axis=1), decided(probability) == truth))


def calibrations(scene_objects: Sequence[Judged], temperature: float) -> tuple[Calibrated, Calibrated]:
    """Calibrate single views and pairs."""
    singles = np.array([mass_of_one(seen, temperature) for _, looks in scene_objects for seen in looks])
    pairs = np.array([mass_of_two(looks, temperature) for _, looks in scene_objects])
    names = [name for name, _ in scene_objects]
    return calibration_of(singles, [name for name in names for _ in range(2)], temperature), calibration_of(
        pairs, names, temperature
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench beliefs`."""
    parser.add_argument(
        "--objects", type=count, default=50, help="objects drawn, and as many to calibrate with (default 50)"
    )


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code."""
    drawn = draw_labelled_objects(chosen.objects, HELD_OUT_SEED)
    names = [scene_object.name for scene_object in drawn]
    looks = [looks_at(scene_object) for scene_object in drawn]
    ours = np.array([mass_of_one(first) for first, _ in looks])
    papers = np.array(
        [
            mass_as_paper(scene_object.views[0], first.shadow)
            for scene_object, (first, _) in zip(drawn, looks, strict=True)
        ]
    )
    both = np.array([mass_of_two(pair) for pair in looks])
    print(
        f"{chosen.objects} objects; medians of beliefs, their sum, masses on 'sphere or cone' and on 'any', "
        "probability of the true class\n"
    )
    _print_rows("printed in the source paper, one view of each", paper_rows())
    _print_rows("the source paper's route derived anew, one view", belief_rows(papers, names))
    _print_rows("ours, one view", belief_rows(ours, names))
    _print_rows("ours, two views at right angles", belief_rows(both, names))
    words = f"{_ambiguous(papers, names)} by the source paper's route, {_ambiguous(ours, names)} by ours"
    print(f"spheres and cones with more than a third of their mass on 'sphere or cone': {words}\n")
    singles = [seen for pair in looks for seen in pair]
    of_rocks = [seen for name, pair in zip(names, looks, strict=True) for seen in pair if name == "clutter"]
    print(
        f"of {len(of_rocks)} views of clutter the free contour explains {sum(map(contour_wins, of_rocks))} better than "
        "every solid;"
    )
    print(f"without plausible sizes {sum(map(clutter_without_sizes, of_rocks))} would be called clutter\n")
    print(f"{'views':>5}{'promised':>10}{'right':>8}   by probability of the winning class, one view")
    for entry in reliability(
        np.array([mass_of_one(seen) for seen in singles]), [name for name in names for _ in range(2)]
    ):
        print(f"{entry.n_views:>5}{entry.promised:>10.3f}{entry.right:>8.3f}")
    print()
    training = draw_labelled_objects(chosen.objects, TRAINING_SEED)
    _print_calibration(
        [(scene_object.name, looks_at(scene_object)) for scene_object in training], list(zip(names, looks, strict=True))
    )
    return 0


def _print_rows(route: str, rows: Sequence[BeliefRow]) -> None:
    print(f"{route}\n{'true class':<16}" + "".join(f"{name:>9}" for name in _HEADINGS))
    for row in rows:
        figures = (*row.beliefs.tolist(), row.total, row.pair, row.ignorance, row.probability, row.correct)
        print(f"{row.name:<16}" + "".join(f"{'-':>9}" if math.isnan(value) else f"{value:>9.3f}" for value in figures))
    print()


def _ambiguous(masses: Array, names: Sequence[ContactClass]) -> str:
    of_pair = [name in ("sphere", "truncated_cone") for name in names]
    return f"{(masses[of_pair, _PAIR] > _AMBIGUOUS).sum()} of {sum(of_pair)}"


def _print_calibration(training: Sequence[Judged], held_out: Sequence[Judged]) -> None:
    print(
        f"{'calibration':<14}{'temperature':>12}{'log-loss of training':>22}{'of others':>11}{'calibration error':>19}"
    )
    for index, views in enumerate(("one view", "two views")):
        tried = [calibrations(training, temperature)[index] for temperature in TEMPERATURES]
        best = min(tried, key=lambda entry: entry.log_loss)
        for calibrated in (tried[TEMPERATURES.index(TEMPERATURE)], best):
            other = calibrations(held_out, calibrated.temperature)[index]
            print(
                f"{views:<14}{calibrated.temperature:>12.1f}{calibrated.log_loss:>22.3f}{other.log_loss:>11.3f}{other.error:>19.3f}"
            )
