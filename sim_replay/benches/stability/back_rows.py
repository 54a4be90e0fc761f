"""Rows of classification, contacts, geodesy and clearance."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from functools import partial
from types import SimpleNamespace
from typing import Any, Final

import mpmath
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import EVERYTHING, N_SUBSETS, dempster, yager
from auv_mcm.classify.likelihood import image_row_sums, labels_cost
from auv_mcm.classify.odds import share_of_ratio, shipped_odds
from auv_mcm.clearance.clearance_map import clearance_over, unsearched
from auv_mcm.clearance.residual import SHAPE, remaining_about
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.contacts import background
from auv_mcm.contacts.assignment import cheapest_columns
from auv_mcm.contacts.ledger import fused_position
from auv_mcm.contacts.pairing import MIN_COVARIANCE_M2, squared_deviation
from auv_mcm.detect.belief import odds_of, probability
from auv_mcm.geometry.geodesy import FLATTENING, SEMI_MAJOR_M, LocalFrame, ecef_to_geodetic, geodetic_to_ecef
from auv_mcm.geometry.shadow import shadow_height_m
from auv_mcm.kernels import shape, speckle, trws
from auv_mcm.kernels.shape import Solid
from auv_mcm.solids.shapes import TruncatedCone, view_shape
from sim_replay.benches.stability.confirmation_rows import labels_of, region_of
from sim_replay.benches.stability.rows import (
    Exact,
    Found,
    NumberRow,
    Watch,
    absolute,
    each,
    exact,
    random_of,
    relative,
    unlike,
)

Values = NDArray[np.float64]

GRID: Final = 1 << 20
"""Masses that are multiples of 1 / GRID are whole numbers to the reference."""


# --- classification


def _explained(gain: float, watch: Watch, _: bool) -> Found:
    """Compare what labels explain with the same sums of 50 digits, in shares of the cost."""
    region, labels = region_of(gain), labels_of()
    image = image_row_sums(region, 1.5)
    found = watch(labels_cost, region, labels, 1.5)
    assert image is not None
    ordered = sorted(Fraction(value) for value in region.intensity.ravel().tolist())
    floor = exact((ordered[899] + ordered[900]) / 2) * mpmath.power(1 - mpmath.mpf(1) / 9, -3)
    capped = [min(exact(value) / floor, mpmath.mpf(3)) for value in region.intensity.ravel().tolist()]
    mean_of_all = mpmath.fsum(capped) / len(capped)
    cost = mpmath.mpf(0)
    for label in (BACKGROUND, SHADOW, HIGHLIGHT):
        values = [
            value / mean_of_all for value, own in zip(capped, labels.ravel().tolist(), strict=True) if own == label
        ]
        mean = mpmath.fsum(values) / len(values)
        cost += len(values) * mpmath.log(mean) + mpmath.fsum(values) / mean - len(values)
    return Found(relative([found], [cost * mpmath.mpf(image.samples_per_pixel)]))


_HYPOTHESES: Final[dict[Solid, tuple[float, ...]]] = {
    "sphere": (1.8, 17.4, 1.0, 0.4, 0.1, 0.0, 0.0, 0.0),
    "cylinder": (1.8, 17.4, 1.0, 0.25, 1.4, 0.4, 0.05, 0.0),
    "truncated_cone": (1.8, 17.4, 1.0, 0.49, 0.25, 0.47, 0.0, 0.0),
    "wedge": (1.8, 17.4, 1.0, 1.0, 0.7, 0.4, 0.3, 0.0),
}


def _on_threads(watch: Watch, quick: bool) -> Found:
    """Count the numbers in which field, speckle and solids' costs differ on four threads at once from those alone."""

    def work(seed: int) -> tuple[Any, ...]:
        region = region_of(seed=seed)
        unary = np.ascontiguousarray(np.stack([region.intensity, 1.0 / region.intensity, region.intensity**2], axis=2))
        image = image_row_sums(region, 1.5)
        assert image is not None
        return (
            trws.trws(unary, np.full(4, 0.3), 6).labels,
            speckle.half_differences(region.intensity, region.valid, (1, 2), 3),
            *(shape.shape_costs(solid, np.array([fields]), image).cost for solid, fields in _HYPOTHESES.items()),
        )

    seeds = range(4 if quick else 40)
    alone = [watch(work, seed) for seed in seeds]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(work, seeds))
    return Found(sum(unlike(one, other) for one, other in zip(alone, together, strict=True)))


def _shadow_of_nothing(watch: Watch, _: bool) -> Found:
    """Compare where shadows of cones of next to no height end with similar triangles, relative to the range."""
    altitude_m, place_m, radius_m = 5.0, 20.0, 0.4
    found, wanted = [], []
    for height_m in (1e-12, 1e-9, 1e-6, 1e-3, 0.5):
        cone = TruncatedCone(base_radius_m=radius_m, top_radius_m=radius_m, height_m=height_m)
        view = watch(view_shape, cone, np.zeros(1), place_m, altitude_m)
        found.append(float(view.shadow_end_m[0]))
        wanted.append(
            (Fraction(place_m) + Fraction(radius_m))
            * Fraction(altitude_m)
            / (Fraction(altitude_m) - Fraction(height_m))
        )
    return Found(relative(found, wanted))


def _shadow_height(watch: Watch, _: bool) -> Found:
    found, wanted, condition = [], [], 0.0
    for altitude_m, top_m in itertools.product((0.3, 5.0, 200.0), (0.0, 0.1, 20.0, 150.0)):
        for length_m in (0.0, 1e-9, 1e-6, 1e-3, 0.5, 40.0):
            end_m = top_m + length_m
            found.append(watch(shadow_height_m, altitude_m, top_m, end_m))
            top, end = (mpmath.hypot(mpmath.mpf(place), mpmath.mpf(altitude_m)) for place in (top_m, end_m))
            wanted.append(mpmath.mpf(altitude_m) * (1 - top / end))
            if length_m > 0.0:
                condition = max(condition, top_m / (end_m - top_m))
    return Found(relative(found, wanted), condition=condition)


def _mine_odds(watch: Watch, _: bool) -> Found:
    """Compare log-odds of the shipped weights with sums of fractions, in nats."""
    worst = 0.0
    for seed in range(3):
        for weights in (shipped_odds("cascade").detector, shipped_odds("contrast").detector):
            names = sorted(set(weights.weights) | {name for tree in weights.trees for name, *_ in tree.ask})
            features = dict(zip(names, (10.0 ** random_of(seed).uniform(-30.0, 2.0, len(names))).tolist(), strict=True))
            total = Fraction(weights.offset)
            total += sum((Fraction(w) * Fraction(features[name]) for name, w in weights.weights.items()), Fraction(0))
            for tree in weights.trees:
                place = 0 if tree.ask else -1
                while place >= 0:
                    name, threshold, no, yes = tree.ask[place]
                    place = yes if features[name] > threshold else no
                total += Fraction(tree.nats[-1 - place])
            worst = max(worst, absolute([watch(weights.log_odds, features)], [total]))
    return Found(worst)


def _probabilities(watch: Watch, _: bool) -> Found:
    odds = [-700.0, -40.0, -12.0, -1e-9, 0.0, 1e-300, 3.0, 12.0, 40.0, 700.0]
    found = [watch(probability, value) for value in odds] + [watch(share_of_ratio, 0.0)]
    wanted: list[Exact] = [1 / (1 + mpmath.exp(-mpmath.mpf(value))) for value in odds]
    back = [1e-6, 0.1, 0.5, 0.9]
    found += [watch(odds_of, p) for p in back]
    wanted += [Fraction(1, 2)] + [mpmath.log(mpmath.mpf(p) / (1 - mpmath.mpf(p))) for p in back]
    return Found(relative(found, wanted))


def _null(asked: tuple[float, float], watch: Watch, _: bool) -> Found:
    """Measure how far Newton's next step, of 50 digits, would move the background found, in nats at a knot."""
    (area_km2, gain), prior = asked, background.shipped_background().cascade
    counts = np.floor(random_of(1).exponential(3.0, background.N_BINS) * gain)
    values, covariance = watch(background.known_background, counts, area_km2, prior)
    weights = background.interpolation(background.LEVELS_NATS + 0.5 * background.BIN_NATS)
    n_knots = len(values)
    precision = mpmath.matrix(np.array(prior.covariance).tolist()) ** -1
    off = mpmath.matrix([mpmath.mpf(a) - mpmath.mpf(b) for a, b in zip(values.tolist(), prior.mean, strict=True)])
    gradient, information = -(precision * off), precision.copy()
    for n, row in zip(counts.tolist(), weights.tolist(), strict=True):
        known = [k for k in range(n_knots) if row[k] != 0.0]
        level = mpmath.fsum(mpmath.mpf(row[k]) * mpmath.mpf(values[k]) for k in known)
        expected = mpmath.mpf(area_km2) * mpmath.mpf(background.BIN_NATS) * mpmath.exp(level)
        for k in known:
            gradient[k] += (mpmath.mpf(n) - expected) * mpmath.mpf(row[k])
            for j in known:
                information[k, j] += expected * mpmath.mpf(row[k]) * mpmath.mpf(row[j])
    step = mpmath.lu_solve(information, gradient)
    return Found(float(max(abs(value) for value in step)), condition=float(np.linalg.cond(covariance)))


def whole_masses(seed: int, n: int) -> list[list[int]]:
    """Draw n masses in units of 1 / GRID, every other one of a few sets only."""
    random = random_of(seed)
    masses = []
    for k in range(n):
        weights = random.exponential(size=N_SUBSETS) ** 6 * (random.random(N_SUBSETS) < (1.0, 0.2)[k % 2])
        weights[[0, EVERYTHING]] = 0.0
        weights[1 + k % EVERYTHING] += 1.0
        mass: list[int] = np.floor(weights / weights.sum() * (GRID - GRID // 20)).astype(int).tolist()
        mass[EVERYTHING] += GRID - sum(mass)
        masses.append(mass)
    return masses


def exact_chain(masses: list[list[int]]) -> list[int]:
    """Combine masses conjunctively, in units of GRID ** -len(masses)."""
    joint = masses[0]
    for mass in masses[1:]:
        fused = [0] * N_SUBSETS
        for a, share in enumerate(joint):
            for b, other in enumerate(mass):
                fused[a & b] += share * other
        joint = fused
    return joint


def _views(n: int, rule: str, watch: Watch, quick: bool) -> Found:
    worst = 0.0
    for seed in range(1 if quick else 4):
        masses = whole_masses(seed, n)
        joint, total = exact_chain(masses), GRID ** len(masses)
        stack = np.array(masses) / GRID
        if rule == "dempster":
            found = watch(dempster, stack)
            worst = max(worst, relative(found.mass.tolist(), [Fraction(m, total - joint[0]) for m in [0, *joint[1:]]]))
            unit = mpmath.log(mpmath.mpf(total - joint[0]) / total)
            worst = max(worst, relative([float(found.log_agreement)], [unit]))
        else:
            wanted = [0, *joint[1:EVERYTHING], joint[EVERYTHING] + joint[0]]
            worst = max(worst, relative(watch(yager, stack).tolist(), [Fraction(m, total) for m in wanted]))
    return Found(worst)


# --- contacts, geodesy, clearance


def _covariances(ratio: float, n: int) -> list[Values]:
    """Draw covariances, m², whose axes are as far apart as the ratio."""
    random = random_of(9)
    drawn = []
    for angle in random.uniform(0.0, math.pi, n).tolist():
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        both = turn @ np.diag([1.0, ratio]) @ turn.T
        drawn.append(0.5 * (both + both.T))
    return drawn


def _deviation(ratio: float, watch: Watch, quick: bool) -> Found:
    covariances = _covariances(ratio, 8 if quick else 80)
    offsets = random_of(2).normal(size=(len(covariances), 2))
    found, wanted, condition = [], [], 0.0
    nothing = np.zeros((2, 2))
    for one, offset in zip(covariances, offsets, strict=True):
        found.append(watch(squared_deviation, offset, one, nothing))
        (a, b), (_, d) = [[Fraction(v) for v in row] for row in (one + MIN_COVARIANCE_M2).tolist()]
        x, y = (Fraction(v) for v in offset.tolist())
        wanted.append((d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b))
        condition = max(condition, float(np.linalg.cond(one + MIN_COVARIANCE_M2)))
    return Found(relative(found, wanted), condition=condition)


def _merged(latitude_deg: float, ratio: float, watch: Watch, quick: bool) -> Found:
    """Compare the place merged from 60 views with the same sums of fractions in the same plane, m."""
    n = 10 if quick else 60
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=179.99999)
    offsets = random_of(4).normal(0.0, 2.0, (n, 2))
    offsets[0] = 0.0
    latitude, longitude, _ = frame.to_geodetic(np.column_stack([offsets, np.zeros(n)]))
    covariances = _covariances(ratio, n)
    shares = [2.0 ** -(k % 8) for k in range(n)]  # of the likeliest view's p_mine
    views: Any = tuple(
        SimpleNamespace(latitude_deg=lat, longitude_deg=lon, covariance_m2=one, squint_rad=0.0, p_mine=0.9 * share)
        for lat, lon, one, share in zip(latitude.tolist(), longitude.tolist(), covariances, shares, strict=True)
    )
    merged = watch(fused_position, views)
    found = LocalFrame(latitude_deg=views[0].latitude_deg, longitude_deg=views[0].longitude_deg).to_enu(
        merged[0], merged[1], 0.0
    )[:2]
    total, moment = [Fraction(0)] * 3, [Fraction(0)] * 2
    for covariance, share, (x, y) in zip(covariances, shares, offsets.tolist(), strict=True):
        (a, b), (_, d) = [[Fraction(v) for v in row] for row in (covariance + MIN_COVARIANCE_M2).tolist()]
        determinant = (a * d - b * b) / Fraction(min(2.0 * share, 1.0))
        p, q, r = d / determinant, -b / determinant, a / determinant
        total = [total[0] + p, total[1] + q, total[2] + r]
        moment = [moment[0] + p * Fraction(x) + q * Fraction(y), moment[1] + q * Fraction(x) + r * Fraction(y)]
    determinant = total[0] * total[2] - total[1] ** 2
    wanted = [
        (total[2] * moment[0] - total[1] * moment[1]) / determinant,
        (total[0] * moment[1] - total[1] * moment[0]) / determinant,
    ]
    return Found(absolute(found.tolist(), wanted), condition=float(np.linalg.cond(covariances[0] + MIN_COVARIANCE_M2)))


def _assignment(scale: float, watch: Watch, quick: bool) -> Found:
    worst = 0.0
    for seed in range(4 if quick else 40):
        cost = random_of(seed).exponential(size=(5, 6)) * scale
        chosen = watch(cheapest_columns, cost).tolist()
        fractions = [[Fraction(v) for v in row] for row in cost.tolist()]
        best = min(sum(fractions[k][c] for k, c in enumerate(way)) for way in itertools.permutations(range(6), 5))
        own = sum(fractions[k][c] for k, c in enumerate(chosen))
        worst = max(worst, float((own - best) / best))
    return Found(worst)


_LATITUDES_DEG: Final = (0.0, 1e-12, 43.0, 89.99, -89.99, 90.0)  # equator to poles, and next to both
_LONGITUDES_DEG: Final = (0.0, 5.5, 179.9999999, -180.0)  # up to the antimeridian


def _to_ecef(latitude_deg: float, longitude_deg: float, height_m: float) -> list[mpmath.mpf]:
    latitude, longitude = (mpmath.mpf(angle) * mpmath.pi / 180 for angle in (latitude_deg, longitude_deg))
    flattening, major = 1 / (1 / mpmath.mpf(FLATTENING)), mpmath.mpf(SEMI_MAJOR_M)
    squared = flattening * (2 - flattening)
    vertical = major / mpmath.sqrt(1 - squared * mpmath.sin(latitude) ** 2)
    axis = (vertical + height_m) * mpmath.cos(latitude)
    return [
        axis * mpmath.cos(longitude),
        axis * mpmath.sin(longitude),
        (vertical * (1 - squared) + height_m) * mpmath.sin(latitude),
    ]


def _there(watch: Watch, _: bool) -> Found:
    worst = 0.0
    for place in itertools.product(_LATITUDES_DEG, _LONGITUDES_DEG, (-11_000.0, 0.0, 1000.0)):
        worst = max(worst, absolute(watch(geodetic_to_ecef, *place).tolist(), _to_ecef(*place)))
    return Found(worst)


def _back(watch: Watch, _: bool) -> Found:
    """Measure how far the place found lies from the one asked for, m."""
    worst = 0.0
    for place in itertools.product(_LATITUDES_DEG, _LONGITUDES_DEG, (-11_000.0, 0.0, 1000.0)):
        ecef = geodetic_to_ecef(*place)
        found = watch(ecef_to_geodetic, ecef)
        worst = max(worst, absolute(ecef.tolist(), _to_ecef(*(float(part) for part in found))))
    return Found(worst)


def _plane(latitude_deg: float, watch: Watch, _: bool) -> Found:
    """Compare a survey's places in its plane, out to 20 km, with 50 digits, m."""
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=179.9999)
    rotation = _rotation(latitude_deg, 179.9999)
    origin = _to_ecef(latitude_deg, 179.9999, 0.0)
    worst = 0.0
    for enu in ([1e-3, -1e-3, 0.0], [1000.0, 500.0, -30.0], [-20_000.0, 9000.0, 0.0]):
        latitude, longitude, height = watch(frame.to_geodetic, np.array(enu))
        place = float(latitude), float(longitude), float(height)
        offset = [a - b for a, b in zip(_to_ecef(*place), origin, strict=True)]
        wanted = [mpmath.fsum(axis[k] * offset[k] for k in range(3)) for axis in rotation]
        worst = max(worst, absolute(watch(frame.to_enu, *place).tolist(), wanted), absolute(enu, wanted))
    return Found(worst)


def _rotation(latitude_deg: float, longitude_deg: float) -> list[list[mpmath.mpf]]:
    latitude, longitude = (mpmath.mpf(angle) * mpmath.pi / 180 for angle in (latitude_deg, longitude_deg))
    (s, c), (sl, cl) = ((mpmath.sin(angle), mpmath.cos(angle)) for angle in (latitude, longitude))
    return [[-sl, cl, mpmath.mpf(0)], [-s * cl, -s * sl, c], [c * cl, c * sl, s]]


def _remaining(watch: Watch, _: bool) -> Found:
    """Compare the probability of no mine left, and hold quantiles to the exact sums of their probabilities."""
    worst = 0.0
    for expected in (0.0, 1e-12, 1e-3, 1.0, 30.0, 2000.0):
        found = watch(remaining_about, expected)
        none = mpmath.power(1 + mpmath.mpf(expected) / SHAPE, -SHAPE)
        worst = max(worst, relative([found.p_none], [none]))
        share, reached, total = mpmath.mpf(expected) / (mpmath.mpf(expected) + SHAPE), none, none
        n = 0
        while total < mpmath.mpf("0.95"):
            reached *= share * (SHAPE + n) / (n + 1)
            total += reached
            n += 1
        worst = max(worst, float(abs(n - found.at_most_95)))
    return Found(worst)


def _detected(watch: Watch, _: bool) -> Found:
    """Compare the probability of detection of a cell with that of its miss exponent of 50 digits."""
    ground = clearance_over(unsearched(43.0, 5.0, 4.0), 0, 0, (1, 60))
    exponents = (10.0 ** np.linspace(-300.0, 3.0, 60)).tolist()
    ground.exponent[0] = exponents
    found = watch(lambda: ground.p_detected)[0]
    return Found(relative(found.tolist(), [-mpmath.expm1(-mpmath.mpf(value)) for value in exponents]))


def back_rows() -> list[NumberRow]:
    """List the rows of classification and what follows."""
    return [*_classification_rows(), *_place_rows()]


def _classification_rows() -> list[NumberRow]:
    ratio, mp, gains = "fractions", "mpmath", (1e-30, 1.0, 1e30)
    return [
        *each("labels' likelihood", "gain {:g}", mp, "relative", 1e-12, _explained, gains),
        NumberRow("threads", "field, speckle and solids, four at once", "alone", "numbers unlike", 0.0, _on_threads),
        NumberRow("solids' shadows", "heights 1e-12 to 0.5 m", ratio, "relative", 1e-15, _shadow_of_nothing),
        NumberRow(
            "shadow height", "shadows of 0 to 40 m, altitude 0.3 to 200 m", mp, "relative", 1e-15, _shadow_height
        ),
    ]


def _place_rows() -> list[NumberRow]:
    ratio, mp, latitudes = "fractions", "mpmath", (0.0, 43.0, 89.99, -90.0)
    counts = ((1e-4, 0.0), (1e-4, 1.0), (0.1, 1.0), (100.0, 1000.0))
    return [
        NumberRow("odds", "shipped trees, features 1e-30 to 100", ratio, "nats", 1e-12, _mine_odds),
        NumberRow("odds", "probabilities of -700 to 700 nats", mp, "relative", 1e-15, _probabilities),
        *each("background", "{0[0]:g} km², counts times {0[1]:g}", mp, "nats", 1e-9, _null, counts),
        *each("belief", "60 views, {}", ratio, "relative", 1e-12, partial(_views, 60), ("dempster", "yager")),
        *each("association", "axes 1 to {:g} m²", ratio, "relative", 1e-9, _deviation, (1.0, 1e-6, 1e6)),
        *each("association", "axes 1 to {:g} m²", ratio, "relative", 1e-3, _deviation, (1e12,)),
        *each("association", "costs times {:g}", "all assignments", "relative", 1e-14, _assignment, (1e-30, 1.0, 1e30)),
        *each("merging", "latitude 43°, axes 1 to {:g} m²", ratio, "m", 1e-6, partial(_merged, 43.0), (1.0, 1e6)),
        *each("merging", "latitude 89.99°, axes 1 to {:g} m²", ratio, "m", 1e-6, partial(_merged, 89.99), (1e6,)),
        *each("merging", "latitude 43°, axes 1 to {:g} m²", ratio, "m", 1e-3, partial(_merged, 43.0), (1e12,)),
        NumberRow("geodesy", "to Earth-centred, poles, antimeridian", mp, "m", 4e-9, _there),
        NumberRow("geodesy", "from Earth-centred, poles, antimeridian", mp, "m", 8e-9, _back),
        *each("projection", "latitude {:g}°", mp, "m", 1e-8, _plane, latitudes),
        NumberRow("clearance", "0 to 2000 mines left", mp, "relative", 1e-12, _remaining),
        NumberRow("clearance", "miss exponents 1e-300 to 1000", mp, "relative", 1e-15, _detected),
    ]
