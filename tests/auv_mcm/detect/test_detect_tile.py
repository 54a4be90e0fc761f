"""A tile in, georeferenced detections out: where they are, whose they are, and what is counted instead."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from auv_mcm.detect.belief import REASONS
from auv_mcm.detect.detect_tile import OVERLAP_M, detect_tile, worth_looking
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import LOW_RESOLUTION, NAN, VALID, Detection, PoseTrack, Side, Tile
from auv_mcm.settings.config import Config, DetectConfig
from tests.auv_mcm.detect.scene_tiles import (
    COLUMN_M,
    FIRST_RETURN_M,
    ROW_M,
    SPEED_MPS,
    Plane,
    make_tile,
    speckle,
    straight_track,
)

CONFIG = Config()
HOME = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)


def with_object(seed: int, row: int, column: int) -> Plane:
    """A box five rows by six columns, its highlight's centre at (row + 2.5, column + 3), with a shadow 1.2 m long."""
    plane = speckle(seed, (120, 300), spread_pixels=1.0)
    plane[row : row + 5, column : column + 6] *= 12.0
    plane[row : row + 5, column + 6 : column + 26] *= 0.03
    return plane


def best(tile: Tile) -> Detection:
    return detect_tile(tile, CONFIG).detections[0]


@pytest.mark.parametrize(("side", "sign", "aspect_deg"), [("starboard", 1.0, 90.0), ("port", -1.0, 270.0)])
def test_an_object_is_found_where_it_lies(side: Side, sign: float, aspect_deg: float) -> None:
    """The vehicle goes north from home: rows are metres north, columns metres east to starboard and west to port."""
    tile = make_tile(with_object(1, 60, 150), side=side, first_row=1000)
    found = best(tile)
    assert found.side == side
    assert found.row == pytest.approx(1062.5, abs=1.0)
    assert found.column == pytest.approx(153.0, abs=1.0)
    east, north, _ = HOME.to_enu(found.latitude_deg, found.longitude_deg, 0.0)
    slant_m = math.hypot(found.column * COLUMN_M, FIRST_RETURN_M)
    assert east == pytest.approx(sign * found.column * COLUMN_M, abs=0.01)
    # heard half-way along the ping's path
    assert north == pytest.approx(found.row * ROW_M + SPEED_MPS * slant_m / 1500.0, abs=0.01)
    assert found.time_s == pytest.approx(1000.0 + found.row * ROW_M / SPEED_MPS, abs=1e-6)
    assert found.ping_number == pytest.approx(found.row - 0.5, abs=0.51)
    assert found.ground_range_m == pytest.approx(found.column * COLUMN_M)
    assert found.slant_range_m == pytest.approx(slant_m)
    assert found.altitude_m == pytest.approx(FIRST_RETURN_M)
    assert found.aspect_deg == pytest.approx(aspect_deg)
    assert found.heading_rad == 0.0
    assert found.score > 4.0
    assert found.p_mine > 0.5
    assert found.reasons == ("highlight_and_shadow",)
    assert (found.row_spacing_m, found.column_spacing_m) == (ROW_M, COLUMN_M)


def test_detections_come_best_first_with_sound_numbers() -> None:
    tile = make_tile(with_object(2, 60, 150))
    result = detect_tile(tile, CONFIG)
    assert len(result.detections) > 3
    scores = [d.score for d in result.detections]
    assert scores == sorted(scores, reverse=True)
    assert (result.n_over_budget, result.n_without_position) == (0, 0)
    for d in result.detections:
        numbers = (
            d.row,
            d.column,
            d.time_s,
            d.latitude_deg,
            d.longitude_deg,
            d.heading_rad,
            d.aspect_deg,
            d.score,
            d.p_mine,
        )
        assert np.isfinite(numbers).all()
        np.testing.assert_array_equal(d.covariance_m2, d.covariance_m2.T)
        assert np.linalg.eigvalsh(d.covariance_m2).min() > 0.0
        assert 0.0 < d.width_m <= d.length_m
        assert 0.0 < d.p_mine < 1.0
        assert set(d.reasons) <= set(REASONS)
        assert 0.0 <= d.aspect_deg < 360.0


@pytest.mark.parametrize("budget", [0, 1, 5])
def test_beyond_the_budget_the_best_are_measured_and_the_rest_is_counted(budget: int) -> None:
    tile = make_tile(with_object(2, 60, 150))
    everything = detect_tile(tile, CONFIG)
    limited = detect_tile(tile, msgspec.structs.replace(CONFIG, detect=DetectConfig(max_candidates_per_tile=budget)))
    assert [fields_of(d) for d in limited.detections] == [fields_of(d) for d in everything.detections[:budget]]
    assert limited.n_over_budget == len(everything.detections) - budget


def test_a_higher_permitted_false_alarm_rate_only_adds_detections() -> None:
    tile = make_tile(with_object(2, 60, 150))
    few, many = (
        {
            fields_of(d)
            for d in detect_tile(tile, msgspec.structs.replace(CONFIG, detect=DetectConfig(p_false_alarm=p))).detections
        }
        for p in (1e-5, 1e-2)
    )
    assert few < many


def fields_of(d: Detection) -> tuple[float, ...]:
    return (d.row, d.column, d.score, d.p_mine, d.latitude_deg, d.longitude_deg, d.length_m, d.highlight_db)


# ---------------------------------------------------------------- navigation


def unknown(n_rows: int, *names: str, rows: slice = slice(None)) -> PoseTrack:
    pose = straight_track(n_rows)
    changes = {}
    for name in names:
        values = getattr(pose, name).copy()
        values[rows] = NAN
        changes[name] = values
    return msgspec.structs.replace(pose, **changes)


EVERYTHING = tuple(name for name in PoseTrack.__struct_fields__ if name != "stale")


@pytest.mark.parametrize(
    "names",
    [EVERYTHING, ("latitude_deg", "longitude_deg"), ("heading_rad",), ("pitch_rad",), ("time_s", "heading_rad")],
)
def test_detections_that_cannot_be_placed_are_counted_instead(names: tuple[str, ...]) -> None:
    plane = with_object(1, 60, 150)
    placed = detect_tile(make_tile(plane), CONFIG)
    lost = detect_tile(make_tile(plane, pose=unknown(120, *names)), CONFIG)
    assert lost.detections == ()
    assert lost.n_without_position == len(placed.detections)


def test_a_hole_in_navigation_costs_only_the_detections_in_it() -> None:
    plane = with_object(1, 60, 150)
    everything = detect_tile(make_tile(plane), CONFIG).detections
    result = detect_tile(
        make_tile(plane, pose=unknown(120, "latitude_deg", "longitude_deg", rows=slice(20, 40))), CONFIG
    )
    assert {fields_of(d)[:2] for d in everything if not 19.0 < d.row < 42.0} <= {
        fields_of(d)[:2] for d in result.detections
    }
    assert result.n_without_position == len(everything) - len(result.detections) > 0


def test_stale_navigation_is_said_and_widens_the_position() -> None:
    plane = with_object(1, 60, 150)
    stale = msgspec.structs.replace(straight_track(120), stale=np.ones(120, dtype=np.bool_))
    fresh, old = best(make_tile(plane)), best(make_tile(plane, pose=stale))
    assert "stale_navigation" in old.reasons
    assert old.covariance_m2[0, 0] > fresh.covariance_m2[0, 0] + 100.0
    assert old.p_mine == fresh.p_mine


def test_without_a_depth_or_a_speed_positions_are_still_known() -> None:
    plane = with_object(1, 60, 150)
    found = best(make_tile(plane, pose=unknown(120, "depth_m", "speed_mps", "altitude_m")))
    known = best(make_tile(plane))
    assert np.hypot(*HOME.to_enu(found.latitude_deg, found.longitude_deg, 0.0)[:2]) > 0.0
    assert found.latitude_deg == pytest.approx(known.latitude_deg, abs=1e-6)


# ---------------------------------------------------------------- tiles


def test_tiles_share_a_strip_among_their_cores_without_loss_or_double() -> None:
    """Detections of two overlapping tiles together are those of the whole strip."""
    overlap = math.ceil(OVERLAP_M / ROW_M)
    boundary = overlap + 37
    n_rows = boundary + overlap + 45
    strip = speckle(7, (n_rows, 200), spread_pixels=1.0)
    for row, column in ((boundary - 3, 60), (boundary + 30, 120), (20, 90)):
        strip[row : row + 5, column : column + 6] *= 10.0
        strip[row : row + 5, column + 6 : column + 26] *= 0.03
    whole = detect_tile(make_tile(strip), CONFIG).detections
    first = make_tile(strip[: boundary + overlap], core=(0, boundary))
    start = boundary - overlap
    second = make_tile(strip[start:], first_row=start, core=(overlap, n_rows - start))
    parts = detect_tile(first, CONFIG).detections + detect_tile(second, CONFIG).detections

    def table(detections: tuple[Detection, ...]) -> np.ndarray:
        return np.array(
            sorted(
                (d.row, d.column, d.score, d.p_mine, d.length_m, d.latitude_deg, d.longitude_deg) for d in detections
            )
        )

    np.testing.assert_allclose(table(parts), table(whole), rtol=0, atol=1e-4)


def test_only_the_core_gives_detections() -> None:
    plane = with_object(1, 60, 150)
    whole = detect_tile(make_tile(plane), CONFIG).detections
    found = detect_tile(make_tile(plane, core=(0, 50)), CONFIG).detections
    assert {fields_of(d) for d in found} < {fields_of(d) for d in whole}
    assert not any(abs(d.row - 62.5) < 3.0 and abs(d.column - 153.0) < 3.0 and d.score > 5.0 for d in found)


def test_a_tile_whose_core_holds_nothing_is_not_worth_looking_at_and_holds_no_detection() -> None:
    plane = with_object(1, 60, 150)
    for bits in (0, LOW_RESOLUTION, VALID | LOW_RESOLUTION):
        mask = np.full(plane.shape, VALID, dtype=np.uint8)
        mask[30:100] = bits
        tile = make_tile(plane, mask, core=(30, 100))
        assert not worth_looking(tile)
        assert detect_tile(tile, CONFIG).detections == ()
    assert worth_looking(make_tile(plane, mask, core=(29, 100)))
