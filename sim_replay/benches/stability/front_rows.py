"""Rows of the waterfall and of detection: transfer, range means, levelling, bottom, contrasts, cascade, peaks."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import partial

import mpmath
import numpy as np

from auv_mcm.detect.ftest import equivalent_looks, f_deviate
from auv_mcm.kernels import cascade, contrast, viterbi, waterfall_boxes, waterfall_rows, waterfall_steps
from auv_mcm.kernels.contrast import Frame, TileSums
from auv_mcm.records import VALID, Transfer
from auv_mcm.waterfall.ground import ground_edges_m, make_traces, mean_between
from auv_mcm.waterfall.transfer import to_intensity
from sim_replay.benches.stability.drawn_inputs import (
    BIG_TILE,
    INTENSITIES,
    ROUNDED,
    TILE,
    Values,
    box_count,
    box_of,
    box_sum,
    places_in,
    speckle,
    with_shadow,
    with_spike,
)
from sim_replay.benches.stability.rows import (
    Exact,
    Found,
    NumberRow,
    Watch,
    absolute,
    each,
    random_of,
    relative,
    unlike,
)

# --- waterfall


def _amplitudes(watch: Watch, _: bool) -> Found:
    samples = 10.0 ** random_of(1).uniform(-15.0, 15.0, 200)
    intensity, _ = watch(to_intensity, samples, Transfer("amplitude"))
    return Found(relative(intensity.tolist(), [Fraction(value) ** 2 for value in samples.tolist()]))


def _decibels(watch: Watch, _: bool) -> Found:
    counts = np.arange(256, dtype=np.uint8)
    intensity, _ = watch(to_intensity, counts, Transfer("log", 0.4))
    exponents = [Fraction(count) * Fraction(float(np.float32(0.04))) - 10 for count in counts.tolist()]
    return Found(
        relative(intensity.tolist(), [mpmath.power(10, mpmath.mpf(e.numerator) / e.denominator) for e in exponents])
    )


def _range_mean(kind: str, watch: Watch, quick: bool) -> Found:
    worst, single = 0.0, 0.0
    for n_samples in (1, 2, 7, 1000, 65535):
        intensity = np.tile(with_spike((n_samples,)) if kind == "spike" else INTENSITIES[kind]((n_samples,)), (1, 1))
        n_columns = min(n_samples, 8 if quick else 60)
        edges_m = np.sort(random_of(n_samples).uniform(0.0, 0.01 * (n_samples - (kind == "spike")), n_columns + 1))
        traces = watch(
            make_traces, intensity, np.ones(intensity.shape, bool), np.zeros(intensity.shape, bool), 0.005, 0.01
        )
        found = watch(mean_between, traces, edges_m[np.newaxis])
        wanted = _exact_means(intensity[0].astype(np.float64), edges_m)
        kept = found.valid[0]
        worst = max(
            worst, relative(found.intensity[0][kept].tolist(), [w for w, k in zip(wanted, kept, strict=True) if k])
        )
        sums = np.concatenate(([0.0], np.cumsum(intensity[0]))).astype(np.float32)
        low = np.float32(sums[n_samples // 2])
        if n_samples > 2 and np.isfinite(sums).all():
            true = float(intensity[0, n_samples // 2])
            single = max(single, abs(float(sums[n_samples // 2 + 1] - low) - true) / true)
    return Found(worst, single=single)


def _exact_means(values: Values, edges_m: Values) -> list[Fraction]:
    """Average samples that are constant over 1 cm each between edges, with every number as it is stored."""
    spacing, first = Fraction(0.01), Fraction(0.005)
    places = [(Fraction(edge) - first) / spacing + Fraction(1, 2) for edge in edges_m.tolist()]
    means = []
    for start, stop in itertools.pairwise(min(max(place, Fraction(0)), Fraction(len(values))) for place in places):
        first_whole, last_whole = math.ceil(start), math.floor(stop)
        if first_whole > last_whole:
            means.append(Fraction(float(values[last_whole])))
            continue
        total = Fraction(math.fsum(values[first_whole:last_whole].tolist()))
        if start < first_whole:
            total += (first_whole - start) * Fraction(float(values[first_whole - 1]))
        if stop > last_whole:
            total += (stop - last_whole) * Fraction(float(values[last_whole]))
        means.append(total / (stop - start) if stop > start else Fraction(0))
    return means


def _nadir(watch: Watch, _: bool) -> Found:
    worst = 0.0
    for first_return_m in (1e-9, 0.05, 5.0, 200.0):
        for spacing_m in (1e-4, 0.06, 2.0):
            edges = watch(ground_edges_m, np.array([first_return_m]), 40, spacing_m)[0]
            places = (np.arange(41) * spacing_m).tolist()
            worst = max(worst, relative(edges.tolist(), [mpmath.hypot(y, first_return_m) for y in places]))
    return Found(worst)


def _box_level(kind: str, watch: Watch, quick: bool) -> Found:
    shape = TILE if quick else BIG_TILE
    level = INTENSITIES[kind](shape)
    half = (9, 11)
    usable = np.ones(shape, dtype=np.bool_)
    mean, known = watch(waterfall_boxes.box_level, level, usable, half, 0.25)
    places = places_in(shape, 40)
    wanted = [Fraction(box_sum(level, place, half)) / box_count(shape, place, half) for place in places]
    if not all(known[place] for place in places):
        return Found(math.inf)
    return Found(relative([float(mean[place]) for place in places], wanted))


def _shadow_level(watch: Watch, quick: bool) -> Found:
    """Measure how far levels in a shadow larger than the box are off, in shares of the floor's level."""
    shape = TILE if quick else BIG_TILE
    level = with_shadow(shape)
    mean, _ = watch(waterfall_boxes.box_level, level, np.ones(shape, dtype=np.bool_), (9, 11), 0.25)
    places = places_in(shape, 40)
    wanted = [Fraction(box_sum(level, place, (9, 11))) / box_count(shape, place, (9, 11)) for place in places]
    return Found(absolute([float(mean[place]) for place in places], wanted))


def _angle_sums(gain: float, watch: Watch, quick: bool) -> Found:
    offset = math.log(gain)
    n_pings, n_bins = (8, 30) if quick else (128, 180)
    random = random_of(3)
    angle = np.sort(random.uniform(0.0, n_bins, (n_pings, 400)), axis=1)
    values = np.log(speckle((n_pings, 400)).astype(np.float64)) + offset
    centre = np.full(n_bins, offset)
    count, total = watch(
        waterfall_rows.angle_sums, angle, np.arange(n_pings), values, np.ones(values.shape, bool), n_bins, centre, 3.0
    )
    bins = np.minimum(angle.astype(np.int64), n_bins - 1)
    clipped = np.clip(values - offset, -3.0, 3.0)
    wanted = [Fraction(math.fsum(clipped[bins == k].tolist())) / max(int(count[k]), 1) for k in range(n_bins)]
    return Found(absolute((total / np.maximum(count, 1)).tolist(), wanted))


def _bottom(gain: float, watch: Watch, quick: bool) -> Found:
    """Compare likelihood ratios of a bottom with sums of fractions, of pings as long as a ping can be."""
    offset = math.log(gain)
    n_bins, window = (3000 if quick else 65_535), 10
    values = np.log(speckle((1, n_bins)).astype(np.float64)) + offset
    values[:, n_bins // 2 :] += 4.0
    scores = watch(waterfall_steps.step_ratios, values, np.ones(values.shape, bool), 4, window, math.log(2.0), 3.29)
    bins = sorted({n_bins // 2, n_bins - window - 1, 7, *random_of(2).integers(7, n_bins - window, 60).tolist()})
    exact_values = [Fraction(value) for value in values[0].tolist()]
    sums = [Fraction(0)]
    for value in exact_values:
        sums.append(sums[-1] + value)
    wanted = []
    for k in bins:
        near = k - max(k - window, 4)
        after_mean, near_mean = (sums[k + window] - sums[k]) / window, (sums[k] - sums[k - near]) / near
        rise, column = after_mean - near_mean, (sums[k] - sums[4]) / (k - 4)
        ratio = Fraction(near * window, near + window) * rise**2 / Fraction(3.29)
        wanted.append(ratio if rise > 0 and after_mean - column > Fraction(math.log(2.0)) else Fraction(0))
    return Found(absolute([float(scores[0, k]) for k in bins], wanted))


def _viterbi(scale: float, watch: Watch, quick: bool) -> Found:
    """Compare the worth of the best path with whole numbers; scores are those times the scale."""
    n_pings, n_bins, step = (12, 20, 2) if quick else (200, 120, 5)
    whole = random_of(8).integers(0, 1 << 20, (n_pings, n_bins))
    path = watch(viterbi.viterbi_path, whole * scale, step, 1000.0 * scale).tolist()
    best = whole[0].tolist()
    for scores in whole[1:].tolist():
        best = [
            scores[k] + max(best[j] - 1000 * abs(j - k) for j in range(max(k - step, 0), min(k + step, n_bins - 1) + 1))
            for k in range(n_bins)
        ]
    worth = sum(int(whole[p, k]) for p, k in enumerate(path)) - 1000 * sum(
        abs(b - a) for a, b in itertools.pairwise(path)
    )
    return Found(relative([float(worth)], [max(best)]))


# --- detection


def _contrast_means(kind: str, watch: Watch, _: bool) -> Found:
    plane = INTENSITIES[kind](TILE)
    mask = np.full(TILE, VALID, dtype=np.uint8)
    sums: TileSums = watch(contrast.image_sums, plane, mask, 3e38)
    box = (-3, 4, -5, 6)
    places = places_in(TILE, 40)
    flat = np.array([row * TILE[1] + column for row, column in places], dtype=np.int32)
    means, _ = watch(contrast.box_means, sums, flat, np.tile(np.array(box, dtype=np.int32), (len(flat), 1)))
    wanted = [Fraction(box_sum(plane, place, (3, 5))) / box_count(TILE, place, (3, 5)) for place in places]
    return Found(relative(means.tolist(), wanted))


def _background(watch: Watch, _: bool) -> Found:
    plane = with_shadow(TILE)
    mask = np.full(TILE, VALID, dtype=np.uint8)
    outer, hollow = (np.array(box, dtype=np.int32) for box in ((-9, 10, -12, 13), (-3, 4, -4, 5)))
    mean, known = watch(contrast.background, plane, mask, Frame(outer, hollow, 30.0), 10.0, np.float32(1e-6))
    bounded = np.minimum(plane, np.float32(10.0))
    found, wanted = [], []
    for place in places_in(TILE, 60):
        if known[place]:
            total = Fraction(box_sum(bounded, place, (9, 12))) - Fraction(box_sum(bounded, place, (3, 4)))
            found.append(float(mean[place]))
            wanted.append(total / (box_count(TILE, place, (9, 12)) - box_count(TILE, place, (3, 4))))
    return Found(relative(found, wanted))


def _variances(offset: float, watch: Watch, _: bool) -> Found:
    """Compare variances of deviates around an offset, which means of squares lose digits to."""
    planes = (random_of(6).normal(offset, 1.0, (3, *TILE))).astype(np.float32)
    known = np.ones(TILE, dtype=np.bool_)
    found = watch(contrast.local_variances, planes, known, (0, TILE[0]), (8, 9), 30.0, 1e-6)[0]
    clipped = np.clip(planes[0], -30.0, 30.0)
    places = places_in(TILE, 30)
    wanted, condition = [], 0.0
    for place in places:
        values = [Fraction(value) for value in clipped[box_of(TILE, place, (8, 9))].astype(float).ravel().tolist()]
        mean = sum(values, Fraction(0)) / len(values)
        variance = sum((value * value for value in values), Fraction(0)) / len(values) - mean * mean
        wanted.append(variance)
        condition = max(condition, float(mean * mean / variance))
    return Found(relative([float(found[place]) for place in places], wanted), condition=condition)


def _f_deviates(watch: Watch, _: bool) -> Found:
    """Compare deviates with the same formula of 50 digits, in standard deviations."""
    random = random_of(7)
    ratio, looks, background = (
        (10.0 ** random.uniform(*powers, 400)).astype(np.float32) for powers in ((-30.0, 6.0), (-0.3, 3.0), (0.0, 4.0))
    )
    ratio[:20] = 0.0
    found = watch(f_deviate, ratio, looks, background)
    wanted: list[Exact] = []
    ninth = mpmath.mpf(1) / 9
    for r, n, m in zip(ratio.tolist(), looks.tolist(), background.tolist(), strict=True):
        a, b, root = ninth / m, ninth / n, mpmath.cbrt(mpmath.mpf(r))
        wanted.append(((1 - a) * root - (1 - b)) / mpmath.sqrt(a * root * root + b))
    return Found(relative(found.tolist(), wanted))


def _looks(watch: Watch, _: bool) -> Found:
    variance = (10.0 ** random_of(9).uniform(-6.0, 3.0, 300)).astype(np.float32)
    found = watch(equivalent_looks, variance)
    wanted = [(1 + mpmath.sqrt(1 + 2 * mpmath.mpf(v))) / (2 * mpmath.mpf(v)) for v in variance.tolist()]
    return Found(relative(found.tolist(), wanted))


def _peaks(watch: Watch, _: bool) -> Found:
    """Count peaks that differ from those found pixel by pixel; values are few, so that many are equal."""
    n_unlike = 0.0
    for gain in (np.float32(1e-30), np.float32(1.0), np.float32(1e30)):
        plane = np.ascontiguousarray(random_of(4).integers(0, 5, (40, 50)).astype(np.float32) * gain)
        found = watch(contrast.peaks, plane, (0, 40), 3, 4)
        n_unlike += unlike(found, contrast.peaks_numpy(plane, (0, 40), 3, 4))
        for place in found.tolist():
            row, column = divmod(place, 50)
            n_unlike += float(plane[row, column] < plane[box_of((40, 50), (row, column), (3, 4))].max())
    return Found(n_unlike)


def _codes(watch: Watch, _: bool) -> Found:
    """Count codes that differ from those of fractions, halves among them."""
    values = np.concatenate(
        [
            (np.arange(0.0, 40.0, 0.5) / 1024.0).astype(np.float32),
            (10.0 ** random_of(3).uniform(-38.0, 38.0, 300)).astype(np.float32),
            np.array([0.0, 1e-45, np.inf], dtype=np.float32),
        ]
    )
    codes, _ = watch(cascade.encode, values, np.ones(values.shape, dtype=np.uint8))
    wanted = [16384 if math.isinf(v) else round(min(Fraction(v), Fraction(16)) * 1024) for v in values.tolist()]
    return Found(float(sum(code != w for code, w in zip(codes.tolist(), wanted, strict=True))))


def _code_sums(watch: Watch, quick: bool) -> Found:
    """Count box sums modulo 2**32 that differ from whole numbers, of a tile full of the highest code."""
    codes = np.full((200, 150) if quick else BIG_TILE, 16384, dtype=np.uint16)
    sums = watch(cascade.integral, codes, (0, 0, 0), 0)
    boxes = [(0, 0, 9, 9), (3, 5, 190, 140), (codes.shape[0] - 130, 2, codes.shape[0], 130)]
    n_unlike = 0
    for top, left, bottom, right in boxes:
        found = (
            int(sums[bottom, right]) - int(sums[top, right]) - int(sums[bottom, left]) + int(sums[top, left])
        ) % 2**32
        n_unlike += found != 16384 * (bottom - top) * (right - left)
    return Found(float(n_unlike))


def front_rows() -> list[NumberRow]:
    """List the rows of waterfall and detection."""
    return [*_waterfall_rows(), *_detection_rows()]


def _waterfall_rows() -> list[NumberRow]:
    fsum, ratio, mp = "exact summation", "fractions", "mpmath"
    gains, spike = (1e-30, 1.0, 1e30), "96 dB spike in the last of 65,535 samples"
    smooth = [kind for kind in INTENSITIES if not kind.startswith("ring")]
    return [
        NumberRow("transfer", "amplitudes 1e-15 to 1e15", ratio, "relative", ROUNDED, _amplitudes),
        NumberRow("transfer", "decibel counts 0 to 255", mp, "relative", 1e-5, _decibels),
        *each("range means", "{}, 1 to 65,535 samples", ratio, "relative", 1e-11, _range_mean, INTENSITIES),
        NumberRow("range means", spike, ratio, "relative", 1e-4, partial(_range_mean, "spike")),
        NumberRow("ground range", "nadir to 80 m, first return 1e-9 to 200 m", mp, "relative", 4e-16, _nadir),
        *each("levelling", "{}", fsum, "relative", 1e-10, _box_level, smooth),
        NumberRow("levelling", "shadow of 1e-30 of the floor", fsum, "of the floor", 1e-10, _shadow_level),
        *each("angle response", "gain {:g}", fsum, "nats", 1e-11, _angle_sums, gains),
        *each("bottom tracking", "gain {:g}, 65,535 bins", ratio, "nats", 1e-8, _bottom, gains),
        *each("bottom path", "scores times {:g}", "whole numbers", "relative", 0.0, _viterbi, (1e-30, 2.0**-20, 1e30)),
    ]


def _detection_rows() -> list[NumberRow]:
    fsum, ratio, mp = "exact summation", "fractions", "mpmath"
    kinds = ("one look", "constant", "saturated", "offset 1e6", "gain 1e30")
    return [
        *each("contrast means", "{}", fsum, "relative", ROUNDED, _contrast_means, kinds),
        NumberRow("contrast background", "shadow of 1e-30 of the floor", fsum, "relative", ROUNDED, _background),
        *each("contrast variances", "offset {:g}", ratio, "relative", 1e-4, _variances, (0.0, 25.0)),
        NumberRow("contrast deviates", "ratios 0 to 1e6, 0.5 to 10,000 looks", mp, "relative", 1e-4, _f_deviates),
        NumberRow("contrast looks", "variances 1e-6 to 1e3", mp, "relative", 4e-7, _looks),
        NumberRow("peaks", "five values, gain 1e-30 to 1e30", "search", "peaks unlike", 0.0, _peaks),
        NumberRow("cascade codes", "1e-38 to 1e38, halves", ratio, "codes unlike", 0.0, _codes),
        NumberRow("cascade sums", "saturated tile", "whole numbers", "sums unlike", 0.0, _code_sums),
    ]
