"""Draw what is embedded in a recorded line to judge by, and check that the line has room for it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from auv_mcm.settings.config import Config
from sim_replay.augment.background_log import read_survey
from sim_replay.augment.targets import ScatteredTargets, TargetSpec, place_targets
from sim_replay.augment.track import track_of
from sim_replay.logs.open_log import open_log

_TARGETS_PER_LINE: Final = 8  # and as many rocks
_APART_M: Final = 5.0  # m between embedded objects, minimum


def scattered(seed: int) -> TargetSpec:
    """Draw targets and as many rocks over a recorded line."""
    targets = ScatteredTargets(
        kinds=("cylinder", "sphere", "truncated_cone", "wedge", "box"),
        count=_TARGETS_PER_LINE,
        apart_m=_APART_M,
        is_target=True,
    )
    rocks = ScatteredTargets(kinds=("rock",), count=_TARGETS_PER_LINE, apart_m=_APART_M, is_target=False)
    return TargetSpec(seed=seed, scatter=(targets, rocks))


def check_lines(logs: Sequence[Path], seeds: Sequence[int]) -> None:
    """Reject recorded lines that cannot be read or have no room for the objects of a seed, before any mission is flown.

    Raises BadInputError or UsageError, as augment does.
    """
    for log in logs:
        open_log(log, Config())
        track = track_of(read_survey(log, Config()), Config())
        for seed in seeds:
            place_targets(scattered(seed), track)
