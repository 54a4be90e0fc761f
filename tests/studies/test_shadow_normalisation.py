"""What chips with normalised shadows are compared with."""

from __future__ import annotations

import msgspec
import numpy as np

from sim_replay.fitting.cascade.classical.chips import N_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.train_classical import ChipSamples
from sim_replay.simulator.scene import Lawnmower
from sim_replay.studies.paper_candidates import NORMALISED, CutChips, ImageCandidates, TileCandidates
from sim_replay.studies.paper_scenes import training_lines
from sim_replay.studies.shadow_normalisation import BANDS_M, CUTS, banded_samples, table

N_TARGETS, N_OTHERS = 8, 24
N = N_TARGETS + N_OTHERS


def _chips(seed: int, cut: str) -> np.ndarray:
    """Draw chips whose targets show in the normalised cut alone."""
    random = np.random.Generator(np.random.PCG64(seed))
    chips = random.normal(0.0, 1.0, (N, N_ROWS, N_COLUMNS))
    if cut == NORMALISED:
        chips[:N_TARGETS, 6:11, 8:16] += 2.0
        chips[:N_TARGETS, 6:11, 20:32] -= 2.0
    return chips.astype(np.float32)


def _image() -> ImageCandidates:
    range_m = np.where(np.arange(N) % 2 == 0, 10.0, 30.0)
    return ImageCandidates(
        "flat/9100",
        (
            TileCandidates(
                rows=np.zeros(N, dtype=np.int32),
                columns=np.zeros(N, dtype=np.int32),
                chips={cut: CutChips(_chips(5, cut), np.ones(N, dtype=np.bool_)) for cut in CUTS},
                detector_odds=np.zeros(N),
                ground_range_m=range_m,
                object_index=np.where(np.arange(N) < N_TARGETS, np.arange(N), -1),
                covers=np.eye(N, dtype=np.bool_),
                on_surface=np.zeros(N, dtype=np.bool_),
                kinds=("wedge",) * N_TARGETS,
                is_target=(True,) * N_TARGETS,
                object_range_m=tuple(range_m[:N_TARGETS].tolist()),
                usable_m2=np.full(40, 100.0),
                column_m=1.0,
            ),
        ),
    )


def test_the_normalised_cut_is_compared_with_every_other_in_every_band() -> None:
    kind = ("wedge",) * N_TARGETS + ("",) * N_OTHERS
    part = {
        (band, cut): ChipSamples(_chips(seed, cut), kind, (f"flat/{seed}",) * N, np.ones(N))
        for seed, band in enumerate(("near", "far"))
        for cut in CUTS
    }
    header, rows = table([part], [_image()])
    assert all(len(row) == len(header) for row in rows)
    everywhere = [row for row in rows if row[:3] == ["all six", "all", "all"]]
    assert [row[3] for row in everywhere] == list(CUTS)
    pd = [float(row[header.index("Pd at 300 FA/km²")].split()[0]) for row in everywhere]
    assert pd[0] == 1.0
    assert pd[0] > max(pd[1:])
    assert everywhere[0][-1] == ""
    assert everywhere[1][-1].startswith("+")


def test_bands_part_the_samples_of_a_mission() -> None:
    line = training_lines(1, ("flat",))[0]
    short = msgspec.structs.replace(line.scene.track, plan=Lawnmower(n_legs=1, leg_m=60.0))
    scatter = tuple(msgspec.structs.replace(group, count=min(group.count, 4)) for group in line.scene.scatter)
    scene = msgspec.structs.replace(line.scene, track=short, scatter=scatter)
    parts = banded_samples(line._replace(scene=scene))
    assert set(parts) == {(band, cut) for band in ("near", "far") for cut in CUTS}
    assert BANDS_M["near"][1] == BANDS_M["far"][0]
    for band in ("near", "far"):
        assert len({len(parts[band, cut].weight) for cut in CUTS}) == 1
        assert any(parts[band, NORMALISED].kind)
