"""Rows of confirmation."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import partial
from typing import Final

import mpmath
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.likelihoods import (
    BackgroundLaw,
    background_cost,
    gamma_cost,
    inverse_trigamma,
    log_bessel_k,
    trigamma,
)
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import COARSE, snake_settings
from auv_mcm.kernels import mean_field, snake, speckle, trws
from sim_replay.benches.stability.rows import Found, NumberRow, Watch, absolute, each, random_of, relative, unlike

Values = NDArray[np.float64]


def _bessel(watch: Watch, quick: bool) -> Found:
    worst = 0.0
    for order in (0.0, 0.7, 5.0, 49.5):
        x = 10.0 ** np.linspace(-3.5, 5.5, 6 if quick else 40)
        found = watch(log_bessel_k, order, x)
        wanted = [mpmath.log(mpmath.besselk(mpmath.mpf(order), mpmath.mpf(value))) for value in x.tolist()]
        worst = max(
            worst,
            absolute([f / max(abs(f), 1.0) for f in found.tolist()], [w / max(abs(float(w)), 1.0) for w in wanted]),
        )
    return Found(worst)


def _trigamma(watch: Watch, quick: bool) -> Found:
    x = (10.0 ** np.linspace(-4.0, 8.0, 12 if quick else 120)).tolist()
    return Found(relative([watch(trigamma, value) for value in x], [mpmath.psi(1, mpmath.mpf(value)) for value in x]))


def _inverse_trigamma(watch: Watch, quick: bool) -> Found:
    """Compare the value at the place found with the value asked for."""
    values = (10.0 ** np.linspace(-7.0, 7.0, 8 if quick else 60)).tolist()
    found = [watch(inverse_trigamma, value) for value in values]
    return Found(
        max(abs(float(mpmath.psi(1, mpmath.mpf(x)) / value - 1)) for x, value in zip(found, values, strict=True))
    )


def _law_cost(nu: float, gain: float, watch: Watch, quick: bool) -> Found:
    """Compare costs of intensities with the law's own, in nats or shares of the cost, whichever is more."""
    looks = 1.7
    intensity = 10.0 ** np.linspace(-6.5, 3.0, 12 if quick else 100) * gain
    found = watch(background_cost, intensity, gain, BackgroundLaw(looks, nu))
    if math.isinf(nu):
        other = watch(gamma_cost, intensity, gain, looks)
        found = np.where(found == other, found, np.nan)
    wanted: list[mpmath.mpf] = []
    log_mean = mpmath.log(mpmath.mpf(gain))
    n = mpmath.mpf(looks)
    for value in intensity.tolist():
        ratio = mpmath.mpf(value) / mpmath.mpf(gain)
        if math.isinf(nu):
            wanted.append(n * (ratio + log_mean))
            continue
        v = mpmath.mpf(nu)
        bessel = mpmath.log(mpmath.besselk(v - n, 2 * mpmath.sqrt(n * v * ratio)))
        own = (n - v) / 2 * mpmath.log(ratio) - bessel - mpmath.log(2) + mpmath.loggamma(v)
        wanted.append(own - (n + v) / 2 * mpmath.log(n * v) + n * mpmath.log(n) + n * log_mean)
    scale = [max(abs(float(w)), 1.0) for w in wanted]
    return Found(
        absolute(
            [f / s for f, s in zip(found.tolist(), scale, strict=True)],
            [w / s for w, s in zip(wanted, scale, strict=True)],
        )
    )


def _field(scale: float, watch: Watch, _: bool) -> Found:
    """Hold energies to fractions, and bounds to the minimum over all labels of small fields."""
    worst = 0.0
    every = np.array(list(itertools.product(range(3), repeat=9)))
    for seed in range(3):
        random = random_of(seed)
        unary = random.exponential(size=(3, 3, 3)) * scale
        weight = random.exponential(size=4) * 0.5 * scale
        found = watch(trws.trws, unary, weight, 60)
        # Rounding of an extended number decides between no two labellings that differ.
        energies = unary.reshape(9, 3).astype(np.longdouble)[np.arange(9), every].sum(axis=1)
        for one, other, edge in _EDGES:
            energies += np.longdouble(weight[edge]) * (every[:, one] != every[:, other])
        best = _energy(every[int(energies.argmin())].tolist(), unary, weight)
        own = _energy(found.labels.ravel().tolist(), unary, weight)
        worst = max(worst, relative([found.energy, watch(trws.energy_of, found.labels, unary, weight)], [own, own]))
        worst = max(worst, float((Fraction(found.lower_bound) - best) / best))
    return Found(worst)


_EDGES: Final = tuple(
    (3 * row + column, 3 * (row + down) + column + right, edge)
    for row, column in itertools.product(range(3), repeat=2)
    for edge, (down, right) in enumerate(((0, 1), (1, -1), (1, 0), (1, 1)))
    if row + down < 3 and 0 <= column + right < 3
)
"""Cells at both ends, and direction, of the edges of three by three cells."""


def _energy(labels: list[int], unary: Values, weight: Values) -> Fraction:
    total = sum((Fraction(float(unary[k // 3, k % 3, label])) for k, label in enumerate(labels)), Fraction(0))
    return total + sum(Fraction(float(weight[edge])) * (labels[one] != labels[other]) for one, other, edge in _EDGES)


def _softmin(scale: float, watch: Watch, quick: bool) -> Found:
    cost = random_of(2).normal(size=(3, 4, 5 if quick else 60)) * scale
    found = watch(mean_field.softmin, cost)
    wanted = []
    for cell in cost.reshape(3, -1).T.tolist():
        weights = [mpmath.exp(-(mpmath.mpf(value) - mpmath.mpf(min(cell)))) for value in cell]
        wanted.append([weight / sum(weights) for weight in weights])
    return Found(absolute(found.reshape(3, -1).T.ravel().tolist(), [p for cell in wanted for p in cell]))


def _speckle(watch: Watch, _: bool) -> Found:
    """Compare half mean squared differences with sums of fractions; C and numpy are held to the same."""
    worst = 0.0
    for gain, offset in ((1e-30, 0.0), (1.0, 0.0), (1.0, 1e4), (1e30, 0.0)):
        plane = (random_of(3).exponential(size=(12, 17)) + offset) * gain
        usable = random_of(4).random(plane.shape) < 0.9
        for kernel in (partial(watch, speckle.half_differences), speckle.half_differences_numpy):
            found = kernel(plane, usable, (1, 2), 3)
            for axis, lag in itertools.product((0, 1), (1, 2)):
                one, known = np.moveaxis(plane, axis, 0), np.moveaxis(usable, axis, 0)
                pairs = known[lag:] & known[:-lag]
                squares = [
                    (Fraction(a) - Fraction(b)) ** 2
                    for a, b in zip(one[lag:][pairs].tolist(), one[:-lag][pairs].tolist(), strict=True)
                ]
                wanted = sum(squares, Fraction(0)) / (2 * len(squares))
                worst = max(worst, relative([float(found[axis, (1, 2).index(lag)])], [wanted]))
    return Found(worst)


def region_of(gain: float = 1.0, seed: int = 1) -> Region:
    """Draw speckle with a highlight and a shadow, 30 rows of 12 cm and 60 columns of 6 cm."""
    intensity = random_of(seed).exponential(size=(30, 60))
    intensity[12:18, 18:24] *= 8.0
    intensity[12:18, 24:44] *= 0.05
    return Region(
        intensity=intensity * gain,
        valid=np.ones((30, 60), dtype=np.bool_),
        altitude_m=6.0,
        row_spacing_m=0.12,
        column_spacing_m=0.06,
        first_ground_range_m=16.0,
        row=15.0,
        column=22.0,
        beam_width_rad=0.007,
    )


def labels_of() -> NDArray[np.uint8]:
    """Label highlight and shadow of `region_of`."""
    labels = np.full((30, 60), BACKGROUND, dtype=np.uint8)
    labels[12:18, 18:24], labels[12:18, 24:44] = HIGHLIGHT, SHADOW
    return labels


def _box(top: float, near: float, foot: float, far: float) -> Values:
    return np.array([[top, near], [top, far], [foot, far], [foot, near]])


def _contours(gain: float, watch: Watch, _: bool) -> Found:
    """Count nodes that differ from those at gain 1."""
    ends = []
    for factor in (gain, 1.0):
        region = region_of(factor)
        table = watch(snake.window_row_sums, region.intensity, region.valid).table
        known = snake_settings(region, table, 1.5)
        start = (_box(11, 17, 19, 24), _box(11, 24, 19, 42))
        schedule = np.array(COARSE)
        ends.append(watch(snake.move_pair, table, known, schedule, *start))
    first = ends[0]
    return Found(sum(unlike(first.highlight, end.highlight) + unlike(first.shadow, end.shadow) for end in ends[1:]))


def _window_sums(kind: str, watch: Watch, _: bool) -> Found:
    """Hold a window's sums to those of its pixels rounded to 2^-20 of the mean."""
    drawn = random_of(6).exponential(size=(20, 300))
    intensity = {"gain 1e-30": drawn * 1e-30, "gain 1e30": drawn * 1e30, "offset 1e6": drawn + 1e6}[kind]
    sums = watch(snake.window_row_sums, intensity, np.ones(drawn.shape, dtype=np.bool_))
    mean = Fraction(math.fsum(intensity.ravel().tolist())) / intensity.size
    wanted = [Fraction(math.fsum(row)) / mean for row in intensity.tolist()]
    return Found(relative(sums.table[:, -1, 0].tolist(), wanted))


def confirmation_rows() -> list[NumberRow]:
    """List the rows of confirmation."""
    ratio, mp, gains = "fractions", "mpmath", (1e-30, 1.0, 1e30)
    law = "field's law"
    return [
        NumberRow(law, "ln K, orders 0 to 50, x 3e-4 to 3e5", mp, "of the value or 1", 1e-12, _bessel),
        NumberRow(law, "trigamma, 1e-4 to 1e8", mp, "relative", 1e-10, _trigamma),
        NumberRow(law, "inverse trigamma, 1e-7 to 1e7", mp, "relative", 1e-9, _inverse_trigamma),
        *each(law, "shape 0.3, gain {:g}", mp, "of the cost or 1", 3e-4, partial(_law_cost, 0.3), gains),
        *each(law, "shape 5, gain {:g}", mp, "of the cost or 1", 3e-4, partial(_law_cost, 5.0), gains),
        *each(law, "no texture, gain {:g}", mp, "of the cost or 1", 1e-12, partial(_law_cost, math.inf), gains),
        *each("Markov field", "costs times {:g}", ratio, "relative", 1e-14, _field, gains),
        *each("mean field", "costs times {:g}", mp, "absolute", 1e-14, _softmin, gains),
        NumberRow("speckle", "gain 1e-30 to 1e30, offset 1e4", ratio, "relative", 1e-10, _speckle),
        *each("contours' sums", "{}", ratio, "relative", 1e-5, _window_sums, ("gain 1e-30", "gain 1e30", "offset 1e6")),
        *each("contours", "gain {:g}", "gain 1", "numbers unlike", 0.0, _contours, (2.0**-100, 2.0**100)),
    ]
