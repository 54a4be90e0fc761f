"""Tests of chips for the convolutional verifier."""

import msgspec
import numpy as np
import pytest

from auv_mcm.confirm.region import Region
from sim_replay.fitting.verifier.chips import N_COLUMNS, N_PLANES, N_ROWS, chip_of, shadow_ends_m

ALTITUDE_M = 5.0
HIGHLIGHT = slice(10, 14)  # columns of the picture by metres: 0.4 m around the centre, 1.2 m behind the chip's edge


def view(
    *,
    ground_range_m: float = 20.0,
    height_m: float = 0.5,
    row_m: float = 0.05,
    column_m: float = 0.02,
    gain: float = 1.0,
) -> Region:
    """Draw an object 1.2 m long and 0.4 m wide that is ten times as bright as the floor, with its shadow."""
    first_m = ground_range_m - 4.0
    rows_m = row_m * (np.arange(round(6.0 / row_m)) + 0.5) - 3.0
    columns_m = first_m + column_m * (np.arange(round(14.0 / column_m)) + 0.5)
    intensity = np.full((len(rows_m), len(columns_m)), gain)
    along = np.abs(rows_m)[:, None] < 0.6
    end_m = shadow_ends_m(ground_range_m, ALTITUDE_M, np.array([height_m]))[0]
    intensity[along & (np.abs(columns_m - ground_range_m) < 0.2)] *= 10.0
    intensity[along & (columns_m > ground_range_m + 0.2) & (columns_m < end_m)] *= 0.01
    return Region(
        intensity=intensity,
        valid=np.ones(intensity.shape, dtype=np.bool_),
        row_spacing_m=row_m,
        column_spacing_m=column_m,
        first_ground_range_m=first_m,
        altitude_m=ALTITUDE_M,
        row=len(rows_m) / 2.0,
        column=4.0 / column_m,
        beam_width_rad=0.005,
    )


def test_a_chip_shows_the_object_in_metres_in_the_middle_of_its_rows() -> None:
    chip = chip_of(view())
    assert chip.shape == (N_PLANES, N_ROWS, N_COLUMNS)
    assert chip.dtype == np.float32
    assert chip[0, 8:16, HIGHLIGHT] == pytest.approx(1.0, abs=1e-3)  # 10 dB
    assert chip[0, :8] == pytest.approx(0.0, abs=1e-3)
    assert chip[0, 16:] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("ground_range_m", [10.0, 20.0, 40.0])
def test_a_shadow_ends_at_the_column_of_the_objects_height_at_every_range(ground_range_m: float) -> None:
    dark = chip_of(view(ground_range_m=ground_range_m))[1, 12] < -1.0
    assert dark[5:10].all()
    assert not dark[10:].any()  # columns of 5 cm: ten to 0.5 m


def test_chips_do_not_depend_on_the_sonars_pixels() -> None:
    fine, coarse = chip_of(view()), chip_of(view(row_m=0.15, column_m=0.1))
    assert coarse[0] == pytest.approx(fine[0], abs=0.05)
    assert coarse[2:4] == pytest.approx(fine[2:4], abs=1e-3)


def test_pixels_that_were_not_measured_are_as_the_floor() -> None:
    region = view()
    hidden = chip_of(msgspec.structs.replace(region, valid=np.zeros(region.valid.shape, dtype=np.bool_)))
    assert not hidden[:2].any()
    assert np.isfinite(hidden).all()


def test_a_chip_is_the_mean_intensity_that_its_pixels_cover() -> None:
    region = view(row_m=0.07, column_m=0.03)
    chip = chip_of(region)
    random = np.random.Generator(np.random.PCG64(1))
    for row, column in random.integers((0, 0), (N_ROWS, N_COLUMNS), size=(20, 2)).tolist():
        centre_m = region.first_ground_range_m + region.column * region.column_spacing_m
        total = area = 0.0
        for y in range(region.intensity.shape[0]):
            low = max(region.row + 0.15 * (row - 12) / 0.07, y)
            high = min(region.row + 0.15 * (row - 11) / 0.07, y + 1)
            if high <= low:
                continue
            for x in range(region.intensity.shape[1]):
                near = max((centre_m - 1.2 + 0.1 * column - region.first_ground_range_m) / 0.03, x)
                far = min((centre_m - 1.1 + 0.1 * column - region.first_ground_range_m) / 0.03, x + 1)
                if far > near:
                    total += (high - low) * (far - near) * region.intensity[y, x]
                    area += (high - low) * (far - near)
        assert chip[0, row, column] == pytest.approx(np.log10(total / area), abs=1e-4)
