"""Measure what normalising shadows is worth to classical detection (source paper, section 4.4.1).

The columns of a chip behind the object are shares of a reference shadow, which grows with range. Here classifiers learn
from such chips, and from the same chips with as many columns of plain metres, up to the reference shadow's median
length or its longest. They are judged out of sample: other seeds, three sea floors that were not learned from, and,
since shadows grow with range, learned near and judged far and the other way round.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Final, TypeAlias

import numpy as np

from sim_replay.fitting.cascade.classical.chips import reference_shadow_m
from sim_replay.fitting.cascade.classical.classical_candidates import Candidates
from sim_replay.fitting.cascade.classical.extractors import FAMILIES, Family
from sim_replay.fitting.cascade.classical.train_classical import ChipSamples, fit_classical_model, merged, samples_at
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import SimulatedLine
from sim_replay.fitting.cascade.training_images import simulated_tiles
from sim_replay.fitting.left_out import Scored, difference, pd_at
from sim_replay.scoring.intervals import proportion
from sim_replay.studies.families import judge_by
from sim_replay.studies.paper_candidates import (
    EVERYWHERE,
    NORMALISED,
    ImageCandidates,
    Judge,
    detected,
    fly_image,
    remembered,
    scored_image,
)
from sim_replay.studies.paper_scenes import add_flight_options, judged_lines, training_lines
from sim_replay.text_tables import columns, markdown, share_cell

_SPLIT_M: Final = 20.0  # m of ground range: about half of the targets lie nearer
_MIDDLE_M: Final = 25.0  # m of ground range, of a swath of 50
_ALTITUDE_M: Final = 6.0  # m above the floor, that of most scenes here
MEDIAN_SHADOW_M: Final = float(reference_shadow_m(np.array(_MIDDLE_M), np.array(_ALTITUDE_M)))
LONGEST_SHADOW_M: Final = float(reference_shadow_m(np.array(2.0 * _MIDDLE_M), np.array(_ALTITUDE_M)))
CUTS: Final[Mapping[str, float | None]] = {
    NORMALISED: None,
    f"metres, up to {MEDIAN_SHADOW_M:.1f} m": MEDIAN_SHADOW_M,
    f"metres, up to {LONGEST_SHADOW_M:.1f} m": LONGEST_SHADOW_M,
}
BANDS_M: Final = {"near": (0.0, _SPLIT_M), "far": (_SPLIT_M, EVERYWHERE[1]), "all": EVERYWHERE}
"""Bands of ground range by name."""
FEATURES: Final[Mapping[str, tuple[Family, ...]]] = {"central": ("central",), "all six": FAMILIES}
_LIMITS_PER_KM2: Final = (300.0, 1000.0)
"""False alarms per km² at which Pd is taken: from what an analyst may look at to what a first stage may pass on."""
_COMPARED_PER_KM2: Final = 1000.0  # false alarms per km² at which differences are given
_JUDGED: Final = {"all": ("all", "near", "far"), "near": ("near", "far"), "far": ("far", "near")}
"""Bands that are judged, by the band that was learned."""

BandSamples: TypeAlias = dict[tuple[str, str], ChipSamples]
"""Samples of a mission by band and cut, near and far."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench shadow`."""
    add_flight_options(parser, "sea floor", 6, 2)


def run(arguments: argparse.Namespace) -> int:
    """Fly, learn, judge and print; return the exit code."""
    farm = Farm(arguments.workers)
    parts = list(run_tasks(banded_samples, training_lines(arguments.missions), farm))
    images = list(run_tasks(partial(fly_image, cuts=CUTS), judged_lines(arguments.images), farm))
    print(f"{len(images)} images, {sum(image.area_km2() for image in images):.3f} km² in all\n")
    print((markdown if arguments.markdown else columns)(*table(parts, images)))
    return 0


def banded_samples(line: SimulatedLine) -> BandSamples:
    """Return the training samples in one mission, by band and cut."""
    found: dict[tuple[str, str], list[ChipSamples]] = {}
    for tile in simulated_tiles(line):
        places, _ = detected(tile, line.config)
        range_m = (places.columns + 0.5) * tile.column_spacing_m
        for band in ("near", "far"):
            low, high = BANDS_M[band]
            inside = (range_m >= low) & (range_m < high)
            some = Candidates(places.rows[inside], places.columns[inside])
            for cut, shadow_m in CUTS.items():
                found.setdefault((band, cut), []).append(samples_at(tile, some, shadow_m))
    return {which: merged(some) for which, some in found.items()}


def table(parts: Sequence[BandSamples], images: Sequence[ImageCandidates]) -> tuple[list[str], list[list[str]]]:
    """Lay out Pd by features, bands learned and judged, and cut, as header and rows.

    Differences are the normalised chips' Pd less that of the row, images drawn again for the interval.
    """
    rows = []
    for (features, families), (learned, bands) in product(FEATURES.items(), _JUDGED.items()):
        judges = {cut: _judge(parts, families, learned, cut) for cut in CUTS}
        for band in bands:
            scores = {
                cut: [scored_image(image, judge, BANDS_M[band]) for image in images] for cut, judge in judges.items()
            }
            rows += [
                [
                    features,
                    learned,
                    band,
                    cut,
                    *(pd_cell(own, limit) for limit in _LIMITS_PER_KM2),
                    "" if cut == NORMALISED else difference_cell(scores[NORMALISED], own, _COMPARED_PER_KM2),
                ]
                for cut, own in scores.items()
            ]
    header = ["features", "learned", "judged", "columns behind the object", *map(pd_words, _LIMITS_PER_KM2)]
    return [*header, f"normalised more by, at {_COMPARED_PER_KM2:g}"], rows


def _judge(parts: Sequence[BandSamples], families: Sequence[Family], learned: str, cut: str) -> Judge:
    bands = ("near", "far") if learned == "all" else (learned,)
    model = fit_classical_model(merged([part[band, cut] for part in parts for band in bands]), families)
    return remembered(partial(judge_by, model, cut=cut))


def pd_words(limit_per_km2: float) -> str:
    """Head a column of Pd."""
    return f"Pd at {limit_per_km2:g} FA/km²"


def pd_cell(scores: Sequence[Scored], limit_per_km2: float) -> str:
    """Write Pd with its interval."""
    n_targets = sum(one.n_targets for one in scores)
    return share_cell(proportion(round(pd_at(scores, limit_per_km2) * n_targets), n_targets))


def difference_cell(one: Sequence[Scored], other: Sequence[Scored], limit_per_km2: float) -> str:
    """Write how much higher the first Pd is, with its interval."""
    more, low, high = difference(one, other, limit_per_km2)
    return f"{more:+.2f} ({low:+.2f} to {high:+.2f})"
