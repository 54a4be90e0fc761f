"""Grid rows against overlap-weighted averages taken row by row and ping by ping."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID, PoseTrack, Side
from auv_mcm.waterfall.grid import AlongTrackGrid, SideImage, Swath, concatenate_swaths, slice_swath
from tests.make.records import pose_of

N_COLUMNS = 3


def poses(along_m: NDArray[Any]) -> PoseTrack:
    """Everything linear in distance, so that an interpolated pose is known in closed form."""
    return pose_of(
        along_m.size,
        time_s=1.7e9 + 0.5 * along_m,
        latitude_deg=43.0 + 1e-5 * along_m,
        longitude_deg=5.0,
        depth_m=10.0 - 0.01 * along_m,
        heading_rad=0.3 + 0.02 * along_m,
        pitch_rad=0.001 * along_m,
        roll_rad=-0.001 * along_m,
        speed_mps=2.0 + 0.01 * along_m,
        altitude_m=8.0 + 0.1 * along_m,
    )


def swath(along_m: NDArray[Any], seed: int = 0, *, sides: tuple[Side, ...] = ("port",), first_number: int = 0) -> Swath:
    random = np.random.default_rng(seed)
    images: dict[Side, SideImage] = {}
    for side in sides:
        mask = random.choice(
            np.array(
                [0, VALID, VALID, VALID, VALID | SATURATED, VALID | TURN, VALID | LOW_RESOLUTION, TURN], dtype=np.uint8
            ),
            (along_m.size, N_COLUMNS),
        )
        images[side] = SideImage(
            np.where(mask & VALID, random.exponential(size=mask.shape), 0.0).astype(np.float32), mask
        )
    return Swath(
        along_m,
        poses(along_m),
        8.0 + 0.1 * along_m,
        0.1 + 0.001 * along_m,
        first_number + np.arange(along_m.size),
        images,
    )


def rows_of(pings: Swath, spacing_m: float, max_gap_m: float, cuts: list[int] | None = None) -> tuple[int, Swath]:
    grid = AlongTrackGrid(spacing_m, max_gap_m)
    done = [grid.add(slice_swath(pings, piece)) for piece in pieces(pings.n_rows, cuts or [])]
    parts = [part for part in [*done, grid.close()] if part is not None]
    row = parts[0][0]
    for first, rows in parts:
        assert first == row
        row += rows.n_rows
    return parts[0][0], concatenate_swaths([rows for _, rows in parts])


def pieces(length: int, cuts: list[int]) -> list[slice]:
    ends = sorted({cut % length for cut in cuts} - {0})
    return [slice(start, stop) for start, stop in zip([0, *ends], [*ends, length], strict=True)]


def stretch(along: list[float], ping: int, max_gap_m: float) -> tuple[float, float]:
    """Track that one ping stands for, by the rule as stated in words."""
    before = along[ping] - along[ping - 1] if ping else math.inf
    after = along[ping + 1] - along[ping] if ping + 1 < len(along) else math.inf
    if before > max_gap_m and after > max_gap_m:
        before = after = max_gap_m
    elif before > max_gap_m:
        before = after
    elif after > max_gap_m:
        after = before
    return along[ping] - 0.5 * before, along[ping] + 0.5 * after


def slow_row(pings: Swath, row: int, spacing_m: float, max_gap_m: float) -> tuple[list[float], list[float], list[int]]:
    """Mean intensity, covered length and flags per column of the port image."""
    along = pings.along_m.tolist()
    total, length, flags = [0.0] * N_COLUMNS, [0.0] * N_COLUMNS, [0] * N_COLUMNS
    for ping in range(len(along)):
        start, stop = stretch(along, ping, max_gap_m)
        shared = min(stop, (row + 1) * spacing_m) - max(start, row * spacing_m)
        if shared <= 0.0:
            continue
        for column in range(N_COLUMNS):
            mask = int(pings.sides["port"].mask[ping, column])
            flags[column] |= mask & (SATURATED | LOW_RESOLUTION | TURN)
            if mask & VALID:
                length[column] += shared
                total[column] += shared * float(pings.sides["port"].intensity[ping, column])
    return [t / n if n > 0.0 else 0.0 for t, n in zip(total, length, strict=True)], length, flags


tracks = st.lists(st.floats(0.01, 0.5) | st.floats(0.5, 3.0), min_size=0, max_size=30).map(
    lambda steps: 0.7 + np.cumsum([0.0, *steps])
)
spacings = st.floats(0.05, 0.8)
gaps = st.floats(0.1, 1.5)


@given(along_m=tracks, seed=st.integers(0, 99), spacing_m=spacings, max_gap_m=gaps)
@settings(max_examples=40)
def test_rows_are_overlap_weighted_averages(
    along_m: NDArray[np.float64], seed: int, spacing_m: float, max_gap_m: float
) -> None:
    pings = swath(along_m, seed)
    first_row, rows = rows_of(pings, spacing_m, max_gap_m)
    track = along_m.tolist()
    assert first_row == math.floor(stretch(track, 0, max_gap_m)[0] / spacing_m)
    assert (first_row + rows.n_rows) * spacing_m >= stretch(track, len(track) - 1, max_gap_m)[1] - 1e-9
    image = rows.sides["port"]
    for index in range(rows.n_rows):
        mean, length, flags = slow_row(pings, first_row + index, spacing_m, max_gap_m)
        for column in range(N_COLUMNS):
            if abs(length[column] - 0.5 * spacing_m) < 1e-9:
                continue
            if length[column] > 0.5 * spacing_m:
                assert image.intensity[index, column] == pytest.approx(mean[column], rel=1e-6)
                assert image.mask[index, column] & VALID
            else:
                assert image.intensity[index, column] == 0.0
                assert not image.mask[index, column] & (VALID | SATURATED)
            mask = int(image.mask[index, column])
            assert mask == (flags[column] | VALID if mask & VALID else flags[column] & (LOW_RESOLUTION | TURN))


@given(
    along_m=tracks,
    seed=st.integers(0, 99),
    spacing_m=spacings,
    max_gap_m=gaps,
    cuts=st.lists(st.integers(0, 30), max_size=6),
)
@settings(max_examples=60)
def test_rows_do_not_depend_on_how_the_pings_were_cut(
    along_m: NDArray[np.float64], seed: int, spacing_m: float, max_gap_m: float, cuts: list[int]
) -> None:
    """To the bit, poses included."""
    pings = swath(along_m, seed)
    first, whole = rows_of(pings, spacing_m, max_gap_m)
    first_parts, parts = rows_of(pings, spacing_m, max_gap_m, cuts)
    assert first_parts == first
    assert_same(parts, whole)


def assert_same(one: Swath, other: Swath) -> None:
    for name in ("along_m", "first_return_m", "first_return_sigma_m", "ping_number"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in PoseTrack.__struct_fields__:
        np.testing.assert_array_equal(getattr(one.pose, name), getattr(other.pose, name), err_msg=name)
    assert one.sides.keys() == other.sides.keys()
    for side in one.sides:
        np.testing.assert_array_equal(one.sides[side].intensity, other.sides[side].intensity)
        np.testing.assert_array_equal(one.sides[side].mask, other.sides[side].mask)


@given(along_m=tracks, spacing_m=spacings, max_gap_m=gaps)
def test_poses_are_interpolated_to_row_centres(
    along_m: NDArray[np.float64], spacing_m: float, max_gap_m: float
) -> None:
    first_row, rows = rows_of(swath(along_m), spacing_m, max_gap_m)
    centre = (first_row + np.arange(rows.n_rows) + 0.5) * spacing_m
    np.testing.assert_allclose(rows.along_m, centre, rtol=1e-12)
    within = np.clip(centre, along_m[0], along_m[-1])  # no extrapolation
    expected = poses(within)
    for name in PoseTrack.__struct_fields__:
        np.testing.assert_allclose(
            getattr(rows.pose, name), getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name
        )
    np.testing.assert_allclose(rows.first_return_m, 8.0 + 0.1 * within, rtol=1e-9)
    np.testing.assert_allclose(rows.first_return_sigma_m, 0.1 + 0.001 * within, rtol=1e-9)


@given(along_m=tracks, spacing_m=spacings, max_gap_m=gaps)
def test_ping_numbers_are_those_of_the_nearest_ping_or_none(
    along_m: NDArray[np.float64], spacing_m: float, max_gap_m: float
) -> None:
    first_row, rows = rows_of(swath(along_m, first_number=100), spacing_m, max_gap_m)
    for index, number in enumerate(rows.ping_number.tolist()):
        edges = (first_row + index) * spacing_m, (first_row + index + 1) * spacing_m
        track = along_m.tolist()
        overlap = max(
            min(stop, edges[1]) - max(start, edges[0])
            for start, stop in (stretch(track, p, max_gap_m) for p in range(len(track)))
        )
        if abs(overlap) < 1e-9:
            continue
        if overlap < 0.0:
            assert number == -1
        else:
            distance = np.abs(along_m - 0.5 * (edges[0] + edges[1]))
            assert distance[number - 100] <= distance.min() + 1e-9


@pytest.mark.parametrize("gap_m", [0.59, 0.8, 4.0])
def test_only_gaps_longer_than_permitted_leave_rows_without_data(gap_m: float) -> None:
    along_m = np.concatenate([np.arange(20) * 0.2, 19 * 0.2 + gap_m + np.arange(20) * 0.2])
    image = SideImage(np.ones((40, 2), dtype=np.float32), np.full((40, 2), VALID, dtype=np.uint8))
    _, rows = rows_of(swath(along_m)._replace(sides={"port": image}), 0.1, 0.6)
    missing = int(np.count_nonzero(rows.sides["port"].mask[:, 0] == 0))
    # Beyond the permitted gap the pings beside it reach as far as on their other side: half of 0.2 m each.
    assert missing * 0.1 == pytest.approx(gap_m - 0.2 if gap_m > 0.6 else 0.0, abs=0.11)


def test_sides_and_widths_that_come_later_are_filled_with_nothing() -> None:
    along_m = 0.2 * np.arange(30) + 1.0
    first = swath(along_m[:10])
    second = swath(along_m[10:20], sides=("port", "starboard"), first_number=10)
    wide: dict[Side, SideImage] = {
        side: SideImage(
            np.pad(image.intensity, ((0, 0), (0, 2)), constant_values=1.0),
            np.pad(image.mask, ((0, 0), (0, 2)), constant_values=VALID),
        )
        for side, image in second.sides.items()
    }
    third = swath(along_m[20:], first_number=20)
    grid = AlongTrackGrid(0.2, 0.6)
    parts = [grid.add(first), grid.add(second._replace(sides=wide)), grid.add(third), grid.close()]
    first_row = next(part[0] for part in parts if part is not None)
    rows = concatenate_swaths([part[1] for part in parts if part is not None])
    centre = first_row + np.arange(rows.n_rows) + 0.5
    alone = (centre * 0.2 < along_m[9] - 0.2) | (centre * 0.2 > along_m[20] + 0.2)
    assert alone.sum() > 10
    assert rows.sides["starboard"].mask.shape == (rows.n_rows, N_COLUMNS + 2)
    assert not rows.sides["starboard"].mask[alone].any()
    assert not rows.sides["port"].mask[alone][:, N_COLUMNS:].any()
    assert rows.sides["port"].mask[~alone][:, N_COLUMNS:].any()


def test_the_grid_is_fixed_to_the_mission_not_to_the_segment() -> None:
    """Two segments through one grid object, the second as if it were alone."""
    grid = AlongTrackGrid(0.12, 0.6)
    first, second = swath(np.linspace(0.6, 9.0, 50)), swath(np.linspace(20.03, 30.0, 60), seed=1)
    grid.add(first)
    grid.close()
    parts = [part for part in (grid.add(second), grid.close()) if part is not None]
    first_row, alone = rows_of(second, 0.12, 0.6)
    assert parts[0][0] == first_row
    assert_same(concatenate_swaths([rows for _, rows in parts]), alone)


def test_rows_come_out_as_soon_as_no_later_ping_can_change_them() -> None:
    grid = AlongTrackGrid(0.1, 0.6)
    assert grid.close() is None
    out = 0
    for ping in range(100):
        part = grid.add(swath(np.array([1.0 + 0.1 * ping]), first_number=ping))
        out += 0 if part is None else part[1].n_rows
        assert out >= ping - 1


def test_memory_does_not_grow_with_the_segment() -> None:
    grid = AlongTrackGrid(0.1, 0.6)
    for block in range(50):
        grid.add(swath(10.0 * block + 0.1 * np.arange(100)))
        assert grid._held is not None
        assert grid._held.n_rows < 10


def test_a_vehicle_standing_still_averages_many_pings_into_one_row() -> None:
    """2000 pings a millimetre apart, one row of 0.5 m: the plain mean of the pings in it."""
    along_m = 5.0 + 1e-3 * np.arange(2000)
    image = np.random.default_rng(0).exponential(size=(2000, 1)).astype(np.float32)
    pings = swath(along_m)._replace(sides={"port": SideImage(image, np.full((2000, 1), VALID, dtype=np.uint8))})
    first_row, rows = rows_of(pings, 0.5, 0.6, [100, 700, 701])
    inside = (along_m > 5.5) & (along_m < 6.0)
    assert rows.sides["port"].intensity[11 - first_row, 0] == pytest.approx(image[inside].mean(), rel=5e-3)
