"""One steady leg over bare sand past objects, described exactly: whatever the chain reports must lie where the scene
has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from auv_mcm.records import NavSample, SourceEvent
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import (
    EXACT,
    STEADY,
    Lawnmower,
    Motion,
    Origin,
    SampleRecorder,
    Scene,
    SceneObject,
    Seabed,
    Sonar,
    Track,
    World,
)

BARE = World(
    depth_m=25.0,
    seabeds=(Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0),),
    relief_rms_m=0.0,
    backscatter="lambert",
)

SONAR = Sonar(
    range_m=22.0,
    n_samples=512,
    ping_rate_hz=12.0,
    range_resolution_m=0.0,
    beam_lines=3,
    recorder=SampleRecorder(samples="amplitude_float32", seabed_counts=3000.0, full_scale=32767),
)


def one_leg(
    objects: Iterable[SceneObject],
    sonar: Sonar,
    *,
    length_m: float,
    altitude_m: float,
    latitude_deg: float = 50.0,
    longitude_deg: float = -4.0,
    heading_deg: float = 0.0,
    speed_mps: float = 1.8,
    motion: Motion = STEADY,
    seed: int = 3,
) -> Scene:
    """The leg starts at the place given."""
    plan = Lawnmower(heading_deg=heading_deg, n_legs=1, leg_m=length_m)
    return Scene(
        seed=seed,
        origin=Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg),
        world=BARE,
        objects=tuple(objects),
        sonar=sonar,
        track=Track(plan=plan, altitude_m=altitude_m, speed_mps=speed_mps, motion=motion),
        navigation_error=EXACT,
    )


def flown(scene: Scene) -> tuple[SourceEvent, ...]:
    """Yield everything that the payload receives."""
    return tuple(Mission(scene).events())


def with_late_navigation(events: Sequence[SourceEvent]) -> list[SourceEvent]:
    """In bursts, as links deliver them: the navigation of each behind its pings."""
    late: list[SourceEvent] = []
    for start in range(0, len(events), 14):
        late += sorted(events[start : start + 14], key=lambda event: isinstance(event, NavSample))
    return late
