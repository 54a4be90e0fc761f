"""Features of chips against slow ones written out cell by cell, and what must not change them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_replay.fitting.cascade.classical import extractors
from sim_replay.fitting.cascade.classical.chips import CENTRE_ROW, N_COLUMNS, N_OBJECT_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.extractors import (
    CENTRAL_FILTERS,
    FAMILIES,
    Family,
    extract,
    feature_names,
    mean_chip,
)
from sim_replay.fitting.cascade.classical.wavelets import Subbands, analyse
from tests.sim_replay.fitting.cascade.classical.chip_samples import Array, chip_of, generator

TEMPLATES = {
    "mine": mean_chip(np.stack([chip_of(seed, True) for seed in range(20)])),
    "other": np.full((N_ROWS, N_COLUMNS), 0.25),
}


def _oracle_central(chip: Array) -> list[float]:
    responses = []
    for bright, dark in CENTRAL_FILTERS.values():
        inside, outside = [], []
        for row, column in product(range(N_ROWS), range(N_COLUMNS)):
            if abs(row - CENTRE_ROW) <= bright.half_rows and bright.near <= column < bright.far:
                inside.append(chip[row, column])
            elif abs(row - CENTRE_ROW) <= dark.half_rows and dark.near <= column < dark.far:
                outside.append(chip[row, column])
        responses.append(math.fsum(inside) / len(inside) - math.fsum(outside) / len(outside))
    return responses


def _oracle_line(line: list[float]) -> tuple[list[float], list[float]]:
    """Smooth and detail of one line by the 5/3 filters' taps, the line reflected at its ends."""

    def at(index: int) -> float:
        index = abs(index)
        return line[index] if index < len(line) else line[2 * (len(line) - 1) - index]

    smooth_taps, detail_taps = (-0.125, 0.25, 0.75, 0.25, -0.125), (-0.5, 1.0, -0.5)
    smooth = [sum(tap * at(i + k - 2) for k, tap in enumerate(smooth_taps)) for i in range(0, len(line), 2)]
    detail = [sum(tap * at(i + k - 1) for k, tap in enumerate(detail_taps)) for i in range(1, len(line), 2)]
    return smooth, detail


def _oracle_subbands(image: Array) -> Subbands:
    def along_rows(part: Array) -> tuple[Array, Array]:
        lines = [_oracle_line(list(column)) for column in part.T]
        return np.array([smooth for smooth, _ in lines]).T, np.array([detail for _, detail in lines]).T

    smooth, detail = along_rows(image)
    (low, columns), (rows, both) = ([half.T for half in along_rows(part.T)] for part in (smooth, detail))
    return Subbands(low, columns, rows, both)


def _oracle_wavelets(chip: Array) -> list[float]:
    features = []
    columns_of = list(range(N_COLUMNS))  # which column of the chip each column of a subband stands on
    smooth = chip
    for _ in range(3):
        bands = _oracle_subbands(smooth)
        even, odd = columns_of[::2], columns_of[1::2]
        for band, places in ((bands.columns, odd), (bands.rows, even), (bands.both, odd)):
            for of_shadow in (False, True):
                in_zone = [(place >= N_OBJECT_COLUMNS) == of_shadow for place in places]
                power = [value * value for line in band for value, inside in zip(line, in_zone, strict=True) if inside]
                features.append(math.log(math.fsum(power) / len(power) + 1e-3))
        smooth, columns_of = bands.smooth, even
    return features


def _oracle_thresholds(chip: Array) -> list[float]:
    shares = []
    for rows, columns in ((range(17), range(44)), (range(5, 12), range(8, 17)), (range(5, 12), range(18, 37))):
        cells = [math.exp(chip[row, column]) for row in rows for column in columns]
        for times in (2.0, 4.0, 8.0):
            shares += [
                sum(cell > times for cell in cells) / len(cells),
                sum(cell < 1.0 / times for cell in cells) / len(cells),
            ]
    return shares


def _variance(cells: list[float]) -> float:
    mean = math.fsum(cells) / len(cells)
    return math.fsum((cell - mean) ** 2 for cell in cells) / len(cells)


def _oracle_variances(chip: Array) -> list[float]:
    features = []
    inner = range(5, 12)
    for near, far in ((0, 9), (9, 17), (17, 28), (28, 44)):
        for rows in (inner, [row for row in range(17) if row not in inner]):
            features.append(
                math.log(_variance([chip[row, column] for row in rows for column in range(near, far)]) + 1e-3)
            )
    return features


def _oracle_templates(chip: Array) -> list[float]:
    features = []
    for template in TEMPLATES.values():
        for columns in (range(44), range(20), range(20, 44)):
            a = [chip[row, column] for row in range(17) for column in columns]
            b = [template[row, column] for row in range(17) for column in columns]
            power = _variance(a) * _variance(b)
            mean_a, mean_b = math.fsum(a) / len(a), math.fsum(b) / len(b)
            shared = math.fsum((x - mean_a) * (y - mean_b) for x, y in zip(a, b, strict=True)) / len(a)
            features.append(shared / math.sqrt(power) if power > 1e-6 else 0.0)
    return features


def _oracle_histograms(chip: Array) -> list[float]:
    cells = sorted(chip.ravel().tolist())
    n = len(cells)
    features = []
    for share in (0.05, 0.1, 0.25, 0.75, 0.9, 0.95):
        place = share * (n - 1)
        below = math.floor(place)
        features.append(cells[below] + (place - below) * (cells[min(below + 1, n - 1)] - cells[below]))
    mean, variance = math.fsum(cells) / n, _variance(cells)
    features.append(math.sqrt(variance))
    for power, normal in ((3, 0.0), (4, 3.0)):
        moment = math.fsum((cell - mean) ** power for cell in cells) / n / max(variance, 1e-3) ** (power / 2) - normal
        features.append(min(max(moment, -10.0), 10.0))
    return features


ORACLES: dict[Family, Callable[[Array], list[float]]] = {
    "central": _oracle_central,
    "wavelets": _oracle_wavelets,
    "thresholds": _oracle_thresholds,
    "variances": _oracle_variances,
    "templates": _oracle_templates,
    "histograms": _oracle_histograms,
}


@pytest.mark.parametrize("family", FAMILIES)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), with_object=st.booleans())
def test_features_are_those_written_out_cell_by_cell(family: Family, seed: int, with_object: bool) -> None:
    chip = chip_of(seed, with_object)
    assert extract(chip[np.newaxis], [family], TEMPLATES)[0] == pytest.approx(ORACLES[family](chip), abs=1e-9)


@pytest.mark.parametrize("shape", [(17, 44), (9, 22), (2, 2), (2, 3), (3, 2), (16, 5)])
def test_subbands_are_those_of_the_filters_taps(shape: tuple[int, int]) -> None:
    image = generator(1).normal(size=shape)
    for found, wanted in zip(analyse(image), _oracle_subbands(image), strict=True):
        assert found == pytest.approx(wanted, abs=1e-12)


def test_a_plane_has_no_detail() -> None:
    rows, columns = np.mgrid[:17, :44]
    bands = analyse(1.0 + 0.5 * rows - 0.25 * columns)
    assert bands.columns[:, :-1] == pytest.approx(0.0, abs=1e-12)
    assert bands.rows == pytest.approx(0.0, abs=1e-12)
    assert bands.both == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirror_image_along_track_has_the_same_features(family: Family, seed: int) -> None:
    chip = chip_of(seed, seed % 2 == 0)
    both = extract(np.stack([chip, chip[::-1]]), [family], TEMPLATES)
    assert both[0] == pytest.approx(both[1], abs=1e-9)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_chip_without_contrast_has_finite_neutral_features(family: Family) -> None:
    features = extract(np.zeros((1, N_ROWS, N_COLUMNS)), [family], TEMPLATES)
    wanted = math.log(1e-3) if family in ("wavelets", "variances") else 0.0
    if family == "histograms":
        assert np.array_equal(features[0, :-2], np.zeros(7))
        assert np.isfinite(features).all()
    else:
        assert features == pytest.approx(wanted, abs=1e-9)


def test_each_feature_has_a_name_of_its_own() -> None:
    names = feature_names(FAMILIES, list(TEMPLATES))
    assert len(set(names)) == len(names) == extract(np.zeros((1, N_ROWS, N_COLUMNS)), FAMILIES, TEMPLATES).shape[1]


@pytest.mark.parametrize(
    "function",
    [extractors.central, extractors.wavelets, extractors.thresholds, extractors.variances, extractors.histograms],
)
def test_features_of_a_chip_do_not_depend_on_those_beside_it(function: Callable[[Array], Array]) -> None:
    chips = np.stack([chip_of(seed, seed % 3 == 0) for seed in range(7)])
    together = function(chips)
    for index in range(len(chips)):
        assert function(chips[index : index + 1])[0] == pytest.approx(together[index], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", ["ring_12_1_2", "pair_1_32", "pair_3_40"])
def test_central_filters_answer_to_an_object_more_than_to_floor(name: str) -> None:
    index = list(CENTRAL_FILTERS).index(name)
    floor, mines = (
        extractors.central(np.stack([chip_of(seed, there) for seed in range(30)]))[:, index] for there in (False, True)
    )
    assert mines.min() > floor.max()
