"""Covered area against counting pixels one by one, and outlines against the pixels they enclose."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clearance.coverage import cover_tile
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import EchoGeometry, locate
from auv_mcm.records import LOW_RESOLUTION, NAN, SATURATED, TURN, VALID, CoveragePatch, PoseTrack, Side, Tile
from auv_mcm.settings.config import SonarConfig
from tests.auv_mcm.clearance.covered_tiles import COLUMN_M, FIRST_RETURN_M, ROW_M, plain, tile_of, track

LOSSES = {"invalid", "low_resolution", "turn", "stale_navigation", "saturated", "shadow"}


def enclosed_m2(ring: NDArray[np.float64], frame: LocalFrame) -> float:
    """Signed area of a closed ring of longitude, latitude: positive counter-clockwise seen from above."""
    flat = frame.to_enu(ring[:, 1], ring[:, 0], 0.0)
    east, north = flat[:, 0], flat[:, 1]
    return float(0.5 * np.sum(east[:-1] * north[1:] - east[1:] * north[:-1]))


def outline_m2(patch: CoveragePatch, frame: LocalFrame) -> float:
    return sum(enclosed_m2(ring, frame) for ring in patch.rings_deg)


def frame_of(tile: Tile) -> LocalFrame:
    known = np.flatnonzero(np.isfinite(tile.pose.latitude_deg))
    return LocalFrame(
        latitude_deg=float(tile.pose.latitude_deg[known[0]]), longitude_deg=float(tile.pose.longitude_deg[known[0]])
    )


def claimed(tile: Tile, patch: CoveragePatch) -> NDArray[np.bool_]:
    """Core pixels whose centres lie inside an outline: every centre is placed on Earth, and rays are counted."""
    frame = frame_of(tile)
    inside = np.zeros(tile.mask.shape, dtype=np.bool_)
    for row in range(tile.core_start, tile.core_stop):
        n = tile.mask.shape[1]
        ground_m = (np.arange(n) + 0.5) * COLUMN_M
        pose = PoseTrack(
            **{name: np.repeat(getattr(tile.pose, name)[row : row + 1], n) for name in PoseTrack.__struct_fields__}
        )
        first_return_m = np.full(n, FIRST_RETURN_M)
        echoes = EchoGeometry(
            side=tile.side,
            pose=pose,
            slant_range_m=np.hypot(ground_m, first_return_m),
            first_return_m=first_return_m,
            sound_speed_mps=np.full(n, 1500.0),
        )
        latitude, longitude, _ = locate(echoes, SonarConfig())
        points = frame.to_enu(latitude, longitude, 0.0)
        for ring in patch.rings_deg:
            corners = frame.to_enu(ring[:, 1], ring[:, 0], 0.0)
            crossings = np.zeros(n, dtype=np.int64)
            for a, b in pairwise(corners):
                spans = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
                with np.errstate(divide="ignore", invalid="ignore"):
                    east = a[0] + (points[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
                crossings += spans & (points[:, 0] < east)
            inside[row] |= crossings % 2 == 1
    return inside[tile.core_start : tile.core_stop]


# ---------------------------------------------------------------- areas


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_every_pixel_of_the_core_is_counted_once_as_covered_or_by_why_not(seed: int) -> None:
    random = np.random.default_rng(seed)
    shape = (int(random.integers(1, 40)), int(random.integers(1, 30)))
    start = int(random.integers(0, shape[0]))
    core = (start, int(random.integers(start + 1, shape[0] + 1)))
    mask = random.choice(
        [0, VALID, VALID | SATURATED, VALID | LOW_RESOLUTION, VALID | TURN, VALID | TURN | LOW_RESOLUTION, TURN], shape
    )
    pose, unplaced = track(shape[0]), random.random((7, shape[0])) < 0.04
    blind = random.random(shape[0]) < 0.1
    needed = ("latitude_deg", "longitude_deg", "heading_rad", "pitch_rad", "roll_rad")
    lost = {name: np.where(rows, NAN, getattr(pose, name)) for name, rows in zip(needed, unplaced, strict=False)}
    pose = msgspec.structs.replace(pose, stale=unplaced[5], **lost)
    first_return_m = np.where(unplaced[6], NAN, FIRST_RETURN_M)
    tile = tile_of(mask.astype(np.uint8), pose, core=core)
    tile = msgspec.structs.replace(tile, first_return_m=first_return_m, squint_rad=0.05)
    patch = cover_tile(tile, SonarConfig(), blind_rows=blind)
    expected = dict.fromkeys([*LOSSES, "covered"], 0)
    for row in range(*core):
        for bits in mask[row].tolist():
            if not bits & VALID:
                expected["invalid"] += 1
            elif bits & LOW_RESOLUTION or blind[row]:
                expected["low_resolution"] += 1
            elif bits & TURN:
                expected["turn"] += 1
            elif unplaced[:, row].any():
                expected["stale_navigation"] += 1
            elif bits & SATURATED:
                expected["saturated"] += 1
            else:
                expected["covered"] += 1
    pixel_m2 = ROW_M * COLUMN_M
    assert patch.covered_m2 == pytest.approx(expected.pop("covered") * pixel_m2)
    assert patch.lost_m2.pop("over_budget") == 0.0
    assert set(patch.lost_m2) == LOSSES
    for reason, count in expected.items():
        assert patch.lost_m2[reason] == pytest.approx(count * pixel_m2)
    assert (patch.side, patch.tile_index, patch.squint_rad) == ("starboard", 3, 0.05)
    assert (patch.start_s, patch.stop_s) == (pose.time_s[core[0]], pose.time_s[core[1] - 1])


def nowhere(n_rows: int) -> PoseTrack:
    unknown = np.full(n_rows, NAN)
    return msgspec.structs.replace(track(n_rows), latitude_deg=unknown, longitude_deg=unknown, heading_rad=unknown)


@pytest.mark.parametrize(
    ("mask", "pose", "reason"),
    [
        (plain() | TURN, None, "turn"),
        (plain() | LOW_RESOLUTION, None, "low_resolution"),
        (plain() & 0, None, "invalid"),
        (plain() | SATURATED, None, "saturated"),
        (plain(), msgspec.structs.replace(track(200), stale=np.ones(200, dtype=np.bool_)), "stale_navigation"),
        (plain(), nowhere(200), "stale_navigation"),
    ],
    ids=["turn", "low resolution", "invalid", "saturated", "stale", "nowhere"],
)
def test_rows_that_earn_nothing_give_no_area_and_no_outline(
    mask: NDArray[np.uint8], pose: PoseTrack | None, reason: str
) -> None:
    patch = cover_tile(tile_of(mask, pose), SonarConfig())
    assert patch.covered_m2 == 0.0
    assert patch.rings_deg == ()
    assert patch.lost_m2[reason] > 0.0


# ---------------------------------------------------------------- outlines


@pytest.mark.parametrize("side", ["port", "starboard"])
@pytest.mark.parametrize("heading_deg", [0.0, 75.0, 200.0, -400.0])
@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg"), [(43.7, 10.3), (-17.0, 180.0), (60.0, 179.9999), (5.0, -179.9999), (89.0, 0.0)]
)
def test_on_a_straight_leg_the_outline_encloses_what_is_covered_counter_clockwise(
    side: Side, heading_deg: float, latitude_deg: float, longitude_deg: float
) -> None:
    pose = track(200, heading_deg=heading_deg, latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    tile = tile_of(plain(), pose, side, core=(20, 180))
    patch = cover_tile(tile, SonarConfig())
    (ring,) = patch.rings_deg
    np.testing.assert_array_equal(ring[0], ring[-1])
    assert ring.dtype == np.float64
    assert ring[:, 0].min() >= -180.0
    assert ring[:, 0].max() < 180.0
    area = enclosed_m2(ring, LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg))
    assert patch.covered_m2 == pytest.approx(160 * 64 * ROW_M * COLUMN_M)
    assert area == pytest.approx(patch.covered_m2, rel=1e-3)


def test_outlines_of_neighbouring_tiles_meet_without_gap_or_overlap() -> None:
    pose = track(300)
    first = cover_tile(tile_of(plain(300), pose, core=(0, 150)), SonarConfig())
    second = cover_tile(tile_of(plain(300), pose, core=(150, 300)), SonarConfig())
    top, bottom = first.rings_deg[0][:, 1].max(), second.rings_deg[0][:, 1].min()
    assert top == pytest.approx(bottom, abs=1e-9)  # a tenth of a millimetre


def test_the_outline_leaves_out_a_turn_and_a_hole_in_navigation() -> None:
    mask = plain()
    mask[60:90] |= TURN
    stale = np.zeros(200, dtype=np.bool_)
    stale[130:141] = True
    tile = tile_of(mask, msgspec.structs.replace(track(200), stale=stale))
    patch = cover_tile(tile, SonarConfig())
    assert len(patch.rings_deg) == 3
    assert outline_m2(patch, frame_of(tile)) == pytest.approx(patch.covered_m2, rel=0.02)
    inside = claimed(tile, patch)
    assert not inside[60:90].any()
    assert not inside[130:141].any()
    assert inside[100, 8:72].all()


@pytest.mark.parametrize(("n_rows", "n_columns", "n_rings"), [(4, 0, 1), (5, 0, 2), (5, 15, 2), (5, 16, 1)])
def test_an_outline_breaks_where_more_than_half_a_metre_covers_less_than_a_fifth(
    n_rows: int, n_columns: int, n_rings: int
) -> None:
    """Rows are 0.12 m apart and have 80 columns."""
    mask = plain()
    mask[50 : 50 + n_rows, 8 + n_columns :] = 0
    assert len(cover_tile(tile_of(mask), SonarConfig()).rings_deg) == n_rings


def test_the_outline_follows_a_swath_that_widens() -> None:
    mask = np.zeros((250, 80), dtype=np.uint8)
    for row in range(250):
        mask[row, 10 : 30 + row // 6] = VALID
    tile = tile_of(mask)
    patch = cover_tile(tile, SonarConfig())
    inside = claimed(tile, patch)
    covered = mask == VALID
    assert (inside & ~covered).sum() < 0.05 * covered.sum()
    assert (covered & ~inside).sum() < 0.05 * covered.sum()


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), side=st.sampled_from(("port", "starboard")))
def test_with_rows_lost_at_random_outlines_claim_little_that_is_not_covered(seed: int, side: Side) -> None:
    random = np.random.default_rng(seed)
    mask = plain(120, 40)
    row = 0
    while row < 120:
        length = int(random.integers(1, 40))
        if random.random() < 0.4:
            mask[row : row + length] |= np.uint8(random.choice([TURN, LOW_RESOLUTION]))
        row += length
    tile = tile_of(mask, side=side)
    patch = cover_tile(tile, SonarConfig())
    covered = mask == VALID
    inside = claimed(tile, patch)
    short_gaps = 4  # rows bridged between two stretches
    gaps = np.count_nonzero(np.diff(covered.any(axis=1).astype(int)) == 1)
    assert (inside & ~covered).sum() <= gaps * short_gaps * covered.sum(axis=1).max()
    ends = 2 * covered.sum(axis=1).max()  # the track ends at the centres of its first and last row
    assert (covered & ~inside).sum() <= 0.02 * covered.sum() + ends
    for ring in patch.rings_deg:
        assert enclosed_m2(ring, frame_of(tile)) > 0.0


@pytest.mark.parametrize("n_rows", [1, 2])
def test_a_tile_of_a_row_or_two_is_counted(n_rows: int) -> None:
    patch = cover_tile(tile_of(plain(n_rows)), SonarConfig())
    assert patch.covered_m2 == pytest.approx(n_rows * 64 * ROW_M * COLUMN_M)
    assert len(patch.rings_deg) == (0 if n_rows == 1 else 1)


@pytest.mark.parametrize("evaluated_fraction", [0.0, 0.25, 1.0])
def test_what_the_budget_did_not_allow_for_is_not_covered(evaluated_fraction: float) -> None:
    tile = tile_of(plain())
    whole, part = cover_tile(tile, SonarConfig()), cover_tile(tile, SonarConfig(), evaluated_fraction)
    assert part.covered_m2 == pytest.approx(evaluated_fraction * whole.covered_m2)
    assert part.covered_m2 + sum(part.lost_m2.values()) == pytest.approx(whole.covered_m2 + sum(whole.lost_m2.values()))
    assert part.evaluated_fraction == evaluated_fraction
