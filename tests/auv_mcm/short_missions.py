"""One steady leg over bare sand past objects, described exactly: whatever the chain reports must lie where the scene
has it.
"""

from __future__ import annotations

from collections.abc import Iterable

from auv_mcm.records import SourceEvent
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import (
    EXACT,
    STEADY,
    Lawnmower,
    Motion,
    Origin,
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
