"""What the source paper's figures flown again, family by family, print."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_replay.fitting.cascade.classical.chips import N_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.extractors import FAMILIES
from sim_replay.fitting.cascade.classical.train_classical import ChipSamples
from sim_replay.simulator.objects import place_objects
from sim_replay.studies.families import (
    EXPERIMENTS,
    FEATURES,
    Experiment,
    image_lines,
    left_out_types,
    models_of,
    odds_of_share,
    table,
)
from sim_replay.studies.paper_candidates import NORMALISED, CutChips, ImageCandidates, TileCandidates
from sim_replay.studies.paper_scenes import TYPES, training_lines

KINDS = ("truncated_cone", "wedge", "cylinder", "rock", "")
N_EACH = 12


def _contrast() -> np.ndarray:
    """Draw chips of every kind, that of nothing last; all but the last two have a highlight and a shadow."""
    random = np.random.Generator(np.random.PCG64(7))
    chips = random.normal(0.0, 0.3, (len(KINDS) * N_EACH, N_ROWS, N_COLUMNS))
    chips[: 3 * N_EACH, 6:11, 8:16] += 2.0
    chips[: 3 * N_EACH, 6:11, 20:32] -= 2.0
    return chips.astype(np.float32)


def _samples() -> ChipSamples:
    kind = tuple("" if kind == "rock" else kind for kind in KINDS for _ in range(N_EACH))
    background = tuple(("flat/1", "flat/2")[index % 2] for index in range(len(kind)))
    return ChipSamples(_contrast(), kind, background, np.ones(len(kind)))


def _image() -> ImageCandidates:
    n = len(KINDS) * N_EACH
    index = np.arange(n)
    index[-N_EACH:] = -1
    return ImageCandidates(
        "flat",
        (
            TileCandidates(
                rows=np.zeros(n, dtype=np.int32),
                columns=np.zeros(n, dtype=np.int32),
                chips={NORMALISED: CutChips(_contrast(), np.ones(n, dtype=np.bool_))},
                detector_odds=np.zeros(n),
                ground_range_m=np.full(n, 20.0),
                object_index=index,
                covers=np.eye(n, dtype=np.bool_),
                on_surface=np.zeros(n, dtype=np.bool_),
                kinds=tuple(kind for kind in KINDS[:-1] for _ in range(N_EACH)),
                is_target=tuple(kind != "rock" for kind in KINDS[:-1] for _ in range(N_EACH)),
                object_range_m=(20.0,) * (n - N_EACH),
                usable_m2=np.full(100, 100.0),
                column_m=1.0,
            ),
        ),
    )


def test_every_family_has_a_block_and_all_together_another() -> None:
    header, rows = table(EXPERIMENTS[0], [_image()], models_of(_samples(), EXPERIMENTS[0].learned))
    assert [row[0] for row in rows] == [name for name in (*FAMILIES, "all six") for _ in range(4)]
    assert all(len(row) == len(header) for row in rows)


def test_objects_and_false_alarms_are_counted_where_the_learned_are_found() -> None:
    header, rows = table(EXPERIMENTS[0], [_image()], models_of(_samples(), EXPERIMENTS[0].learned))
    everything = dict(zip(header, rows[-1], strict=True))
    assert everything["called from"] == "all learned"
    assert everything["B"].startswith("1.00")
    assert everything["C"].startswith("1.00")
    assert everything["rock"].startswith("0.00")
    assert everything["FA/km²"].startswith("0 ")


def test_a_type_left_out_is_judged_by_models_that_learned_the_others() -> None:
    header, rows = left_out_types(_samples(), [_image()])
    assert len(rows) == len(FEATURES)
    assert [name for name in header if "found" in name] == [f"{name} found, not learned" for name in TYPES]


@pytest.mark.parametrize(("share", "odds"), [(0.25, 3.0), (0.5, 2.0), (0.9, -1.0), (1.0, -1.0)])
def test_the_threshold_is_the_odds_of_the_last_object_needed(share: float, odds: float) -> None:
    assert odds_of_share([3.0, 2.0, 0.0, -1.0], 4, share) == odds


def test_objects_never_seen_have_no_threshold_that_finds_them() -> None:
    assert odds_of_share([3.0], 2, 1.0) == -math.inf


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=["first", "second"])
def test_images_hold_the_objects_of_the_paper(experiment: Experiment) -> None:
    placed = place_objects(image_lines(experiment, 1)[0].scene)
    targets = [scene_object.kind for scene_object in placed if scene_object.is_target]
    wanted = {kind: n for kind, n in experiment.objects.items() if kind not in experiment.not_targets}
    assert {kind: targets.count(kind) for kind in wanted} == wanted
    assert len(targets) == sum(wanted.values())


def test_images_are_never_learned_from() -> None:
    learned = {line.scene.seed for line in training_lines(2)}
    assert learned.isdisjoint(line.scene.seed for line in image_lines(EXPERIMENTS[0], 3))
