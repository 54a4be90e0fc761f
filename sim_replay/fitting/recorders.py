"""Name kinds of recorders that scenes are recorded with, so that odds can be judged on each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import msgspec

from sim_replay.simulator.scene import SampleRecorder, Scene


class Recorder(NamedTuple):
    """Set how echoes are stored, and how many looks are averaged before."""

    looks: int
    recorder: SampleRecorder


RECORDERS: Final[Mapping[str, Recorder]] = {
    "8-bit amplitude": Recorder(1, SampleRecorder(samples="amplitude_uint8", seabed_counts=20.0)),
    "log 0.3 dB": Recorder(1, SampleRecorder(samples="log_uint8", db_per_count=0.3, seabed_counts=110.0)),
    "log 0.4 dB, 4 looks": Recorder(4, SampleRecorder(samples="log_uint8", db_per_count=0.4, seabed_counts=110.0)),
}
RECORDED_SCENES: Final = ("flat", "ripple")
"""Scenes that each recorder of RECORDERS records."""


def recorded_by(scene: Scene, how: Recorder) -> Scene:
    """Give a scene another recorder."""
    sonar = msgspec.structs.replace(scene.sonar, looks=how.looks, recorder=how.recorder)
    return msgspec.structs.replace(scene, sonar=sonar)
