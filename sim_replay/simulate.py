"""Fly a scene and write what it recorded: an XTF log, and the truth beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.records import NavSample, Ping
from auv_mcm.shell.whole_files import make_directory, write_json
from sim_replay.arguments import refuse_other_log
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.recording import sample_type
from sim_replay.simulator.scene import Scene, Track

LOG_NAME: Final = "mission.xtf"
TRUTH_NAME: Final = "truth.json"


class Simulated(NamedTuple):
    """Count what was written."""

    log: Path
    truth: Path
    n_pings: int
    duration_s: float
    area_km2: float
    n_objects: int
    n_targets: int


def simulate(
    scene: Scene, out: Path, *, threads: int = 1, progress: Callable[[float], None] = lambda fraction: None
) -> Simulated:
    """Write mission.xtf and truth.json into `out`, made if it is not there.

    Equal scenes give equal bytes, whatever the threads.

    progress: called with the fraction flown, 0..1. Raises UsageError for a scene that cannot be or a directory that
    cannot be made.
    """
    folder = make_directory(out)
    refuse_other_log(folder / LOG_NAME, folder / TRUTH_NAME)
    mission = Mission(scene, threads=threads)
    expected_s = _expected_s(scene.track)
    last_s = scene.track.start_time_s

    def watched() -> Iterator[NavSample | Ping]:
        nonlocal last_s
        for event in mission.events():
            if isinstance(event, Ping):
                last_s = event.time_s - _stepped_s(scene, event)
                progress(min(1.0, (last_s - scene.track.start_time_s) / expected_s))
            yield event
        (folder / TRUTH_NAME).unlink(missing_ok=True)  # it belongs to the log that is replaced now

    log = folder / LOG_NAME
    n_pings = write_xtf(
        log, watched(), sample_type=sample_type(mission.sea.recorder), frequency_khz=scene.sonar.frequency_khz
    )
    facts = mission.truth()
    write_json(folder / TRUTH_NAME, facts)
    return Simulated(
        log=log,
        truth=folder / TRUTH_NAME,
        n_pings=n_pings,
        duration_s=last_s - scene.track.start_time_s,
        area_km2=facts["area_km2"],
        n_objects=len(facts["objects"]),
        n_targets=sum(one["is_target"] for one in facts["objects"]),
    )


def _stepped_s(scene: Scene, ping: Ping) -> float:
    """Sum up by how much faults moved the clock until a ping, s."""
    return sum(one.step_s for one in scene.faults if one.kind == "clock_step" and one.at_ping <= ping.number)


def _expected_s(track: Track) -> float:
    """Estimate how long the plan takes, s."""
    legs = planned_legs(track.plan)
    turning_s = 2.0 * math.pi / math.radians(track.turn_rate_deg_s)
    return sum(leg.length_m for leg in legs) / track.speed_mps + turning_s * (len(legs) - 1)
