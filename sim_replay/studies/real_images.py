"""Measure highlights on real side-scan tiles with a known object, and false confirmations on real images without one.

auv-mcm bench images --data FOLDER [--sheets FOLDER]

FOLDER holds the folders that `real_pictures` describes. The size of a pixel is assumed, and varied where it could
matter.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.classify.odds import MineOdds, shipped_odds
from auv_mcm.records import Detection
from auv_mcm.shell.whole_files import make_directory
from sim_replay.studies.picture_speckle import picture_speckle
from sim_replay.studies.real_calls import CALLED, Called, call, is_call, n_kept
from sim_replay.studies.real_outlines import JudgedOutline, Overlaps, judge_outlines
from sim_replay.studies.real_pictures import EFFIGY_M, Picture, clutter, effigies, length_px, snippets
from sim_replay.studies.real_sheets import write_sheets
from sim_replay.studies.real_tiles import SAS, SIDE_SCAN

FALSE_CALLS: Final = (0.1, 0.2, 0.5, 1.0)
"""Per picture without the object, at which the share of objects called is compared."""
OTHER_SCALES_M: Final = (0.024, 0.042)
SAS_SCALES_M: Final = (0.025, 0.05)

_CONTRASTS_DB: Final = (-math.inf, 3.0, 5.0, 7.0, math.inf)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench images`."""
    parser.add_argument("--data", type=Path, required=True, metavar="FOLDER", help="folder with sdvd_20240429 and sas")
    parser.add_argument("--sheets", type=Path, metavar="FOLDER", help="draw contact sheets there, too")


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code."""
    if chosen.sheets is not None:
        make_directory(chosen.sheets)
    odds = shipped_odds("contrast")
    pictures = effigies(chosen.data)
    _print_pictures(pictures)
    judged = [judge_outlines(picture, SIDE_SCAN, odds) for picture in pictures]
    _print_overlaps(judged)
    _print_scales([picture for picture in pictures if not picture.cut], odds)
    by_tile = [call(picture, SIDE_SCAN, odds) for picture in clutter(chosen.data)]
    print("\nside-scan tiles without the object, each looked at from either side")
    _print_calls(by_tile)
    _print_kept(judged, by_tile)
    by_scale = []
    for pixel_m in SAS_SCALES_M:
        called = [call(picture, SAS._replace(pixel_m=pixel_m), odds) for picture in snippets(chosen.data)]
        print(f"\nsynthetic-aperture snippets, {100.0 * pixel_m:g} cm a pixel")
        _print_calls(called)
        by_scale.append(called)
    if chosen.sheets is not None:
        for path in write_sheets(chosen.sheets, judged, by_scale[0]):
            print(f"written: {path}")
    return 0


def _print_pictures(pictures: Sequence[Picture]) -> None:
    whole = [length_px(picture.mask) for picture in pictures if picture.mask is not None and not picture.cut]
    lower, middle, upper = quartiles(whole)
    print(
        f"{len(pictures)} tiles with the object, {len(whole)} of them whole; {sum(p.inverted for p in pictures)} "
        "recorded inverted"
    )
    print(
        f"whole masks are {lower:.0f}, {middle:.0f}, {upper:.0f} pixels long (quartiles): "
        f"{100.0 * EFFIGY_M / middle:.1f} cm a pixel"
    )
    evidence = [picture_speckle(picture.amplitude) for picture in pictures]
    for name, part in (
        ("skewness", [e.skewness for e in evidence]),
        ("deviation over mean", [e.relative_std for e in evidence]),
    ):
        print(f"speckle's {name} (quartiles): " + ", ".join(f"{value:.2f}" for value in quartiles(part)))


def _print_overlaps(judged: Sequence[JudgedOutline]) -> None:
    names = [name.replace("_", " ") for name in Overlaps._fields]
    heading = "".join(f"{name:>18}" for name in names)
    print(f"\n{'tile':<42}{'cut':>4}{'dB':>6}{'+1 px':>7}{'nodes':>7}{'thresh.':>9}{heading}{'found':>7}{'IoU':>6}")
    for one in sorted(judged, key=lambda j: -j.given.iou.best_start):
        found = "no" if one.found is None else "first" if one.first else "later"
        of_found = "-" if one.found is None else f"{one.found.iou.best_start:.2f}"
        limits = f"{one.contrast_db:>6.1f}{one.one_pixel:>7.2f}{one.few_nodes:>7.2f}{one.best_threshold:>9.2f}"
        values = "".join(f"{value:>18.2f}" for value in one.given.iou)
        print(f"{one.picture.name:<42}{'cut' if one.picture.cut else '':>4}{limits}{values}{found:>7}{of_found:>6}")
    _print_quartiles("whole", [j for j in judged if not j.picture.cut])
    _print_quartiles("cut off", [j for j in judged if j.picture.cut])
    print(f"\n{'contrast, dB':<18}{'tiles':>6}{'thresh.':>9}{heading}   medians, place given, whole and cut off")
    for low, high in pairwise(_CONTRASTS_DB):
        part = [j for j in judged if low <= j.contrast_db < high]
        values = "".join(f"{statistics.median(j.given.iou[k] for j in part):>18.2f}" for k in range(len(names)))
        threshold = statistics.median(j.best_threshold for j in part)
        print(f"{f'{low:g} to {high:g}':<18}{len(part):>6}{threshold:>9.2f}{values}")


def _print_quartiles(title: str, part: Sequence[JudgedOutline]) -> None:
    print(
        f"\n{title}: {len(part)} tiles, {sum(j.detected for j in part)} detected, {sum(j.first for j in part)} as the "
        "most mine-like"
    )
    looked_at = [j.looked_at for j in part if j.looked_at is not None]
    for threshold in CALLED:
        alone, after = (
            sum(one.p_mine >= threshold for one, _ in looked_at),
            sum(is_call(one, threshold) for _, one in looked_at),
        )
        print(f"  called at {threshold:g}: {alone} by the detector alone, {after} after confirmation")
    rejected = sum(one.confirmation is not None and one.confirmation.rejected for _, one in looked_at)
    print(
        f"  {sum(one.confirmation is not None for _, one in looked_at)} looked at closely, contours of {rejected} "
        "rejected"
    )
    rows = [
        ("mask and a pixel more", [j.one_pixel for j in part]),
        ("mask by 16 nodes", [j.few_nodes for j in part]),
        ("best threshold", [j.best_threshold for j in part]),
    ]
    for k, name in enumerate(Overlaps._fields):
        rows.append((f"{name}, place given", [j.given.iou[k] for j in part]))
        rows.append((f"{name}, as detected", [j.found.iou[k] for j in part if j.found is not None]))
    for name, values in rows:
        print(f"  {name.replace('_', ' '):<36}" + "".join(f"{value:>7.2f}" for value in quartiles(values)))


def _print_scales(whole: Sequence[Picture], odds: MineOdds) -> None:
    print("\nmedians over whole tiles, place given, for other sizes of a pixel")
    for pixel_m in OTHER_SCALES_M:
        part = [judge_outlines(picture, SIDE_SCAN._replace(pixel_m=pixel_m), odds) for picture in whole]
        iou = [statistics.median(j.given.iou[k] for j in part) for k in range(len(Overlaps._fields))]
        overlaps = ", ".join(
            f"{name.replace('_', ' ')} {value:.2f}" for name, value in zip(Overlaps._fields, iou, strict=True)
        )
        print(f"  {100.0 * pixel_m:.1f} cm: {overlaps}; {sum(j.detected for j in part)} of {len(part)} detected")


def _print_kept(judged: Sequence[JudgedOutline], called: Sequence[Called]) -> None:
    looked_at = [j.looked_at for j in judged if j.looked_at is not None]
    scores: dict[str, tuple[list[float], list[float]]] = {
        "detector alone": ([one.p_mine for one, _ in looked_at], [d.p_mine for c in called for d in c.detections]),
        "confirmation": ([one.p_mine for _, one in looked_at], [d.p_mine for c in called for d in c.looked_at]),
        "confirmation, rejected left out": (
            [_unless_rejected(one) for _, one in looked_at],
            [_unless_rejected(d) for c in called for d in c.looked_at],
        ),
    }
    print(
        f"\nobjects called of {len(judged)}, by false calls per tile without one"
        + "".join(f"{rate:>8g}" for rate in FALSE_CALLS)
    )
    for name, (of_object, of_none) in scores.items():
        kept = "".join(f"{n_kept(of_object, of_none, round(rate * len(called))):>8}" for rate in FALSE_CALLS)
        print(f"  {name:<58}{kept}")


def _unless_rejected(detection: Detection) -> float:
    return detection.p_mine if is_call(detection, 0.0) else 0.0


def _print_calls(called: Sequence[Called]) -> None:
    heading = "".join(f"{f'alone {p:g}':>12}{f'looked {p:g}':>12}" for p in CALLED)
    print(f"{'picture':<22}{'detections':>11}{heading}")
    for one in called:
        counts = "".join(f"{one.n_detector(p):>12}{one.n_confirmed(p):>12}" for p in CALLED)
        print(f"{one.picture.name:<22}{len(one.detections):>11}{counts}")
    means = "".join(
        f"{statistics.fmean(count(c, p) for c in called):>12.2f}"
        for p in CALLED
        for count in (Called.n_detector, Called.n_confirmed)
    )
    print(f"{'mean per picture':<22}{statistics.fmean(len(c.detections) for c in called):>11.1f}{means}")


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Return lower quartile, median, upper quartile."""
    lower, middle, upper = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    return lower, middle, upper
