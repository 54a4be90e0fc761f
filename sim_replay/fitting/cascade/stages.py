"""Train one stage of a Viola-Jones cascade: stumps of AdaBoost until nearly all targets pass and few others do.

Sources: P. Viola, M. Jones, Int. J. Computer Vision 57(2), 2004, table 2; goals of 99 % and 50 % for each stage as in
"Target recognition in synthetic aperture and high resolution side-scan sonar", sec. 4.4.2.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.fitting.cascade.boost import Bins, BoostedStump, ada_stumps

DETECTION: Final = 0.99  # share of targets that each stage keeps (Viola and Jones 2004)
FALSE_ALARMS: Final = 0.5  # share of clutter that each stage keeps, maximum (Viola and Jones 2004)
_MAX_STUMPS: Final = 200  # of a stage; bounds time


class Stage(NamedTuple):
    """Hold stumps, the score below which a window is dropped, and the shares of the samples judged on that pass."""

    stumps: tuple[BoostedStump, ...]
    reject: int
    detection: float
    false_alarms: float


class StageSamples(NamedTuple):
    """Hold samples of one stage. bins: (n_features, n_samples) uint8. is_target: (n_samples,) bool."""

    bins: Bins
    is_target: NDArray[np.bool_]


def train_stage(learned: StageSamples, judged: StageSamples, rng: np.random.Generator) -> Stage:
    """Train the shortest stage that meets both goals on held-out samples, or the longest allowed if none does.

    Raises ValueError if either set lacks targets or others.
    """
    n_targets = int(np.count_nonzero(judged.is_target))
    if not 0 < n_targets < judged.is_target.size:
        raise ValueError(
            f"{n_targets} targets among {judged.is_target.size} samples to judge by: there must be some, and something "
            "else"
        )
    stumps: list[BoostedStump] = []
    score = np.zeros(judged.is_target.size, dtype=np.int32)
    reject, false_alarms = 0, 1.0
    for stump in ada_stumps(learned.bins, learned.is_target, _MAX_STUMPS, 1.0, rng):
        stumps.append(stump)
        score += stump.scores(judged.bins)
        reject = threshold(score[judged.is_target], DETECTION)
        false_alarms = float(np.mean(score[~judged.is_target] >= reject))
        if false_alarms <= FALSE_ALARMS:
            break
    return Stage(tuple(stumps), reject, float(np.mean(score[judged.is_target] >= reject)), false_alarms)


def threshold(score: NDArray[np.int32], detection: float) -> int:
    """Find the highest threshold that this share of the scores (n,) or more reaches."""
    n_lost = int((1.0 - detection) * score.size + 1e-9)
    return int(np.sort(score)[n_lost])
