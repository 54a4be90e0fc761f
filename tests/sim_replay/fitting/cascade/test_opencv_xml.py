from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest

from auv_mcm.detect.cascade.bands import areas, pixel_boxes
from auv_mcm.detect.cascade.model import Calibration, CascadeModel, Stump
from sim_replay.fitting.cascade.boost import BoostedStump
from sim_replay.fitting.cascade.opencv_xml import opencv_cascade
from sim_replay.fitting.cascade.pool import feature_pool, model_stump

POOL = feature_pool()
ROW_M, COLUMN_M = 0.12, 0.06


def _model(kind: Literal["soft", "stages"], seed: int) -> CascadeModel:
    """Stumps that speckle passes about half of the time, with random leaves."""
    rng = np.random.Generator(np.random.PCG64(seed))
    edges = np.array([[1.0 if feature.is_ratio else 0.02] for feature in POOL.features], dtype=np.float32)
    chosen = rng.choice(len(POOL.features), 18, replace=False)
    stumps = [model_stump(POOL, edges, BoostedStump(int(f), 0, *rng.integers(-900, 900, 2).tolist())) for f in chosen]
    return CascadeModel(
        kind=kind,
        trained_on="nothing",
        training_sha256="",
        row_spacing_m=(ROW_M, ROW_M),
        column_spacing_m=(COLUMN_M, COLUMN_M),
        calibration=Calibration(score=(0, 1), log_odds=(0.0, 0.0)),
        reject=(-1500, -600, 0),
        groups=(tuple(stumps[:3]), tuple(stumps[3:9]), tuple(stumps[9:])),
    )


def _holds(stump: Stump, band: int, image: np.ndarray, row: int, column: int) -> bool:
    """Whether a stump's comparison holds at a pixel, in float32, from sums over slices."""
    terms = []
    factors = (1.0, stump.threshold) if stump.w is None else (1.0, 1.0, stump.threshold)
    for box, factor in zip((stump.a, stump.b, *([stump.w] if stump.w else [])), factors, strict=True):
        pixels = pixel_boxes([box], ROW_M, COLUMN_M)[band, 0]
        top, bottom, left, right = pixels.tolist()
        total = int(image[row + top : row + bottom, column + left : column + right].astype(np.int64).sum())
        terms.append(np.float32(total) * np.float32(1.0 / areas(pixels) * factor))
    return bool(terms[0] < terms[1] if stump.w is None else terms[0] - terms[1] < terms[2])


def _passes(model: CascadeModel, band: int, image: np.ndarray, row: int, column: int) -> bool:
    score = 0
    for stumps, reject in zip(model.groups, model.reject, strict=True):
        score = score if model.kind == "soft" else 0
        score += sum(s.below if _holds(s, band, image, row, column) else s.above for s in stumps)
        if score < reject:
            return False
    return True


@pytest.mark.parametrize("kind", ["soft", "stages"])
@pytest.mark.parametrize("band", [0, 7, 16])
def test_opencv_passes_the_windows_that_the_model_passes(
    kind: Literal["soft", "stages"], band: int, tmp_path: Path
) -> None:
    rng = np.random.Generator(np.random.PCG64(band))
    passed, seen = 0, 0
    for seed in range(4):
        model = _model(kind, seed)
        exported = opencv_cascade(model, band, ROW_M, COLUMN_M)
        path = tmp_path / f"{seed}.xml"
        path.write_text(exported.xml)
        classifier = cv2.CascadeClassifier(str(path))
        assert not classifier.empty()
        size = (exported.n_columns, exported.n_rows)
        for _ in range(30):
            image = np.minimum(rng.gamma(1.0, 60.0, (exported.n_rows, exported.n_columns)), 255.0).astype(np.uint8)
            found = len(classifier.detectMultiScale(image, 2.0, 0, minSize=size, maxSize=size)) > 0
            assert found == _passes(model, band, image, exported.centre_row, exported.centre_column)
            passed, seen = passed + found, seen + 1
    assert 0.05 * seen < passed < 0.95 * seen
