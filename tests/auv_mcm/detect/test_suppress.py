"""Suppression against a slow oracle that sees the whole pass at once, however the pass was cut into tiles."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect import suppress
from auv_mcm.detect.belief import crowding, odds_of, probability
from auv_mcm.detect.candidates import FaintPlaces
from auv_mcm.detect.measure import ROWS_M
from auv_mcm.detect.suppress import Suppressor
from auv_mcm.records import NAN, Detection
from auv_mcm.settings.config import DetectConfig
from tests.auv_mcm.classify.drawn_looks import detection

ROW_M, COLUMN_M = 0.12, 0.06


def seen(row_m: float, column_m: float, **values: Any) -> Detection:
    """A detection so many metres along the pass and across it."""
    known: dict[str, Any] = {
        "side": "port",
        "row": row_m / ROW_M,
        "column": column_m / COLUMN_M,
        "time_s": row_m / 1.8,
        "ground_range_m": column_m,
        "slant_range_m": column_m,
        "score": 5.0,
        "length_m": 0.6,
        "shadow_length_m": NAN,
        "p_mine": 0.6,
        "row_spacing_m": ROW_M,
        "column_spacing_m": COLUMN_M,
    }
    return detection(**{**known, **values})


def apart_m(a: Detection, b: Detection) -> float:
    return math.hypot((a.row - b.row) * ROW_M, (a.column - b.column) * COLUMN_M)


def hides(better: Detection, other: Detection, reach_m: float) -> bool:
    """Whether `other` lies in the box that belongs to a better detection: beside it, before it, in and behind its
    shadow.
    """
    along_m = abs(other.row - better.row) * ROW_M
    behind_m = (other.column - better.column) * COLUMN_M
    shadow_m = 0.0 if math.isnan(better.shadow_length_m) else min(better.shadow_length_m, suppress._MAX_SHADOW_M)
    half_m = reach_m
    if "too_large" not in better.reasons:
        half_m = max(reach_m, (better.length_m + reach_m) / 2.0)
    return along_m < half_m and -reach_m < behind_m < reach_m + shadow_m


def slow_pass(detections: list[Detection], config: DetectConfig) -> list[Detection]:
    """Everything at once: flood-fill chains, best first within a chain, then count the neighbours of what is left."""
    link_m = max(suppress._LINK_M, config.suppression_m)
    loose = list(detections)
    result = []
    while loose:
        chain = [loose.pop()]
        grown = True
        while grown:
            near = [
                d
                for d in loose
                if any(apart_m(d, member) <= link_m and stretch(d) == stretch(member) for member in chain)
            ]
            loose = [d for d in loose if not any(d is other for other in near)]
            chain += near
            grown = bool(near)
        kept: list[Detection] = []
        for d in sorted(chain, key=lambda d: (-d.score, d.row, d.column)):
            if not any(hides(better, d, config.suppression_m) for better in kept):
                kept.append(d)
        kept = [
            d for d in kept if not any(across_border(e, d) and hides(e, d, config.suppression_m) for e in detections)
        ]
        rows, columns = [d.row * ROW_M for d in chain], [d.column * COLUMN_M for d in chain]
        extents = (max(rows) - min(rows), max(columns) - min(columns))
        n_large = sum("too_large" in d.reasons for d in chain)
        if (
            len(chain) >= suppress._STRUCTURE_MEMBERS
            and math.hypot(*extents) > config.max_object_m
            and n_large >= suppress._STRUCTURE_LARGE
        ):
            kept = outline(kept, extents)
        result += kept
    return [surrounded(d, detections, config) for d in result]


def stretch(d: Detection) -> float:
    return d.row * ROW_M // suppress._BORDER_M


def across_border(better: Detection, d: Detection) -> bool:
    return stretch(better) != stretch(d) and (-better.score, better.row, better.column) < (-d.score, d.row, d.column)


def outline(kept: list[Detection], extents: tuple[float, float]) -> list[Detection]:
    markers: list[Detection] = []
    alone: list[Detection] = []
    for d in kept:
        if "too_large" not in d.reasons and d.p_mine >= suppress._ALONE_P:
            p = probability(odds_of(d.p_mine) - suppress._BESIDE_STRUCTURE_ODDS)
            alone.append(msgspec.structs.replace(d, p_mine=p, reasons=(*d.reasons, "extended")))
        elif all(apart_m(d, marker) >= suppress._OUTLINE_STEP_M for marker in markers):
            reasons = [*d.reasons, *(code for code in ("too_large", "extended") if code not in d.reasons)]
            length_m, width_m = max(*extents, d.length_m), max(min(extents), d.width_m)
            markers.append(
                msgspec.structs.replace(
                    d, p_mine=suppress._STRUCTURE_P, reasons=tuple(reasons), length_m=length_m, width_m=width_m
                )
            )
    return alone + markers


def surrounded(d: Detection, everything: list[Detection], config: DetectConfig) -> Detection:
    n = sum(
        config.suppression_m < apart_m(d, e) < suppress._SURROUNDINGS_M and e.score >= d.score - suppress._ALIKE
        for e in everything
    )
    reasons = (*d.reasons, "crowded") if n >= suppress._CROWDED else d.reasons
    return msgspec.structs.replace(d, p_mine=probability(odds_of(d.p_mine) - crowding(n)), reasons=reasons)


def fields_of(detections: list[Detection]) -> list[tuple[Any, ...]]:
    """Everything that suppression decides, to the bit, in order of place."""
    return sorted((d.row, d.column, d.score, d.p_mine, d.reasons, d.length_m, d.width_m) for d in detections)


def in_tiles(
    detections: list[Detection], peak_rows: list[float], boundaries: list[float], config: DetectConfig
) -> list[Detection]:
    """What comes out when each detection arrives with the tile whose core its peak lies in."""
    suppressor = Suppressor(config, ROW_M, Counter())
    out: list[Detection] = []
    start = -math.inf
    for stop in [*sorted(boundaries), math.inf]:
        tile = tuple(d for d, peak in zip(detections, peak_rows, strict=True) if start <= peak < stop)
        if math.isfinite(stop):
            settled = suppressor.add(tile, stop)
            assert all(d.row < stop for d in settled)
            assert [d.row for d in settled] == sorted(d.row for d in settled)
            out += settled
        else:
            last = max(peak_rows, default=0.0) + 1.0
            out += suppressor.add(tile, max(last, start))
        start = stop
    return out + suppressor.flush()


def a_pass(seed: int) -> tuple[list[Detection], list[float]]:
    """Random detections in clumps, some long, some with shadows, each with the row of the score peak it came from."""
    random = np.random.default_rng(seed)
    length_m = float(random.uniform(1.0, 120.0))
    detections, peaks = [], []
    for _ in range(int(random.integers(1, 12))):
        centre = random.uniform(0.0, [length_m, 25.0])
        for _ in range(int(random.integers(1, 12))):
            row_m, column_m = centre + random.normal(0.0, random.choice([0.3, 1.5, 4.0]), 2)
            large = random.random() < 0.25
            detection = seen(
                float(row_m),
                float(abs(column_m)),
                score=float(random.choice([3.5, 4.0, 4.2, random.uniform(3.3, 7.0)])),
                p_mine=float(random.uniform(0.001, 0.98)),
                length_m=float(random.uniform(4.0, 8.0) if large else random.uniform(0.1, 3.4)),
                shadow_length_m=float(random.choice([NAN, 0.5, 3.0, 6.0])),
                reasons=("highlight_and_shadow", "too_large") if large else ("no_highlight",),
            )
            detections.append(detection)
            peaks.append(detection.row + float(random.uniform(-1.0, 1.0)) * ROWS_M / ROW_M)
    return detections, peaks


@settings(max_examples=150)
@given(
    seed=st.integers(0, 100_000),
    boundaries=st.lists(st.floats(-60.0, 1100.0), max_size=9),
    suppression_m=st.sampled_from((1.0, 0.3, 3.5)),
)
def test_any_cut_into_tiles_gives_to_the_bit_what_the_whole_pass_at_once_gives(
    seed: int, boundaries: list[float], suppression_m: float
) -> None:
    config = DetectConfig(suppression_m=suppression_m)
    detections, peaks = a_pass(seed)
    assert fields_of(in_tiles(detections, peaks, boundaries, config)) == fields_of(slow_pass(detections, config))


@settings(max_examples=15)
@given(seed=st.integers(0, 100_000))
def test_order_within_a_tile_does_not_matter(seed: int) -> None:
    detections, _ = a_pass(seed)
    shuffled = [detections[k] for k in np.random.default_rng(seed).permutation(len(detections))]
    results = []
    for given_order in (detections, shuffled):
        suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
        results.append(fields_of(suppressor.add(tuple(given_order), 5000.0) + suppressor.flush()))
    assert results[0] == results[1]


def alone(detections: list[Detection]) -> list[Detection]:
    suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
    return suppressor.add(tuple(detections), 0.0) + suppressor.flush()


def test_of_two_echoes_of_one_object_the_better_stays_and_the_other_is_counted() -> None:
    counters: Counter[str] = Counter()
    suppressor = Suppressor(DetectConfig(), ROW_M, counters)
    assert suppressor.add((seen(50.0, 10.0, score=4.0), seen(50.3, 10.4, score=5.0)), 500.0) == []
    (kept,) = suppressor.flush()
    assert kept.score == 5.0
    assert counters["detect.suppressed"] == 1


def test_two_objects_farther_apart_than_the_reach_both_stay() -> None:
    reach_m = DetectConfig().suppression_m
    assert len(alone([seen(50.0, 10.0), seen(50.0 + reach_m + 0.01, 10.0, score=4.0)])) == 2
    assert len(alone([seen(50.0, 10.0), seen(50.0, 10.0 - reach_m - 0.01, score=4.0)])) == 2
    assert len(alone([seen(50.0, 10.0), seen(50.0 + reach_m - 0.01, 10.0, score=4.0)])) == 1


def test_a_shadow_hides_what_lies_in_it_but_not_what_lies_before_the_object() -> None:
    caster = seen(50.0, 10.0, shadow_length_m=2.0)
    assert len(alone([caster, seen(50.0, 12.4, score=4.0)])) == 1
    assert len(alone([caster, seen(50.0, 7.6, score=4.0)])) == 2


def test_a_weak_echo_never_hides_a_strong_one() -> None:
    (kept,) = alone([seen(50.0, 10.0, score=4.0, shadow_length_m=6.0), seen(50.0, 10.9, score=6.0)])
    assert kept.score == 6.0


def test_equals_nearby_lower_the_probability_and_are_said() -> None:
    lone = alone([seen(50.0, 10.0)])[0]
    n_needed = suppress._CROWDED
    ring = [
        seen(50.0 + 5.0 * math.cos(angle), 12.0 + 5.0 * math.sin(angle))
        for angle in 0.5 + np.linspace(0.0, 2.0 * np.pi, n_needed, endpoint=False)
    ]
    field = alone([seen(50.0, 12.0), *ring])
    middle = next(d for d in field if d.row == 50.0 / ROW_M)
    assert lone.p_mine == pytest.approx(0.6)
    assert middle.p_mine < 0.6
    assert "crowded" in middle.reasons
    assert "crowded" not in lone.reasons
    weak = [msgspec.structs.replace(d, score=2.0) for d in ring]
    assert next(d for d in alone([seen(50.0, 12.0), *weak]) if d.score == 5.0).p_mine == pytest.approx(0.6)


def wreck() -> list[Detection]:
    return [
        seen(
            40.0 + 1.5 * k,
            10.0 + 0.1 * k,
            length_m=4.5,
            reasons=("highlight_and_shadow", "too_large"),
            score=4.0 + 0.1 * k,
            p_mine=0.05,
        )
        for k in range(10)
    ]


def test_endless_clutter_comes_out_as_it_goes() -> None:
    """A field where every detection has a neighbour: nothing may wait for its end."""
    field = [seen(0.9 * step, 5.0 + step % 3, score=3.5 + (step * 7 % 11) / 10.0) for step in range(400)]
    suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
    longest_wait_m = 0.0
    for stop_m in range(20, 361, 20):
        stop = stop_m / ROW_M
        suppressor.add(tuple(d for d in field if stop_m - 20.0 <= d.row * ROW_M < stop_m), stop)
        waiting = [d.row for d in suppressor._waiting]
        longest_wait_m = max(longest_wait_m, (stop - min(waiting)) * ROW_M if waiting else 0.0)
    assert longest_wait_m < suppress._BORDER_M + suppress._SURROUNDINGS_M + ROWS_M + 20.0


def test_a_structure_is_reported_by_its_outline_and_its_whole_size() -> None:
    result = alone(wreck())
    assert 3 <= len(result) < 8
    assert all(d.length_m == pytest.approx(13.5) for d in result)
    assert all({"too_large", "extended"} <= set(d.reasons) and len(set(d.reasons)) == len(d.reasons) for d in result)
    assert all(d.p_mine <= suppress._STRUCTURE_P for d in result)
    assert min(apart_m(a, b) for a in result for b in result if a is not b) >= suppress._OUTLINE_STEP_M


def test_a_mine_beside_a_wreck_is_not_lost_in_it() -> None:
    mine = seen(47.0, 8.4, score=5.5, p_mine=0.9, length_m=0.8)
    found = [d for d in alone([*wreck(), mine]) if d.score == 5.5]
    assert len(found) == 1
    assert found[0].p_mine > 0.5
    assert found[0].length_m == 0.8
    assert "extended" in found[0].reasons


def test_nothing_is_final_before_its_surroundings_are_and_everything_is_after_the_flush() -> None:
    suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
    reach_rows = (suppress._SURROUNDINGS_M + ROWS_M) / ROW_M
    detection = seen(12.0, 5.0)
    assert suppressor.add((detection,), detection.row + reach_rows - 0.01) == []
    assert len(suppressor.add((), detection.row + reach_rows + 0.01)) == 1
    assert suppressor.flush() == []
    assert suppressor.add((detection,), 0.0) == []
    assert len(suppressor.flush()) == 1


def test_after_a_flush_nothing_of_the_segment_before_is_remembered() -> None:
    suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
    suppressor.add(tuple(seen(50.0 + 1.2 * k, 10.0) for k in range(9)), 430.0)
    suppressor.flush()
    suppressor.add((seen(62.0, 10.0),), 600.0)
    (after,) = suppressor.flush()
    assert after.p_mine == pytest.approx(0.6)


def test_faint_places_crowd_a_detection_as_detections_do_and_are_forgotten_behind() -> None:
    lone, crowd = seen(50.0, 10.0), [seen(50.0 + 1.2 * k, 14.0) for k in range(1, 6)]
    together = in_tiles([lone, *crowd], [d.row for d in (lone, *crowd)], [], DetectConfig())
    (expected,) = (d for d in together if d.column == lone.column)
    faint = FaintPlaces(*(np.array([getattr(d, name) for d in crowd]) for name in ("row", "column", "strength")))
    suppressor = Suppressor(DetectConfig(), ROW_M, Counter())
    (crowded,) = suppressor.add((lone,), math.inf, faint)
    assert crowded.p_mine == expected.p_mine < lone.p_mine
    (alone,) = suppressor.add((lone,), math.inf)
    assert alone.p_mine == pytest.approx(lone.p_mine)
