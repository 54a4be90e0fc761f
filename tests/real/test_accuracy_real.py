"""A recorded line with embedded targets holds its probability of detection and its false alarms, as shipped.

Measured at p_mine 0.2 with draws 1 to 3 of targets and rocks: 6, 7 and 4 of 8 targets, with 1, 2 and 4 false
alarms, rocks among them, on the 0.0025 km2 of the line; 61 of 80 and 26 over draws 1 to 10. The weights of p_mine were
fitted on simulated missions alone. The floor leaves room for one target and one false alarm more, which rounding and
the order of sums may move across the threshold.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import scattered
from sim_replay.replay import replay
from sim_replay.scoring import score_files

SEED = 1
LINE = "sidescan/scotsman-iver2.xtf"
THRESHOLD = 0.2  # of p_mine


def test_a_line_with_embedded_targets_is_as_accurate_as_it_was(
    shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    embedded = augment(shared_data(LINE), scattered(SEED), tmp_path / "embedded", Config())
    replay([embedded.log], tmp_path / "results", Config())
    point = score_files([tmp_path / "results" / "contacts.geojson", embedded.truth], threshold=THRESHOLD).at_threshold
    assert point.pd.of == 8
    assert point.pd.count >= 5
    assert point.false_alarms.count <= 2
